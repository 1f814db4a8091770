"""Nodal fields next to free rigid bodies: the mean pressure, and four fields in one record.

The impulse of the mean pressure dt V p / dx [kg m/s] and the rest volume [m3] have a ratio that is
the mean pressure at a node, by which a body holds what flows a cell outside it. Velocity gradients
(velocity_gradient.py) and mean pressure have no slopes, so one record per particle, with the four
values of each field, serves them all.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.kernels.particle_records import AFFINE, STATE, VOLUME, load_tensor
from vgmpi.kernels.simd.material_dispatch import load_state_vector, stress
from vgmpi.kernels.simd.row_ops import broadcast, store_records
from vgmpi.kernels.simd.vector16 import load
from vgmpi.runtime.jit import always_inline

from . import stress_impulse
from .field_protocol import MIRROR_NONE, accumulate, particle_contribution
from .momentum import by_weights


class MeanPressure(NamedTuple):
    """Contribution of the impulse of the mean pressure."""

    mirror: float  # code of nodal_fields/field_protocol.py
    dx: float  # [m] cell size


def mean_pressure_kind(plan) -> MeanPressure:
    """Return the contribution of particles."""
    return MeanPressure(*(plan.real.type(v) for v in (MIRROR_NONE, plan.dx)))


def accumulator_range(plan, speed: float) -> np.ndarray:
    """Return the scales of the sums: those of stress impulses, shape (phases, 4)."""
    return stress_impulse.accumulator_range(plan, speed)


@always_inline
def pressure_impulse(law, p, cap, f, L, scale):
    """Return the impulse of the mean pressure of 16 particles, and their volumes [m3].

    Args:
        law: Material parameters of the group.
        p: First of the particles.
        cap: Particles that the group has room for.
        f: Channels of the group, flat.
        L: Velocity gradient.
        scale: -dt / (3 dx).
    """
    t00, t11, t22, _, _, _ = stress(law, load_state_vector(law, f, p + STATE * cap, cap), L)
    volume = load(f, p + VOLUME * cap)
    return scale * volume * (t00 + t11 + t22), volume


@particle_contribution.register(MeanPressure)
def _mean_pressure(kind, law, count, offset, cap, f, extra, peak, records, dt):
    o = broadcast(f, 0.0)
    scale = broadcast(f, dt) * -1.0 / (3.0 * kind.dx)
    for n in range(0, count, 16):
        p = offset + n
        L = load_tensor(f, p + AFFINE * cap, cap)
        pressure, volume = pressure_impulse(law, p, cap, f, L, scale)
        store_records(records, 16 * n, (pressure, o, o, volume, o, o, o, o, o, o, o, o, o, o, o, o))


accumulate.register(MeanPressure)(by_weights)


class BodyFields(NamedTuple):
    """Contribution of velocity gradients and mean pressure."""

    mirror: float  # code of nodal_fields/field_protocol.py
    dx: float  # [m] cell size
    density: float  # [kg/m3] rest density


def kind(plan, group) -> BodyFields:
    """Return the contribution of a group's particles."""
    return BodyFields(*(plan.real.type(v) for v in (MIRROR_NONE, plan.dx, group.density)))


@particle_contribution.register(BodyFields)
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
