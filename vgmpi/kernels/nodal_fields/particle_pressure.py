"""Rest volume times pressure of particles at the nodes [m3], relative to the Tait coefficient.

It is the first guess of an implicit pressure (kernels/grid/pressure_system.py).
"""

from typing import NamedTuple

import numpy as np

from vgmpi.kernels.particle_records import STATE, VOLUME
from vgmpi.kernels.reproducible_sums import next_power_of_two
from vgmpi.kernels.simd.row_ops import broadcast, store_records
from vgmpi.kernels.simd.vector16 import load
from vgmpi.kernels.stencil_sums import scatter
from vgmpi.runtime.jit import always_inline

from .field_protocol import MIRROR_VECTOR, accumulate, particle_contribution

MAX_RELATIVE_PRESSURE = 16.0  # [-] above kernels/grid/pressure_system.MAX_PRESSURE


class ParticlePressure(NamedTuple):
    """Contribution of pressure."""

    mirror: float  # code of nodal_fields/field_protocol.py


def kind(plan) -> ParticlePressure:
    """Return the contribution of particles to the field, mirrored at walls as their mass is."""
    return ParticlePressure(plan.real.type(MIRROR_VECTOR))


def accumulator_range(plan) -> np.ndarray:
    """Return the scales of the sums, powers of two, shape (phases, 4)."""
    return np.full((len(plan.phases), 4), next_power_of_two(MAX_RELATIVE_PRESSURE * plan.dx**3))


@always_inline
def relative_pressure(law, f, p, cap):
    """Return the pressure of 16 particles relative to the Tait coefficient of their law."""
    theta = load(f, p + STATE * cap)
    return np.minimum(np.expm1(-law.gamma * theta), 0.0 * theta + MAX_RELATIVE_PRESSURE)


@particle_contribution.of(ParticlePressure)
def _particle_pressure(kind, law, count, offset, cap, f, extra, peak, records, dt):
    o = broadcast(f, 0.0)
    for n in range(0, count, 16):
        p = offset + n
        amount = load(f, p + VOLUME * cap) * relative_pressure(law, f, p, cap)
        store_records(records, 16 * n, (o, o, o, amount, o, o, o, o, o, o, o, o, o, o, o, o))


@accumulate.of(ParticlePressure)
def _add(kind, count, records, weights, base, patch):
    scatter(count, records, weights, base, patch)
