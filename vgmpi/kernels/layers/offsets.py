"""Volumes V [m3] and offsets V (x_p - x_i) [m4], which tell contact where the surfaces of phases
are, and couplings how the shares of fluids change (contact.py, couple.py).
"""

from typing import NamedTuple

import numpy as np

from ...device.jit import inline
from ...lanes.lanes import load, store
from ...lanes.laws import lane_state, volume_ratio
from ...lanes.rows import diagonal, fourth
from ..records import STATE, VOLUME
from ..rowsums import scatter
from ..sums import power
from .base import OFFSET, add, contribute


class Offsets(NamedTuple):
    """Of rest volumes."""

    mirror: float
    share: float  # of the rest volume that the material takes up itself
    dx: float  # [m]


class Present(NamedTuple):
    """Of volumes as they are now: where the stress is kept apart it is couplings that ask."""

    mirror: float
    share: float
    dx: float


def kind(plan, group) -> Offsets | Present:
    """What a group's particles contribute."""
    real = plan.real.type
    made = Present if group.apart else Offsets
    return made(*(real(v) for v in (OFFSET, group.share, plan.dx)))


def full(plan) -> np.ndarray:
    """Powers of two (phases, 4): a cell's volume times its width, and its volume."""
    far, volume = power(plan.dx**4), power(plan.dx**3)
    return np.tile([far, far, far, volume], (len(plan.phases), 1))


@inline
def present(law, count, at, cap, f, volumes):
    """Volumes [m3] of `count` particles as they are now, into volumes (BATCH,)."""
    for n in range(0, count, 16):
        p = at + n
        J = volume_ratio(law, lane_state(law, f, p + STATE * cap, cap))
        store(volumes, n, J * load(f, p + VOLUME * cap))


@inline
def _offsets(kind, count, volumes, first, records):
    """All records are one pattern times a volume, volumes[first...]."""
    pattern = kind.share * (fourth(records) - kind.dx * diagonal(records))
    for n in range(count):
        store(records, 16 * n, volumes[first + n] * pattern)


@contribute.of(Offsets)
def _rest(kind, law, count, at, cap, f, extra, peak, records, dt):
    _offsets(kind, count, f, at + VOLUME * cap, records)


@contribute.of(Present)
def _present(kind, law, count, at, cap, f, extra, peak, records, dt):
    present(law, count, at, cap, f, extra)
    _offsets(kind, count, extra, 0, records)


@add.of(Offsets)
@add.of(Present)
def _add(kind, count, records, weights, base, patch):
    scatter(count, records, weights, base, patch)
