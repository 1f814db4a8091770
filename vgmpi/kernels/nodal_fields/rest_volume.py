"""Rest volume [m3] of particles at the nodes, in the step of no time before a shift.

The mass of a node tells how full its cell is only where all liquids of its phase have one density.
Elsewhere this field does; see kernels/transfer/particle_shifting.py.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.kernels.particle_records import VOLUME
from vgmpi.kernels.reproducible_sums import next_power_of_two
from vgmpi.kernels.simd.row_ops import broadcast, store_records
from vgmpi.kernels.simd.vector16 import load

from .field_protocol import MIRROR_VECTOR, accumulate, particle_contribution
from .momentum import by_weights


class RestVolume(NamedTuple):
    """Contribution of rest volume."""

    mirror: float  # code of nodal_fields/field_protocol.py


def kind(plan) -> RestVolume:
    """Return the contribution of particles to the field, mirrored at walls as their mass is."""
    return RestVolume(plan.real.type(MIRROR_VECTOR))


def accumulator_range(plan) -> np.ndarray:
    """Return the scales of the sums, powers of two, shape (phases, 4): the volume of a cell."""
    return np.full((len(plan.phases), 4), next_power_of_two(plan.dx**3))


@particle_contribution.register(RestVolume)
def _rest_volume(kind, law, count, offset, cap, f, extra, peak, records, dt):
    zero = broadcast(f, 0.0)
    for n in range(0, count, 16):
        volume = load(f, offset + n + VOLUME * cap)
        store_records(
            records,
            16 * n,
            (
                zero, zero, zero, volume, zero, zero, zero, zero,
                zero, zero, zero, zero, zero, zero, zero, zero,
            ),
        )  # fmt: skip


accumulate.register(RestVolume)(by_weights)
