"""Particle shifting of liquids, in plain NumPy; see docs/explanation/transfer-schemes.md."""

from typing import Any

import numpy as np

from vgmpi.parallel.block_lattice import position_limits
from vgmpi.parallel.particle_group import ParticleGroup

from .kernels import (
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
    NodeFill,
    ShiftConstants,
)


class DenseShifting:
    """Shifts of liquids on dense arrays."""

    def __init__(self, fill: NodeFill, dense: Any):
        """Take what fills the nodes' cells, and the nodes of the domain."""
        self.fill, self.dense = fill, dense

    def begin(
        self, mass: np.ndarray, groups: list, stencils: list, distance: np.ndarray | None,
        division: Any,
    ) -> None:  # fmt: skip
        """Find the part of each node's cell that is filled, with its images at mirroring walls.

        Args:
            mass: Nodal masses of the phases (in/out), shape (phases, ..., 1) [kg]; rest volumes
                [m3] replace them where the liquids of a phase differ in density.
            groups, stencils: Groups of particles, and their stencils.
            distance: Distance of the nodes from colliders [m], or None without.
            division: What divides nodes between phases, or None; it is a half space for each half.
        """
        for p in np.flatnonzero(self.fill.by_volume):
            mass[p] = 0.0
            for group, stencil in zip(groups, stencils, strict=True):
                if group.plan.phase == p:
                    self.dense.sum(mass[p], stencil, _get(group, "vol0"))
            self.dense.fold(None, mass[p])
        filled = np.einsum("p,p...->p...", self.fill.space.astype(np.float64), mass)
        if division is not None:
            seen = [self._fullness(*division.seen_from(half, filled)) for half in (-1, 0, 1)]
            self.fullness = np.stack([seen[half + 1] for half in division.half])
        else:
            self.fullness = np.stack([self._fullness(filled.sum(0), distance)] * len(mass))

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

    def apply(self, group: ParticleGroup, stencil: Any, constants: ShiftConstants) -> None:
        """Relax the volumes of a liquid to its fullness, and separate particles that crowd.

        Args:
            group: Particles (in/out).
            stencil: Stencil of the particles.
            constants: Constants of the shift.
        """
        dense, fullness = self.dense, self.fullness[group.plan.phase]
        crowd = dense.gather(fullness, stencil)[:, 0]
        slope = dense.dx * dense.gather_slopes(fullness, stencil, moments=True)[:, 0]
        theta, C = _get(group, "theta"), _get(group, "C")
        excess = crowd * np.exp(theta[:, 0]) - 1.0
        margin = MARGIN + MARGIN_GROWTH * np.maximum(1.0 - crowd, 0.0)
        margin *= np.linalg.norm(slope, axis=1)
        inner = np.clip((crowd - MIN_FILL) / (FULL_FILL - MIN_FILL), 0.0, 1.0)
        error = np.maximum(excess - margin, 0.0) + inner * np.minimum(excess + margin, 0.0)
        rate = constants.duration * np.linalg.norm(C, axis=1)
        _put(group, "theta", theta - (rate * np.minimum(error, MAX_FILL_ERROR))[:, None])
        spray = np.clip((LIQUID_FILL - crowd) / (LIQUID_FILL - SPRAY_FILL), 0.0, 1.0)
        diagonal = [0, 4, 8]
        C[:, diagonal] -= (spray * C[:, diagonal].mean(1))[:, None]
        _put(group, "C", C)

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
    group: ParticleGroup, dense: Any, distance: np.ndarray, wall_shift: np.ndarray,
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


def _get(group: ParticleGroup, name: str) -> np.ndarray:
    """Return a channel of all particles as doubles, shape (n, width)."""
    return group.get(name, group.index()).astype(np.float64)


def _put(group: ParticleGroup, name: str, values: np.ndarray) -> None:
    """Set a channel of all particles, shape (n, width)."""
    group.put(name, group.index(), values)
