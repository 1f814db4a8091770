"""Separate walls of solids and grains in plain NumPy; see kernels/wall_boundary.py.

Whether what is beyond such a wall presses on it is decided by the sums of each segment alone, so
that these phases are summed in one patch of 8^3 nodes per segment first.
"""

from typing import Any

import numpy as np

from vgmpi.kernels.wall_boundary import SIDE, SLIP, STICK, YIELDING, patch_codes
from vgmpi.parallel.block_lattice import BLOCK_EDGE
from vgmpi.parallel.particle_group import ParticleGroup
from vgmpi.solver.engines.plan_tables import wall_kinds_of

from .dense_grid import Dense, Stencil


class PatchStencil:
    """Stencil of a group's particles whose indices select nodes of the patches of its segments."""

    def __init__(self, group: ParticleGroup, stencil: Stencil):
        self.stencil, self.base = stencil, stencil.base
        self.segment = np.repeat(np.arange(len(group.count)), group.count)
        self.low = np.repeat(BLOCK_EDGE * group.block - 1, group.count, axis=0)  # array indices

    def _local(self, index: tuple) -> tuple:
        return (self.segment, *(i - low for i, low in zip(index, self.low.T, strict=True)))

    def __iter__(self):
        """Yield 27 times what `Stencil` yields, with the index of the segment first."""
        for index, *weights in self.stencil:
            yield self._local(index), *weights

    def by_cells(self):
        """Yield 27 times index and gradient, see `Stencil.by_cells`."""
        for index, gradient in self.stencil.by_cells():
            yield self._local(index), gradient


class ImpulseSums:
    """Fields to which the momentum, mass and stress impulses of a group are added."""

    def __init__(self, stencil, momentum: np.ndarray, mass: np.ndarray, forces: np.ndarray):
        self.stencil, self.momentum, self.mass, self.forces = stencil, momentum, mass, forces
        self.pressure = momentum

    def finish(self) -> None:
        """Do nothing: the sums are those of the domain."""


class PatchedSums(ImpulseSums):
    """Sums of a phase that walls let go: by segments, until what presses is folded back."""

    def __init__(
        self, group: ParticleGroup, dense: Dense, kinds: np.ndarray, stencil: Stencil,
        fields: tuple, recorders: tuple,
    ):  # fmt: skip
        """Begin empty sums.

        Args:
            group, dense, kinds: See `PatchSums`.
            stencil: Stencil of the particles.
            fields: Momentum, mass and stress impulses of the phase in the domain.
            recorders: `WallRecorder` of the momentum and of the impulses, or None each.
        """
        self.patches = [PatchSums(group, dense, kinds) for _ in range(3)]
        own, pressure, forces = self.patches
        super().__init__(PatchStencil(group, stencil), own.vectors, own.numbers, forces.vectors)
        self.pressure, self.fields, self.recorders = pressure.vectors, fields, recorders

    def finish(self) -> None:
        """Fold back what presses on walls, and add all to the fields of the domain."""
        momentum, mass, impulses = self.fields
        of_momentum, of_impulses = self.recorders
        own, pressure, forces = self.patches
        own.move_to(momentum, mass, of_momentum)
        pressure.move_to(momentum, None, of_momentum)
        forces.move_to(impulses, None, of_impulses)


