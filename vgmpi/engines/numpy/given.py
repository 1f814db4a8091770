"""What colliders and walls give to bodies in a step, on dense arrays: see kernels/given.py."""

import numpy as np

from ...kernels.given import NUMBERS, WALLS
from ...planning.plan import Plan
from .dense import Dense


class Given:
    """sums: (rows, 7) impulse, its moment about the domain's origin and work, of colliders and then
    of walls."""

    def __init__(self, plan: Plan, dense: Dense, rows: int, quanta: np.ndarray):
        self.plan, self.rows, self.quanta = plan, rows, quanta
        self.points = dense.points().reshape(*dense.shape, 3)
        self.sums = np.zeros((rows, NUMBERS))
        self.mass: dict[tuple, np.ndarray] = {}  # by phase and wall: own mass of the nodes beyond

    def shares(self, dt: float) -> tuple[float, float]:
        """How much of what mirrors of momentum, and of the velocity's change, do reaches particles
        in a step of dt [s], or of no time."""
        keeps = self.plan.keeps
        kept = 0.0 if keeps is None or not dt else keeps.over(dt)
        return 1.0 - kept if dt else -float(self.plan.restores), kept

    def taken(self) -> np.ndarray:
        """The sums, as whole numbers of the quanta; they begin anew."""
        found = np.rint(self.sums / self.quanta).astype(np.int64)
        self.sums[:] = 0.0
        return found

    def add(self, row: int, at: np.ndarray, push: np.ndarray, work: float = 0.0) -> None:
        """Impulses (..., 3) [kg m/s] at places (..., 3) [m]."""
        both = push, np.cross(at, push)
        parts = [part.reshape(-1, 3).sum(0) for part in both]
        self.sums[row] += np.concatenate([*parts, [work]])

    def on_wall(self, axis: int, wall: int, push: np.ndarray, plane: int | None = None) -> None:
        """Impulses (n, m, 3) at a wall's nodes, or those of another plane."""
        at = np.moveaxis(self.points, axis, 0)
        at = at[wall if plane is None else plane].copy()
        at[..., axis] = np.moveaxis(self.points, axis, 0)[wall][..., axis]
        self.add(self.rows - WALLS + 2 * axis + (wall != 1), at, push)


class Teller:
    """Tells Given what walls do to a phase: an argument of Dense.fold, constrain and mirror."""

    def __init__(self, given: Given, phase: int, share: float, mass: np.ndarray | None = None):
        """share: of what is told, how much reaches particles; mass: of the phase at the nodes, for
        constrain."""
        self.given, self.phase, self.share, self.mass = given, phase, share, mass

    def folded(self, axis: int, wall: int, momentum: np.ndarray, by: np.ndarray) -> None:
        """Momentum (n, m, 3) beyond a wall is folded as its mirror has it."""
        self.given.on_wall(axis, wall, self.share * (by - 1.0) * momentum)

    def weighed(self, axis: int, wall: int, mass: np.ndarray) -> None:
        """Own mass of the nodes beyond a wall, (n, m, 1)."""
        self.given.mass[self.phase, axis, wall] = mass.copy()

    def stopped(self, axis: int, wall: int, plane: int, change: np.ndarray) -> None:
        """Velocities of a plane of nodes have changed."""
        assert self.mass is not None
        here = np.moveaxis(self.mass, axis, 0)[plane]
        self.given.on_wall(axis, wall, here[..., None] * change)

    def mirrored(self, axis: int, wall: int, change: np.ndarray) -> None:
        """What particles gather beyond a wall differs from where its momentum went."""
        mass = self.given.mass[self.phase, axis, wall]
        self.given.on_wall(axis, wall, self.share * mass * change)
