"""Drag as VersaGauss prints it, for comparison.

The exchange at a node is c m_s m_w / (m_s + m_w), without the time step and of no consistent unit:
the slip loses the same share in a step of any length, so that half the step doubles the drag. It is
solved implicitly here as well, since the printed form has no stable step of its own.
"""

from typing import ClassVar, Literal

from .base import coupling
from .drag import Drag


@coupling
class DragPaper(Drag):
    """Drag by the paper's printed equations: for comparison only."""

    kind: Literal["drag-paper"]  # type: ignore[assignment]

    printed: ClassVar = True
