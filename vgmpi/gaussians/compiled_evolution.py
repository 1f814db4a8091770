"""Compiled versions of the shapes and view-dependent colors of vgmpi.gaussians.

They are many times as fast. Captures carry up to 48 color numbers per Gaussian, and every frame
needs them all again.
"""

import numpy as np

from vgmpi.runtime.compile_cache import njit_cached

from . import shape_evolution
from .spherical_harmonics import C0, C1, C2, C3

_A, _B, _C = C2
_D, _E, _F, _G, _H = C3


@njit_cached(error_model="numpy")
def evaluate(sh, rows, directions):
    """Return colors (m, 3) >= 0 of sh[rows], seen along `directions` (m, 3) of any length.

    sh: (n, K, 3), K = 1, 4, 9 or 16. rows: (m,). The basis is that of
    vgmpi.gaussians.spherical_harmonics.
    """
    count = sh.shape[1]
    out = np.empty((len(rows), 3))
    basis = np.zeros(16)
    basis[0] = C0
    for i in range(len(rows)):
        x, y, z = directions[i, 0], directions[i, 1], directions[i, 2]
        length = np.sqrt(x * x + y * y + z * z)
        if length > 0.0:
            x, y, z = x / length, y / length, z / length
        if count > 1:
            basis[1], basis[2], basis[3] = -C1 * y, C1 * z, -C1 * x
        if count > 4:
            xx, yy, zz = x * x, y * y, z * z
            basis[4], basis[5], basis[7] = _A * x * y, -_A * y * z, -_A * x * z
            basis[6], basis[8] = _B * (2 * zz - xx - yy), _C * (xx - yy)
            if count > 9:
                basis[9], basis[15] = -_D * y * (3 * xx - yy), -_D * x * (xx - 3 * yy)
                basis[10], basis[14] = _E * x * y * z, _H * z * (xx - yy)
                basis[11], basis[13] = -_F * y * (4 * zz - xx - yy), -_F * x * (4 * zz - xx - yy)
                basis[12] = _G * z * (2 * zz - 3 * xx - 3 * yy)
        for c in range(3):
            color = 0.5
            for k in range(count):
                color += basis[k] * sh[rows[i], k, c]
            out[i, c] = color if color > 0.0 else 0.0
    return out


@njit_cached(error_model="numpy")
def _rotate_view_directions(F, directions, bad):
    """Replace directions (m, 3) by R^T d, with R the rotation in F (m, 9).

    Rows without a usable rotation are marked in `bad`. The method is Newton's iteration with
    Higham's scaling, as in vgmpi.gaussians.shape_evolution.rotation.
    """
    for i in range(len(F)):
        a, b, c, d, e, f, g, h, k = F[i]
        a, b, c, d, e = float(a), float(b), float(c), float(d), float(e)
        f, g, h, k = float(f), float(g), float(h), float(k)
        for step in range(13):
            p, q, r = e * k - f * h, f * g - d * k, d * h - e * g
            s, t, u = c * h - b * k, a * k - c * g, b * g - a * h
            v, w, z = b * f - c * e, c * d - a * f, a * e - b * d
            det = a * p + b * q + c * r
            square = a * a + b * b + c * c + d * d + e * e + f * f + g * g + h * h + k * k
            if not (det > 1e-3 * (square / 3) ** 1.5) or step == 12:
                bad[i] = True
                break
            if abs(square - 3) < 1e-9 and abs(det - 1) < 1e-9:  # both hold for a rotation only
                break
            cof = p * p + q * q + r * r + s * s + t * t + u * u + v * v + w * w + z * z
            gamma = np.sqrt(np.sqrt(cof / square) / det)
            m, n = 0.5 * gamma, 0.5 / (gamma * det)
            a, b, c = m * a + n * p, m * b + n * q, m * c + n * r
            d, e, f = m * d + n * s, m * e + n * t, m * f + n * u
            g, h, k = m * g + n * v, m * h + n * w, m * k + n * z
        if not bad[i]:
            x, y, z = directions[i]
            directions[i, 0] = a * x + d * y + g * z
            directions[i, 1] = b * x + e * y + h * z
            directions[i, 2] = c * x + f * y + k * z


