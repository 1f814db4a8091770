"""What tells contact where the surfaces of phases are, and couplings how the shares of fluids
change (contact.py, couple.py): volumes V [m3] and offsets V (x_p - x_i) [m4].

Of a solid that knows the surface of its body at rest, in their place: mass times the normal at the
node m (n + K (x_i - x_p)) [kg], and mass times the node's distance m (d + n . (x_i - x_p)) [kg m],
both of the surface as it is now: n along F^-T n0, K along F^-T K0 F^-1, the distance shorter by the
length of F^-T n0. K is what particles to one side of a node would have wrong on a round body. In
the first of the two sums each counts by how sure its normal is, the length of n0: little at edges.
"""

from typing import NamedTuple

import numpy as np

from ...device.jit import inline
from ...device.select import select
from ...device.tensor import cofactors, product, product_transposed
from ...lanes.lanes import load, store
from ...lanes.laws import lane_state, volume_ratio
from ...lanes.rows import diagonal, fourth, store_records
from ..records import STATE, VOLUME, nine
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


class Surface(NamedTuple):
    """Of the body's surface."""

    mirror: float
    dx: float  # [m]
    density: float  # [kg/m3]
    gradient: float  # channel of F - I
    surface: float  # channel of the normal and the distance at rest


DEEPEST = 4.0  # cells below a surface from which nobody asks how deep


def kind(plan, group) -> Offsets | Present | Surface:
    """What a group's particles contribute."""
    real = plan.real.type
    if group.surface:
        gradient = group.channels.first("F" if group.followed else "H")
        numbers = plan.dx, group.density, gradient, group.channels.first("surface")
        return Surface(real(OFFSET), *(real(v) for v in numbers))
    made = Present if group.apart else Offsets
    return made(*(real(v) for v in (OFFSET, group.share, plan.dx)))


def full(plan) -> np.ndarray:
    """Powers of two (phases, 4): a cell's volume times its width, and its volume; where a surface
    is known a cell's mass, and that times the largest depth."""
    far, volume = power(plan.dx**4), power(plan.dx**3)
    out = np.tile([far, far, far, volume], (len(plan.phases), 1))
    for row, phase in zip(out, plan.phases, strict=True):
        if phase.surface:
            mass, deep = power([phase.most, phase.most * DEEPEST * plan.dx])
            row[:] = mass, mass, mass, deep
    return out


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


@contribute.of(Surface)
def _surface(kind, law, count, at, cap, f, extra, peak, records, dt):
    deep = DEEPEST * kind.dx
    for n in range(0, count, 16):
        p = at + n
        q, s = p + np.int64(kind.gradient) * cap, p + np.int64(kind.surface) * cap
        h0, h1, h2, h3, h4, h5, h6, h7, h8 = nine(f, q, cap)
        F = (1.0 + h0, h1, h2, h3, 1.0 + h4, h5, h6, h7, 1.0 + h8)
        x, y, z, d = load(f, s), load(f, s + cap), load(f, s + 2 * cap), load(f, s + 3 * cap)
        xx, xy, xz = load(f, s + 4 * cap), load(f, s + 5 * cap), load(f, s + 6 * cap)
        yy, yz, zz = load(f, s + 7 * cap), load(f, s + 8 * cap), load(f, s + 9 * cap)
        c = cofactors(F)  # J F^-T
        J = F[0] * c[0] + F[1] * c[1] + F[2] * c[2]
        a = c[0] * x + c[1] * y + c[2] * z
        b = c[3] * x + c[4] * y + c[5] * z
        e = c[6] * x + c[7] * y + c[8] * z
        size2 = a * a + b * b + e * e
        sure = np.sqrt(x * x + y * y + z * z)
        k = select(size2 > 0.0, 1.0 / np.sqrt(size2), 0.0)
        shrinks = J * sure * k  # 1 / |F^-T n0|
        mass = kind.density * load(f, p + VOLUME * cap)
        d = mass * np.minimum(np.maximum(shrinks * d, -deep), deep)
        K = product_transposed(product(c, (xx, xy, xz, xy, yy, yz, xz, yz, zz)), c)
        curve = mass * kind.dx * sure * shrinks / (J * J)
        k = k * mass
        a, b, e = k * a, k * b, k * e
        steep = kind.dx * a, kind.dx * b, kind.dx * e
        a, b, e = sure * a, sure * b, sure * e
        store_records(
            records,
            16 * n,
            (
                a, b, e, d,
                curve * K[0], curve * K[1], curve * K[2], steep[0],
                curve * K[1], curve * K[4], curve * K[5], steep[1],
                curve * K[2], curve * K[5], curve * K[8], steep[2],
            ),
        )  # fmt: skip


@add.of(Offsets)
@add.of(Present)
@add.of(Surface)
def _add(kind, count, records, weights, base, patch):
    scatter(count, records, weights, base, patch)
