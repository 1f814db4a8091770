"""Transfer of liquids with an implicit pressure: pressure to the nodes, and displacement back.

The nodes receive rest volume times pressure of the particles [m3], relative to the Tait
coefficient: the first guess of an implicit pressure (pressure_system.py). Where liquids of several
densities have one velocity, they also receive the rest volume. Particles gather the displacement
and the pressure of the nodes. Their volume ratio is not integrated. It is the one at which the law
has the pressure of the grid, which is the first guess of the next step, and what files and
checkpoints contain. The gathering is a kind of auxiliary_gather.py; see
docs/explanation/implicit-pressure.md.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.features.field_request import FieldRequest
from vgmpi.kernels.nodal_fields.field_protocol import (
    MIRROR_VECTOR,
    accumulate,
    particle_contribution,
)
from vgmpi.kernels.nodal_fields.momentum import by_weights
from vgmpi.kernels.particle_records import BATCH, STATE, VOLUME, patch_of, scatter_columns
from vgmpi.kernels.reproducible_sums import next_power_of_two
from vgmpi.kernels.simd.row_ops import broadcast, store_records
from vgmpi.kernels.simd.static_dispatch import static_dispatch
from vgmpi.kernels.simd.vector16 import load, store
from vgmpi.kernels.stencil_sums import gather_value
from vgmpi.kernels.transfer.auxiliary_gather import (
    VelocityOnly,
    advection_velocity,
    bounded_volume_rate,
    displacement,
    gather_batch,
    load_mirrored_patch,
    load_patches,
    max_velocity,
    particle_velocity,
    velocity_gradient,
    wave_speed_squared,
)
from vgmpi.planning.plan import Plan
from vgmpi.runtime.jit import always_inline

from .plan import LIQUID_VOLUME, PARTICLE_PRESSURE, liquid_groups
from .pressure_system import MAX_PRESSURE

# [-] The volume of particles is not integrated: lone drops may change theirs five times as fast.
VOLUME_RATE_SHARE = 0.2
MAX_THETA = 1.5  # [-] of particles: small Tait exponents would make volumes that end a run
MAX_RELATIVE_PRESSURE = MAX_PRESSURE + 1.0  # [-] beyond what the system gives to particles


class ParticlePressure(NamedTuple):
    """Contribution of volume times relative pressure."""

    mirror: float  # code of nodal_fields/field_protocol.py


class LiquidVolume(NamedTuple):
    """Contribution of volume."""

    mirror: float  # code of nodal_fields/field_protocol.py


def request_liquid_fields(plan: Plan) -> tuple[FieldRequest, ...]:
    """Return the requests for the fields, mirrored at walls as the mass of the particles is."""
    dx3, mirror, own = plan.dx**3, plan.real.type(MIRROR_VECTOR), liquid_groups(plan)
    mixed = {a.phase for a in own for b in own if a.phase == b.phase and a.density != b.density}
    pressure, volume = ParticlePressure(mirror), LiquidVolume(mirror)
    max_sum = next_power_of_two(MAX_RELATIVE_PRESSURE * dx3)
    fields = [
        FieldRequest(
            PARTICLE_PRESSURE,
            lambda _: np.full((len(plan.phases), 4), max_sum),
            lambda group: pressure if group.volume.separate_pressure else None,
            is_for_couplings=True,
        ),
        FieldRequest(
            LIQUID_VOLUME,
            lambda _: np.full((len(plan.phases), 4), next_power_of_two(dx3)),
            lambda group: volume if group.phase in mixed else None,
            is_for_couplings=True,
        ),
    ]
    return tuple(fields if mixed else fields[:1])


@always_inline
def relative_pressure(law, f, p, cap):
    """Return the pressure of 16 particles relative to the Tait coefficient of their law."""
    theta = load(f, p + STATE * cap)
    return np.minimum(np.expm1(-law.gamma * theta), 0.0 * theta + MAX_RELATIVE_PRESSURE)


@static_dispatch
def summed_amount(kind, law, f, p, cap):
    """Return what 16 particles add to a nodal field.

    Args:
        kind: Contribution kind.
        law: Material parameters of the group.
        f, p, cap: Particle channels, flat; first of the 16 particles; stride of channels.
    """


@summed_amount.register(ParticlePressure)
def _(kind, law, f, p, cap):
    return load(f, p + VOLUME * cap) * relative_pressure(law, f, p, cap)


@summed_amount.register(LiquidVolume)
def _(kind, law, f, p, cap):
    return load(f, p + VOLUME * cap)


@particle_contribution.register(ParticlePressure)
@particle_contribution.register(LiquidVolume)
def _summed(kind, law, count, offset, cap, f, extra, peak, records, dt):
    o = broadcast(f, 0.0)
    for n in range(0, count, 16):
        amount = summed_amount(kind, law, f, offset + n, cap)
        store_records(records, 16 * n, (o, o, o, amount, o, o, o, o, o, o, o, o, o, o, o, o))


for _kind in (ParticlePressure, LiquidVolume):
    accumulate.register(_kind)(by_weights)


class ImplicitPressureGather(NamedTuple):
    """Kind of liquids with an implicit pressure."""

    moves: np.ndarray  # (node blocks, 256) [cells] displacement, and relative pressure
    patch: int  # number of its patch
    exponent: float  # [-] exponent of the Tait equation


for _dispatch in (particle_velocity, max_velocity, advection_velocity):
    _dispatch.register(ImplicitPressureGather)(_dispatch.table[VelocityOnly])


@load_patches.register(ImplicitPressureGather)
def _(kind, blocks, box, mirror, real, ghosts, s):
    load_mirrored_patch(kind.moves, blocks, box, mirror, patch_of(real, kind.patch), None, s)


@gather_batch.register(ImplicitPressureGather)
def _(kind, count, weights, records, base, real, extra):
    """Gather the displacement [cells] and the relative pressure."""
    gather_value(count, records, weights, base, patch_of(real, kind.patch))
    scatter_columns(count, records, extra, 0, BATCH)
    for n in range(count):
        extra[3 * BATCH + n] = records[16 * n + 3]


@displacement.register(ImplicitPressureGather)
def _(kind, extra, n, moves):
    x, y, z = moves
    return (
        x + load(extra, n),
        y + load(extra, BATCH + n),
        z + load(extra, 2 * BATCH + n),
    )


@velocity_gradient.register(ImplicitPressureGather)
def _(kind, split, f, p, cap, extra, n, L, fill, slope, numbers):
    """Set the volume ratio by the pressure, and return no gradient, which would change it."""
    theta = np.log1p(load(extra, 3 * BATCH + n)) * (-1.0 / kind.exponent)
    limit = 0.0 * theta + MAX_THETA
    store(f, p + STATE * cap, np.minimum(np.maximum(theta, -limit), limit))
    none = 0.0 * L[0]
    return (none, none, none, none, none, none, none, none, none)


@wave_speed_squared.register(ImplicitPressureGather)
def _(kind, f, p, cap, wave2):
    return 0.0 * wave2


@bounded_volume_rate.register(ImplicitPressureGather)
def _(kind, trace):
    return VOLUME_RATE_SHARE * trace
