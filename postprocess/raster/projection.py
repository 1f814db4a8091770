"""EWA projection of Gaussians to ellipses on the picture, and their depth order.

Compiled functions take the transform from world to camera, `w2c` (4, 4), and `lens`: fx, fy, cx,
cy [pixels] and the near plane [m]. Comparisons are written so that they fail for NaN: a broken
Gaussian is left out.

References:
    M. Zwicker, H. Pfister, J. van Baar, M. Gross. EWA splatting. 2002.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.runtime.compile_cache import njit_cached


class ProjectedGaussians(NamedTuple):
    """Projected Gaussians, one row each."""

    ellipses: np.ndarray  # (n, 5) center [pixels] and a, b, c of s = a dx^2 + b dx dy + c dy^2
    looks: np.ndarray  # (n, 5) float32: opacity, cutoff of s, red, green, blue
    bounds: np.ndarray  # (n, 4) int32: x0 x1 y0 y1 [pixels], inclusive


def depth_order(depth: np.ndarray) -> np.ndarray:
    """Return row numbers (n,) int64 from near to far; equal depths keep their order.

    The bits of a positive float32 sort like its value, so one integer sort does both keys.
    """
    key = depth.astype(np.float32).view(np.uint32).astype(np.uint64) << np.uint64(32)
    key |= np.arange(len(depth), dtype=np.uint64)
    key.sort()
    return (key & np.uint64(0xFFFFFFFF)).astype(np.int64)


@njit_cached(nogil=True, error_model="numpy")
def _projected_covariance(u, v, z, c, w2c, fx, fy, limits):
    """Return the 2-D covariance xx, xy, yy [pixels^2] of a Gaussian at depth z, covariance c (6,).

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


@njit_cached(nogil=True, error_model="numpy")
def _fill_ellipse(m, center, xx, xy, yy, det, opacity, alpha_min, shape, rows):
    """Fill in row m except its colors; return whether the Gaussian covers any pixel.

    center: its center [pixels]; xx, xy, yy, det: its covariance on the picture [pixels^2] and the
    determinant. shape: height and width of the picture.
    """
    px, py = center
    level = np.log(opacity / alpha_min)  # s <= level is alpha >= alpha_min
    rx, ry = np.sqrt(2.0 * level * xx), np.sqrt(2.0 * level * yy)
    # the box holds the pixels whose centers lie around the ellipse s <= level
    x0, x1 = max(0.0, np.ceil(px - rx - 0.5)), min(shape[1] - 1.0, np.floor(px + rx - 0.5))
    y0, y1 = max(0.0, np.ceil(py - ry - 0.5)), min(shape[0] - 1.0, np.floor(py + ry - 0.5))
    if not (x0 <= x1 and y0 <= y1):
        return False
    box, half, e = rows.bounds[m], 0.5 / det, rows.ellipses[m]
    box[0], box[1], box[2], box[3] = x0, x1, y0, y1
    e[0], e[1], e[2], e[3], e[4] = px, py, half * yy, -2.0 * half * xy, half * xx
    rows.looks[m, 0], rows.looks[m, 1] = opacity, level
    return True


def project(
    x: np.ndarray,
    cov: np.ndarray,
    opacity: np.ndarray,
    color: np.ndarray,
    w2c: np.ndarray,
    lens: np.ndarray,
    height: int,
    width: int,
    lowpass: float,
    compensated: np.ndarray | None,
    alpha_min: float,
    visible_ids: np.ndarray | None = None,
) -> tuple[np.ndarray, ...]:
    """Project Gaussians to the picture and keep those in view.

    Args:
        x, cov: Centers, shape (n, 3) [m], and covariances, shape (n, 6) [m^2].
        opacity, color: Shapes (n,) and (n, 3).
        w2c, lens: Camera, see the module.
        height, width: Picture size [pixels].
        lowpass: Variance added to the 2-D covariance [pixels^2].
        compensated: Variance added instead to each one with its opacity compensated, shape (n,)
            [pixels^2], 0 for `lowpass`; None for `lowpass` everywhere.
        alpha_min: Cutoff of alpha.
        visible_ids: (out) Shape (n,) int64, or None; its first m entries become the numbers of the
            Gaussians in view.

    Returns:
        The arrays of `ProjectedGaussians` and depths of the m Gaussians in view.
    """
    out, depth, shape = _empty_rows(len(x)), np.empty(len(x)), (height, width)
    camera, options = (w2c, lens, shape), (lowpass, compensated, alpha_min)
    m = _project(x, cov, opacity, color, camera, *options, out, depth, visible_ids)
    return *(array[:m] for array in out), depth[:m]


def _empty_rows(n: int) -> ProjectedGaussians:
    """Return uninitialized rows of n Gaussians.

    NumPy allocates them, with large pages: those of compiled code cost a quarter of a picture's
    time.
    """
    looks = np.zeros((n, 5), dtype=np.float32)
    return ProjectedGaussians(np.empty((n, 5)), looks, np.empty((n, 4), dtype=np.int32))


