"""How the shape and the colour of a Gaussian follow the particle that carries it.

Solids deform with the total deformation gradient F, always from the shape at rest: cov = F cov0
F^T, and their view-dependent colour turns with the rotation in F; those whose law carries no F keep
their shape and swell with J. Fluids, sand and snow forget their shape: such a Gaussian is a ball of
its particle's volume, cov = J^(2/3) r^2 I with r = (3 vol0 / 4 pi)^(1/3). The clamps here are for
drawing only.
"""

import numpy as np

from vgmpi.gaussians.cloud import full, upper

BALLS = ("fluid", "sand", "snow")  # families whose Gaussians forget their shape
J_RANGE = (0.3, 3.0)  # volume ratios drawn: a droplet torn further apart is no bigger ball
STRETCH_RANGE = (0.2, 4.0)  # principal stretches that are certainly drawn as they are

_UPPER = (0, 0, 0, 1, 1, 2), (0, 1, 2, 1, 2, 2)  # rows, columns of xx, xy, xz, yy, yz, zz


def fluid_variance(vol0: np.ndarray, J: np.ndarray) -> np.ndarray:
    """Variance [m2] along every axis of fluid Gaussians (n,).

    vol0: rest volumes [m3], (n,). J: volume ratios, (n,), clamped to J_RANGE.
    """
    radius = np.cbrt(3 * np.asarray(vol0, dtype=np.float64) / (4 * np.pi))
    return np.cbrt(np.clip(np.asarray(J, dtype=np.float64), *J_RANGE)) ** 2 * radius**2


def fluid(vol0: np.ndarray, J: np.ndarray) -> np.ndarray:
    """Covariances [m2] of fluid Gaussians, upper triangles (n, 6); see fluid_variance."""
    out = np.zeros((len(vol0), 6))
    out[:, (0, 3, 5)] = fluid_variance(vol0, J)[:, None]
    return out


def rounded(cov0: np.ndarray, J: np.ndarray) -> np.ndarray:
    """Covariances [m2] of balls as large as Gaussians at rest, swollen with J: upper triangles
    (n, 6). J^(2/3) det(cov0)^(1/3) I; cov0 (n, 6), J (n,) clamped to J_RANGE."""
    # the determinant of a flat Gaussian in m6 is below the smallest numbers in single precision
    square = np.maximum(np.linalg.det(full(np.asarray(cov0, dtype=np.float64))), 0.0)
    out = np.zeros((len(square), 6))
    variance = np.cbrt(square) * np.cbrt(np.clip(np.asarray(J, dtype=np.float64), *J_RANGE)) ** 2
    out[:, (0, 3, 5)] = variance[:, None]
    return out


def swollen(J: np.ndarray) -> np.ndarray:
    """F of a body that only changed its volume, cbrt(J) I (n, 9), J (n,) clamped to J_RANGE."""
    J = np.clip(np.asarray(J, dtype=np.float64), *J_RANGE)
    return np.cbrt(J)[:, None] * np.eye(3).ravel()


def solid(cov0: np.ndarray, F: np.ndarray) -> np.ndarray:
    """Covariances F cov0 F^T [m2] of solid Gaussians, upper triangles (n, 6).

    cov0: at rest [m2], (n, 6). F: total deformation gradients, (n, 9) or (n, 3, 3). Eigenvalues are
    clamped to [0.2^2 smallest, 4^2 largest] of those at rest, which touches no Gaussian whose
    principal stretches lie in STRETCH_RANGE but keeps a torn or inverted particle from becoming a
    needle across the picture.
    """
    f = _components(F)
    xx, xy, xz, yy, yz, zz = np.asarray(cov0, dtype=np.float64).T
    rows = [
        (a * xx + b * xy + c * xz, a * xy + b * yy + c * yz, a * xz + b * yz + c * zz)
        for a, b, c in (f[0:3], f[3:6], f[6:9])
    ]
    out = np.empty((len(xx), 6))
    for at, (i, j) in enumerate(zip(*_UPPER)):
        (p, q, r), (a, b, c) = rows[i], f[3 * j : 3 * j + 3]
        out[:, at] = p * a + q * b + r * c
    wild = _wild(f)
    if wild.any():
        out[wild] = _clamped(out[wild], np.asarray(cov0, dtype=np.float64)[wild])
    return out


