"""Mixing as published by VersaGauss, for comparison.

The drift has the other sign, which un-mixes, and both fluids move with the mean velocity before
their share of the force acts: so their slip is proportional to the time step.
"""

from typing import ClassVar, Literal

from .interaction import coupling
from .mixing import Mixing


@coupling
class MixingPaper(Mixing):
    """Mixing by the paper's printed equations: for comparison only."""

    kind: Literal["mixing-versagauss"]  # type: ignore[assignment]

    printed: ClassVar = True
