"""Sides of thin walls: particles on the back side of a wall are in groups of their own.

A particle keeps its side while it is close to a wall. It takes the side on which it is when it
comes close, and wherever it passes the edge of a wall. Far from walls the side does not matter.
Nodes outside a wall let particles approach it a little, so that some would creep through within
thousands of steps: those inside a wall are pushed out.
"""

from typing import Any

import numpy as np

from vgmpi.features.active_feature import ActiveFeature, StartContext
from vgmpi.features.particle_insertion import remove_particles
from vgmpi.kernels.colliders.moving_colliders import MovingColliders
from vgmpi.kernels.grid.divided_nodes import Phases
from vgmpi.kernels.step_records import StepMaxima, StepSpan
from vgmpi.parallel.block_lattice import BLOCK_EDGE, position_limits
from vgmpi.parallel.migration import append_particles
from vgmpi.parallel.particle_group import ParticleGroup

from .kernels import EDGE, NEAR_EDGE, SampledShells, SidedPhases, find_sides
from .plan import ThinWallsPlan

CHECK_INTERVAL = 4  # [steps] after which the sides of particles are compared with their places
# [cells] depth on the other side of a wall beyond which a particle did not come through the wall
MAX_CREEP_CELLS = 1.5
MAX_PUSH_CELLS = 0.05  # [cells] largest distance by which a particle is pushed out of a wall
URGENT_CELLS = 4.0  # [cells] distance from a wall below which a particle must change its side
_STRAY_CELLS = 3.0  # [cells] distance of a particle from the center of its block


class ThinWalls(ActiveFeature):
    """Sides of the particles of this rank."""

    has_request = True
    margin = MAX_PUSH_CELLS

    def __init__(self, own: ThinWallsPlan, context: StartContext):
        """Take the groups that have two sides.

        Args:
            own: Plan of the walls.
            context: What a feature may take when a run starts.
        """
        plan, self.plan = context.plan, own
        self.dx, self.cells = plan.dx, plan.cells
        self.rows = np.array(own.side), np.array(own.twin)  # of the phases
        self.features = context.features
        self.movers: MovingColliders = context.movers
        self.groups = context.groups
        self.twin = own.twin_group
        self.side = [own.side[group.phase] for group in plan.groups]

    def divide_phases(self, phases: Phases) -> SidedPhases:
        """Return the constants of the phases with the walls where they are now."""
        table = self.movers.table
        assert isinstance(table, SampledShells)
        return SidedPhases._make((*phases, *self.rows, self.movers.nodes, table.faces))

    def divide_dense_nodes(self, dense: Any) -> Any:
        """Return the sides of the walls on dense arrays.

        Args:
            dense: See `ActiveFeature.divide_dense_nodes`.
        """
        from .reference import WallSides

        return WallSides(self.plan, self.movers, dense)

    def assign_groups(self, group_of: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return the groups (n,) of new particles, given those on the front side of walls.

        Args:
            group_of: Groups on the front side, shape (n,).
            x: Positions, shape (n, 3) [m].
        """
        middle, kinds, _ = self._find(x)
        twin = np.array(self.twin)[group_of]
        return np.where((kinds > 0) & (middle < 0.0) & (twin >= 0), twin, group_of)

    def request(self, span: StepSpan) -> float:
        """Push particles out of walls every few steps; return 1 if any must change its side."""
        if span.number % CHECK_INTERVAL:
            return False
        self.movers.place(span.end)
        return any([self._push_group(g) for g in self._sided_groups()])

    def needs_sort(self, span: StepSpan, maxima: StepMaxima) -> bool:
        """Move particles whose side has changed, if a particle of any rank must."""
        if not maxima.requests_of_features["thin_walls"]:
            return False
        self.movers.place(span.end)
        moved = [(g, self._leavers(g)) for g in self._sided_groups()]
        moved = [(g, indices) for g, indices in moved if len(indices)]
        rows = []
        for g, indices in moved:  # all leave before any arrives
            group = self.groups[g]
            block = group.block[group.segment_of(indices)]
            rows.append((block, group.xi[:, indices], group.f[:, indices], group.ids[indices]))
        for g, indices in moved:
            remove_particles(self.groups[g], indices)
        for (g, _), row in zip(moved, rows, strict=True):
            append_particles(self.groups[self.twin[g]], *row)
            volume = row[2][self.groups[g].plan.channels["vol0"].first]
            for feature in self.features.values():
                feature.count_transferred(g, self.twin[g], volume)
        return True

    def _sided_groups(self) -> list[int]:
        """Return the groups that have two sides."""
        return [g for g, twin in enumerate(self.twin) if twin >= 0]

    def _find(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return what `find_sides` finds for points (n, 3) [m]."""
        table = self.movers.table
        assert isinstance(table, SampledShells)
        middle, kinds, faces = np.empty(len(x)), np.empty(len(x), np.int8), np.zeros((len(x), 2, 4))
        find_sides(np.ascontiguousarray(x), table, middle, kinds, faces)
        return middle, kinds, faces

    def _crossed(self, g: int, middle: np.ndarray, kinds: np.ndarray) -> np.ndarray:
        """Return which particles of a group have come to the other side, but not through a wall."""
        depth = -self.side[g] * middle / self.dx  # [cells] on the other side
        return (kinds > 0) & (depth > np.where(kinds >= NEAR_EDGE, 0.0, MAX_CREEP_CELLS))

    def _push_group(self, g: int) -> bool:
        """Push the particles of a group out of walls; return whether any must change its side."""
        group = self.groups[g]
        index = group.places(np.flatnonzero(self._near_walls(group) & (group.count > 0)))
        middle, kinds, faces = self._find(group.positions_at(index))
        crossed = self._crossed(g, middle, kinds)
        own = faces[:, (1 - self.side[g]) // 2]
        inside = np.flatnonzero(~crossed & (kinds > 0) & (kinds != EDGE) & (own[:, 3] < 0.0))
        index, own = index[inside], own[inside]
        if len(index):
            cells = np.minimum(-own[:, 3] / self.dx, MAX_PUSH_CELLS)
            shift = np.rint(np.ldexp(cells[:, None] * own[:, :3], group.bits))
            limit = position_limits(group.block[group.segment_of(index)], self.cells)
            low, high = np.moveaxis(np.ldexp(limit, group.bits), 2, 0)
            xi = group.xi[:, index].T
            pushed = np.clip(xi + shift, np.minimum(low, xi), np.maximum(high, xi))
            group.xi[:, index] = pushed.T.astype(group.xi.dtype)
        return bool((crossed & (kinds != EDGE) & (np.abs(middle) < URGENT_CELLS * self.dx)).any())

    def _leavers(self, g: int) -> np.ndarray:
        """Return the particles of a group that change their side."""
        group = self.groups[g]
        close, filled = self._near_walls(group), group.count > 0
        index = group.places(np.flatnonzero(close & filled))
        middle, kinds, _ = self._find(group.positions_at(index))
        crossed = self._crossed(g, middle, kinds)
        if self.side[g] > 0:
            return index[crossed]
        others = group.places(np.flatnonzero(~close & filled))  # far from walls, all are one
        return np.sort(np.concatenate([index[crossed | (kinds == 0)], others]))

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
