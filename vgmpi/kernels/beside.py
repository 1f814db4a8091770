"""What particles gather beside the velocity, by kind: nothing; where phases share space the flux of
volume and the drift; for FLIP the change of velocity; or all of these.

Every kind says what it fetches from the grid for a segment (`fetch`), what it sets aside for a
batch (`set_aside`), and how that enters the particle: its velocity (`keep`), the velocity it moves
by (`moving`), its strain (`strain`) and its waves (`waves`). Of the volume of liquids: volume.py.
"""

from typing import NamedTuple

import numpy as np

from ..device.jit import inline
from ..lanes.kinds import by_kind
from ..lanes.lanes import load, store
from ..lanes.rows import higher, spread
from .couple import LEAST_PORES
from .given import kept_of
from .patches import gather, nodes_of
from .records import BATCH, columns, patch_of
from .rowsums import moments, values
from .walls import reflect

CHANGE = 5 * BATCH  # where the change of velocity is set aside
RELAX = 10.0  # [1/s] at which a fluid in pores gives way where there is more volume than space


class Nothing(NamedTuple):
    """Velocity alone."""

    unused: float


class Sharing(NamedTuple):
    """Of phases that share space."""

    flux: np.ndarray  # (node blocks, 256) flux of volume [m/s], and the fluids' share of space
    drift: np.ndarray  # (node blocks, 256) velocity that moves but is no momentum [m/s]
    drifts: int  # whether there is any


class Blend(NamedTuple):
    """FLIP and AFLIP."""

    change: np.ndarray  # (node blocks, 256) of velocity [m/s]
    share: float  # that particles keep of what the grid does not see
    patch: int  # which of the patches beside the velocity's is its own


class Both(NamedTuple):
    """Of phases that share space, with FLIP or AFLIP."""

    sharing: Sharing
    blend: Blend


@by_kind
def complete(kind, nodes, mirror):
    """What has to be done to the masses of a segment's patch."""


@by_kind
def fetch(kind, blocks, box, mirror, real, ghosts, s):
    """The patches of a segment s that shares space, or of any for FLIP, into its thread's scratch.
    ghosts: given.Ghosts, or None."""


@by_kind
def set_aside(kind, count, weights, records, base, real, extra):
    """What a batch gathers from them, into extra (8 BATCH,)."""


@by_kind
def keep(kind, f, p, cap, extra, n, v):
    """The velocity of 16 particles from p, v as gathered: a tuple of three."""


@by_kind
def kept(kind, f, p, cap, way, scale):
    """The largest part of that velocity along an axis [cells per step]. way: of the velocity they
    move by; scale: cells per step of 1 m/s."""


@by_kind
def moving(kind, split, extra, n, v):
    """The velocity they move by."""


@by_kind
def strain(kind, split, f, p, cap, extra, n, L, fill, slope, numbers):
    """The velocity gradient that their law is told, L as gathered: a tuple of nine. fill, slope:
    the fourth number as gathered, and a quarter of its slope per cell, a tuple of three."""


@by_kind
def waves(kind, f, p, cap, numbers, wave2):
    """Their squared wave speed [m2/s2], wave2 by the law."""


@inline
def _read(grid, blocks, box, mirror, patch, ghosts, s):
    gather(patch, grid, blocks, box)
    share = kept_of(ghosts)
    reflect(nodes_of(patch), mirror, ghosts, share, s)


@inline
def _as_gathered(f, p, cap, v):
    store(f, p, v[0])
    store(f, p + cap, v[1])
    store(f, p + 2 * cap, v[2])


@inline
def _largest(f, p, cap, scale):
    x, y, z = load(f, p), load(f, p + cap), load(f, p + 2 * cap)
    return scale * higher(abs(x), higher(abs(y), abs(z)))


# ---- nothing ------------------------------------------------------------------------------------


@complete.of(Nothing)
def _(kind, nodes, mirror):
    pass


@fetch.of(Nothing)
def _(kind, blocks, box, mirror, real, ghosts, s):
    pass


@set_aside.of(Nothing)
def _(kind, count, weights, records, base, real, extra):
    pass


@keep.of(Nothing)
def _(kind, f, p, cap, extra, n, v):
    _as_gathered(f, p, cap, v)


@kept.of(Nothing)
def _(kind, f, p, cap, way, scale):
    return way


@moving.of(Nothing)
def _(kind, split, extra, n, v):
    return v


@strain.of(Nothing)
def _(kind, split, f, p, cap, extra, n, L, fill, slope, numbers):
    return L


@waves.of(Nothing)
def _(kind, f, p, cap, numbers, wave2):
    return wave2


# ---- phases that share space --------------------------------------------------------------------


@complete.of(Sharing)
def _(kind, nodes, mirror):
    pass


@fetch.of(Sharing)
def _(kind, blocks, box, mirror, real, ghosts, s):
    _read(kind.flux, blocks, box, mirror, patch_of(real, 0), None, s)
    if kind.drifts:
        _read(kind.drift, blocks, box, mirror, patch_of(real, 1), None, s)


