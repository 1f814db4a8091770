"""Transfer of liquids with an implicit pressure: pressure to the nodes, and displacement back.

The nodes receive the rest volume of the particles [m3], and the same times their pressure relative
to the Tait coefficient: the first guess of an implicit pressure (pressure_system.py).
Particles gather the displacement and the pressure of the nodes. Their volume ratio is not
integrated. It is the one at which the law has the pressure of the grid, which is the first guess of
the next step, and what files and checkpoints contain. The gathering is a kind of
auxiliary_gather.py; see docs/explanation/implicit-pressure.md.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.features.field_request import FieldRequest
from vgmpi.kernels.nodal_fields.field_protocol import (
    MIRROR_SCALARS,
    accumulate,
    particle_contribution,
)
from vgmpi.kernels.nodal_fields.momentum import by_weights
from vgmpi.kernels.particle_records import BATCH, STATE, VOLUME, patch_of, scatter_columns
from vgmpi.kernels.reproducible_sums import next_power_of_two
from vgmpi.kernels.simd.row_ops import broadcast, store_records
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

from .pressure_system import MAX_PRESSURE

VOLUMES = "liquid volumes"  # name of the field
# [-] The volume of particles is not integrated: lone drops may change theirs five times as fast.
VOLUME_RATE_SHARE = 0.2
MAX_THETA = 1.5  # [-] of particles: small Tait exponents would make volumes that end a run
MAX_RELATIVE_PRESSURE = MAX_PRESSURE + 1.0  # [-] beyond what the system gives to particles


class LiquidVolume(NamedTuple):
    """Contribution of volume and pressure."""

    mirror: float  # code of nodal_fields/field_protocol.py


def request_liquid_volumes(plan: Plan) -> FieldRequest:
    """Return the request for the field, mirrored at walls as the mass of the particles is."""
    kind = LiquidVolume(plan.real.type(MIRROR_SCALARS))
    scale = next_power_of_two(MAX_RELATIVE_PRESSURE * plan.dx**3)
    return FieldRequest(
        VOLUMES,
        lambda _: np.full((len(plan.phases), 4), scale),
        lambda group: kind if group.volume.separate_pressure else None,
        is_for_couplings=True,
    )


@always_inline
def relative_pressure(law, f, p, cap):
    """Return the pressure of 16 particles relative to the Tait coefficient of their law."""
    theta = load(f, p + STATE * cap)
    return np.minimum(np.expm1(-law.gamma * theta), 0.0 * theta + MAX_RELATIVE_PRESSURE)


@particle_contribution.register(LiquidVolume)
def _liquid_volume(kind, law, count, offset, cap, f, extra, peak, records, dt):
    o = broadcast(f, 0.0)
    for n in range(0, count, 16):
        p = offset + n
        volume = load(f, p + VOLUME * cap)
        amount = volume * relative_pressure(law, f, p, cap)
        store_records(records, 16 * n, (volume, o, o, amount, o, o, o, o, o, o, o, o, o, o, o, o))


accumulate.register(LiquidVolume)(by_weights)


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
