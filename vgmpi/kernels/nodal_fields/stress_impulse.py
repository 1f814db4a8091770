"""Stress impulses over a step [kg m/s], kept separate from momentum, and current volumes [m3].

They are separate where FLIP needs the change of velocity and where fluids share their pressure.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.kernels.particle_records import AFFINE, STATE, VOLUME, load_tensor
from vgmpi.kernels.reproducible_sums import next_power_of_two
from vgmpi.kernels.simd.material_dispatch import load_state_vector, stress, volume_ratio
from vgmpi.kernels.simd.row_ops import broadcast, max_ignore_nan, store_records
from vgmpi.kernels.simd.static_dispatch import static_dispatch
from vgmpi.kernels.simd.vector16 import first_n, load, store

from . import momentum
from .field_protocol import MIRROR_IMPULSE, accumulate, particle_contribution


class Impulses(NamedTuple):
    """Contribution of stress impulses and volumes."""

    mirror: float  # code of nodal_fields/field_protocol.py
    splines: float  # 1: forces by the gradients of the B-splines, 0: by moments
    counted: float  # 1 where phases share space, so that nodes need volumes
    porosity: float  # channel of the fluid's volume fraction, or -1
    dx: float  # [m] cell size
    density: float  # [kg/m3] rest density


class ImpulsesWithoutPressure(NamedTuple):
    """Contribution of deviatoric stress impulses and rest volumes: a feature has the pressure."""

    mirror: float  # code of nodal_fields/field_protocol.py
    splines: float  # 1: forces by the gradients of the B-splines, 0: by moments
    counted: float  # 1 where phases share space, so that nodes need volumes
    porosity: float  # channel of the fluid's volume fraction, or -1
    dx: float  # [m] cell size
    density: float  # [kg/m3] rest density


momentum.stress_by_moments.register(Impulses)(momentum.stress_by_moments.table[momentum.Momentum])
momentum.stress_by_moments.register(ImpulsesWithoutPressure)(
    momentum.stress_by_moments.table[momentum.MomentumWithoutPressure]
)


@static_dispatch
def current_volume(kind, law, state, volume):
    """Return the volumes that 16 particles fill.

    Args:
        kind: Contribution kind.
        law, state: Material parameters, and state of the particles.
        volume: Their rest volumes.
    """


@current_volume.register(Impulses)
def _(kind, law, state, volume):
    return volume * volume_ratio(law, state)


@current_volume.register(ImpulsesWithoutPressure)
def _(kind, law, state, volume):
    return volume


def kind(plan, group) -> Impulses | ImpulsesWithoutPressure:
    """Return the contribution of a group's particles."""
    real = plan.real.type
    contribution = ImpulsesWithoutPressure if group.volume.separate_pressure else Impulses
    counted = any(feature.counts_volumes for feature in plan.features)
    porosity = group.channels.first("share")
    return contribution(
        *(
            real(v)
            for v in (MIRROR_IMPULSE, plan.splines, counted, porosity, plan.dx, group.density)
        )
    )


def accumulator_range(plan, speed: float) -> np.ndarray:
    """Return the scales of the sums, powers of two, shape (phases, 4).

    They are those of momentum, and the volume of a cell.
    """
    out = momentum.accumulator_range(plan, speed)
    out[:, 3] = next_power_of_two(plan.dx**3)
    return out


@particle_contribution.register(Impulses)
@particle_contribution.register(ImpulsesWithoutPressure)
def _impulses(kind, law, count, offset, cap, f, extra, peak, records, dt):
    porosity = np.int64(kind.porosity)
    zero = broadcast(f, 0.0)
    four = dt * 4.0 / kind.dx
    stress_peak, over = load(peak, 0), 1.0 / (kind.density * kind.density)
    for n in range(0, count, 16):
        p = offset + n
        L = load_tensor(f, p + AFFINE * cap, cap)
        state = load_state_vector(law, f, p + STATE * cap, cap)
        t00, t11, t22, t01, t02, t12 = stress(law, state, L)
        t00, t11, t22 = momentum.stress_by_moments(kind, t00, t11, t22)
        volume = load(f, p + VOLUME * cap)
        k, over_pores = -four * volume, broadcast(f, 1.0)
        filled = current_volume(kind, law, state, volume) if kind.counted > 0.0 else zero
        if porosity >= 0:
            pore_fraction = load(f, p + porosity * cap)
            k = k / pore_fraction
            over_pores = 1.0 / (pore_fraction * pore_fraction)
        size = t00 * t00 + t11 * t11 + t22 * t22 + t01 * t01 + t02 * t02 + t12 * t12
        stress_peak = max_ignore_nan(first_n(over * over_pores * size, count - n), stress_peak)
        a, b, c = k * t01, k * t02, k * t12
        store_records(
            records,
            16 * n,
            (
                zero, zero, zero, filled, k * t00, a, b, zero,
                a, k * t11, c, zero, b, c, k * t22, zero,
            ),
        )  # fmt: skip
    store(peak, 0, stress_peak)


for _kind in (Impulses, ImpulsesWithoutPressure):
    accumulate.register(_kind)(momentum.by_slopes)
