"""Reaction impulses of colliders and walls, on dense arrays; see kernels/reaction_impulses.py."""

import numpy as np

from vgmpi.kernels.reaction_impulses import NUMBERS, WALLS
from vgmpi.planning.plan import Plan

from .dense_grid import Dense


class ReactionSums:
    """Sums of the reactions, shape (rows, 7): colliders, then walls.

    A row holds the impulse, its moment about the domain's origin, and the work.
    """

    def __init__(self, plan: Plan, dense: Dense, rows: int, quanta: np.ndarray):
        self.plan, self.rows, self.quanta = plan, rows, quanta
        self.points = dense.points().reshape(*dense.shape, 3)
        self.sums = np.zeros((rows, NUMBERS))
        self.mass: dict[tuple, np.ndarray] = {}  # (phase, axis, wall) -> own mass beyond

    def mirror_shares(self, dt: float) -> tuple[float, float]:
        """Return how much of the mirror's change of momentum and of velocity reaches particles.

        dt: length of the step [s], 0 for a step of no time.
        """
        retained = self.plan.retained_share(dt) if dt else 0.0
        return 1.0 - retained if dt else -float(self.plan.correction_interval), retained

    def take(self) -> np.ndarray:
        """Return the sums in integer multiples of the quanta, and reset them."""
        totals = np.rint(self.sums / self.quanta).astype(np.int64)
        self.sums[:] = 0.0
        return totals

    def add(self, row: int, position: np.ndarray, impulse: np.ndarray, work: float = 0.0) -> None:
        """Add impulses and their moments to a row.

        Args:
            row: Collider or wall.
            position: Positions, shape (..., 3) [m].
            impulse: Impulses, shape (..., 3) [kg m/s].
            work: Work [J].
        """
        vectors = impulse, np.cross(position, impulse)
        totals = [part.reshape(-1, 3).sum(0) for part in vectors]
        self.sums[row] += np.concatenate([*totals, [work]])

    def on_wall(self, axis: int, wall: int, impulse: np.ndarray, plane: int | None = None) -> None:
        """Add impulses at the nodes of a wall.

        Args:
            axis: Axis across the wall.
            wall: Plane of the wall's nodes.
            impulse: Impulses, shape (n, m, 3) [kg m/s].
            plane: Plane of the nodes where the impulses act, if not the wall's.
        """
        position = np.moveaxis(self.points, axis, 0)
        position = position[wall if plane is None else plane].copy()
        position[..., axis] = np.moveaxis(self.points, axis, 0)[wall][..., axis]
        self.add(self.rows - WALLS + 2 * axis + (wall != 1), position, impulse)


class WallRecorder:
    """Records reactions of walls on a phase; argument of Dense.fold, constrain and mirror."""

    def __init__(
        self, sums: ReactionSums, phase: int, share: float, mass: np.ndarray | None = None
    ):
        """Create a recorder.

        Args:
            sums: Sums to which reactions are added.
            phase: Velocity field.
            share: Fraction of the recorded impulse that reaches particles.
            mass: Nodal masses of the phase, for `constrain`.
        """
        self.sums, self.phase, self.share, self.mass = sums, phase, share, mass

    def record_fold(self, axis: int, wall: int, momentum: np.ndarray, sign: np.ndarray) -> None:
        """Record the momentum beyond a wall that is folded to its mirror image.

        Args:
            axis, wall: Axis and plane of the wall.
            momentum: Momentum beyond, shape (n, m, 3) [kg m/s].
            sign: Factors of the mirror, shape (3,).
        """
        self.sums.on_wall(axis, wall, self.share * (sign - 1.0) * momentum)

    def record_mass(self, axis: int, wall: int, mass: np.ndarray) -> None:
        """Store the own mass of the nodes beyond a wall.

        Args:
            axis, wall: Axis and plane of the wall.
            mass: Masses, shape (n, m, 1) [kg].
        """
        self.sums.mass[self.phase, axis, wall] = mass.copy()

    def add_mass(self, axis: int, wall: int, unfolded: np.ndarray, folded: np.ndarray) -> None:
        """Add to the own mass of the nodes beyond a wall that lets go.

        Args:
            axis, wall: Axis and plane of the wall.
            unfolded, folded: Masses that stay and that were folded back, shape (n, m, 1) [kg].
        """
        for key, mass in (
            ((self.phase, axis, wall), unfolded),
            ((self.phase, axis, -wall), folded),
        ):
            self.sums.mass[key] = self.sums.mass.get(key, 0.0) + mass

    def record_folded(self, axis: int, wall: int, change: np.ndarray) -> None:
        """Record the difference of velocity that folded-back mass gathers beyond a wall.

        Args:
            axis, wall, change: See `record_mirror`.
        """
        mass = self.sums.mass.get((self.phase, axis, -wall), 0.0)
        self.sums.on_wall(axis, wall, self.share * mass * change)

    def record_constraint(self, axis: int, wall: int, plane: int, change: np.ndarray) -> None:
        """Record a velocity constraint.

        Args:
            axis, wall: Axis and plane of the wall.
            plane: Plane of nodes whose velocities have changed.
            change: Change of velocity, shape (n, m, 3) [m/s].
        """
        assert self.mass is not None
        plane_mass = np.moveaxis(self.mass, axis, 0)[plane]
        self.sums.on_wall(axis, wall, plane_mass[..., None] * change)

    def record_mirror(self, axis: int, wall: int, change: np.ndarray) -> None:
        """Record the difference of velocity that particles gather beyond a wall.

        Args:
            axis, wall: Axis and plane of the wall.
            change: Difference from the velocity to which the momentum went, shape (n, m, 3) [m/s].
        """
        mass = self.sums.mass.get((self.phase, axis, wall), 0.0)
        self.sums.on_wall(axis, wall, self.share * mass * change)
