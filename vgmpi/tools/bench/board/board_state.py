"""State of a run of the board and what records it; it needs numpy alone."""

from typing import NamedTuple, Protocol

import numpy as np

GRAVITY = 9.8  # [m/s2]
Edges = tuple[float, float, float]  # [m] of a box, or its lower corner


class BoardState(NamedTuple):
    """State of all particles.

    Attributes:
        t: Time [s].
        x: Positions from the tank's corner, shape (n, 3) [m].
        v: Velocities, shape (n, 3) [m/s].
    """

    t: float
    x: np.ndarray
    v: np.ndarray


class Measure(Protocol):
    """Record of a run, from which its error follows."""

    def record(self, now: BoardState) -> None:
        """Record a state."""

    def result(self) -> dict[str, float]:
        """Return the quantities of the run; `error`, if there is one, is compared."""
