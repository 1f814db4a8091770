"""Momentum [kg m/s] and mass [kg], with the stress's impulse over a step where that is not kept
apart (quadratic B-splines, APIC: Jiang 2015, MLS force: Hu 2018).
"""

from typing import NamedTuple

import numpy as np

from ...lanes.lanes import load, store
from ...lanes.laws import lane_state, stress
from ...lanes.rows import first_lanes, higher, spread, store_records
from ..records import AFFINE, STATE, VOLUME, nine
from ..rowsums import scatter, scatter_slopes
from ..sums import power
from .base import VECTOR, add, contribute


class Momentum(NamedTuple):
    """With the stress's impulse."""

    mirror: float
    splines: float  # 1: forces by the gradients of the B-splines, 0: by moments
    density: float  # [kg/m3] of a particle's rest volume
    affine: float  # 1: particles carry the velocity's gradient (APIC), 0: they do not
    dx: float  # [m]


class Inertia(NamedTuple):
    """Without: the impulses are a layer of their own."""

    mirror: float
    splines: float  # 1: forces by the gradients of the B-splines, 0: by moments
    density: float
    affine: float
    dx: float


def kinds(plan, group) -> tuple[Momentum, Inertia]:
    """What a group's particles contribute, where their stress is part of it and where not."""
    real = plan.real.type
    numbers = [real(v) for v in (VECTOR, plan.splines, group.density, plan.affine, plan.dx)]
    return Momentum(*numbers), Inertia(*numbers)


def full(plan, speed: float) -> np.ndarray:
    """Powers of two (phases, 4): momentum of a full cell of a phase's densest material at a speed
    [m/s], a power of two, and its mass."""
    mass = power([phase.most for phase in plan.phases])
    fast = mass * speed
    return np.stack([fast, fast, fast, mass], 1)


@contribute.of(Momentum)
def _momentum(kind, law, count, at, cap, f, extra, peak, records, dt):
    zero = spread(f, 0.0)
    dx = kind.dx
    four = spread(f, dt) * 4.0 / (dx * dx)  # as a vector: a plain number would be a double
    most, over = load(peak, 0), 1.0 / (kind.density * kind.density)
    for n in range(0, count, 16):
        p = at + n
        L = nine(f, p + AFFINE * cap, cap)
        c0, c1, c2, c3, c4, c5, c6, c7, c8 = L
        t00, t11, t22, t01, t02, t12 = stress(law, lane_state(law, f, p + STATE * cap, cap), L)
        size = t00 * t00 + t11 * t11 + t22 * t22 + t01 * t01 + t02 * t02 + t12 * t12
        most = higher(first_lanes(over * size, count - n), most)
        volume = load(f, p + VOLUME * cap)
        mass = kind.density * volume
        k, m = dx * four * volume, kind.affine * dx * mass
        store_records(
            records,
            16 * n,
            (
                mass * load(f, p), mass * load(f, p + cap), mass * load(f, p + 2 * cap), mass,
                m * c0 - k * t00, m * c3 - k * t01, m * c6 - k * t02, zero,
                m * c1 - k * t01, m * c4 - k * t11, m * c7 - k * t12, zero,
                m * c2 - k * t02, m * c5 - k * t12, m * c8 - k * t22, zero,
            ),
        )  # fmt: skip
    store(peak, 0, most)


@contribute.of(Inertia)
def _inertia(kind, law, count, at, cap, f, extra, peak, records, dt):
    zero = spread(f, 0.0)
    for n in range(0, count, 16):
        p = at + n
        mass = kind.density * load(f, p + VOLUME * cap)
        m = kind.affine * kind.dx * mass
        c0, c1, c2, c3, c4, c5, c6, c7, c8 = nine(f, p + AFFINE * cap, cap)
        v0, v1, v2 = load(f, p), load(f, p + cap), load(f, p + 2 * cap)
        store_records(
            records,
            16 * n,
            (
                mass * v0, mass * v1, mass * v2, mass,
                m * c0, m * c3, m * c6, zero, m * c1, m * c4, m * c7, zero,
                m * c2, m * c5, m * c8, zero,
            ),
        )  # fmt: skip


@add.of(Momentum)
@add.of(Inertia)
def by_slopes(kind, count, records, weights, base, patch):
    """As `scatter`, or along the slopes of the B-splines."""
    if kind.splines > 0.0:
        scatter_slopes(count, records, weights, base, patch)
    else:
        scatter(count, records, weights, base, patch)
