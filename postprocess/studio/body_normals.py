"""Normals of bodies at rest, turned with the deformation.

Flat Gaussians lie in the surface: their normal is the axis along which they are thin. Round ones
take that of a flat one nearby, or the gradient of the density of all.
"""

import numpy as np

from vgmpi.gaussians.baked_shading import LIGHT
from vgmpi.runtime.compile_cache import njit_cached

from .value_grid import KERNEL, deposit, new_grid, trilinear

REACH = 3.0  # [spacings] radius of the kernels
FLATNESS = 0.25  # [-] thickness relative to the smaller width, up to which a Gaussian is flat
FILLING_DEPTH = 3.0  # [spacings] from a flat Gaussian, up to which others take its normal
COVERED_DEPTH = 1.0  # [spacings] from a flat Gaussian, up to which round ones are hidden by it
MIN_FACING = 1e-4  # [-] cosine to the painted light that tells the side of a surface
SEEN_FROM_BEHIND = 0.05  # [-] length of a normal that is turned towards the eye


def rest_normals(
    x: np.ndarray, cov: np.ndarray, spacing: float, facing: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the outward normals (n, 3) of one body at rest, and rows of two kinds of Gaussians.

    The kinds are flat ones, and round ones right below them. The normals of round ones are shorter
    inside.

    Args:
        x: Centers of its Gaussians, shape (n, 3) [m].
        cov: Their covariances, shape (n, 6) [m2].
        spacing: Their spacing [m].
        facing: Cosines between normals and the light painted on the colors, shape (n,), or None.
    """
    axis, is_flat = thin_axes(cov)
    flat = np.flatnonzero(is_flat)
    if not len(flat):
        return density_normals(x, spacing), flat, flat
    normal = axis[flat]
    side = np.zeros(len(flat))
    if facing is not None:
        side = np.where(np.abs(facing[flat]) > MIN_FACING, facing[flat] * (normal @ LIGHT), 0.0)
    if (side == 0.0).any():
        outward = density_normals(x, spacing)[flat]
        side = np.where(side == 0.0, (outward * normal).sum(axis=1), side)
    normal[side < 0.0] *= -1.0
    out = np.zeros_like(x)
    out[flat] = normal
    filling = covered = np.flatnonzero(~is_flat)
    if len(filling):
        from scipy.spatial import cKDTree

        reach = FILLING_DEPTH * spacing
        distance, nearest = cKDTree(x[flat]).query(x[filling], distance_upper_bound=reach)
        close = np.isfinite(distance)
        out[filling[close]] = normal[nearest[close]]
        covered = filling[distance < COVERED_DEPTH * spacing]
    return out, flat, covered


def thin_axes(cov: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return unit vectors (n, 3) along which Gaussians are thinnest, and which ones are flat (n,).

    The matrix of cofactors has the same eigenvectors, and the largest eigenvalue where that of the
    covariance is smallest; squaring it separates that one.

    Args:
        cov: Covariances, upper triangles, shape (n, 6) [m2].
    """
    xx, xy, xz, yy, yz, zz = (np.asarray(cov, dtype=np.float64) / _traces(cov)[:, None]).T
    a, b, c = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    d, e, f = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
    area = a + d + f  # sum of the products of two of the eigenvalues, whose sum is 1
    power = np.stack([a, b, c, b, d, e, c, e, f], axis=1).reshape(-1, 3, 3)
    for _ in range(4):
        power /= np.maximum(np.trace(power, axis1=1, axis2=2), 1e-300)[:, None, None]
        power = power @ power
    longest = (power**2).sum(axis=1).argmax(axis=1)
    axis = np.take_along_axis(power, longest[:, None, None], axis=2)[:, :, 0]
    axis /= np.maximum(np.linalg.norm(axis, axis=1), 1e-300)[:, None]
    u, v, w = axis.T
    thin = u * (xx * u + 2 * (xy * v + xz * w)) + v * (yy * v + 2 * yz * w) + zz * w * w
    half = 0.5 * (1.0 - thin)
    middle = half - np.sqrt(np.maximum(half * half - (area - 2.0 * thin * half), 0.0))
    return axis, thin <= FLATNESS**2 * middle


def _traces(cov: np.ndarray) -> np.ndarray:
    """Return the traces (n,) of covariances (n, 6), at least a tiny number."""
    return np.maximum(np.asarray(cov, dtype=np.float64)[:, (0, 3, 5)].sum(axis=1), 1e-300)


@njit_cached(nogil=True, error_model="numpy")
def face_eye(x, normals, eye, out):
    """Write the normals (n, 3), turned where they point away from the eye, to out (n, 3).

    One that is turned is short: where the front of a surface is in the same pixel, that prevails.

    Args:
        x: Positions, shape (n, 3) [m].
        normals: Normals, shape (n, 3).
        eye: Position of the eye, shape (3,) [m].
        out: (out) Shape (n, 3).
    """
    for p in range(len(x)):
        away = 0.0
        for m in range(3):
            away += normals[p, m] * (x[p, m] - eye[m])
        factor = -SEEN_FROM_BEHIND if away > 0.0 else 1.0
        for m in range(3):
            out[p, m] = factor * normals[p, m]


def density_normals(x: np.ndarray, spacing: float) -> np.ndarray:
    """Return vectors (n, 3) towards lower density of the points x (n, 3) [m].

    Their length is 1 at a surface and less inside of bodies.
    """
    from scipy import ndimage

    if not len(x):
        return np.zeros((0, 3))
    spacing = max(spacing, float(np.ptp(x, axis=0).max()) / 300, 1e-9)
    total = new_grid(x.min(axis=0) - 4 * spacing, x.max(axis=0) + 4 * spacing, spacing)
    none = total._replace(values=np.zeros((1, 1, 1, 0), np.float32))
    n = len(x)
    deposit(
        x, np.full(n, REACH * spacing), np.full(n, KERNEL / REACH**3), np.zeros((n, 0)), total, none
    )
    smooth = ndimage.gaussian_filter(total.values, 0.7)
    out = np.empty((n, 3))
    _gradients(np.ascontiguousarray((x - total.lower) / spacing), smooth, out)
    size = np.linalg.norm(out, axis=1)
    surface_size = np.percentile(size, 90)
    return out / np.maximum(size, 0.5 * surface_size + 1e-12)[:, None]


@njit_cached(nogil=True, error_model="numpy")
def _gradients(positions, v, out):
    """Write the negative gradients of a grid at grid coordinates to out (n, 3)."""
    for p in range(len(positions)):
        x, y, z = positions[p, 0], positions[p, 1], positions[p, 2]
        out[p, 0] = trilinear(v, x - 1.0, y, z) - trilinear(v, x + 1.0, y, z)
        out[p, 1] = trilinear(v, x, y - 1.0, z) - trilinear(v, x, y + 1.0, z)
        out[p, 2] = trilinear(v, x, y, z - 1.0) - trilinear(v, x, y, z + 1.0)


@njit_cached(nogil=True, error_model="numpy")
def turn_normals(normals, F, out):
    """Write the normals (n, 3) of surfaces deformed by F (n, 9), along cof(F) n, to out.

    Their lengths are conserved.
    """
    for p in range(len(normals)):
        a, b, c, d, e, f, g, h, k = F[p]
        x, y, z = normals[p, 0], normals[p, 1], normals[p, 2]
        u = (e * k - f * h) * x + (f * g - d * k) * y + (d * h - e * g) * z
        v = (c * h - b * k) * x + (a * k - c * g) * y + (b * g - a * h) * z
        w = (b * f - c * e) * x + (c * d - a * f) * y + (a * e - b * d) * z
        size = np.sqrt(u * u + v * v + w * w)
        scale = np.sqrt(x * x + y * y + z * z) / size if size > 1e-12 else 0.0
        out[p, 0], out[p, 1], out[p, 2] = u * scale, v * scale, w * scale
