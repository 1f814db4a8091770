"""Occlusion of light: a pyramid of densities, and cones through it.

The volumes of all opaque particles are deposited on a grid over the domain, which is halved four
times. A cone samples at each step the level whose cells are as wide as the cone (cone tracing
without color). The same pyramid serves soft shadows, ambient light, the ground and rays in the
liquid; it does not depend on the camera and has no noise. Rays and cones start at p0, p1, p2 [m]
along the unit direction d0, d1, d2.

References:
    C. Crassin, F. Neyret, M. Sainz, S. Green, E. Eisemann. Interactive indirect illumination using
    voxel cone tracing. Pacific Graphics 2011.
"""

import itertools
from typing import NamedTuple

import numpy as np

from vgmpi.runtime.compile_cache import njit_cached

from .compile_options import LEAF, RAY

LEVELS = 5  # [-] levels of the pyramid
EXTINCTION = 2.2  # [1/cone width] extinction of filled space
# extinction of the wide cones of ambient light: a density s counts as s / (1 + SOFT - s), so that
# a thin wall occludes fully, and the rim of a cell next to a floor little
DIFFUSE, SOFT = 3.98, 1.056
STRIDE = 1.2  # [cone widths] step of a wide cone
OPAQUE = -np.log(0.02)  # [-] optical depth at which a cone ends
MAX_STEPS = 500  # [-] of a wide cone
SUPPORT = 3.0  # [cone widths] support of a sample
TINT = 4  # [cells] edge of the cells of color
SOLID = 0.45  # [-] density at which a ray hits an opaque surface


class Occlusion(NamedTuple):
    """Pyramid of opaque densities.

    Attributes:
        values: Densities of all levels, flat float32.
        offsets: Start of each level, shape (levels,).
        shapes: Shapes of the levels, shape (levels, 3).
        lower: Position of the first node of level 0, shape (3,) [m].
        cell: Cell size of level 0 [m].
        upper: Position of the last node, shape (3,) [m].
        occupied: Corners of a box outside of which all levels are empty, shape (6,) [m].
        leap: Number of empty cells of level 1 around a cell, shape (cx, cy, cz) int16.
        color: Mean albedo of the opaque particles in cells of 4, shape (dx, dy, dz, 3) float32.
    """

    values: np.ndarray
    offsets: np.ndarray
    shapes: np.ndarray
    lower: np.ndarray
    cell: float
    upper: np.ndarray
    occupied: np.ndarray
    leap: np.ndarray
    color: np.ndarray


def cell_size(low: np.ndarray, high: np.ndarray, cells: int) -> float:
    """Return the cell size of the finest level [m], see `occlusion`."""
    size = np.maximum(high - low, 1e-9)
    return max(float(np.cbrt(np.prod(size)) / cells), float(size.max()) / 1000)


