"""Tile-based alpha blending of projected Gaussians, front to back, in tiles of 16 x 16 pixels.

The Gaussians come in order of depth and in batches. A batch is sorted into the tiles (a counting
sort), then drawn tile by tile, Gaussian after Gaussian, row after row: the 16 pixels of a row are
one branch-free loop that the compiler turns into vector instructions. A tile in which every pixel
has stopped is closed, and Gaussians in closed tiles only are not even sorted: in a solid body most
Gaussians are hidden by those in front.

A tile's canvas holds for each row 16 numbers each of: transmittance, red, green, blue (or, for
depth, the weighted depth, the median depth, the sum of the weights). The transmittance of a pixel
that has stopped is negative: then the next Gaussian stops it again, whatever it is, and adds
nothing.

Surfaces that are lit later (surface_canvas.py) are drawn in one pass: color, normal, material and
median depth share the alphas of a Gaussian, and a canvas holds 16 numbers each of all of them.
"""

import numpy as np
from numba import njit

from vgmpi.runtime.compile_cache import njit_cached

TILE = 16  # [pixels] edge of a tile
BATCH = 1 << 14  # [Gaussians] their records stay in the caches while sorted and drawn
COLORS = 4  # numbers of a pixel of colors or depths


def _exponential() -> list[np.float32]:
    """Return polynomial coefficients, lowest first, for e^t on [-0.75, 0] (error 3e-9)."""
    fit = np.polynomial.chebyshev.Chebyshev.interpolate(np.exp, 6, domain=[-0.75, 0])
    return [np.float32(c) for c in fit.convert(kind=np.polynomial.Polynomial).coef]


_E0, _E1, _E2, _E3, _E4, _E5, _E6 = _exponential()
_SIXTEENTH, _MIN_EXPONENT = np.float32(-1 / 16), np.float32(-0.75)
_ALPHA_MAX, _STOP = np.float32(0.99), np.float32(1e-4)
_ZERO, _ONE, _HALF = np.float32(0), np.float32(1), np.float32(0.5)


def new_canvas(height: int, width: int) -> np.ndarray:
    """Return an empty canvas (tiles, numbers) for a picture."""
    canvas = uncleared_canvas(height, width, COLORS)
    _clear(canvas, height, width)
    return canvas