class PatchSums:
    """Momentum and mass, or stress impulses, of a group in the patches of its segments."""

    def __init__(self, group: ParticleGroup, dense: Dense, kinds: np.ndarray):
        """Begin empty sums.

        Args:
            group: Particles.
            dense: Nodes of the domain.
            kinds: Wall kinds of the phase, shape (3, 2).
        """
        shape = len(group.block), SIDE, SIDE, SIDE
        self.vectors, self.numbers = np.zeros((*shape, 3)), np.zeros((*shape, 1))
        self.low = BLOCK_EDGE * group.block - 1
        self.codes = patch_codes(group.block, dense.cells, kinds)
        self.dense = dense

    def move_to(self, vectors: np.ndarray, numbers: np.ndarray | None, recorder=None) -> None:
        """Fold back what presses on walls, and add all to fields of the domain.

        Args:
            vectors: Vectors (in/out), shape (..., 3).
            numbers: Numbers (in/out), shape (..., 1), or None.
            recorder: `WallRecorder` of the momentum, or None.
        """
        for axis, side in np.ndindex(3, 2):
            codes = self.codes[:, axis, side]
            for code in np.unique(codes[codes > 0]):
                if code & 7 in (STICK, SLIP, YIELDING):
                    rows = np.flatnonzero(codes == code)
                    self._fold(rows, axis, side, int(code), recorder, numbers is not None)
        self._add(self.vectors, vectors)
        if numbers is not None:
            self._add(self.numbers, numbers)

    def _fold(self, rows, axis, side, code, recorder, has_mass) -> None:
        """Fold the ghost nodes of some segments beyond one wall."""
        wall, step, kind = code >> 3, 1 - 2 * side, code & 7
        u, m = (np.moveaxis(f, axis + 1, 1) for f in (self.vectors, self.numbers))
        beyond, mass = u[rows, wall - step], m[rows, wall - step]
        folds = np.ones(beyond.shape[:-1], bool)
        if kind == YIELDING:
            folds = step * beyond[..., axis] < 0.0
            u[rows, wall, ..., axis] += 2.0 * np.where(folds, beyond[..., axis], 0.0)
        folded, sign = np.where(folds[..., None], beyond, 0.0), np.ones(3)
        sign[axis] = -1.0
        if kind == STICK:
            sign = -np.ones(3)
        part = np.where(folds[..., None], mass, 0.0)
        u[rows, wall + step] += folded * sign
        m[rows, wall + step] += part
        u[rows, wall - step] = beyond - folded
        m[rows, wall - step] = mass - part
        if recorder is not None:
            plane = 1 if side == 0 else self.dense.cells[axis] + 1
            impulse, bent, unfolded = (
                self._plane(rows, axis, f) for f in (folded, part, mass - part)
            )
            if kind != YIELDING:
                recorder.record_fold(axis, plane, impulse, sign)
            if has_mass:
                recorder.add_mass(axis, plane, unfolded, bent)

    def _plane(self, rows, axis, values) -> np.ndarray:
        """Return values on planes of patches, shape (n, 8, 8, k), summed on a plane of nodes."""
        first, second = (a for a in range(3) if a != axis)
        shape = self.dense.shape[first], self.dense.shape[second]
        out = np.zeros((shape[0] + 2 * SIDE, shape[1] + 2 * SIDE, values.shape[-1]))
        for row, value in zip(rows, values, strict=True):
            i, j = self.low[row, first] + SIDE, self.low[row, second] + SIDE
            out[i : i + SIDE, j : j + SIDE] += value
        return out[SIDE : SIDE + shape[0], SIDE : SIDE + shape[1]]

    def _add(self, patches: np.ndarray, field: np.ndarray) -> None:
        """Add patches to a field of the domain."""
        for low, patch in zip(self.low, patches, strict=True):
            start, stop = np.maximum(low, 0), np.minimum(low + SIDE, self.dense.shape)
            inside = tuple(slice(a, b) for a, b in zip(start, stop, strict=True))
            own = tuple(slice(a, b) for a, b in zip(start - low, stop - low, strict=True))
            field[inside] += patch[own]


def sums_of(engine: Any, group: ParticleGroup, stencil: Stencil) -> ImpulseSums:
    """Return the fields of an engine to which a group adds momentum, mass and stress impulses.

    Args:
        engine: Reference engine.
        group: Particles.
        stencil: Their stencil.
    """
    p, dense = group.plan.phase, engine.dense
    fields = engine.nodes.momentum[p], engine.nodes.mass[p], engine.nodes.forces[p]
    if not dense.yields(p):
        return ImpulseSums(stencil, *fields)
    kinds = wall_kinds_of(engine.walls, engine.plan.phases[p])
    recorders = engine.record(p, engine.mirrors), engine.record(p, 1.0)
    return PatchedSums(group, dense, kinds, stencil, fields, recorders)