def rotation(F: np.ndarray) -> np.ndarray:
    """Proper polar factors R of F = R S, (n, 3, 3), for F (n, 9) or (n, 3, 3).

    Newton's iteration with Higham's scaling (Higham 1986), all rows at once; rows that are inverted
    or nearly flat take an SVD, where the sign goes to the direction of least stretch.
    """
    r = _components(F)
    bad = ~(_determinant(r) > 1e-3 * (sum(c * c for c in r) / 3) ** 1.5)
    r = [np.where(bad, float(at in (0, 4, 8)), c) for at, c in enumerate(r)]
    for _ in range(12):
        inverse_t = [c / _determinant(r) for c in _cofactors(r)]
        gamma = np.sqrt(np.sqrt(sum(c * c for c in inverse_t) / sum(c * c for c in r)))
        step = [0.5 * (gamma * a + b / gamma) for a, b in zip(r, inverse_t)]
        change = max(np.abs(a - b).max(initial=0.0) for a, b in zip(step, r))
        r = step
        if change < 1e-7:  # quadratic: the next change would be below rounding
            break
    out = np.stack(r, axis=1).reshape(-1, 3, 3)
    if bad.any():
        out[bad] = _rotation_svd(np.asarray(F, dtype=np.float64).reshape(-1, 3, 3)[bad])
    return out


def _components(F: np.ndarray) -> list[np.ndarray]:
    """The nine entries of F as contiguous float64 arrays (n,): numpy is quick on these."""
    return list(np.ascontiguousarray(np.asarray(F, dtype=np.float64).reshape(-1, 9).T))


def _cofactors(m: list[np.ndarray]) -> list[np.ndarray]:
    """Cofactor matrix (= det * inverse transposed) of 3x3 matrices given by components."""
    a, b, c, d, e, f, g, h, i = m
    return [
        *(e * i - f * h, f * g - d * i, d * h - e * g),
        *(c * h - b * i, a * i - c * g, b * g - a * h),
        *(b * f - c * e, c * d - a * f, a * e - b * d),
    ]


def _determinant(m: list[np.ndarray]) -> np.ndarray:
    a, b, c, d, e, f, g, h, i = m
    return a * (e * i - f * h) + b * (f * g - d * i) + c * (d * h - e * g)


def _wild(f: list[np.ndarray]) -> np.ndarray:
    """Rows whose principal stretches may leave STRETCH_RANGE, by bounds that need no eigenvalues.

    With |F|^2 the sum of the squared stretches, none is above |F|, and none is below det / (|F|^2 /
    2).
    """
    square = sum(c * c for c in f)
    low = STRETCH_RANGE[0] * 0.5 * square
    return ~((square <= STRETCH_RANGE[1] ** 2) & (np.abs(_determinant(f)) > low))


def _clamped(cov: np.ndarray, cov0: np.ndarray) -> np.ndarray:
    """`cov` (n, 6) with eigenvalues limited by those of `cov0`; rows not finite become cov0."""
    cov = np.where(np.isfinite(cov).all(axis=1, keepdims=True), cov, cov0)
    rest = np.linalg.eigvalsh(full(cov0))
    values, vectors = np.linalg.eigh(full(cov))
    low, high = STRETCH_RANGE[0] ** 2 * rest[:, :1], STRETCH_RANGE[1] ** 2 * rest[:, 2:]
    values = np.clip(values, np.maximum(low, 0.0), high)
    matrices = (vectors * values[:, None, :]) @ vectors.transpose(0, 2, 1)
    return upper(matrices)


def _rotation_svd(F: np.ndarray) -> np.ndarray:
    F = np.where(np.isfinite(F).all(axis=(1, 2), keepdims=True), F, np.eye(3))
    u, _, vt = np.linalg.svd(F)
    u[:, :, 2] *= np.sign(np.linalg.det(u @ vt))[:, None]
    return u @ vt
