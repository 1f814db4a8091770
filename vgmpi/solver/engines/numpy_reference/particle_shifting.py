"""Particle shifting of liquids, in plain NumPy; see docs/explanation/transfer-schemes.md."""

from typing import Any

import numpy as np

from vgmpi.kernels.colliders.moving_colliders import MovingColliders
from vgmpi.kernels.transfer.particle_shifting import (
    FULL_FILL,
    LIQUID_FILL,
    MARGIN,
    MARGIN_GROWTH,
    MAX_FILL_ERROR,
    MAX_SHIFT_CELLS,
    MIN_FILL,
    SHIFT_FACTOR,
    SPRAY_FILL,
    TOLERATED_FILL,
    WALL_GAP_CELLS,
    ShiftConstants,
)
from vgmpi.parallel.block_lattice import position_limits
from vgmpi.parallel.particle_group import ParticleGroup
from vgmpi.planning.plan import Plan
from vgmpi.solver.engines.plan_tables import node_fill

from .dense_grid import Dense, Stencil
from .group_channels import get_channel, put_channel
from .moving_colliders import distance_from_colliders


class ParticleShifting:
    """Shifts of the liquids of a plan; `constants` are those of the present step of no time."""

    def __init__(self, plan: Plan, dense: Dense):
        self.dense = dense
        self.table = node_fill(plan)
        self.constants: ShiftConstants | None = None

    def replace_mass(self, mass: np.ndarray, groups: list, stencils: list[Stencil]) -> None:
        """Replace nodal masses by rest volumes in the phases whose liquids differ in density.

        Args:
            mass: Nodal masses of the phases (in/out), shape (phases, ..., 1) [kg].
            groups, stencils: Groups of particles, and their stencils.
        """
        if self.constants is None or self.table is None:
            return
        for p in np.flatnonzero(self.table.by_volume):
            mass[p] = 0.0
            for group, stencil in zip(groups, stencils, strict=True):
                if group.plan.phase == p:
                    self.dense.sum(mass[p], stencil, get_channel(group, "vol0"))
            self.dense.fold(None, mass[p])

    def nodal_fullness(
        self, mass: np.ndarray, movers: MovingColliders | None, at_rest: np.ndarray,
        division: Any,
    ) -> np.ndarray | None:  # fmt: skip
        """Return the part of each node's cell that is filled, with its images at mirroring walls.

        Args:
            mass: Nodal masses [kg] or rest volumes [m3] of the phases, shape (phases, ..., 1).
            movers, at_rest: Colliders, see `distance_from_colliders`.
            division: What divides nodes between phases, or None; it is a half space for each half.

        Returns:
            Fullness that each phase sees, shape (phases, ..., 1), or None if no particles are
            shifted now.
        """
        if self.constants is None or self.table is None:
            return None
        filled = np.einsum("p,p...->p...", self.table.space.astype(np.float64), mass)
        if division is not None:
            seen = [self._fullness(*division.seen_from(half, filled)) for half in (-1, 0, 1)]
            return np.stack([seen[half + 1] for half in division.half])
        distance = distance_from_colliders(movers, self.dense, at_rest)
        return np.stack([self._fullness(filled.sum(0), distance)] * len(mass))

    def _fullness(self, filled: np.ndarray, distance: np.ndarray | None) -> np.ndarray:
        """Return the fullness of nodes, shape (..., 1).

        Args:
            filled: Part of the cells that particles fill, shape (..., 1).
            distance: Distance of the nodes from colliders [m], or None without.
        """
        fullness = self.dense.complete_wall_mass(filled)
        free = self._share_outside_walls()
        if distance is not None:
            free = free * (1.0 - half_space_share(distance.reshape(free.shape) / self.dense.dx))
        fullness = fullness + (1.0 - free)[..., None]
        return self.dense.symmetrize(fullness)

    def _share_outside_walls(self) -> np.ndarray:
        """Return the part of each node's cell that separating walls leave free, shape (...)."""
        dense = self.dense
        share = np.ones([len(axis) for axis in dense.nodes])
        for axis, kind, _, wall, inside, _ in dense.wall_planes():
            if kind == "separate":
                depth = (inside - wall) * (np.arange(share.shape[axis]) - wall)
                outside = 1.0 - half_space_share(depth.astype(float))
                share *= np.expand_dims(outside, [a for a in range(3) if a != axis])
        return share

    def apply(self, group: ParticleGroup, stencil: Stencil, fullness: np.ndarray) -> None:
        """Relax the volumes of a liquid to its fullness, and separate particles that crowd.

        Args:
            group: Particles (in/out).
            stencil: Stencil of the particles.
            fullness: Fullness of the nodes, shape (..., 1).
        """
        dense, constants = self.dense, self.constants
        assert constants is not None
        crowd = dense.gather(fullness, stencil)[:, 0]
        slope = dense.dx * dense.gather_slopes(fullness, stencil, moments=True)[:, 0]
        theta, C = get_channel(group, "theta"), get_channel(group, "C")
        excess = crowd * np.exp(theta[:, 0]) - 1.0
        margin = MARGIN + MARGIN_GROWTH * np.maximum(1.0 - crowd, 0.0)
        margin *= np.linalg.norm(slope, axis=1)
        inner = np.clip((crowd - MIN_FILL) / (FULL_FILL - MIN_FILL), 0.0, 1.0)
        error = np.maximum(excess - margin, 0.0) + inner * np.minimum(excess + margin, 0.0)
        rate = constants.duration * np.linalg.norm(C, axis=1)
        put_channel(group, "theta", theta - (rate * np.minimum(error, MAX_FILL_ERROR))[:, None])
        spray = np.clip((LIQUID_FILL - crowd) / (LIQUID_FILL - SPRAY_FILL), 0.0, 1.0)
        diagonal = [0, 4, 8]
        C[:, diagonal] -= (spray * C[:, diagonal].mean(1))[:, None]
        put_channel(group, "C", C)

        surplus = np.maximum(fullness - TOLERATED_FILL, 0.0)
        gradient = sum(
            surplus[index][:, :1] * spline_gradient for index, _, _, spline_gradient in stencil
        )
        distance = -SHIFT_FACTOR * dense.dx * gradient
        norm = np.linalg.norm(distance, axis=1, keepdims=True)
        distance *= MAX_SHIFT_CELLS / np.maximum(norm, MAX_SHIFT_CELLS)
        wall_shift = np.clip(
            SHIFT_FACTOR * dense.gather(surplus, stencil)[:, :1], 0.0, MAX_SHIFT_CELLS
        )
        _move(group, dense, distance, wall_shift, constants)


