"""The stress's impulses over a step [kg m/s], kept apart from momentum where FLIP asks for the
change of velocity and where fluids share their pressure; and volumes [m3] as they are now.
"""

from typing import NamedTuple

import numpy as np

from ...lanes.lanes import load, store
from ...lanes.laws import lane_state, stress, volume_ratio
from ...lanes.rows import first_lanes, higher, spread, store_records
from ..records import AFFINE, STATE, VOLUME, nine
from ..sums import power
from . import momentum
from .base import VECTOR, add, contribute


class Impulses(NamedTuple):
    mirror: float
    splines: float  # 1: forces by the gradients of the B-splines, 0: by moments
    counted: float  # 1 where phases share space, so that nodes must know volumes
    porosity: float  # channel of the fluid's share of space, or -1
    dx: float  # [m]
    density: float  # [kg/m3]


def kind(plan, group) -> Impulses:
    """What a group's particles contribute."""
    real = plan.real.type
    counted, porosity = plan.rules is not None, group.channels.first("share")
    return Impulses(
        *(real(v) for v in (VECTOR, plan.splines, counted, porosity, plan.dx, group.density))
    )


def full(plan, speed: float) -> np.ndarray:
    """Powers of two (phases, 4): as of momentum, and the volume of a cell."""
    out = momentum.full(plan, speed)
    out[:, 3] = power(plan.dx**3)
    return out


@contribute.of(Impulses)
def _impulses(kind, law, count, at, cap, f, extra, peak, records, dt):
    porosity = np.int64(kind.porosity)
    zero = spread(f, 0.0)
    four = dt * 4.0 / kind.dx
    most, over = load(peak, 0), 1.0 / (kind.density * kind.density)
    for n in range(0, count, 16):
        p = at + n
        L = nine(f, p + AFFINE * cap, cap)
        state = lane_state(law, f, p + STATE * cap, cap)
        t00, t11, t22, t01, t02, t12 = stress(law, state, L)
        volume = load(f, p + VOLUME * cap)
        k, over_pores = -four * volume, spread(f, 1.0)
        now = volume * volume_ratio(law, state) if kind.counted > 0.0 else zero
        if porosity >= 0:
            share = load(f, p + porosity * cap)
            k = k / share
            over_pores = 1.0 / (share * share)
        size = t00 * t00 + t11 * t11 + t22 * t22 + t01 * t01 + t02 * t02 + t12 * t12
        most = higher(first_lanes(over * over_pores * size, count - n), most)
        a, b, c = k * t01, k * t02, k * t12
        store_records(
            records,
            16 * n,
            (
                zero, zero, zero, now, k * t00, a, b, zero,
                a, k * t11, c, zero, b, c, k * t22, zero,
            ),
        )  # fmt: skip
    store(peak, 0, most)


add.of(Impulses)(momentum.by_slopes)
