"""FLIP and AFLIP: particles retain a part of their motion that the grid does not resolve.

The nodes store the change of velocity in a step; particles gather it and blend their own velocity,
changed as much, with the grid velocity.

References:
    Zhu and Bridson 2005 (FLIP); Fei 2021 (AFLIP, with the velocity gradient).
"""

from typing import Any, NamedTuple

import numpy as np

from vgmpi.features.active_feature import DenseStage
from vgmpi.kernels.grid.node_stages import after_stress, after_walls, before_stress
from vgmpi.kernels.kernel_arguments import NODE_MASS_FLOOR
from vgmpi.kernels.particle_records import BATCH, patch_of, scatter_columns
from vgmpi.kernels.simd.cooperative import flat_pointer
from vgmpi.kernels.simd.row_ops import broadcast, fourth_of
from vgmpi.kernels.simd.vector16 import load, store
from vgmpi.kernels.stencil_sums import gather_value
from vgmpi.kernels.transfer.auxiliary_gather import (
    CHANGE,
    VelocityOnly,
    advection_velocity,
    bounded_volume_rate,
    displacement,
    gather_batch,
    load_mirrored_patch,
    load_patches,
    max_velocity,
    max_velocity_component,
    particle_velocity,
    store_velocity,
    velocity_gradient,
    wave_speed_squared,
)
from vgmpi.materials.tensor_math.select import select
from vgmpi.parallel.particle_group import ParticleGroup


class VelocityChange(NamedTuple):
    """Stage that stores the change of the nodal velocities in a step."""

    change: np.ndarray  # (node blocks, 256) [m/s] change of velocity (out)


@before_stress.register(VelocityChange)
def _store_velocity_before(kind, block, fields, push):
    """Store the velocities of a block before gravity's `push` and separate impulses.

    Nodes without mass are at rest before and after.
    """
    change = flat_pointer(kind.change)
    for nb in range(block.n0, block.n1):
        tiny = broadcast(fields.grid, NODE_MASS_FLOOR * fields.min_cell_mass[fields.phase[nb]])
        for c in range(256 * nb, 256 * (nb + 1), 16):
            row = load(fields.grid, c)
            store(change, c, select(fourth_of(row) > tiny, row - push, row))


@after_stress.register(VelocityChange)
def _(kind, block, fields, scratch, walls, phases, step):
    pass


@after_walls.register(VelocityChange)
def _store_velocity_change(kind, block, has_impulses, fields, scratch, dx):
    """Store the change of velocity since `_store_velocity_before`."""
    change = flat_pointer(kind.change)
    if has_impulses:
        for c in range(256 * block.n0, 256 * block.n1, 16):
            store(change, c, load(fields.grid, c) - load(change, c))


class FlipGather(NamedTuple):
    """Kind of FLIP and AFLIP."""

    change: np.ndarray  # (node blocks, 256) [m/s] change of velocity
    share: float  # [-] FLIP ratio: part of the unresolved velocity that particles retain
    patch: int  # number of its patch among the auxiliary ones


for _dispatch in (
    advection_velocity, displacement, velocity_gradient, wave_speed_squared, bounded_volume_rate,
):  # fmt: skip
    _dispatch.register(FlipGather)(_dispatch.table[VelocityOnly])


@load_patches.register(FlipGather)
def _(kind, blocks, box, mirror, real, ghosts, s):
    load_mirrored_patch(kind.change, blocks, box, mirror, patch_of(real, kind.patch), ghosts, s)


@gather_batch.register(FlipGather)
def _(kind, count, weights, records, base, real, extra):
    """Gather the change of velocity [m/s], behind all other quantities."""
    gather_value(count, records, weights, base, patch_of(real, kind.patch))
    scatter_columns(count, records, extra, CHANGE, BATCH)


@particle_velocity.register(FlipGather)
def _(kind, f, p, cap, extra, n, v):
    """Blend the particle's velocity plus the grid's change with the grid velocity."""
    a, b, c = v
    a = a + kind.share * (load(f, p) + load(extra, CHANGE + n) - a)
    b = b + kind.share * (load(f, p + cap) + load(extra, CHANGE + BATCH + n) - b)
    c = c + kind.share * (load(f, p + 2 * cap) + load(extra, CHANGE + 2 * BATCH + n) - c)
    store_velocity(f, p, cap, (a, b, c))


@max_velocity.register(FlipGather)
def _(kind, f, p, cap, displacement, scale):
    return max_velocity_component(f, p, cap, scale)


class DenseFlip(DenseStage):
    """Change of the nodal velocities and blend of particles, in plain NumPy."""

    def __init__(self, blend: Any, dense: Any):
        """Take the `FlipBlend` and the nodes of the domain."""
        self.blend, self.dense = blend, dense

    def after_walls(self, nodes: Any, v: np.ndarray, mass: np.ndarray) -> np.ndarray:
        """Store the change of the velocities (phases, ..., 3) [m/s] in a step.

        Args:
            nodes, v, mass: See `DenseStage.after_walls`.
        """
        self.change = v - nodes.velocity_before
        return v

    def gathered_fields(self, change_share: float) -> list[tuple[np.ndarray, float]]:
        """Return the change, and the share that particles take of it.

        Args:
            change_share: See `DenseStage.gathered_fields`.
        """
        return [(self.change, change_share)]

    def particle_velocity(
        self, group: ParticleGroup, stencil: Any, v: np.ndarray, dt: float
    ) -> np.ndarray:
        """Return the blended velocities of particles, shape (n, 3) [m/s].

        Args:
            group, stencil, v, dt: See `DenseStage.particle_velocity`.
        """
        own = group.get("v", group.index()).astype(np.float64)
        retained = own + self.dense.gather(self.change[group.plan.phase], stencil)
        blended: np.ndarray = v + self.blend.over(dt) * (retained - v)
        return blended
