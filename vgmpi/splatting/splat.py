"""Draws Gaussians: EWA splatting, front to back, on one CPU core.

Conventions (those of gsplat, see docs/rendering.md): the projection is linearised with x/z and y/z
limited to the picture and 30 % around it; `lowpass` pixels^2 are added to the 2-D covariance; pixel
centres lie at +0.5; a Gaussian adds alpha = min(0.99, opacity e^-s) and is left out below
`alpha_min`; a pixel stops, for good, before the Gaussian that would bring its transmittance below
1e-4. `antialias` multiplies opacities by sqrt(det / det') so that the lowpass does not fatten
Gaussians smaller than a pixel.

One depth sort, one counting sort into tiles of 16 x 16 pixels, then per tile Gaussian after
Gaussian, row after row: the 16 pixels of a row are one branch-free loop that the compiler turns
into vector instructions.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

from vgmpi.splatting.camera import Camera

TILE = 16
ALPHA_MIN = 1 / 255
ALPHA_MIN_RANGE = (1e-5, 0.5)  # e^-s is accurate on the part of its range that these need


@dataclass(frozen=True)
class Splats:
    """Gaussians ready to be drawn. x: (n, 3) [m]. cov: upper triangles (n, 6) [m2].

    opacity: (n,) in 0..1. color: as seen from the camera, (n, 3) >= 0.
    """

    x: np.ndarray
    cov: np.ndarray
    opacity: np.ndarray
    color: np.ndarray


def render(
    splats: Splats,
    camera: Camera,
    background: np.ndarray = (1.0, 1.0, 1.0),
    *,
    lowpass: float = 0.3,
    antialias: bool = False,
    alpha_min: float = ALPHA_MIN,
) -> tuple[np.ndarray, np.ndarray]:
    """Picture (height, width, 3) float32, not clamped, and transmittance (height, width) float32.

    background: one colour (3,) or a picture (height, width, 3).
    """
    if not ALPHA_MIN_RANGE[0] <= alpha_min <= ALPHA_MIN_RANGE[1]:
        raise ValueError(f"alpha_min is {alpha_min}: allowed is {ALPHA_MIN_RANGE}")
    shape = (camera.height, camera.width)
    records, bounds, depth = _project(
        *(np.ascontiguousarray(getattr(splats, f)) for f in ("x", "cov", "opacity", "color")),
        np.ascontiguousarray(camera.world_to_camera, dtype=np.float64),
        np.array([camera.fx, camera.fy, camera.cx, camera.cy, camera.near], dtype=np.float64),
        *shape,
        float(lowpass),
        bool(antialias),
        float(alpha_min),
    )
    order = _by_depth(depth)
    starts, items = _into_tiles(order, bounds, *shape)
    image = np.empty((*shape, 3), dtype=np.float32)
    transmittance = np.empty(shape, dtype=np.float32)
    _blend(records, bounds, starts, items, image, transmittance)
    return image + transmittance[..., None] * np.asarray(background, np.float32), transmittance


def _by_depth(depth: np.ndarray) -> np.ndarray:
    """Row numbers from near to far; equal depths keep their order.

    The bits of a positive float32 sort like its value, so one integer sort does both keys.
    """
    key = depth.astype(np.float32).view(np.uint32).astype(np.uint64) << np.uint64(32)
    key |= np.arange(len(depth), dtype=np.uint64)
    key.sort()
    return (key & np.uint64(0xFFFFFFFF)).astype(np.int64)


@njit(cache=True, error_model="numpy")
def _on_screen(u, v, z, c, w2c, fx, fy, limits):
    """2-D covariance xx, xy, yy [pixels^2] of a Gaussian at depth z with covariance c (6,).

    u, v: x/z and y/z in the camera. The Jacobian of the projection is taken at the nearest point
    within `limits`: far outside the picture it would blow up.
    """
    left, right, above, below = limits
    su, sv, mx, my = -min(right, max(-left, u)), -min(below, max(-above, v)), fx / z, fy / z
    # the two rows of Jacobian @ rotation
    a0, a1, a2 = w2c[0, 0] + su * w2c[2, 0], w2c[0, 1] + su * w2c[2, 1], w2c[0, 2] + su * w2c[2, 2]
    b0, b1, b2 = w2c[1, 0] + sv * w2c[2, 0], w2c[1, 1] + sv * w2c[2, 1], w2c[1, 2] + sv * w2c[2, 2]
    p0, p1 = c[0] * a0 + c[1] * a1 + c[2] * a2, c[1] * a0 + c[3] * a1 + c[4] * a2
    q0, q1 = c[0] * b0 + c[1] * b1 + c[2] * b2, c[1] * b0 + c[3] * b1 + c[4] * b2
    p2, q2 = c[2] * a0 + c[4] * a1 + c[5] * a2, c[2] * b0 + c[4] * b1 + c[5] * b2
    xx, yy = mx * mx * (a0 * p0 + a1 * p1 + a2 * p2), my * my * (b0 * q0 + b1 * q1 + b2 * q2)
    return xx, mx * my * (a0 * q0 + a1 * q1 + a2 * q2), yy


@njit(cache=True, error_model="numpy")
def _project(x, cov, opacity, color, w2c, lens, height, width, lowpass, antialias, alpha_min):
    """Records (m, 10), pixel bounds x0 x1 y0 y1 (m, 4) and depths (m,) of the Gaussians in view.

    Comparisons are written so that they fail for NaN: a broken Gaussian is left out.
    """
    fx, fy, cx, cy, near = lens
    mx, my = 0.15 * width / fx, 0.15 * height / fy
    limits = (cx / fx + mx, (width - cx) / fx + mx, cy / fy + my, (height - cy) / fy + my)
    n, m = len(x), 0
    records = np.empty((n, 10))
    bounds = np.empty((n, 4), dtype=np.int32)
    depth = np.empty(n)
    for i in range(n):
        z = w2c[2, 0] * x[i, 0] + w2c[2, 1] * x[i, 1] + w2c[2, 2] * x[i, 2] + w2c[2, 3]
        if not (z >= near and z < 1e30):
            continue
        u = (w2c[0, 0] * x[i, 0] + w2c[0, 1] * x[i, 1] + w2c[0, 2] * x[i, 2] + w2c[0, 3]) / z
        v = (w2c[1, 0] * x[i, 0] + w2c[1, 1] * x[i, 1] + w2c[1, 2] * x[i, 2] + w2c[1, 3]) / z
        xx, xy, yy = _on_screen(u, v, z, cov[i], w2c, fx, fy, limits)
        before = xx * yy - xy * xy
        xx, yy = xx + lowpass, yy + lowpass
        det = xx * yy - xy * xy
        o = opacity[i]
        if antialias:
            o *= np.sqrt(max(before / det, 0.005**2))
        if not (det > 0.0 and det < 1e30 and o >= alpha_min):
            continue
        level = np.log(o / alpha_min)  # s <= level is alpha >= alpha_min
        px, py = fx * u + cx, fy * v + cy
        rx, ry = np.sqrt(2.0 * level * xx), np.sqrt(2.0 * level * yy)
        # the pixels whose centres lie in the box around the ellipse s <= level
        x0, x1 = max(0.0, np.ceil(px - rx - 0.5)), min(width - 1.0, np.floor(px + rx - 0.5))
        y0, y1 = max(0.0, np.ceil(py - ry - 0.5)), min(height - 1.0, np.floor(py + ry - 0.5))
        if not (x0 <= x1 and y0 <= y1):
            continue
        bounds[m, 0], bounds[m, 1], bounds[m, 2], bounds[m, 3] = x0, x1, y0, y1
        depth[m] = z
        r = records[m]
        r[0], r[1], r[2], r[3], r[4] = px, py, 0.5 * yy / det, -xy / det, 0.5 * xx / det
        r[5], r[6], r[7], r[8], r[9] = o, level, color[i, 0], color[i, 1], color[i, 2]
        m += 1
    return records[:m], bounds[:m], depth[:m]


@njit(cache=True)
def _into_tiles(order, bounds, height, width):
    """Tile t draws records items[starts[t] : starts[t + 1]], from near to far."""
    nx, ny = (width + TILE - 1) // TILE, (height + TILE - 1) // TILE
    starts = np.zeros(nx * ny + 1, dtype=np.int64)
    for p in range(len(bounds)):
        for ty in range(bounds[p, 2] // TILE, bounds[p, 3] // TILE + 1):
            for tx in range(bounds[p, 0] // TILE, bounds[p, 1] // TILE + 1):
                starts[ty * nx + tx + 1] += 1
    for t in range(nx * ny):
        starts[t + 1] += starts[t]
    items = np.empty(starts[-1], dtype=np.int32)
    fill = starts[:-1].copy()
    for p in order:
        for ty in range(bounds[p, 2] // TILE, bounds[p, 3] // TILE + 1):
            for tx in range(bounds[p, 0] // TILE, bounds[p, 1] // TILE + 1):
                items[fill[ty * nx + tx]] = p
                fill[ty * nx + tx] += 1
    return starts, items


def _exponential() -> list[np.float32]:
    """Coefficients, lowest first, of a polynomial for e^t on [-0.75, 0] (error 3e-9)."""
    fit = np.polynomial.chebyshev.Chebyshev.interpolate(np.exp, 6, domain=[-0.75, 0])
    return [np.float32(c) for c in fit.convert(kind=np.polynomial.Polynomial).coef]


_E0, _E1, _E2, _E3, _E4, _E5, _E6 = _exponential()
_SIXTEENTH, _FARTHEST = np.float32(-1 / 16), np.float32(-0.75)
_ALPHA_MAX, _STOP = np.float32(0.99), np.float32(1e-4)
_ZERO, _ONE, _HALF = np.float32(0), np.float32(1), np.float32(0.5)


@njit(cache=True, error_model="numpy", fastmath={"contract", "nsz", "nnan", "ninf"})
def _row(buf, at, mx, a, bdy, cdy, opacity, level, r, g, b):
    """Blend one Gaussian into the 16 pixels of a tile's row.

    buf[at:] holds 16 each of: transmittance, live (1 or 0), red, green, blue.
    """
    if at < 0:  # tells the compiler that no index wraps around, which would keep the loop scalar
        return
    for k in range(TILE):
        dx = np.float32(k) + _HALF - mx
        s = cdy + dx * (a * dx + bdy)
        t = s * _SIXTEENTH  # e^-s = (e^(-s/16))^16
        t = t if t > _FARTHEST else _FARTHEST  # min() and max() would keep the loop scalar
        e = _E0 + t * (_E1 + t * (_E2 + t * (_E3 + t * (_E4 + t * (_E5 + t * _E6)))))
        e *= e
        e *= e
        e *= e
        e *= e
        alpha = opacity * e
        alpha = alpha if alpha < _ALPHA_MAX else _ALPHA_MAX
        alpha = alpha if s <= level else _ZERO
        alpha *= buf[at + TILE + k]
        before = buf[at + k]
        after = before - before * alpha
        stop = after < _STOP
        w = _ZERO if stop else alpha * before
        buf[at + k] = before if stop else after
        buf[at + TILE + k] = _ZERO if stop else buf[at + TILE + k]
        buf[at + 2 * TILE + k] += w * r
        buf[at + 3 * TILE + k] += w * g
        buf[at + 4 * TILE + k] += w * b


@njit(cache=True)
def _blend(records, bounds, starts, items, image, transmittance):
    """Fill `image` (without background) and `transmittance`, tile by tile."""
    height, width = transmittance.shape
    nx = (width + TILE - 1) // TILE
    buf = np.empty(TILE * 5 * TILE, dtype=np.float32)
    alive = np.empty(TILE, dtype=np.bool_)
    for tile in range(len(starts) - 1):
        left, top = (tile % nx) * TILE, (tile // nx) * TILE
        rows = min(TILE, height - top)
        for j in range(TILE):
            alive[j] = j < rows
            for k in range(5 * TILE):
                buf[j * 5 * TILE + k] = _ONE if k < 2 * TILE else _ZERO
        for i in range(starts[tile], starts[tile + 1]):
            if (i - starts[tile]) % 32 == 31 and not _any_alive(buf, alive):
                break
            r = records[items[i]]
            y0, y1 = bounds[items[i], 2], bounds[items[i], 3]
            # coordinates within the tile: float32 keeps its digits where they matter
            mx, my = np.float32(r[0] - left), r[1] - top
            a, o, level = np.float32(r[2]), np.float32(r[5]), np.float32(r[6])
            red, green, blue = np.float32(r[7]), np.float32(r[8]), np.float32(r[9])
            for j in range(max(y0 - top, 0), min(y1 - top + 1, TILE)):
                if alive[j]:
                    dy = j + 0.5 - my
                    bdy, cdy = np.float32(r[3] * dy), np.float32(r[4] * dy * dy)
                    _row(buf, j * 5 * TILE, mx, a, bdy, cdy, o, level, red, green, blue)
        for j in range(rows):
            for k in range(min(TILE, width - left)):
                at = j * 5 * TILE + k
                transmittance[top + j, left + k] = buf[at]
                for c in range(3):
                    image[top + j, left + k, c] = buf[at + (2 + c) * TILE]


@njit(cache=True)
def _any_alive(buf, alive):
    """Mark the rows in which no pixel is live; False when there is none left."""
    found = False
    for j in range(TILE):
        if alive[j]:
            alive[j] = False
            for k in range(TILE):
                if buf[j * 5 * TILE + TILE + k] > _ZERO:
                    alive[j] = True
                    found = True
                    break
    return found
