"""Transfer of phases that share space: what their particles gather besides the velocity.

Fluids change their density by the volume flux of all phases at a node, and move with their drift.
The kind is one of kernels/transfer/auxiliary_gather.py; see docs/explanation/mixtures.md.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.kernels.particle_records import BATCH, patch_of, scatter_columns
from vgmpi.kernels.simd.row_ops import broadcast
from vgmpi.kernels.simd.vector16 import load, store
from vgmpi.kernels.stencil_sums import gather_affine, gather_value
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
    store_velocity,
    velocity_gradient,
    wave_speed_squared,
)

from .kernels import MIN_POROSITY

OVERFILL_RELAXATION_RATE = 10.0  # [1/s] relaxation rate of a fluid in pores that are overfilled


class MixtureGather(NamedTuple):
    """Kind of phases that share space."""

    flux: np.ndarray  # (node blocks, 256) volume flux [m/s], and the fluids' volume fraction
    drift: np.ndarray  # (node blocks, 256) [m/s] drift, which advects but carries no momentum
    drifts: int  # 1 if any phase drifts
    porosity: float  # channel of the fluid's volume fraction, or -1
    dx: float  # [m] cell size
    relaxation_rate: float  # [1/s] of a fluid where space is overfilled
    wave_factor: float  # [-] factor on the squared wave speed of a fluid that slips through others
    density_ratio: float  # [-] density relative to the grains of sand in the same space, at least 1
    added_wave2: float  # [m2/s2] squared wave speed that such sand adds


displacement.register(MixtureGather)(displacement.table[VelocityOnly])


@load_patches.register(MixtureGather)
def _(kind, blocks, box, mirror, real, ghosts, s):
    load_mirrored_patch(kind.flux, blocks, box, mirror, patch_of(real, 0), None, s)
    if kind.drifts:
        load_mirrored_patch(kind.drift, blocks, box, mirror, patch_of(real, 1), None, s)


@gather_batch.register(MixtureGather)
def _(kind, count, weights, records, base, real, extra):
    """Gather the flux divergence [cells/s], the fluids' volume fraction and the drift [m/s]."""
    gather_affine(count, records, weights, base, patch_of(real, 0))
    for n in range(count):
        m = 16 * n
        extra[n] = 4.0 * (records[m + 4] + records[m + 9] + records[m + 14])
        extra[BATCH + n] = records[m + 3]
    if kind.drifts:
        gather_value(count, records, weights, base, patch_of(real, 1))
        scatter_columns(count, records, extra, 2 * BATCH, BATCH)


@particle_velocity.register(MixtureGather)
def _(kind, f, p, cap, extra, n, v):
    store_velocity(f, p, cap, v)


@max_velocity.register(MixtureGather)
def _(kind, f, p, cap, displacement, scale):
    return max_velocity_component(f, p, cap, scale) if kind.drifts else displacement


@advection_velocity.register(MixtureGather)
def _(kind, split, extra, n, v):
    x, y, z = v
    if split and kind.drifts:
        x = x + load(extra, 2 * BATCH + n)
        y = y + load(extra, 3 * BATCH + n)
        z = z + load(extra, 4 * BATCH + n)
    return x, y, z


@velocity_gradient.register(MixtureGather)
def _(kind, split, f, p, cap, extra, n, L, fill, slope, numbers):
    """Add the volume change of the mixture to the velocity gradient.

    A fluid's volume changes by the flux of all phases that share its space. In the presence of sand
    the volume fraction of the pores is stored at the particle; where more volume than space was
    gathered (fill > 1), the volume ratio relaxes.
    """
    porosity = np.int64(kind.porosity)
    c0, c1, c2, c3, c4, c5, c6, c7, c8 = L
    added = 0.0 * c0
    if split:
        rate = load(extra, n) / kind.dx
        if porosity >= 0:
            pore_fraction = np.minimum(np.maximum(load(extra, BATCH + n), MIN_POROSITY), 1.0)
            store(f, p + porosity * cap, pore_fraction)
            rate = rate / pore_fraction - kind.relaxation_rate * np.maximum(fill - 1.0, 0.0)
        added = (rate - (c0 + c4 + c8)) * (1.0 / 3.0)
    elif porosity >= 0:
        store(f, p + porosity * cap, broadcast(f, 1.0))
    return (c0 + added, c1, c2, c3, c4 + added, c5, c6, c7, c8 + added)


bounded_volume_rate.register(MixtureGather)(bounded_volume_rate.table[VelocityOnly])


@wave_speed_squared.register(MixtureGather)
def _(kind, f, p, cap, wave2):
    porosity = np.int64(kind.porosity)
    wave2 = wave2 * kind.wave_factor
    if porosity >= 0:
        pore_fraction = load(f, p + porosity * cap)
        wave2 = wave2 * (1.0 + (1.0 / pore_fraction - 1.0) * kind.density_ratio) + kind.added_wave2
    return wave2
