"""Normals of bodies from the density of their reference Gaussians, turned with the deformation."""

import numpy as np

from vgmpi.runtime.compile_cache import njit_cached

from .value_grid import KERNEL, deposit, new_grid, trilinear

REACH = 3.0  # [spacings] radius of the kernels


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
