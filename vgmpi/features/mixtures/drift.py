"""Drift of fluids that mix, beside an implicit pressure.

The velocities at the nodes have the drift while the pressure is found: the volumes of all fluids
then stay. Particles move with it, but carry no momentum of it (docs/explanation/mixtures.md).
"""

from typing import NamedTuple

import numpy as np

from vgmpi.features.active_feature import ActiveFeature, NodeState
from vgmpi.kernels.particle_records import BATCH, patch_of, scatter_columns
from vgmpi.kernels.simd.vector16 import load
from vgmpi.kernels.stencil_sums import gather_value
from vgmpi.kernels.step_records import StepSpan
from vgmpi.kernels.transfer.auxiliary_gather import (
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
    velocity_gradient,
    wave_speed_squared,
)
from vgmpi.runtime.jit import kernel

from .plan import DRIFT


class MixtureDrift(ActiveFeature):
    """Drift of the fluids of a run."""

    couples_nodes = True

    def couple_nodes(self, nodes: NodeState, span: StepSpan, gravity: np.ndarray) -> None:
        """Note the nodes of a step.

        Args:
            nodes, span, gravity: See `ActiveFeature.couple_nodes`.
        """
        self.nodes = nodes

    def end_coupling(self, span: StepSpan) -> None:
        """Subtract the drift from the velocities, once all else has changed them."""
        nodes, has_terms = self.nodes, self.nodes.fields["impulses"].tables.has_terms
        drift, first = nodes.gathered[DRIFT], nodes.tables.first
        for rows in nodes.block_rows:
            nodes.call(subtract_drift, rows, first, has_terms, drift, nodes.velocities)


@kernel
def subtract_drift(rows, first, has_terms, drift, velocity):
    """Subtract the drift where the step has found one; elsewhere it is 0 from here on.

    Args:
        rows: Blocks to process, shape (n,).
        first: First node block of each block, shape (blocks + 1,).
        has_terms: Whether node blocks have separate impulses, and so a drift, (node blocks,).
        drift: Drifts [m/s], shape (node blocks, 256) (in/out).
        velocity: Velocities [m/s], shape (node blocks, 256) (in/out).
    """
    for b in rows:
        is_found = False
        for r in range(first[b], first[b + 1]):
            is_found |= has_terms[r] != 0
        for r in range(first[b], first[b + 1]):
            for q in range(64):
                for a in range(3):
                    if is_found:
                        velocity[r, 4 * q + a] -= drift[r, 4 * q + a]
                    else:
                        drift[r, 4 * q + a] = 0


class DriftGather(NamedTuple):
    """Kind of fluids that mix beside an implicit pressure."""

    drift: np.ndarray  # (node blocks, 256) [m/s] drift, which advects but carries no momentum
    patch: int  # number of its patch


for _dispatch in (displacement, particle_velocity, velocity_gradient, wave_speed_squared,
                  bounded_volume_rate):  # fmt: skip
    _dispatch.register(DriftGather)(_dispatch.table[VelocityOnly])


@load_patches.register(DriftGather)
def _(kind, blocks, box, mirror, real, ghosts, s):
    load_mirrored_patch(kind.drift, blocks, box, mirror, patch_of(real, kind.patch), None, s)


@gather_batch.register(DriftGather)
def _(kind, count, weights, records, base, real, extra):
    """Gather the drift [m/s], behind what an implicit pressure gathers."""
    gather_value(count, records, weights, base, patch_of(real, kind.patch))
    scatter_columns(count, records, extra, 4 * BATCH, BATCH)


@max_velocity.register(DriftGather)
def _(kind, f, p, cap, displacement, scale):
    return max_velocity_component(f, p, cap, scale)


@advection_velocity.register(DriftGather)
def _(kind, split, extra, n, v):
    x, y, z = v
    return (
        x + load(extra, n + 4 * BATCH),
        y + load(extra, n + 5 * BATCH),
        z + load(extra, n + 6 * BATCH),
    )
