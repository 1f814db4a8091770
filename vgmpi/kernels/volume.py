"""Volume of liquids that is held to the space that they take: a kind of beside.py that goes with
any of the others (docs/theory.md).
"""

from typing import NamedTuple

import numpy as np

from ..lanes.lanes import load
from .beside import complete, fetch, keep, kept, moving, set_aside, strain, waves
from .records import STATE
from .walls import whole_at_walls

RETURN = 5.0  # [1/s] at which a fluid's volume comes to be that of the space it takes
# below a free surface less is gathered than is there, by some .3 to .4 of how much that changes in
# a cell (1.25 cells below it .026 and .09); spray, where much less is gathered, tells nothing
SURFACE, SPRAY, DENSE = 0.4, 0.8, 0.9


class Kept(NamedTuple):
    """Of fluids whose volume is held to the space that they take."""

    inner: tuple  # one of the others
    space: float  # [1/kg] of what fills a cell at rest


@complete.of(Kept)
def _(kind, nodes, mirror):
    whole_at_walls(nodes, mirror)


@fetch.of(Kept)
def _(kind, blocks, box, mirror, real, ghosts, s):
    fetch(kind.inner, blocks, box, mirror, real, ghosts, s)


@set_aside.of(Kept)
def _(kind, count, weights, records, base, real, extra):
    set_aside(kind.inner, count, weights, records, base, real, extra)


@keep.of(Kept)
def _(kind, f, p, cap, extra, n, v):
    keep(kind.inner, f, p, cap, extra, n, v)


@kept.of(Kept)
def _(kind, f, p, cap, way, scale):
    return kept(kind.inner, f, p, cap, way, scale)


@moving.of(Kept)
def _(kind, split, extra, n, v):
    return moving(kind.inner, split, extra, n, v)


@strain.of(Kept)
def _(kind, split, f, p, cap, extra, n, L, fill, slope, numbers):
    """What is crowded is told to shrink, so that its pressure grows, and what has room inside the
    fluid to swell: by what a cell's mass and the particle's J differ, at the rate RETURN."""
    L = strain(kind.inner, split, f, p, cap, extra, n, L, fill, slope, numbers)
    zero = 0.0 * fill
    crowd, J = kind.space * fill, np.exp(load(f, p + STATE * cap))
    more = crowd * J - 1.0
    x, y, z = slope
    near = (4.0 * SURFACE) * np.sqrt(x * x + y * y + z * z) * kind.space
    inner = np.minimum(np.maximum((crowd - SPRAY) * (1.0 / (DENSE - SPRAY)), zero), zero + 1.0)
    off = np.maximum(more, zero) + inner * np.minimum(more + near, zero)
    less = (RETURN / 3.0) * off
    return (L[0] - less, L[1], L[2], L[3], L[4] - less, L[5], L[6], L[7], L[8] - less)


@waves.of(Kept)
def _(kind, f, p, cap, numbers, wave2):
    return waves(kind.inner, f, p, cap, numbers, wave2)