@set_aside.of(Sharing)
def _(kind, count, weights, records, base, real, extra):
    """Divergence of the flux [cells/s], share of space, drift [m/s]."""
    moments(count, records, weights, base, patch_of(real, 0))
    for n in range(count):
        m = 16 * n
        extra[n] = 4.0 * (records[m + 4] + records[m + 9] + records[m + 14])
        extra[BATCH + n] = records[m + 3]
    if kind.drifts:
        values(count, records, weights, base, patch_of(real, 1))
        columns(count, records, extra, 2 * BATCH, BATCH)


@keep.of(Sharing)
def _(kind, f, p, cap, extra, n, v):
    _as_gathered(f, p, cap, v)


@kept.of(Sharing)
def _(kind, f, p, cap, way, scale):
    return _largest(f, p, cap, scale) if kind.drifts else way


@moving.of(Sharing)
def _(kind, split, extra, n, v):
    x, y, z = v
    if split and kind.drifts:
        x = x + load(extra, 2 * BATCH + n)
        y = y + load(extra, 3 * BATCH + n)
        z = z + load(extra, 4 * BATCH + n)
    return x, y, z


@strain.of(Sharing)
def _(kind, split, f, p, cap, extra, n, L, fill, slope, numbers):
    """A fluid's volume changes by the flux of all that share its space. Where sand is, its pores'
    share of space is noted at the particle; where more volume than space was gathered (fill > 1),
    the volume ratio relaxes."""
    porosity = np.int64(numbers.porosity)
    c0, c1, c2, c3, c4, c5, c6, c7, c8 = L
    more = 0.0 * c0
    if split:
        rate = load(extra, n) / numbers.dx
        if porosity >= 0:
            share = np.minimum(np.maximum(load(extra, BATCH + n), LEAST_PORES), 1.0)
            store(f, p + porosity * cap, share)
            rate = rate / share - numbers.relax * np.maximum(fill - 1.0, 0.0)
        more = (rate - (c0 + c4 + c8)) * (1.0 / 3.0)
    elif porosity >= 0:
        store(f, p + porosity * cap, spread(f, 1.0))
    return (c0 + more, c1, c2, c3, c4 + more, c5, c6, c7, c8 + more)


@waves.of(Sharing)
def _(kind, f, p, cap, numbers, wave2):
    porosity = np.int64(numbers.porosity)
    wave2 = wave2 * numbers.slips
    if porosity >= 0:
        share = load(f, p + porosity * cap)
        wave2 = wave2 * (1.0 + (1.0 / share - 1.0) * numbers.dense) + numbers.stiff
    return wave2


# ---- FLIP ---------------------------------------------------------------------------------------


@complete.of(Blend)
def _(kind, nodes, mirror):
    pass


@fetch.of(Blend)
def _(kind, blocks, box, mirror, real, ghosts, s):
    _read(kind.change, blocks, box, mirror, patch_of(real, kind.patch), ghosts, s)


@set_aside.of(Blend)
def _(kind, count, weights, records, base, real, extra):
    """The change of velocity [m/s], behind all else."""
    values(count, records, weights, base, patch_of(real, kind.patch))
    columns(count, records, extra, CHANGE, BATCH)


@keep.of(Blend)
def _(kind, f, p, cap, extra, n, v):
    """A particle's own velocity and the grid's change of it, blended with the grid's velocity
    (Zhu & Bridson 2005; with its gradient, AFLIP: Fei 2021)."""
    a, b, c = v
    a = a + kind.share * (load(f, p) + load(extra, CHANGE + n) - a)
    b = b + kind.share * (load(f, p + cap) + load(extra, CHANGE + BATCH + n) - b)
    c = c + kind.share * (load(f, p + 2 * cap) + load(extra, CHANGE + 2 * BATCH + n) - c)
    _as_gathered(f, p, cap, (a, b, c))


@kept.of(Blend)
def _(kind, f, p, cap, way, scale):
    return _largest(f, p, cap, scale)


@moving.of(Blend)
def _(kind, split, extra, n, v):
    return v


@strain.of(Blend)
def _(kind, split, f, p, cap, extra, n, L, fill, slope, numbers):
    return L


@waves.of(Blend)
def _(kind, f, p, cap, numbers, wave2):
    return wave2


# ---- both ---------------------------------------------------------------------------------------


@complete.of(Both)
def _(kind, nodes, mirror):
    pass


@fetch.of(Both)
def _(kind, blocks, box, mirror, real, ghosts, s):
    fetch(kind.sharing, blocks, box, mirror, real, ghosts, s)
    fetch(kind.blend, blocks, box, mirror, real, ghosts, s)


@set_aside.of(Both)
def _(kind, count, weights, records, base, real, extra):
    set_aside(kind.sharing, count, weights, records, base, real, extra)
    set_aside(kind.blend, count, weights, records, base, real, extra)


@keep.of(Both)
def _(kind, f, p, cap, extra, n, v):
    keep(kind.blend, f, p, cap, extra, n, v)


@kept.of(Both)
def _(kind, f, p, cap, way, scale):
    return kept(kind.blend, f, p, cap, way, scale)


@moving.of(Both)
def _(kind, split, extra, n, v):
    return moving(kind.sharing, split, extra, n, v)


@strain.of(Both)
def _(kind, split, f, p, cap, extra, n, L, fill, slope, numbers):
    return strain(kind.sharing, split, f, p, cap, extra, n, L, fill, slope, numbers)


@waves.of(Both)
def _(kind, f, p, cap, numbers, wave2):
    return waves(kind.sharing, f, p, cap, numbers, wave2)
