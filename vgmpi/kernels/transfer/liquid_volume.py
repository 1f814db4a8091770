"""Volume of liquids: how it follows the divergence, and how errors of it decay.

The density correction relaxes the volume of a liquid to the space that it takes. With dilatation by
cells, against locking, the volume of a particle follows the mean divergence of the cells around it,
interpolated, in place of the trace of its own velocity gradient; its adjoint is the impulse of the
mean stress [kg m/s] by the means of cells, a second contribution to momentum: a pressure does work
on that dilatation. Both are kinds of auxiliary_gather.py (docs/explanation/transfer-schemes.md).

Sparse liquid receives a part of the divergence alone. A particle without neighbors is one mass with
the nodes around it: with a pressure K theta its rate of expansion changes by -(12 / dx^2) c^2
theta, 4 / dx^2 along each axis, where waves in a body of liquid reach a third of that. So a lone
drop would bound the steps of all liquids. Its volume has no meaning: where the liquid fills little
of the space around a particle, the volume ratio follows only a part of the divergence. That divides
the squared frequency, needs no further state and leaves momentum as it is
(docs/explanation/time-step.md).
"""

from typing import NamedTuple

import numpy as np

from vgmpi.kernels.cell_stencil_sums import gather_cell_slopes, scatter_cell_pressure
from vgmpi.kernels.nodal_fields.field_protocol import (
    MIRROR_IMPULSE,
    accumulate,
    particle_contribution,
)
from vgmpi.kernels.particle_records import AFFINE, STATE, VOLUME, load_tensor, velocity_patch_of
from vgmpi.kernels.simd.material_dispatch import load_state_vector, stress
from vgmpi.kernels.simd.row_ops import broadcast, store_records
from vgmpi.kernels.simd.vector16 import load
from vgmpi.runtime.jit import device_function

from .auxiliary_gather import (
    VelocityOnly,
    advection_velocity,
    bounded_volume_rate,
    displacement,
    gather_batch,
    load_patches,
    max_velocity,
    particle_velocity,
    velocity_gradient,
    wave_speed_squared,
)

CORRECTION_RATE = 5.0  # [1/s] relaxation rate of a fluid's volume to the space that it takes
# [-] Below a free surface the gathered mass is too small, by 0.3 to 0.4 of its change per cell
# (0.026 and 0.09 at a depth of 1.25 cells); in spray, where it is much smaller, it means nothing.
SURFACE_SLOPE, MIN_FILL, FULL_FILL = 0.4, 0.8, 0.9
# [-] filled fraction of space below which the part falls, and at which it is least; on the flat
# surface of a liquid 0.61 to 0.66 is filled, at an edge 0.4 and around a lone drop 0.03
FULL_RESPONSE_FILL, LEAST_RESPONSE_FILL = 0.4, 0.1
LEAST_RESPONSE = 0.3  # [-] part of the divergence: a lone drop is stable up to sqrt(1 / 3 / 0.3)
INVERSE_RANGE = 1.0 / (FULL_RESPONSE_FILL - LEAST_RESPONSE_FILL)


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


@load_patches.register(DensityCorrected)
def _(kind, blocks, box, mirror, real, ghosts, s):
    load_patches(kind.inner, blocks, box, mirror, real, ghosts, s)


@gather_batch.register(DensityCorrected)
def _(kind, count, weights, records, base, real, extra):
    gather_batch(kind.inner, count, weights, records, base, real, extra)


@particle_velocity.register(DensityCorrected)
def _(kind, f, p, cap, extra, n, v):
    particle_velocity(kind.inner, f, p, cap, extra, n, v)


@max_velocity.register(DensityCorrected)
def _(kind, f, p, cap, displacement, scale):
    return max_velocity(kind.inner, f, p, cap, displacement, scale)


@advection_velocity.register(DensityCorrected)
def _(kind, split, extra, n, v):
    return advection_velocity(kind.inner, split, extra, n, v)