def occlusion(
    x: np.ndarray,
    volume: np.ndarray,
    albedo: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    cells: int,
) -> Occlusion:
    """Build the pyramid of opaque densities.

    Args:
        x: Positions, shape (n, 3) [m].
        volume: Volumes, shape (n,) [m3].
        albedo: Linear colors, shape (n, 3).
        low: Lower corner of the occupied space, shape (3,) [m].
        high: Upper corner, shape (3,) [m].
        cells: Cells along the cube root of that volume.
    """
    size = np.maximum(high - low, 1e-9)
    cell = cell_size(low, high, cells)
    lower = low - 0.05 * size - 2 * cell
    shape = ((high + 0.05 * size + 2 * cell - lower) / cell).astype(int) // 16 * 16 + 16
    flat = np.zeros(sum(int((shape >> q).prod()) for q in range(LEVELS)), np.float32)
    base = flat[: shape.prod()].reshape(shape)
    tint = np.zeros((*(shape // TINT + 1), 4), np.float32)
    _deposit(
        np.ascontiguousarray(x, dtype=np.float64), np.asarray(volume, dtype=np.float64),
        np.ascontiguousarray(albedo, dtype=np.float64), lower, cell, base, tint,
    )  # fmt: skip
    if len(x):
        for axis in range(3):
            _smooth(base, axis)
        np.minimum(base, 1.0, out=base)
    shapes = np.array([shape >> q for q in range(LEVELS)], np.int64)
    ends = np.cumsum(shapes.prod(axis=1))
    first = np.append(0, ends[:-1])
    levels = [flat[a:b].reshape(n) for a, b, n in zip(first, ends, shapes)]
    for level, halved in itertools.pairwise(levels):
        _halve(level, halved)
    color = _spread(tint)
    upper = lower + (shape - 1) * cell
    box = _occupied(levels[-1], lower, cell * (1 << (LEVELS - 1)))
    return Occlusion(flat, first, shapes, lower, cell, upper, box, _leaps(levels[1]), color)


def _occupied(coarsest: np.ndarray, lower: np.ndarray, size: float) -> np.ndarray:
    """Return the corners (6,) [m] of the box that the coarsest level, of cells of a size, fills."""
    box = np.append(lower, lower)
    filled = np.argwhere(coarsest > 0)
    if len(filled):  # up to the neighbors of the filled nodes, which lie in the middle of cells
        box[:3] += (filled.min(axis=0) - 1) * size
        box[3:] += (filled.max(axis=0) + 2) * size
    return box


@njit_cached(nogil=True, error_model="numpy")
def _deposit(x, volume, albedo, lower, cell, base, tint):
    """Scatter volumes to the nodes and colors to their cells."""
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
        color_cell = tint[(i + TINT // 2) // TINT, (j + TINT // 2) // TINT, (k + TINT // 2) // TINT]
        color_cell[3] += m
        for q in range(3):
            color_cell[q] += m * albedo[p, q]


@njit_cached(nogil=True, error_model="numpy")
def _smooth(v, axis):
    """Filter in place by [1 2 1] / 4 along an axis."""
    nx, ny, nz = v.shape
    if axis == 2:
        for i in range(nx):
            for j in range(ny):
                before = v[i, j, 0]
                for k in range(1, nz - 1):
                    value = v[i, j, k]
                    v[i, j, k] = np.float32(0.25) * (before + value + value + v[i, j, k + 1])
                    before = value
        return
    line = np.zeros((2, nz), np.float32)
    count, rows = (nx, ny) if axis == 0 else (ny, nx)
    for j in range(rows):
        line[:] = 0.0
        for i in range(count - 1):
            for k in range(nz):
                value = v[i, j, k] if axis == 0 else v[j, i, k]
                after = v[i + 1, j, k] if axis == 0 else v[j, i + 1, k]
                smoothed = np.float32(0.25) * (line[0, k] + value + value + after)
                line[0, k] = value
                if axis == 0:
                    v[i, j, k] = smoothed
                else:
                    v[j, i, k] = smoothed


@njit_cached(nogil=True, error_model="numpy")
def _halve(v, out):
    """Write the next level to out: means of 2 x 2 x 2 cells."""
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            a, b = v[2 * i, 2 * j], v[2 * i, 2 * j + 1]
            c, d = v[2 * i + 1, 2 * j], v[2 * i + 1, 2 * j + 1]
            for k in range(out.shape[2]):
                first = a[2 * k] + a[2 * k + 1] + b[2 * k] + b[2 * k + 1]
                second = c[2 * k] + c[2 * k + 1] + d[2 * k] + d[2 * k + 1]
                out[i, j, k] = np.float32(0.125) * (first + second)


def _spread(tint: np.ndarray) -> np.ndarray:
    """Return the mean colors of occupied cells, extended to the empty cells next to them."""
    total = tint[..., 3:]
    color = np.full((*tint.shape[:3], 3), 0.5, np.float32)
    has_color = total[..., 0] > 0
    color[has_color] = tint[has_color, :3] / total[has_color]
    if has_color.any() and not has_color.all():
        from scipy.ndimage import distance_transform_edt

        nearest = distance_transform_edt(~has_color, return_distances=False, return_indices=True)
        color = color[tuple(nearest)]
    return np.ascontiguousarray(color)


def _leaps(level: np.ndarray) -> np.ndarray:
    """Return the numbers of empty cells around each cell."""
    from scipy.ndimage import distance_transform_cdt

    is_opaque = level > 0.02
    if not is_opaque.any():
        return np.full(level.shape, 1000, np.int16)
    return distance_transform_cdt(~is_opaque, metric="chessboard").astype(np.int16)


@njit_cached(**LEAF)
def level_value(pyramid, q, x, y, z):
    """Return the density of level q at a point, 0 outside.

    Args:
        pyramid: The pyramid.
        q: Level.
        x, y, z: Point [m].
    """
    scale = 1.0 / (pyramid.cell * (1 << q))
    shift = 0.5 * (1.0 - 1.0 / (1 << q))
    nx, ny, nz = pyramid.shapes[q, 0], pyramid.shapes[q, 1], pyramid.shapes[q, 2]
    u = (x - pyramid.lower[0]) * scale - shift
    v = (y - pyramid.lower[1]) * scale - shift
    w = (z - pyramid.lower[2]) * scale - shift
    if not (u >= 0 and v >= 0 and w >= 0 and u < nx - 1 and v < ny - 1 and w < nz - 1):
        return np.float32(0.0)
    i, j, k = int(u), int(v), int(w)
    a, b, c = np.float32(u - i), np.float32(v - j), np.float32(w - k)
    p = pyramid.values
    o = pyramid.offsets[q] + (i * ny + j) * nz + k
    r = ny * nz
    v00 = p[o] + c * (p[o + 1] - p[o])
    v01 = p[o + nz] + c * (p[o + nz + 1] - p[o + nz])
    v10 = p[o + r] + c * (p[o + r + 1] - p[o + r])
    v11 = p[o + r + nz] + c * (p[o + r + nz + 1] - p[o + r + nz])
    v0, v1 = v00 + b * (v01 - v00), v10 + b * (v11 - v10)
    return v0 + a * (v1 - v0)


@njit_cached(**LEAF)
def clip(low, high, p0, p1, p2, d0, d1, d2):
    """Return the distances at which a ray enters and leaves a box.

    Args:
        low, high: Corners of the box, shape (3,) [m].
        p0, p1, p2, d0, d1, d2: The ray.

    Returns:
        Entry and exit [m]; the entry lies behind the exit where the ray misses.
    """
    begin, end = 0.0, 1e30
    for m in range(3):
        p = p0 if m == 0 else p1 if m == 1 else p2
        d = d0 if m == 0 else d1 if m == 1 else d2
        if abs(d) < 1e-12:
            if p < low[m] or p > high[m]:
                return 1.0, 0.0
        else:
            first, second = (low[m] - p) / d, (high[m] - p) / d
            begin, end = max(begin, min(first, second)), min(end, max(first, second))
    return begin, end


@njit_cached(**LEAF)
def _entry(pyramid, p0, p1, p2, d0, d1, d2):
    """Return the distance at which a ray enters the pyramid [m], 0 if it starts there."""
    low, high = pyramid.lower, pyramid.upper
    if low[0] <= p0 <= high[0] and low[1] <= p1 <= high[1] and low[2] <= p2 <= high[2]:
        return 0.0
    return clip(low, high, p0, p1, p2, d0, d1, d2)[0]


@njit_cached(**RAY)
def cone(pyramid, p0, p1, p2, d0, d1, d2, tangent, start, extinction):
    """Return the transmittance of light along a cone, 0..1.

    Args:
        pyramid: The pyramid.
        p0, p1, p2, d0, d1, d2: Apex and axis.
        tangent: Half width per distance.
        start: Distance from which on objects occlude [m].
        extinction: Extinction per width of the cone.
    """
    box = pyramid.occupied
    clear, end = clip(box[:3], box[3:], p0, p1, p2, d0, d1, d2)
    if clear > end:
        return 1.0
    t, depth = max(start, _entry(pyramid, p0, p1, p2, d0, d1, d2)), 0.0
    cell, last = pyramid.cell, len(pyramid.offsets) - 1
    q, size = 0, cell
    while t < end and depth < OPAQUE:
        wide = max(2.0 * tangent * t, cell)
        step = max(0.6 * wide, 0.7 * cell)
        if t + SUPPORT * wide < clear:  # the space is empty
            t += step
            continue
        while q < last and wide >= 2.0 * size:
            q, size = q + 1, 2.0 * size
        x, y, z = p0 + t * d0, p1 + t * d1, p2 + t * d2
        s = _between_levels(pyramid, q, wide / size - 1.0, x, y, z)
        if s > 0.0:
            depth += extinction * s * step / wide
        else:
            clear = t + leap(pyramid, x, y, z)
        t += step
    return np.exp(-depth)


@njit_cached(**LEAF)
def _between_levels(pyramid, q, f, x, y, z):
    """Return the density at a point [m], between levels q and q + 1."""
    s = level_value(pyramid, q, x, y, z)
    if f > 0.0 and q + 1 < len(pyramid.offsets):
        s += min(f, 1.0) * (level_value(pyramid, q + 1, x, y, z) - s)
    return s


@njit_cached(**LEAF)
def wide_cone(pyramid, p0, p1, p2, d0, d1, d2, tangent, start):
    """Return the transmittance along a cone of ambient light, 0..1.

    Its steps are no longer than the largest cells.

    Args:
        pyramid: The pyramid.
        p0, p1, p2, d0, d1, d2: Apex and axis.
        tangent: Half width per distance.
        start: Distance from which on objects occlude [m].
    """
    box = pyramid.occupied
    clear, end = clip(box[:3], box[3:], p0, p1, p2, d0, d1, d2)
    if clear > end:
        return 1.0
    t, depth = max(start, _entry(pyramid, p0, p1, p2, d0, d1, d2)), 0.0
    cell, last = pyramid.cell, len(pyramid.offsets) - 1
    widest = cell * (1 << last)
    q, size = 0, cell
    for _n in range(MAX_STEPS):
        if t >= end or depth >= OPAQUE:
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
            depth += DIFFUSE * STRIDE * s / (1.0 + SOFT - s)
        else:
            clear = t + leap(pyramid, x, y, z)
        t += STRIDE * wide
    return np.exp(-depth)


@njit_cached(**LEAF)
def leap(pyramid, x, y, z):
    """Return a lower bound of the distance to opaque space [m], 0 where it is close.

    Args:
        pyramid: The pyramid.
        x, y, z: Point [m].
    """
    size = 2.0 * pyramid.cell
    scale = 1.0 / size
    i = int((x - pyramid.lower[0]) * scale)
    j = int((y - pyramid.lower[1]) * scale)
    k = int((z - pyramid.lower[2]) * scale)
    n = pyramid.leap.shape
    if i < 0 or j < 0 or k < 0 or i >= n[0] or j >= n[1] or k >= n[2]:
        return 1e9
    return max((pyramid.leap[i, j, k] - 1) * size, 0.0)
