"""What hides light: a pyramid of densities, and cones through it.

The volumes of all that is opaque are deposited on a grid over the domain, which is halved four
times. A cone takes at each step the level whose cells are as wide as it is (cone tracing, without
color). The same pyramid serves soft shadows, ambient light, the ground and rays in the liquid; it
does not depend on the camera and has no noise.

References:
    C. Crassin, F. Neyret, M. Sainz, S. Green, E. Eisemann. Interactive indirect illumination using
    voxel cone tracing. Pacific Graphics 2011.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.caching import cached
from vgmpi.studio.compiling import RAY

LEVELS = 5
EXTINCTION = 2.2  # per width of a cone, of what is filled
# the same of the wide cones of ambient light; of what is filled by a density s, s / (1 + SOFT - s):
# a thin wall hides all that is behind it, the rim of a cell next to a floor little
DIFFUSE, SOFT = 3.98, 1.056
STRIDE = 1.2  # widths of a wide cone
MOST_STEPS = 500
SUPPORT = 3.0  # widths of a cone, that its samples reach
TINT = 4  # cells of the pyramid in one of the colors
SOLID = 0.45  # density from which a ray has met something opaque


class Occlusion(NamedTuple):
    """Attributes:
    values: densities of all levels, flat float32.
    offsets: (levels,) where each begins.
    shapes: (levels, 3).
    lower: (3,) position of the first node of level 0 [m].
    cell: edge of level 0 [m].
    upper: (3,) last node [m].
    leap: (cx, cy, cz) int16: how many cells of level 1 are empty around one of them.
    color: (dx, dy, dz, 3) float32, mean albedo of what is there, in cells of 4.
    """

    values: np.ndarray
    offsets: np.ndarray
    shapes: np.ndarray
    lower: np.ndarray
    cell: float
    upper: np.ndarray
    leap: np.ndarray
    color: np.ndarray


def occlusion(
    x: np.ndarray,
    volume: np.ndarray,
    albedo: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    cells: int,
) -> Occlusion:
    """The pyramid of what is opaque.

    Args:
        x: (n, 3) positions [m].
        volume: (n,) [m3].
        albedo: (n, 3) linear colors.
        low: (3,) lower corner of where something can be [m].
        high: (3,) upper corner [m].
        cells: along the cube root of that volume.
    """
    size = np.maximum(high - low, 1e-9)
    cell = float(np.cbrt(np.prod(size)) / cells)
    cell = max(cell, float(size.max()) / 1000)
    lower = low - 0.05 * size - 2 * cell
    shape = ((high + 0.05 * size + 2 * cell - lower) / cell).astype(int) // 16 * 16 + 16
    base = np.zeros(tuple(shape), np.float32)
    tint = np.zeros((*(shape // TINT + 1), 4), np.float32)
    _deposit(
        np.ascontiguousarray(x, dtype=np.float64), np.asarray(volume, dtype=np.float64),
        np.ascontiguousarray(albedo, dtype=np.float64), lower, cell, base, tint,
    )  # fmt: skip
    if len(x):
        for axis in range(3):
            _smooth(base, axis)
        np.minimum(base, 1.0, out=base)
    levels = [base]
    for _ in range(LEVELS - 1):
        levels.append(_halved(levels[-1]))
    color = _spread(tint)
    first = np.cumsum([0] + [level.size for level in levels[:-1]]).astype(np.int64)
    shapes = np.array([level.shape for level in levels], np.int64)
    flat = np.concatenate([level.ravel() for level in levels])
    upper = lower + (shape - 1) * cell
    return Occlusion(flat, first, shapes, lower, cell, upper, _leaps(levels[1]), color)


@cached(nogil=True, error_model="numpy")
def _deposit(x, volume, albedo, lower, cell, base, tint):
    nx, ny, nz = base.shape
    scale = 1.0 / (cell * cell * cell)
    for p in range(len(x)):
        u, v, w = (
            (x[p, 0] - lower[0]) / cell,
            (x[p, 1] - lower[1]) / cell,
            (x[p, 2] - lower[2]) / cell,
        )
        if not (u >= 1 and v >= 1 and w >= 1 and u < nx - 2 and v < ny - 2 and w < nz - 2):
            continue
        i, j, k = int(u), int(v), int(w)
        a, b, c, m = u - i, v - j, w - k, volume[p] * scale
        for q in range(8):
            r, s, t = q >> 2, (q >> 1) & 1, q & 1
            share = (a if r else 1 - a) * (b if s else 1 - b) * (c if t else 1 - c)
            base[i + r, j + s, k + t] += share * m
        cellwise = tint[(i + TINT // 2) // TINT, (j + TINT // 2) // TINT, (k + TINT // 2) // TINT]
        cellwise[3] += m
        for q in range(3):
            cellwise[q] += m * albedo[p, q]


@cached(nogil=True, error_model="numpy")
def _smooth(v, axis):
    """In place by [1 2 1] / 4 along an axis."""
    nx, ny, nz = v.shape
    if axis == 2:
        for i in range(nx):
            for j in range(ny):
                before = v[i, j, 0]
                for k in range(1, nz - 1):
                    here = v[i, j, k]
                    v[i, j, k] = np.float32(0.25) * (before + here + here + v[i, j, k + 1])
                    before = here
        return
    line = np.zeros((2, nz), np.float32)
    count, rows = (nx, ny) if axis == 0 else (ny, nx)
    for j in range(rows):
        line[:] = 0.0
        for i in range(count - 1):
            for k in range(nz):
                here = v[i, j, k] if axis == 0 else v[j, i, k]
                after = v[i + 1, j, k] if axis == 0 else v[j, i + 1, k]
                new = np.float32(0.25) * (line[0, k] + here + here + after)
                line[0, k] = here
                if axis == 0:
                    v[i, j, k] = new
                else:
                    v[j, i, k] = new


def _halved(v: np.ndarray) -> np.ndarray:
    nx, ny, nz = (n // 2 for n in v.shape)
    return v.reshape(nx, 2, ny, 2, nz, 2).mean(axis=(1, 3, 5), dtype=np.float32)


def _spread(tint: np.ndarray) -> np.ndarray:
    """Mean colors where something is, carried on to the cells next to it."""
    total = tint[..., 3:]
    color = np.full((*tint.shape[:3], 3), 0.5, np.float32)
    known = total[..., 0] > 0
    color[known] = tint[known, :3] / total[known]
    if known.any() and not known.all():
        from scipy.ndimage import distance_transform_edt

        at = distance_transform_edt(~known, return_distances=False, return_indices=True)
        color = color[tuple(at)]
    return np.ascontiguousarray(color)


def _leaps(level: np.ndarray) -> np.ndarray:
    from scipy.ndimage import distance_transform_cdt

    there = level > 0.02
    if not there.any():
        return np.full(level.shape, 1000, np.int16)
    return distance_transform_cdt(~there, metric="chessboard").astype(np.int16)


@cached(**RAY)
def level_value(pyramid, q, x, y, z):
    """Density of level q at a point [m], 0 outside."""
    size = pyramid.cell * (1 << q)
    shift = 0.5 * (1.0 - 1.0 / (1 << q))
    nx, ny, nz = pyramid.shapes[q, 0], pyramid.shapes[q, 1], pyramid.shapes[q, 2]
    u = (x - pyramid.lower[0]) / size - shift
    v = (y - pyramid.lower[1]) / size - shift
    w = (z - pyramid.lower[2]) / size - shift
    if not (u >= 0 and v >= 0 and w >= 0 and u < nx - 1 and v < ny - 1 and w < nz - 1):
        return 0.0
    i, j, k = int(u), int(v), int(w)
    a, b, c = u - i, v - j, w - k
    p = pyramid.values
    o = pyramid.offsets[q] + (i * ny + j) * nz + k
    r = ny * nz
    v00 = p[o] + c * (p[o + 1] - p[o])
    v01 = p[o + nz] + c * (p[o + nz + 1] - p[o + nz])
    v10 = p[o + r] + c * (p[o + r + 1] - p[o + r])
    v11 = p[o + r + nz] + c * (p[o + r + nz + 1] - p[o + r + nz])
    v0, v1 = v00 + b * (v01 - v00), v10 + b * (v11 - v10)
    return v0 + a * (v1 - v0)


@cached(**RAY)
def clip(low, high, p0, p1, p2, d0, d1, d2):
    """Where a ray enters and leaves a box; enters behind leaves where it misses."""
    begin, end = 0.0, 1e30
    for m in range(3):
        p = p0 if m == 0 else p1 if m == 1 else p2
        d = d0 if m == 0 else d1 if m == 1 else d2
        if abs(d) < 1e-12:
            if p < low[m] or p > high[m]:
                return 1.0, 0.0
        else:
            one, two = (low[m] - p) / d, (high[m] - p) / d
            begin, end = max(begin, min(one, two)), min(end, max(one, two))
    return begin, end


@cached(**RAY)
def cone(pyramid, p0, p1, p2, d0, d1, d2, tangent, start, extinction):
    """What of the light comes along a cone, 0..1.

    tangent: half its width per way. start: way [m] from which on something hides it.
    """
    begin, far = clip(pyramid.lower, pyramid.upper, p0, p1, p2, d0, d1, d2)
    t, passes = max(start, begin), 1.0
    cell, last = pyramid.cell, len(pyramid.offsets) - 1
    q, size, clear = 0, cell, 0.0
    while t < far and passes > 0.02:
        wide = max(2.0 * tangent * t, cell)
        step = max(0.6 * wide, 0.7 * cell)
        if t + SUPPORT * wide < clear:  # nothing is there
            t += step
            continue
        while q < last and wide >= 2.0 * size:
            q, size = q + 1, 2.0 * size
        x, y, z = p0 + t * d0, p1 + t * d1, p2 + t * d2
        s = _between_levels(pyramid, q, wide / size - 1.0, x, y, z)
        if s > 0.0:
            passes *= np.exp(-extinction * s * step / wide)
        else:
            clear = t + leap(pyramid, x, y, z)
        t += step
    return passes


@cached(**RAY)
def _between_levels(pyramid, q, f, x, y, z):
    """Density at a point [m], between levels q and q + 1."""
    s = level_value(pyramid, q, x, y, z)
    if f > 0.0 and q + 1 < len(pyramid.offsets):
        s += min(f, 1.0) * (level_value(pyramid, q + 1, x, y, z) - s)
    return s


@cached(**RAY)
def wide_cone(pyramid, p0, p1, p2, d0, d1, d2, tangent, start):
    """The same along a cone of ambient light, whose steps are no longer than the largest cells."""
    begin, far = clip(pyramid.lower, pyramid.upper, p0, p1, p2, d0, d1, d2)
    t, passes = max(start, begin), 1.0
    cell, last = pyramid.cell, len(pyramid.offsets) - 1
    widest = cell * (1 << last)
    q, size, clear = 0, cell, 0.0
    for _n in range(MOST_STEPS):
        if t >= far or passes <= 0.02:
            break
        wide = min(max(2.0 * tangent * t, cell), widest)
        if t + SUPPORT * wide < clear:
            t += STRIDE * wide
            continue
        while q < last and wide >= 2.0 * size:
            q, size = q + 1, 2.0 * size
        x, y, z = p0 + t * d0, p1 + t * d1, p2 + t * d2
        s = _between_levels(pyramid, q, wide / size - 1.0, x, y, z)
        if s > 0.0:
            passes *= np.exp(-DIFFUSE * STRIDE * s / (1.0 + SOFT - s))
        else:
            clear = t + leap(pyramid, x, y, z)
        t += STRIDE * wide
    return passes


@cached(**RAY)
def leap(pyramid, x, y, z):
    """How far from a point [m] nothing opaque can be; a quarter of a cell where it may be."""
    size = 2.0 * pyramid.cell
    i = int((x - pyramid.lower[0]) / size)
    j = int((y - pyramid.lower[1]) / size)
    k = int((z - pyramid.lower[2]) / size)
    n = pyramid.leap.shape
    if i < 0 or j < 0 or k < 0 or i >= n[0] or j >= n[1] or k >= n[2]:
        return 1e9
    return max((pyramid.leap[i, j, k] - 1) * size, 0.0)
