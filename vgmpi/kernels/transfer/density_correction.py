"""Density correction of liquids: their volume is relaxed to the space that they take.

It is a kind of auxiliary_gather.py that combines with any of the others
(docs/explanation/transfer-schemes.md).
"""

from typing import NamedTuple

import numpy as np

from vgmpi.kernels.particle_records import STATE
from vgmpi.kernels.simd.vector16 import load
from vgmpi.runtime.jit import device_function

from .auxiliary_gather import (
    advection_velocity,
    displacement,
    gather_batch,
    load_patches,
    max_velocity,
    mixture_wave_speed_squared,
    particle_velocity,
    velocity_gradient,
)

CORRECTION_RATE = 5.0  # [1/s] relaxation rate of a fluid's volume to the space that it takes
# [-] Below a free surface the gathered mass is too small, by 0.3 to 0.4 of its change per cell
# (0.026 and 0.09 at a depth of 1.25 cells); in spray, where it is much smaller, it means nothing.
SURFACE_SLOPE, MIN_FILL, FULL_FILL = 0.4, 0.8, 0.9


class DensityCorrected(NamedTuple):
    """Kind of fluids with density correction."""

    inner: tuple  # kind of auxiliary_gather.py
    space: float  # [1/kg] inverse of the mass that fills a cell at rest


@device_function
def interior_weight(fill_fraction):
    """Return the weight of missing mass: 0 in spray, 1 in the interior of a liquid."""
    return clamp_to_unit((fill_fraction - MIN_FILL) * (1.0 / (FULL_FILL - MIN_FILL)))


@device_function
def clamp_to_unit(value):
    """Return values of 16 particles, limited to the range from 0 to 1."""
    zero = 0.0 * value
    return np.minimum(np.maximum(value, zero), zero + 1.0)


@load_patches.of(DensityCorrected)
def _(kind, blocks, box, mirror, real, ghosts, s):
    load_patches(kind.inner, blocks, box, mirror, real, ghosts, s)


@gather_batch.of(DensityCorrected)
def _(kind, count, weights, records, base, real, extra):
    gather_batch(kind.inner, count, weights, records, base, real, extra)


@particle_velocity.of(DensityCorrected)
def _(kind, f, p, cap, extra, n, v):
    particle_velocity(kind.inner, f, p, cap, extra, n, v)


@max_velocity.of(DensityCorrected)
def _(kind, f, p, cap, displacement, scale):
    return max_velocity(kind.inner, f, p, cap, displacement, scale)


@advection_velocity.of(DensityCorrected)
def _(kind, split, extra, n, v):
    return advection_velocity(kind.inner, split, extra, n, v)


@displacement.of(DensityCorrected)
def _(kind, extra, n, moves):
    return displacement(kind.inner, extra, n, moves)


@velocity_gradient.of(DensityCorrected)
def _(kind, split, f, p, cap, extra, n, L, fill, slope, numbers):
    """Add the density correction to the velocity gradient seen by the equation of state.

    The gathered mass gives the local fill fraction. Where it exceeds 1 / J the volumetric strain
    rate is reduced, so that pressure rises; in the interior, where it is smaller, the rate is
    increased. The relative error decays at the rate CORRECTION_RATE.
    """
    L = velocity_gradient(kind.inner, split, f, p, cap, extra, n, L, fill, slope, numbers)
    zero = 0.0 * fill
    fill_fraction, J = kind.space * fill, np.exp(load(f, p + STATE * cap))
    overfill = fill_fraction * J - 1.0
    x, y, z = slope
    surface_margin = (4.0 * SURFACE_SLOPE) * np.sqrt(x * x + y * y + z * z) * kind.space
    missing = interior_weight(fill_fraction) * np.minimum(overfill + surface_margin, zero)
    error = np.maximum(overfill, zero) + missing
    correction = (CORRECTION_RATE / 3.0) * error
    return (
        L[0] - correction,
        L[1],
        L[2],
        L[3],
        L[4] - correction,
        L[5],
        L[6],
        L[7],
        L[8] - correction,
    )


@mixture_wave_speed_squared.of(DensityCorrected)
def _(kind, f, p, cap, numbers, wave2):
    return mixture_wave_speed_squared(kind.inner, f, p, cap, numbers, wave2)