def half_space_share(distance: np.ndarray) -> np.ndarray:
    """Return the part of nodes' cells that a half space fills, `distance` [cells] outside it."""
    d = np.clip(distance, -1.5, 1.5)
    middle = 0.5 - 0.75 * d + d**3 / 3.0
    outer, inner = (1.5 - d) ** 3 / 6.0, 1.0 - (1.5 + d) ** 3 / 6.0
    return np.where(d > 0.5, outer, np.where(d < -0.5, inner, middle))


def _move(
    group: ParticleGroup, dense: Dense, distance: np.ndarray, wall_shift: np.ndarray,
    shift: ShiftConstants,
) -> None:  # fmt: skip
    """Move particles by `distance`, shape (n, 3) [cells], except what leads to a wall.

    Those on a wall move off it by `wall_shift`, shape (n, 1) [cells].
    """
    index = group.index()
    limit = position_limits(np.repeat(group.block, group.count, axis=0), dense.cells)
    x = np.ldexp(group.xi[:, index].T.astype(np.float64), -group.bits)
    low, high = limit[..., 0] + WALL_GAP_CELLS, limit[..., 1] - WALL_GAP_CELLS
    distance = np.maximum(distance, np.minimum(low - x, 0.0))
    distance = np.minimum(distance, np.maximum(high - x, 0.0))
    distance = np.where(x < low, wall_shift, np.where(x > high, -wall_shift, distance))
    dither = np.array([shift.dither_x, shift.dither_y, shift.dither_z])
    units = np.floor(shift.cell_units * distance + np.where(distance != 0.0, dither, 0.0))
    group.xi[:, index] += units.T.astype(group.xi.dtype)
