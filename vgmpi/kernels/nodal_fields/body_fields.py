"""The four nodal fields next to free bodies in one record: velocity gradients, mean pressure.

They are those of velocity_gradient.py and mean_pressure.py. A record holds the four values of each
field and no slopes, so one record per particle serves them all.
"""

from typing import NamedTuple

from vgmpi.kernels.particle_records import AFFINE, load_tensor
from vgmpi.kernels.simd.row_ops import broadcast, store_records

from .field_protocol import MIRROR_NONE, particle_contribution
from .mean_pressure import pressure_impulse


class BodyFields(NamedTuple):
    """Contribution of velocity gradients and mean pressure."""

    mirror: float  # code of nodal_fields/field_protocol.py
    dx: float  # [m] cell size
    density: float  # [kg/m3] rest density


def kind(plan, group) -> BodyFields:
    """Return the contribution of a group's particles."""
    return BodyFields(*(plan.real.type(v) for v in (MIRROR_NONE, plan.dx, group.density)))


@particle_contribution.of(BodyFields)
def _body_fields(kind, law, count, offset, cap, f, extra, peak, records, dt):
    o = broadcast(f, 0.0)
    scale = broadcast(f, dt) * -1.0 / (3.0 * kind.dx)
    for n in range(0, count, 16):
        p = offset + n
        L = load_tensor(f, p + AFFINE * cap, cap)
        pressure, volume = pressure_impulse(law, p, cap, f, L, scale)
        mass = kind.density * volume
        k = kind.dx * mass
        store_records(
            records,
            16 * n,
            (
                k * L[0], k * L[3], k * L[6], mass, k * L[1], k * L[4], k * L[7], mass,
                k * L[2], k * L[5], k * L[8], mass, pressure, o, o, volume,
            ),
        )  # fmt: skip
