"""What tells contact how fast a surface goes that lies beside a node: the change of momentum per
cell along the surface's outward normal, m dx C n [kg m/s], of solids that know their surfaces.

A node D cells outside a body that moves with v there sees its surface move with v - D dx C n. What
rolls is at rest where it touches, and not at the nodes beside.
"""

from typing import NamedTuple

import numpy as np

from ...device.jit import inline
from ...device.select import select
from ...device.tensor import cofactors
from ...lanes.lanes import load
from ...lanes.rows import spread, store_records
from ..records import AFFINE, VOLUME, nine
from ..rowsums import scatter
from .base import VECTOR, add, contribute


class Shear(NamedTuple):
    mirror: float
    dx: float  # [m]
    density: float  # [kg/m3]
    gradient: float  # channel of F - I
    surface: float  # channel of the normal at rest


def kind(plan, group) -> Shear:
    """What a group's particles contribute."""
    gradient = group.channels.first("F" if group.followed else "H")
    numbers = VECTOR, plan.dx, group.density, gradient, group.channels.first("surface")
    return Shear(*(plan.real.type(v) for v in numbers))


@inline
def _normal(kind, p, cap, f):
    """Outward normals of the surface as it is now, of 16 particles."""
    q, s = p + np.int64(kind.gradient) * cap, p + np.int64(kind.surface) * cap
    h0, h1, h2, h3, h4, h5, h6, h7, h8 = nine(f, q, cap)
    c = cofactors((1.0 + h0, h1, h2, h3, 1.0 + h4, h5, h6, h7, 1.0 + h8))
    x, y, z = load(f, s), load(f, s + cap), load(f, s + 2 * cap)
    a = c[0] * x + c[1] * y + c[2] * z
    b = c[3] * x + c[4] * y + c[5] * z
    e = c[6] * x + c[7] * y + c[8] * z
    size2 = a * a + b * b + e * e
    k = select(size2 > 0.0, 1.0 / np.sqrt(size2), 0.0)
    return k * a, k * b, k * e


@contribute.of(Shear)
def _shear(kind, law, count, at, cap, f, extra, peak, records, dt):
    o = spread(f, 0.0)
    for n in range(0, count, 16):
        p = at + n
        x, y, z = _normal(kind, p, cap, f)
        c0, c1, c2, c3, c4, c5, c6, c7, c8 = nine(f, p + AFFINE * cap, cap)
        m = kind.dx * kind.density * load(f, p + VOLUME * cap)
        a = m * (c0 * x + c1 * y + c2 * z)
        b = m * (c3 * x + c4 * y + c5 * z)
        e = m * (c6 * x + c7 * y + c8 * z)
        store_records(records, 16 * n, (a, b, e, o, o, o, o, o, o, o, o, o, o, o, o, o))


@add.of(Shear)
def _add(kind, count, records, weights, base, patch):
    scatter(count, records, weights, base, patch)
