"""Sides of thin walls: particles on the far side of a wall are in groups of their own.

A particle keeps its side while it is close to a wall. It takes the side on which it is when it
comes close, and wherever it passes the edge of a wall. Far from walls the side does not matter.
"""

import numpy as np

from vgmpi.kernels.rigid.moving_colliders import MovingColliders
from vgmpi.kernels.rigid.shell_sampling import (
    EDGE,
    NEAR_EDGE,
    WALL_BAND_CELLS,
    SampledShells,
    find_sides,
)
from vgmpi.parallel.block_lattice import BLOCK_EDGE
from vgmpi.parallel.migration import append_particles
from vgmpi.parallel.particle_group import ParticleGroup
from vgmpi.planning.plan import Plan

from .flow_accounting import Tally
from .outlets import remove

CHECK_INTERVAL = 4  # [steps] after which the sides of particles are compared with their places
# [cells] depth on the other side of a wall beyond which a particle did not come through the wall
MAX_CREEP_CELLS = 1.5
URGENT_CELLS = 4.0  # [cells] distance from a wall below which a particle must change its side
_STRAY_CELLS = 3.0  # [cells] distance of a particle from the center of its block


class WallSides:
    """Sides of the particles of this rank."""

    def __init__(self, plan: Plan, movers: MovingColliders, groups: list, tally: Tally | None):
        """Take the groups that have two sides.

        Args:
            plan: Plan of the run; it has thin walls.
            movers: Colliders.
            groups: Particle groups of this rank.
            tally: Account of open boundaries, or None.
        """
        assert plan.sides is not None
        self.dx, self.movers, self.groups, self.tally = plan.dx, movers, groups, tally
        self.twin = plan.sides.twin_group
        self.side = [plan.sides.side[group.phase] for group in plan.groups]

    def groups_of_points(self, group_of: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return the groups (n,) of new particles, given those on the near side of walls.

        Args:
            group_of: Groups on the near side, shape (n,).
            x: Positions, shape (n, 3) [m].
        """
        middle, kinds = self._find(x)
        twin = np.array(self.twin)[group_of]
        return np.where((kinds > 0) & (middle < 0.0) & (twin >= 0), twin, group_of)

    def must_change(self, step: int, time: float) -> bool:
        """Return whether a particle of this rank must change its side now.

        Args:
            step: Number of the step that has just ended.
            time: Time at its end [s].
        """
        if step % CHECK_INTERVAL:
            return False
        self.movers.stand(time)
        return any(self._leavers(g, urgent=True)[1] for g in self._sided_groups())

    def change(self, needed: float, time: float) -> bool:
        """Move particles whose side has changed by a time [s], if a particle of any rank must.

        Args:
            needed: Largest result of `must_change` of all ranks.
            time: Time [s].

        Returns:
            Whether particles have moved to other groups, so that a sort must follow.
        """
        if not needed:
            return False
        self.movers.stand(time)
        moved = [(g, self._leavers(g, urgent=False)[0]) for g in self._sided_groups()]
        moved = [(g, indices) for g, indices in moved if len(indices)]
        rows = []
        for g, indices in moved:  # all leave before any arrives
            group = self.groups[g]
            block = group.block[group.segment_of(indices)]
            rows.append((block, group.xi[:, indices], group.f[:, indices], group.ids[indices]))
        for g, indices in moved:
            remove(self.groups[g], indices)
        for (g, _), row in zip(moved, rows, strict=True):
            append_particles(self.groups[self.twin[g]], *row)
            if self.tally is not None:
                volume = row[2][self.groups[g].plan.channels["vol0"].first]
                self.tally.transfer(g, self.twin[g], volume)
        return True

    def _sided_groups(self) -> list[int]:
        """Return the groups that have two sides."""
        return [g for g, twin in enumerate(self.twin) if twin >= 0]

    def _find(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return distance from the middle of the closest wall [m] and kind of points (n, 3) [m]."""
        table = self.movers.table
        assert isinstance(table, SampledShells)
        middle, kinds = np.empty(len(x)), np.empty(len(x), np.int8)
        find_sides(np.ascontiguousarray(x), table, middle, kinds)
        return middle, kinds

    def _leavers(self, g: int, urgent: bool) -> tuple[np.ndarray, bool]:
        """Return the particles of a group that change their side, and whether any must do so now.

        Args:
            g: Number of the group.
            urgent: Leave out those that have time.
        """
        group = self.groups[g]
        index = group.places(np.flatnonzero(self._near_walls(group) & (group.count > 0)))
        middle, kinds = self._find(group.positions_at(index))
        depth = -self.side[g] * middle / self.dx  # [cells] on the other side
        crossed = (kinds > 0) & (depth > np.where(kinds >= NEAR_EDGE, 0.0, MAX_CREEP_CELLS))
        hurried = crossed & (kinds != EDGE) & (depth < URGENT_CELLS)
        must = bool(hurried.any())
        if urgent:
            return index[hurried], must
        if self.side[g] < 0:
            crossed |= kinds == 0
            others = np.flatnonzero(~self._near_walls(group) & (group.count > 0))
            return np.sort(np.concatenate([index[crossed], group.places(others)])), must
        return index[crossed], must

    def _near_walls(self, group: ParticleGroup) -> np.ndarray:
        """Return whether the segments of a group may hold particles close to a wall."""
        table, dx = self.movers.table, self.dx
        assert isinstance(table, SampledShells)
        center = (BLOCK_EDGE * group.block + 0.5 * (BLOCK_EDGE - 1)) * dx
        out = np.zeros(len(center), bool)
        reach = (np.sqrt(3.0) * _STRAY_CELLS + 1.0) * dx
        for m in np.flatnonzero(table.shell_first >= 0):
            x, r = center - table.about[m] - table.move[m], table.rotation[m]
            own = x[:, :1] * r[0] + x[:, 1:2] * r[1] + x[:, 2:] * r[2] + table.about[m]
            low = table.shell_start[m] - reach
            high = table.shell_start[m] + table.shell_shape[m] * table.spacing + reach
            out |= ((own > low) & (own < high)).all(1)
        return out


def wall_sides(plan: Plan, movers, groups: list, tally: Tally | None) -> WallSides | None:
    """Return the sides of a scene's thin walls, or None without thin walls.

    Args:
        plan: Plan of the run.
        movers: Colliders, or None.
        groups: Particle groups of this rank.
        tally: Account of open boundaries, or None.
    """
    if plan.sides is None or movers is None:
        return None
    return WallSides(plan, movers, groups, tally)