def uncleared_canvas(height: int, width: int, numbers: int) -> np.ndarray:
    """Return a canvas of so many numbers of a pixel that is not cleared yet."""
    tiles = -(-width // TILE) * -(-height // TILE)
    return np.empty((tiles, TILE * TILE * numbers), dtype=np.float32)


@njit_cached(nogil=True, error_model="numpy")
def _clear(canvas, height, width):
    """Clear a canvas; pixels beyond the picture have stopped already."""
    for t in range(len(canvas)):
        _clear_tile(canvas[t], t, height, width)


@njit_cached(nogil=True, error_model="numpy")
def _clear_tile(buf, t, height, width):
    """Clear tile t of a picture."""
    nx, row = (width + TILE - 1) // TILE, len(buf) // TILE
    buf[:] = _ZERO
    for j in range(TILE):
        for k in range(TILE):
            is_inside = (t // nx) * TILE + j < height and (t % nx) * TILE + k < width
            buf[j * row + k] = _ONE if is_inside else -_ONE


@njit(inline="always")
def _alpha(s, opacity, level):
    """Return a Gaussian's alpha at a pixel: min(0.99, opacity e^-s), 0 beyond its level."""
    t = s * _SIXTEENTH  # e^-s = (e^(-s/16))^16
    t = t if t > _MIN_EXPONENT else _MIN_EXPONENT  # min() and max() would keep the loop scalar
    e = _E0 + t * (_E1 + t * (_E2 + t * (_E3 + t * (_E4 + t * (_E5 + t * _E6)))))
    e *= e
    e *= e
    e *= e
    e *= e
    alpha = opacity * e
    alpha = alpha if alpha < _ALPHA_MAX else _ALPHA_MAX
    return alpha if s <= level else _ZERO


@njit_cached(nogil=True, error_model="numpy", fastmath={"contract", "nsz", "nnan", "ninf"})
def _blend_row(buf, start, first, a, b, c, opacity, level, color):
    """Blend one Gaussian into a row of 16 pixels: s is a X^2 + b X + c, X = first + 0 .. 15."""
    red, green, blue = color
    if start < 0:  # excludes negative indices, whose handling would keep the loop scalar
        return
    for k in range(TILE):
        X = np.float32(k) + first
        s = c + X * (a * X + b)
        alpha = _alpha(s, opacity, level)
        before = buf[start + k]
        w = alpha * before
        after = before - w
        stop = after < _STOP
        buf[start + k] = -abs(before) if stop else after
        w = _ZERO if stop else w
        buf[start + TILE + k] += w * red
        buf[start + 2 * TILE + k] += w * green
        buf[start + 3 * TILE + k] += w * blue


@njit_cached(nogil=True, error_model="numpy", fastmath={"contract", "nsz", "nnan", "ninf"})
def _blend_depth_row(buf, start, first, a, b, c, opacity, level, depth):
    """Blend a Gaussian's depth into a row: weighted sum and depth of half transmittance."""
    if start < 0:
        return
    for k in range(TILE):
        X = np.float32(k) + first
        s = c + X * (a * X + b)
        alpha = _alpha(s, opacity, level)
        before = buf[start + k]
        w = alpha * before
        after = before - w
        stop = after < _STOP
        buf[start + k] = -abs(before) if stop else after
        w = _ZERO if stop else w
        buf[start + TILE + k] += w * depth
        buf[start + 3 * TILE + k] += w
        crossing = (before > _HALF) & (after <= _HALF)
        buf[start + 2 * TILE + k] = depth if crossing else buf[start + 2 * TILE + k]


@njit_cached(nogil=True, error_model="numpy", fastmath={"contract", "nsz", "nnan", "ninf"})
def _blend_surface_row(buf, start, first, a, b, c, opacity, level, color, surface, material):
    """Blend a Gaussian's color (3,), normal and depth (4,) and maybe material (3,) into a row."""
    red, green, blue = color
    u, v, w, depth = surface[0], surface[1], surface[2], surface[3]
    if material is not None:
        sand, snow, captured = material[0], material[1], material[2]
    if start < 0:
        return
    for k in range(TILE):
        X = np.float32(k) + first
        s = c + X * (a * X + b)
        before = buf[start + k]
        share = _alpha(s, opacity, level) * before
        after = before - share
        stop = after < _STOP
        buf[start + k] = -abs(before) if stop else after
        share = _ZERO if stop else share
        buf[start + TILE + k] += share * red
        buf[start + 2 * TILE + k] += share * green
        buf[start + 3 * TILE + k] += share * blue
        buf[start + 4 * TILE + k] += share * u
        buf[start + 5 * TILE + k] += share * v
        buf[start + 6 * TILE + k] += share * w
        crossing = (before > _HALF) & (after <= _HALF)
        buf[start + 7 * TILE + k] = depth if crossing else buf[start + 7 * TILE + k]
        if material is not None:
            buf[start + 8 * TILE + k] += share * sand
            buf[start + 9 * TILE + k] += share * snow
            buf[start + 10 * TILE + k] += share * captured


@njit_cached(nogil=True, error_model="numpy")
def _draw_tile(buf, items, ellipses, looks, left, top, depths, surface, materials):
    """Draw the Gaussians of a batch in one tile and return whether any pixel is still open.

    depths: whether `looks` hold a depth for red, and depths are drawn instead of colors. surface,
    materials: None, or normals and depths, and materials of all Gaussians of the batch, which are
    drawn too.
    """
    row = len(buf) // TILE
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
        # s is expanded about the tile's point nearest to the Gaussian's center: whether it
        # is small and close or large and far away, float32 keeps the significant digits
        rx = min(max(mx, left), left + 16.0)
        ry = min(max(my, top), top + 16.0)
        dx, dy = rx - mx, ry - my
        s0 = np.float32(a * dx * dx + b * dx * dy + c * dy * dy)
        sx, sy = np.float32(2.0 * a * dx + b * dy), np.float32(2.0 * c * dy + b * dx)
        first_x, first_y = np.float32(left + 0.5 - rx), np.float32(top + 0.5 - ry)
        fa, fb, fc = np.float32(a), np.float32(b), np.float32(c)
        opacity, level, red, green, blue = looks[p]
        color = (red, green, blue)
        material = None if materials is None else materials[p]
        for j in range(y0, y1 + 1):
            Y = np.float32(j) + first_y
            constant = s0 + Y * (sy + fc * Y)
            if surface is not None:
                _blend_surface_row(
                    buf, j * row, first_x, fa, sx + fb * Y, constant, opacity, level, color,
                    surface[p], material,
                )  # fmt: skip
            elif depths:
                _blend_depth_row(
                    buf, j * row, first_x, fa, sx + fb * Y, constant, opacity, level, red
                )  # fmt: skip
            else:
                _blend_row(
                    buf, j * row, first_x, fa, sx + fb * Y, constant, opacity, level, color
                )  # fmt: skip
    return _open_rows(buf)[1] >= 0


@njit_cached(nogil=True, error_model="numpy")
def _open_rows(buf):
    """Return the first and last row of a tile with an open pixel; (16, -1) for none."""
    first, last, row = TILE, -1, len(buf) // TILE
    for j in range(TILE):
        any_open = np.int32(0)
        for k in range(TILE):
            any_open |= np.int32(buf[j * row + k] > _ZERO)
        if any_open:
            first, last = min(first, j), j
    return first, last


@njit_cached(nogil=True, error_model="numpy")
def _assign_tiles(boxes, is_open, nx, fill, items):
    """Append each Gaussian's number and rows to the lists of the open tiles in its box."""
    for p in range(len(boxes)):
        y0, y1 = boxes[p, 2], boxes[p, 3]
        for ty in range(y0 // TILE, y1 // TILE + 1):
            rows = max(y0 - ty * TILE, 0) << 4 | min(y1 - ty * TILE, TILE - 1)
            for tx in range(boxes[p, 0] // TILE, boxes[p, 1] // TILE + 1):
                t = ty * nx + tx
                if is_open[t]:
                    items[fill[t]] = p << 8 | rows
                    fill[t] += 1


@njit_cached(nogil=True, error_model="numpy")
def _touch_open_tiles(order, bounds, is_open, nx, boxes, chosen, starts):
    """Write boxes and numbers of the Gaussians that touch an open tile; return how many there are.

    starts: (out) Numbers of them in each tile, from the second entry on, shape (tiles + 1,).
    """
    # plain loops with scattered reads: the processor waits for many of them at a time
    for i in range(len(order)):
        p = order[i]
        for c in range(4):
            boxes[i, c] = bounds[p, c]
    starts[:] = 0
    active = 0
    for i in range(len(order)):
        touches_open = 0
        for ty in range(boxes[i, 2] // TILE, boxes[i, 3] // TILE + 1):
            for tx in range(boxes[i, 0] // TILE, boxes[i, 1] // TILE + 1):
                starts[ty * nx + tx + 1] += is_open[ty * nx + tx]
                touches_open |= is_open[ty * nx + tx]
        for c in range(4):
            boxes[active, c] = boxes[i, c]
        chosen[active] = order[i]
        active += touches_open
    return active


@njit_cached(nogil=True, error_model="numpy")
def blend_tiles(order, ellipses, looks, bounds, canvas, nx, depths, surface, materials):
    """Blend Gaussians (see project) into a canvas (tiles, numbers), nx tiles wide.

    Args:
        order, ellipses, looks, bounds: Order from near to far; rows of `ProjectedGaussians`.
        canvas, nx, depths: (in/out), width in tiles, whether red is a depth.
        surface: None, or Surfaces with their canvas.
        materials: Their materials, shape (n, 3), or None if all have one.
    """
    tiles = len(canvas)
    is_open = np.ones(tiles, dtype=np.uint8)
    starts = np.empty(tiles + 1, dtype=np.int64)
    fill = np.empty(tiles, dtype=np.int64)
    items = np.empty(4 * BATCH, dtype=np.int32)
    batch = np.empty((BATCH, 5)), np.empty((BATCH, 5), dtype=np.float32)
    boxes = np.empty((BATCH, 4), dtype=np.int32)
    chosen = np.empty(BATCH, dtype=np.int64)
    for begin in range(0, len(order), BATCH):
        batch_order = order[begin : begin + BATCH]
        active = _touch_open_tiles(batch_order, bounds, is_open, nx, boxes, chosen, starts)
        for i in range(active):
            p = chosen[i]
            for c in range(5):
                batch[0][i, c] = ellipses[p, c]
                batch[1][i, c] = looks[p, c]
        for t in range(tiles):
            starts[t + 1] += starts[t]
            fill[t] = starts[t]
        if starts[tiles] > len(items):
            items = np.empty(2 * starts[tiles], dtype=np.int32)
        _assign_tiles(boxes[:active], is_open, nx, fill, items)
        own_surface = None if surface is None else surface.rows[chosen[:active]]
        own_materials = None if materials is None else materials[chosen[:active]]
        for t in range(tiles):
            if starts[t + 1] > starts[t]:
                own = items[starts[t] : starts[t + 1]]
                left, top = (t % nx) * TILE, (t // nx) * TILE
                if surface is not None and not surface.is_drawn[t]:
                    surface.is_drawn[t] = 1
                    _clear_tile(canvas[t], t, *surface.shape)
                is_open[t] = _draw_tile(
                    canvas[t], own, batch[0], batch[1], left, top, depths, own_surface,
                    own_materials,
                )  # fmt: skip


@njit_cached(nogil=True, error_model="numpy")
def picture(canvas, background, image, transmittance):
    """Write image and transmittance of a canvas.

    Args:
        canvas: Canvas of colors.
        background: Picture behind the Gaussians, shape (height, width, 3).
        image: (out) Picture, shape (height, width, 3).
        transmittance: (out) Shape (height, width).
    """
    height, width = transmittance.shape
    nx = (width + TILE - 1) // TILE
    for y in range(height):
        for x in range(width):
            tile = canvas[(y // TILE) * nx + x // TILE]
            start = (y % TILE) * COLORS * TILE + x % TILE
            left = abs(tile[start])
            transmittance[y, x] = left
            for c in range(3):
                image[y, x, c] = tile[start + (c + 1) * TILE] + left * background[y, x, c]


@njit_cached(nogil=True, error_model="numpy")
def depths_of(canvas, expected, median):
    """Write expected and median depths (height, width) of a canvas, infinite where it is empty."""
    height, width = expected.shape
    nx = (width + TILE - 1) // TILE
    for y in range(height):
        for x in range(width):
            tile = canvas[(y // TILE) * nx + x // TILE]
            start = (y % TILE) * COLORS * TILE + x % TILE
            transmittance = abs(tile[start])
            # 1 - transmittance would lack digits where little is drawn
            total = tile[start + 3 * TILE]
            expected[y, x] = tile[start + TILE] / total if total > _ZERO else np.inf
            median[y, x] = tile[start + 2 * TILE] if transmittance <= _HALF else np.inf
