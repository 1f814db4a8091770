"""Shapes and view-dependent colours, compiled: what vgmpi.gaussians does, many times as fast.

Captures carry up to 48 numbers of colour per Gaussian, and every frame needs them all again.
"""

import numpy as np

from vgmpi.caching import cached
from vgmpi.gaussians import evolve
from vgmpi.gaussians.sh import C0, C1, C2, C3

_A, _B, _C = C2
_D, _E, _F, _G, _H = C3


@cached(error_model="numpy")
def evaluate(sh, rows, directions):
    """Colours (m, 3) >= 0 of sh[rows], seen along `directions` (m, 3) of any length.

    sh: (n, K, 3), K = 1, 4, 9 or 16. rows: (m,). The basis is that of vgmpi.gaussians.sh.
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


@cached(error_model="numpy")
def _turn_back(F, directions, bad):
    """Replace directions (m, 3) by R^T d, R the rotation in F (m, 9); mark rows it is not for.

    Newton's iteration with Higham's scaling, as in vgmpi.gaussians.evolve.rotation.
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
            if abs(square - 3) < 1e-9 and abs(det - 1) < 1e-9:  # only a rotation has both
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


def turn_back(F: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """R^T d for directions d (m, 3) and the rotations R in the deformations F (m, 9)."""
    out, bad = directions.copy(), np.zeros(len(F), dtype=np.bool_)
    _turn_back(F, out, bad)
    if bad.any():  # inverted or flat: rare, and left to the numpy version
        out[bad] = np.einsum("nij,ni->nj", evolve.rotation(F[bad]), directions[bad])
    return out


@cached(nogil=True, error_model="numpy")
def _solid(cov0, ids, rows, F, low, high, out, wild):
    """Write F cov0 F^T of the frame's `rows`; mark those whose stretches may leave low .. high.

    The test is that of vgmpi.gaussians.evolve.
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
    """Write the covariances (see vgmpi.gaussians.evolve.solid) of a frame's `rows` into out (n, 6).

    cov0: of all particles [m2], (particles, 6). ids: of the frame's rows, (n,). F: (n, 9).
    """
    wild = np.zeros(len(rows), dtype=np.bool_)
    _solid(cov0, ids, rows, F, *evolve.STRETCH_RANGE, out, wild)
    if wild.any():  # torn or inverted: rare, and left to the numpy version
        torn = rows[wild]
        out[torn] = evolve.solid(cov0[ids[torn]], F[torn])


@cached(nogil=True, error_model="numpy")
def carried(there, at, offset, weights, x, F):
    """Positions [m] (m, 3) and F (m, 9) of Gaussians `there` (m,) that ride along with k particles.

    Of all riders: at (p, k): rows of their carriers; offset (p, k, 3): from the carriers at rest to
    the Gaussian at rest [m]; weights (p, k). Of the carriers now: x (n, 3) [m], F (n, 9). x = sum w
    (x + F offset), F = sum w F: exact where the carriers' motion is affine.
    """
    places, gradients = np.zeros((len(there), 3)), np.zeros((len(there), 9))
    for n in range(len(there)):
        p = there[n]
        for k in range(weights.shape[1]):
            i, w = at[p, k], weights[p, k]
            a, b, c = offset[p, k, 0], offset[p, k, 1], offset[p, k, 2]
            for r in range(3):
                f, g, h = float(F[i, 3 * r]), float(F[i, 3 * r + 1]), float(F[i, 3 * r + 2])
                places[n, r] += w * (float(x[i, r]) + f * a + g * b + h * c)
                gradients[n, 3 * r] += w * f
                gradients[n, 3 * r + 1] += w * g
                gradients[n, 3 * r + 2] += w * h
    return places, gradients
