"""Gathering of liquids with an implicit pressure: displacement and pressure of the nodes.

Their volume ratio is not integrated. It is the one at which the law has the pressure of the grid,
which is the first guess of the next step, and what files and checkpoints contain. It is a kind of
auxiliary_gather.py; see docs/explanation/implicit-pressure.md.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.kernels.particle_records import BATCH, STATE, patch_of, scatter_columns
from vgmpi.kernels.simd.vector16 import load, store
from vgmpi.kernels.stencil_sums import gather_value

from .auxiliary_gather import (
    VelocityOnly,
    advection_velocity,
    displacement,
    gather_batch,
    load_mirrored_patch,
    load_patches,
    max_velocity,
    mixture_wave_speed_squared,
    particle_velocity,
    velocity_gradient,
)


class ImplicitPressure(NamedTuple):
    """Kind of liquids with an implicit pressure."""

    moves: np.ndarray  # (node blocks, 256) [cells] displacement, and relative pressure
    exponent: float  # [-] exponent of the Tait equation


for _dispatch in (particle_velocity, max_velocity, advection_velocity):
    _dispatch.of(ImplicitPressure)(_dispatch.table[VelocityOnly])


@load_patches.of(ImplicitPressure)
def _(kind, blocks, box, mirror, real, ghosts, s):
    load_mirrored_patch(kind.moves, blocks, box, mirror, patch_of(real, 0), None, s)


@gather_batch.of(ImplicitPressure)
def _(kind, count, weights, records, base, real, extra):
    """Gather the displacement [cells] and the relative pressure."""
    gather_value(count, records, weights, base, patch_of(real, 0))
    scatter_columns(count, records, extra, 0, BATCH)
    for n in range(count):
        extra[3 * BATCH + n] = records[16 * n + 3]


@displacement.of(ImplicitPressure)
def _(kind, extra, n, moves):
    x, y, z = moves
    return (
        x + load(extra, n),
        y + load(extra, BATCH + n),
        z + load(extra, 2 * BATCH + n),
    )


@velocity_gradient.of(ImplicitPressure)
def _(kind, split, f, p, cap, extra, n, L, fill, slope, numbers):
    """Set the volume ratio by the pressure, and return the gradient without its trace."""
    c0, c1, c2, c3, c4, c5, c6, c7, c8 = L
    store(f, p + STATE * cap, np.log1p(load(extra, 3 * BATCH + n)) * (-1.0 / kind.exponent))
    third = (c0 + c4 + c8) * (1.0 / 3.0)
    return (c0 - third, c1, c2, c3, c4 - third, c5, c6, c7, c8 - third)


@mixture_wave_speed_squared.of(ImplicitPressure)
def _(kind, f, p, cap, numbers, wave2):
    return 0.0 * wave2
