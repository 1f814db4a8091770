"""Drag as published by VersaGauss, for comparison.

The exchange at a node is c m_s m_w / (m_s + m_w), without the time step and of no consistent unit:
the slip loses the same fraction in a step of any length, so that half the step doubles the drag. It
is solved implicitly here as well, since the published form has no stable step of its own.
"""

from typing import ClassVar, Literal

from .drag import Drag
from .interaction import coupling


@coupling
class DragPaper(Drag):
    """Drag by the paper's printed equations: for comparison only."""

    kind: Literal["drag-versagauss"]  # type: ignore[assignment]

    printed: ClassVar = True