@njit_cached(nogil=True, error_model="numpy")
def _project(
    x, cov, opacity, color, camera, lowpass, compensated, alpha_min, rows, depth, visible_ids
):
    """Fill in rows, depth and, unless None, visible_ids; return the number of visible Gaussians."""
    w2c, lens, shape = camera
    height, width = shape
    fx, fy, cx, cy, near_plane = lens
    mx, my = 0.15 * width / fx, 0.15 * height / fy
    limits = (cx / fx + mx, (width - cx) / fx + mx, cy / fy + my, (height - cy) / fy + my)
    m = 0
    for i in range(len(x)):
        z = w2c[2, 0] * x[i, 0] + w2c[2, 1] * x[i, 1] + w2c[2, 2] * x[i, 2] + w2c[2, 3]
        if not (z >= near_plane and z < 1e30):
            continue
        u = (w2c[0, 0] * x[i, 0] + w2c[0, 1] * x[i, 1] + w2c[0, 2] * x[i, 2] + w2c[0, 3]) / z
        v = (w2c[1, 0] * x[i, 0] + w2c[1, 1] * x[i, 1] + w2c[1, 2] * x[i, 2] + w2c[1, 3]) / z
        xx, xy, yy = _projected_covariance(u, v, z, cov[i], w2c, fx, fy, limits)
        before = xx * yy - xy * xy
        variance = lowpass
        if compensated is not None and compensated[i] > 0.0:
            variance = compensated[i]
        xx, yy = xx + variance, yy + variance
        det = xx * yy - xy * xy
        o = opacity[i]
        if compensated is not None and compensated[i] > 0.0:
            o *= np.sqrt(max(before / det, 0.005**2))
        if not (det > 0.0 and det < 1e30 and o >= alpha_min):
            continue
        center = fx * u + cx, fy * v + cy
        if not _fill_ellipse(m, center, xx, xy, yy, det, o, alpha_min, shape, rows):
            continue
        depth[m] = z
        if visible_ids is not None:
            visible_ids[m] = i
        for c in range(3):
            rows.looks[m, 2 + c] = color[i, c]
        m += 1
    return m


def project_to_plane(
    x: np.ndarray,
    cov: np.ndarray,
    opacity: np.ndarray,
    lean: np.ndarray,
    plane: float,
    lower: np.ndarray,
    pixel: float,
    softness: float,
    height: int,
    width: int,
    alpha_min: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Project the Gaussians above the plane z = `plane` onto it along the light.

    Blurred Gaussians are as much fainter as they are wider. Colors are 0.

    Args:
        x, cov, opacity: Gaussians, see `project`.
        lean: Displacement in x and y per m of fall, shape (2,).
        plane: Height of the plane [m].
        lower: Corner of the picture on the plane, shape (2,) [m].
        pixel: Side of its pixels [m].
        softness: Standard deviation of the blur per m of height.
        height, width: Picture size [pixels].
        alpha_min: Cutoff of alpha.

    Returns:
        The arrays of `ProjectedGaussians`.
    """
    out, shape = _empty_rows(len(x)), (height, width)
    m = _drop(x, cov, opacity, lean, plane, lower, pixel, softness, shape, alpha_min, out)
    ellipses, looks, bounds = out
    return ellipses[:m], looks[:m], bounds[:m]


@njit_cached(nogil=True, error_model="numpy")
def _drop(x, cov, opacity, lean, plane, lower, pixel, softness, shape, alpha_min, rows):
    """Fill in rows and return their number."""
    m = 0
    p, q = lean[0], lean[1]
    for i in range(len(x)):
        fall = x[i, 2] - plane
        if not (fall >= 0.0 and fall < 1e30):
            continue
        xx = cov[i, 0] + 2.0 * p * cov[i, 2] + p * p * cov[i, 5]
        xy = cov[i, 1] + p * cov[i, 4] + q * cov[i, 2] + p * q * cov[i, 5]
        yy = cov[i, 3] + 2.0 * q * cov[i, 4] + q * q * cov[i, 5]
        scale = 1.0 / (pixel * pixel)
        xx, xy, yy = xx * scale, xy * scale, yy * scale
        before = xx * yy - xy * xy
        blur = 0.3 + (softness * fall / pixel) ** 2
        xx, yy = xx + blur, yy + blur
        det = xx * yy - xy * xy
        o = opacity[i] * np.sqrt(max(before / det, 0.0))
        if not (det > 0.0 and det < 1e30 and o >= alpha_min):
            continue
        center = (x[i, 0] + p * fall - lower[0]) / pixel, (x[i, 1] + q * fall - lower[1]) / pixel
        if _fill_ellipse(m, center, xx, xy, yy, det, o, alpha_min, shape, rows):
            m += 1
    return m