@displacement.register(DensityCorrected)
def _(kind, extra, n, moves):
    return displacement(kind.inner, extra, n, moves)


@velocity_gradient.register(DensityCorrected)
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


@wave_speed_squared.register(DensityCorrected)
def _(kind, f, p, cap, wave2):
    return wave_speed_squared(kind.inner, f, p, cap, wave2)


@bounded_volume_rate.register(DensityCorrected)
def _(kind, trace):
    return bounded_volume_rate(kind.inner, trace)


class CellDilatation(NamedTuple):
    """Kind of liquids whose dilatation is that of cells; otherwise as `VelocityOnly`."""

    unused: float


for _dispatch in (
    load_patches, particle_velocity, max_velocity, advection_velocity, displacement,
    wave_speed_squared, bounded_volume_rate,
):  # fmt: skip
    _dispatch.register(CellDilatation)(_dispatch.table[VelocityOnly])


@gather_batch.register(CellDilatation)
def _gather_cell_divergence(kind, count, weights, records, base, real, extra):
    """Gather the mean divergence of the cells [cells/s]."""
    gather_cell_slopes(count, records, weights, base, velocity_patch_of(real))
    for n in range(count):
        m = 16 * n
        extra[n] = records[m] + records[m + 5] + records[m + 10]


@velocity_gradient.register(CellDilatation)
def _replace_trace(kind, split, f, p, cap, extra, n, L, fill, slope, numbers):
    """Replace the trace of the velocity gradient."""
    c0, c1, c2, c3, c4, c5, c6, c7, c8 = L
    added = (load(extra, n) / numbers.dx - (c0 + c4 + c8)) * (1.0 / 3.0)
    return (c0 + added, c1, c2, c3, c4 + added, c5, c6, c7, c8 + added)


class CellPressure(NamedTuple):
    """Contribution of the impulse of the mean stress, by the means of cells.

    It is for `dilatation = "cells"`; else pressure is part of nodal_fields/momentum.py.
    """

    mirror: float  # code of nodal_fields/field_protocol.py
    dx: float  # [m] cell size


def cell_pressure_kind(plan) -> CellPressure:
    """Return the contribution of a group's particles."""
    return CellPressure(*(plan.real.type(v) for v in (MIRROR_IMPULSE, plan.dx)))


@particle_contribution.register(CellPressure)
def _cell_pressure(kind, law, count, offset, cap, f, extra, peak, records, dt):
    zero = broadcast(f, 0.0)
    dx = kind.dx
    scale = broadcast(f, dt) * -1.0 / (3.0 * dx)
    for n in range(0, count, 16):
        p = offset + n
        L = load_tensor(f, p + AFFINE * cap, cap)
        t00, t11, t22, _, _, _ = stress(law, load_state_vector(law, f, p + STATE * cap, cap), L)
        impulse = scale * load(f, p + VOLUME * cap) * (t00 + t11 + t22)
        store_records(
            records,
            16 * n,
            (
                zero, zero, zero, zero, impulse, zero, zero, zero,
                zero, impulse, zero, zero, zero, zero, impulse, zero,
            ),
        )  # fmt: skip


@accumulate.register(CellPressure)
def _add_by_cells(kind, count, records, weights, base, patch):
    scatter_cell_pressure(count, records, weights, base, patch)


@device_function
def reduce_spray_divergence(L, fill_fraction):
    """Return the velocity gradient that the equation of state of a liquid receives.

    Args:
        L: Velocity gradient, nine components, row by row [1/s].
        fill_fraction: Filled fraction of the space around the particle [-].
    """
    sparsity = clamp_to_unit((FULL_RESPONSE_FILL - fill_fraction) * INVERSE_RANGE)
    c0, c1, c2, c3, c4, c5, c6, c7, c8 = L
    removed = ((1.0 - LEAST_RESPONSE) / 3.0) * sparsity * (c0 + c4 + c8)
    return (c0 - removed, c1, c2, c3, c4 - removed, c5, c6, c7, c8 - removed)
