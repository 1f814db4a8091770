"""Ellipses on the picture to pixels: front to back, in tiles of 16 x 16 pixels.

The Gaussians come in order of depth and in batches. A batch is sorted into the tiles (a counting
sort), then drawn tile by tile, Gaussian after Gaussian, row after row: the 16 pixels of a row are
one branch-free loop that the compiler turns into vector instructions. A tile in which every pixel
has stopped is closed, and what lies in closed tiles only is not even sorted: of a solid body most
Gaussians are hidden by those in front.

A tile's canvas holds for each row 16 numbers each of: transmittance, red, green, blue (or, for
depth, the weighted depth, the median depth, the sum of the weights). The transmittance of a pixel
that has stopped is negative: then the next Gaussian stops it again, whatever it is, and adds
nothing.

Where a picture is drawn in two layers, before and behind a surface, every pixel has a depth of its
own: a Gaussian leaves out the pixels on whose other side its middle is.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from vgmpi.caching import cached

TILE = 16
BATCH = 1 << 14  # Gaussians: their records stay in the caches while they are sorted and drawn
_ROW = 4 * TILE
_CANVAS = TILE * _ROW


def _exponential() -> list[np.float32]:
    """Coefficients, lowest first, of a polynomial for e^t on [-0.75, 0] (error 3e-9)."""
    fit = np.polynomial.chebyshev.Chebyshev.interpolate(np.exp, 6, domain=[-0.75, 0])
    return [np.float32(c) for c in fit.convert(kind=np.polynomial.Polynomial).coef]


_E0, _E1, _E2, _E3, _E4, _E5, _E6 = _exponential()
_SIXTEENTH, _FARTHEST = np.float32(-1 / 16), np.float32(-0.75)
_ALPHA_MAX, _STOP = np.float32(0.99), np.float32(1e-4)
_ZERO, _ONE, _HALF = np.float32(0), np.float32(1), np.float32(0.5)


def new_canvas(height: int, width: int) -> np.ndarray:
    """A canvas (tiles, numbers) with nothing on it."""
    tiles = -(-width // TILE) * -(-height // TILE)
    canvas = np.empty((tiles, _CANVAS), dtype=np.float32)
    _clear(canvas, height, width)
    return canvas


@cached(nogil=True, error_model="numpy")
def _clear(canvas, height, width):
    """Pixels beyond the picture have stopped already."""
    nx = (width + TILE - 1) // TILE
    canvas[:] = _ZERO
    for t in range(len(canvas)):
        for j in range(TILE):
            for k in range(TILE):
                inside = (t // nx) * TILE + j < height and (t % nx) * TILE + k < width
                canvas[t, j * _ROW + k] = _ONE if inside else -_ONE


class Side(NamedTuple):
    """What is drawn on one side of a depth per pixel."""

    depth: np.ndarray  # (n,) float32 of the Gaussians [m]
    limit: np.ndarray  # (tiles, 256) float32 [m], see `tiled`
    behind: bool  # or before


def tiled(limit: np.ndarray) -> np.ndarray:
    """Depths (height, width) as a canvas holds its pixels: float32 (tiles, 256), 0 beyond."""
    height, width = limit.shape
    ny, nx = -(-height // TILE), -(-width // TILE)
    padded = np.zeros((ny * TILE, nx * TILE), dtype=np.float32)
    padded[:height, :width] = limit
    tiles = padded.reshape(ny, TILE, nx, TILE).swapaxes(1, 2)
    return np.ascontiguousarray(tiles.reshape(ny * nx, TILE * TILE))


@njit(inline="always")
def _alpha(s, opacity, level):
    """What a Gaussian covers of a pixel: min(0.99, opacity e^-s), nothing beyond its level."""
    t = s * _SIXTEENTH  # e^-s = (e^(-s/16))^16
    t = t if t > _FARTHEST else _FARTHEST  # min() and max() would keep the loop scalar
    e = _E0 + t * (_E1 + t * (_E2 + t * (_E3 + t * (_E4 + t * (_E5 + t * _E6)))))
    e *= e
    e *= e
    e *= e
    e *= e
    alpha = opacity * e
    alpha = alpha if alpha < _ALPHA_MAX else _ALPHA_MAX
    return alpha if s <= level else _ZERO


@cached(nogil=True, error_model="numpy", fastmath={"contract", "nsz", "nnan", "ninf"})
def _row(buf, at, first, a, b, c, opacity, level, color, limits, z, behind):
    """Blend one Gaussian into a row of 16 pixels: s is a X^2 + b X + c, X = first + 0 .. 15.

    limits, z, behind: None, or depths of the tile's pixels, that of the Gaussian, and whether it is
    drawn where it is behind the pixel's, or before.
    """
    red, green, blue = color
    if at < 0:  # tells the compiler that no index wraps around, which would keep the loop scalar
        return
    for k in range(TILE):
        X = np.float32(k) + first
        s = c + X * (a * X + b)
        alpha = _alpha(s, opacity, level)
        if limits is not None:
            alpha = alpha if (z >= limits[at // 4 + k]) == behind else _ZERO
        before = buf[at + k]
        w = alpha * before
        after = before - w
        stop = after < _STOP
        buf[at + k] = -abs(before) if stop else after
        w = _ZERO if stop else w
        buf[at + TILE + k] += w * red
        buf[at + 2 * TILE + k] += w * green
        buf[at + 3 * TILE + k] += w * blue


@cached(nogil=True, error_model="numpy", fastmath={"contract", "nsz", "nnan", "ninf"})
def _row_of_depths(buf, at, first, a, b, c, opacity, level, depth, limits, z, behind):
    """The same for depths: their weighted sum, and the one that brings the light below a half."""
    if at < 0:
        return
    for k in range(TILE):
        X = np.float32(k) + first
        s = c + X * (a * X + b)
        alpha = _alpha(s, opacity, level)
        if limits is not None:
            alpha = alpha if (z >= limits[at // 4 + k]) == behind else _ZERO
        before = buf[at + k]
        w = alpha * before
        after = before - w
        stop = after < _STOP
        buf[at + k] = -abs(before) if stop else after
        w = _ZERO if stop else w
        buf[at + TILE + k] += w * depth
        buf[at + 3 * TILE + k] += w
        crossing = (before > _HALF) & (after <= _HALF)
        buf[at + 2 * TILE + k] = depth if crossing else buf[at + 2 * TILE + k]


@cached(nogil=True, error_model="numpy")
def _draw(buf, items, ellipses, looks, left, top, depths, limits, z, behind):
    """Draw the Gaussians of a batch in one tile; whether any of its pixels is still open.

    depths: whether `looks` hold a depth for red, and depths are drawn instead of colours. limits,
    z, behind: as for a row, with the depths of all Gaussians of the batch.
    """
    first, last = _open_rows(buf)
    count = 0
    for item in items:
        count += 1
        if count % 32 == 0:
            first, last = _open_rows(buf)
        if last < 0:
            return False
        p, y0, y1 = item >> 8, (item >> 4) & 15, item & 15
        y0, y1 = max(y0, first), min(y1, last)
        mx, my, a, b, c = ellipses[p]
        # s about the point of the tile that is nearest to the middle of the Gaussian: whether it
        # is small and here or large and far away, float32 keeps the digits that count
        rx = min(max(mx, left), left + 16.0)
        ry = min(max(my, top), top + 16.0)
        dx, dy = rx - mx, ry - my
        s0 = np.float32(a * dx * dx + b * dx * dy + c * dy * dy)
        sx, sy = np.float32(2.0 * a * dx + b * dy), np.float32(2.0 * c * dy + b * dx)
        first_x, first_y = np.float32(left + 0.5 - rx), np.float32(top + 0.5 - ry)
        fa, fb, fc = np.float32(a), np.float32(b), np.float32(c)
        opacity, level, red, green, blue = looks[p]
        color, own = (red, green, blue), None if limits is None else z[p]
        for j in range(y0, y1 + 1):
            Y = np.float32(j) + first_y
            at = s0 + Y * (sy + fc * Y)
            if depths:
                _row_of_depths(
                    buf, j * _ROW, first_x, fa, sx + fb * Y, at, opacity, level, red,
                    limits, own, behind,
                )  # fmt: skip
            else:
                _row(
                    buf, j * _ROW, first_x, fa, sx + fb * Y, at, opacity, level, color,
                    limits, own, behind,
                )  # fmt: skip
    return _open_rows(buf)[1] >= 0


@cached(nogil=True, error_model="numpy")
def _open_rows(buf):
    """First and last row of a tile with a pixel that has not stopped; (16, -1) if there is none."""
    first, last = TILE, -1
    for j in range(TILE):
        found = np.int32(0)
        for k in range(TILE):
            found |= np.int32(buf[j * _ROW + k] > _ZERO)
        if found:
            first, last = min(first, j), j
    return first, last


@cached(nogil=True, error_model="numpy")
def _share(boxes, is_open, nx, fill, items):
    """Write each Gaussian's number and its rows into the lists of the open tiles that its box
    touches."""
    for p in range(len(boxes)):
        y0, y1 = boxes[p, 2], boxes[p, 3]
        for ty in range(y0 // TILE, y1 // TILE + 1):
            rows = max(y0 - ty * TILE, 0) << 4 | min(y1 - ty * TILE, TILE - 1)
            for tx in range(boxes[p, 0] // TILE, boxes[p, 1] // TILE + 1):
                t = ty * nx + tx
                if is_open[t]:
                    items[fill[t]] = p << 8 | rows
                    fill[t] += 1


@cached(nogil=True, error_model="numpy")
def paint(order, ellipses, looks, bounds, canvas, nx, depths, side):
    """Draw Gaussians (see project) in `order` on the canvas (tiles, _CANVAS), nx tiles wide.

    depths: draw depths, which `looks` hold for red, instead of colours. side: None, or a Side.
    """
    tiles = len(canvas)
    is_open = np.ones(tiles, dtype=np.uint8)
    starts = np.empty(tiles + 1, dtype=np.int64)
    fill = np.empty(tiles, dtype=np.int64)
    items = np.empty(4 * BATCH, dtype=np.int32)
    near = np.empty((BATCH, 5)), np.empty((BATCH, 5), dtype=np.float32)
    boxes = np.empty((BATCH, 4), dtype=np.int32)
    chosen = np.empty(BATCH, dtype=np.int64)
    for begin in range(0, len(order), BATCH):
        # plain loops that fetch from all over the memory: the processor waits for many at a time
        count = min(BATCH, len(order) - begin)
        for i in range(count):
            p = order[begin + i]
            for c in range(4):
                boxes[i, c] = bounds[p, c]
        # what touches an open tile is kept
        starts[:] = 0
        kept = 0
        for i in range(count):
            found = 0
            for ty in range(boxes[i, 2] // TILE, boxes[i, 3] // TILE + 1):
                for tx in range(boxes[i, 0] // TILE, boxes[i, 1] // TILE + 1):
                    starts[ty * nx + tx + 1] += is_open[ty * nx + tx]
                    found |= is_open[ty * nx + tx]
            for c in range(4):
                boxes[kept, c] = boxes[i, c]
            chosen[kept] = order[begin + i]
            kept += found
        for i in range(kept):
            p = chosen[i]
            for c in range(5):
                near[0][i, c] = ellipses[p, c]
                near[1][i, c] = looks[p, c]
        for t in range(tiles):
            starts[t + 1] += starts[t]
            fill[t] = starts[t]
        if starts[tiles] > len(items):
            items = np.empty(2 * starts[tiles], dtype=np.int32)
        _share(boxes[:kept], is_open, nx, fill, items)
        depth = None if side is None else side.depth[chosen[:kept]]
        for t in range(tiles):
            if starts[t + 1] > starts[t]:
                mine = items[starts[t] : starts[t + 1]]
                left, top = (t % nx) * TILE, (t // nx) * TILE
                if side is None:
                    is_open[t] = _draw(
                        canvas[t], mine, near[0], near[1], left, top, depths, None, None, None
                    )
                else:
                    is_open[t] = _draw(
                        canvas[t], mine, near[0], near[1], left, top, depths,
                        side.limit[t], depth, side.behind,
                    )  # fmt: skip


@cached(nogil=True, error_model="numpy")
def picture(canvas, background, image, transmittance):
    """Fill `image` (height, width, 3), over the background of that shape, and `transmittance`."""
    height, width = transmittance.shape
    nx = (width + TILE - 1) // TILE
    for y in range(height):
        for x in range(width):
            tile = canvas[(y // TILE) * nx + x // TILE]
            at = (y % TILE) * _ROW + x % TILE
            through = abs(tile[at])
            transmittance[y, x] = through
            for c in range(3):
                image[y, x, c] = tile[at + (c + 1) * TILE] + through * background[y, x, c]


@cached(nogil=True, error_model="numpy")
def depths_of(canvas, expected, median):
    """Fill `expected` and `median` (height, width), infinite where there is nothing to tell."""
    height, width = expected.shape
    nx = (width + TILE - 1) // TILE
    for y in range(height):
        for x in range(width):
            tile = canvas[(y // TILE) * nx + x // TILE]
            at = (y % TILE) * _ROW + x % TILE
            through = abs(tile[at])
            total = tile[at + 3 * TILE]  # 1 - through has lost digits where little is drawn
            expected[y, x] = tile[at + TILE] / total if total > _ZERO else np.inf
            median[y, x] = tile[at + 2 * TILE] if through <= _HALF else np.inf