def rotate_view_directions(F: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Return R^T d for directions d (m, 3) and the rotations R in F (m, 9)."""
    out, bad = directions.copy(), np.zeros(len(F), dtype=np.bool_)
    _rotate_view_directions(F, out, bad)
    if bad.any():  # inverted or flat: these are rare, and the numpy version handles them
        out[bad] = np.einsum("nij,ni->nj", shape_evolution.rotation(F[bad]), directions[bad])
    return out


@njit_cached(nogil=True, error_model="numpy")
def _solid(cov0, ids, rows, F, low, high, out, wild):
    """Write F cov0 F^T of the frame's `rows`; mark rows with extreme stretches in `wild`.

    The test of stretches against low .. high is that of vgmpi.gaussians.shape_evolution.
    """
    for n in range(len(rows)):
        i = rows[n]
        xx, xy, xz, yy, yz, zz = cov0[ids[i]]
        a, b, c, d, e, f, g, h, k = F[i]
        a, b, c, d, e = float(a), float(b), float(c), float(d), float(e)
        f, g, h, k = float(f), float(g), float(h), float(k)
        p, q, r = a * xx + b * xy + c * xz, a * xy + b * yy + c * yz, a * xz + b * yz + c * zz
        out[i, 0], out[i, 1] = p * a + q * b + r * c, p * d + q * e + r * f
        out[i, 2] = p * g + q * h + r * k
        p, q, r = d * xx + e * xy + f * xz, d * xy + e * yy + f * yz, d * xz + e * yz + f * zz
        out[i, 3], out[i, 4] = p * d + q * e + r * f, p * g + q * h + r * k
        p, q, r = g * xx + h * xy + k * xz, g * xy + h * yy + k * yz, g * xz + h * yz + k * zz
        out[i, 5] = p * g + q * h + r * k
        square = a * a + b * b + c * c + d * d + e * e + f * f + g * g + h * h + k * k
        det = a * (e * k - f * h) + b * (f * g - d * k) + c * (d * h - e * g)
        wild[n] = not (square <= high * high and abs(det) > low * 0.5 * square)


def solid(
    cov0: np.ndarray, ids: np.ndarray, rows: np.ndarray, F: np.ndarray, out: np.ndarray
) -> None:
    """Write deformed covariances of some rows of a frame, see `shape_evolution`.

    Args:
        cov0: Covariances of all particles at rest, shape (particles, 6) [m2].
        ids: Particle of each row of the frame, shape (n,).
        rows: Rows to write.
        F: Deformation gradients, shape (n, 9).
        out: Covariances (out), shape (n, 6) [m2].
    """
    wild = np.zeros(len(rows), dtype=np.bool_)
    _solid(cov0, ids, rows, F, *shape_evolution.STRETCH_RANGE, out, wild)
    if wild.any():  # torn or inverted: these are rare, and the numpy version handles them
        torn = rows[wild]
        out[torn] = shape_evolution.deformed_covariance(cov0[ids[torn]], F[torn])


@njit_cached(nogil=True, error_model="numpy")
def skin_to_carriers(riders, carrier_rows, offset, weights, x, F):
    """Return positions (m, 3) [m] and F (m, 9) of Gaussians that are carried by particles.

    x = sum w (x + F offset) and F = sum w F; both are exact where the motion of the carriers is
    affine.

    Args:
        riders: Numbers of the Gaussians, shape (m,).
        carrier_rows: Rows of the k carriers of all Gaussians, shape (p, k).
        offset: Vectors from the carriers to the Gaussian at rest, shape (p, k, 3) [m].
        weights: Weights of the carriers, shape (p, k).
        x: Positions of the particles, shape (n, 3) [m].
        F: Deformation gradients of the particles, shape (n, 9).
    """
    positions, gradients = np.zeros((len(riders), 3)), np.zeros((len(riders), 9))
    for n in range(len(riders)):
        p = riders[n]
        for k in range(weights.shape[1]):
            i, w = carrier_rows[p, k], weights[p, k]
            a, b, c = offset[p, k, 0], offset[p, k, 1], offset[p, k, 2]
            for r in range(3):
                f, g, h = float(F[i, 3 * r]), float(F[i, 3 * r + 1]), float(F[i, 3 * r + 2])
                positions[n, r] += w * (float(x[i, r]) + f * a + g * b + h * c)
                gradients[n, 3 * r] += w * f
                gradients[n, 3 * r + 1] += w * g
                gradients[n, 3 * r + 2] += w * h
    return positions, gradients
