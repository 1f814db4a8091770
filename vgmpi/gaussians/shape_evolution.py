"""Shape and color of a Gaussian that follows its particle.

Solids deform with the total deformation gradient F, always from the reference shape: cov = F cov0
F^T, and their view-dependent color turns with the rotation in F; solids whose law carries no F keep
their shape and swell with J. Fluids, sand and snow lose their shape: such a Gaussian is a sphere of
its particle's volume, cov = J^(2/3) r^2 I with r = (3 vol0 / 4 pi)^(1/3). The clamps are for
drawing only.
"""

import numpy as np

from .cloud import pack_symmetric, unpack_symmetric

FAMILIES_DRAWN_AS_SPHERES = ("fluid", "sand", "snow")  # families whose Gaussians lose their shape
J_RANGE = (0.3, 3.0)  # [-] volume ratios for drawing: a droplet that is torn more grows no more
STRETCH_RANGE = (0.2, 4.0)  # [-] principal stretches that are drawn without clamping

_UPPER = (0, 0, 0, 1, 1, 2), (0, 1, 2, 1, 2, 2)  # rows, columns of xx, xy, xz, yy, yz, zz


def fluid_variance(vol0: np.ndarray, J: np.ndarray) -> np.ndarray:
    """Return the variance [m2] along every axis of fluid Gaussians (n,).

    Args:
        vol0: Reference volumes, shape (n,) [m3].
        J: Volume ratios, shape (n,), clamped to J_RANGE.
    """
    radius = np.cbrt(3 * np.asarray(vol0, dtype=np.float64) / (4 * np.pi))
    return np.cbrt(np.clip(np.asarray(J, dtype=np.float64), *J_RANGE)) ** 2 * radius**2


def volume_sphere_covariance(vol0: np.ndarray, J: np.ndarray) -> np.ndarray:
    """Return covariances [m2] of fluid Gaussians, upper triangles (n, 6); see fluid_variance."""
    out = np.zeros((len(vol0), 6))
    out[:, (0, 3, 5)] = fluid_variance(vol0, J)[:, None]
    return out


def equivalent_sphere_covariance(cov0: np.ndarray, J: np.ndarray) -> np.ndarray:
    """Return the covariances [m2] of spheres of the Gaussians' volumes times J, (n, 6).

    They are J^(2/3) det(cov0)^(1/3) I as upper triangles; cov0 (n, 6), J (n,) clamped to J_RANGE.
    """
    # the determinant of a flat Gaussian [m6] underflows in single precision
    determinant = np.maximum(
        np.linalg.det(unpack_symmetric(np.asarray(cov0, dtype=np.float64))), 0.0
    )
    out = np.zeros((len(determinant), 6))
    variance = (
        np.cbrt(determinant) * np.cbrt(np.clip(np.asarray(J, dtype=np.float64), *J_RANGE)) ** 2
    )
    out[:, (0, 3, 5)] = variance[:, None]
    return out


def isotropic_deformation(J: np.ndarray) -> np.ndarray:
    """Return F (n, 9) of a pure volume change, cbrt(J) I, with J (n,) clamped to J_RANGE."""
    J = np.clip(np.asarray(J, dtype=np.float64), *J_RANGE)
    return np.cbrt(J)[:, None] * np.eye(3).ravel()


def deformed_covariance(cov0: np.ndarray, F: np.ndarray) -> np.ndarray:
    """Return the covariances F cov0 F^T [m2] of solid Gaussians, upper triangles (n, 6).

    Eigenvalues are clamped to [0.2^2 smallest, 4^2 largest] of the reference ones. This changes no
    Gaussian whose principal stretches lie in STRETCH_RANGE but keeps a torn or inverted particle
    from becoming a needle across the picture.

    Args:
        cov0: Reference covariances, shape (n, 6) [m2].
        F: Total deformation gradients, shape (n, 9) or (n, 3, 3).
    """
    f = _components(F)
    xx, xy, xz, yy, yz, zz = np.asarray(cov0, dtype=np.float64).T
    rows = [
        (a * xx + b * xy + c * xz, a * xy + b * yy + c * yz, a * xz + b * yz + c * zz)
        for a, b, c in (f[0:3], f[3:6], f[6:9])
    ]
    out = np.empty((len(xx), 6))
    for entry, (i, j) in enumerate(zip(*_UPPER)):
        (p, q, r), (a, b, c) = rows[i], f[3 * j : 3 * j + 3]
        out[:, entry] = p * a + q * b + r * c
    unbounded = _may_exceed_stretch(f)
    if unbounded.any():
        out[unbounded] = _clamped(out[unbounded], np.asarray(cov0, dtype=np.float64)[unbounded])
    return out


def rotation(F: np.ndarray) -> np.ndarray:
    """Return the proper polar factors R (n, 3, 3) of F = R S, F (n, 9) or (n, 3, 3).

    Newton's iteration with Higham's scaling runs on all rows at once. Inverted or nearly flat rows
    take an SVD, where the sign goes to the direction of least stretch.

    References:
        N. J. Higham 1986.
    """
    r = _components(F)
    degenerate = ~(_determinant(r) > 1e-3 * (sum(c * c for c in r) / 3) ** 1.5)
    r = [np.where(degenerate, float(entry in (0, 4, 8)), c) for entry, c in enumerate(r)]
    for _ in range(12):
        inverse_t = [c / _determinant(r) for c in _cofactors(r)]
        gamma = np.sqrt(np.sqrt(sum(c * c for c in inverse_t) / sum(c * c for c in r)))
        step = [0.5 * (gamma * a + b / gamma) for a, b in zip(r, inverse_t)]
        change = max(np.abs(a - b).max(initial=0.0) for a, b in zip(step, r))
        r = step
        if change < 1e-7:  # convergence is quadratic: the next change is below rounding
            break
    out = np.stack(r, axis=1).reshape(-1, 3, 3)
    if degenerate.any():
        out[degenerate] = _rotation_svd(
            np.asarray(F, dtype=np.float64).reshape(-1, 3, 3)[degenerate]
        )
    return out


def _components(F: np.ndarray) -> list[np.ndarray]:
    """Return the nine entries of F as contiguous float64 arrays (n,), which are fast."""
    return list(np.ascontiguousarray(np.asarray(F, dtype=np.float64).reshape(-1, 9).T))


def _cofactors(m: list[np.ndarray]) -> list[np.ndarray]:
    """Return the cofactor matrix (det * inverse transposed) of 3x3 matrices given by components."""
    a, b, c, d, e, f, g, h, i = m
    return [
        *(e * i - f * h, f * g - d * i, d * h - e * g),
        *(c * h - b * i, a * i - c * g, b * g - a * h),
        *(b * f - c * e, c * d - a * f, a * e - b * d),
    ]


def _determinant(m: list[np.ndarray]) -> np.ndarray:
    """Return the determinants of 3x3 matrices given by components."""
    a, b, c, d, e, f, g, h, i = m
    return a * (e * i - f * h) + b * (f * g - d * i) + c * (d * h - e * g)


def _may_exceed_stretch(f: list[np.ndarray]) -> np.ndarray:
    """Return a mask of rows whose principal stretches may leave STRETCH_RANGE.

    The bounds need no eigenvalues: with |F|^2 the sum of the squared stretches, none is above |F|,
    and none is below det / (|F|^2 / 2).
    """
    squared_norm = sum(c * c for c in f)
    low = STRETCH_RANGE[0] * 0.5 * squared_norm
    return ~((squared_norm <= STRETCH_RANGE[1] ** 2) & (np.abs(_determinant(f)) > low))


def _clamped(cov: np.ndarray, cov0: np.ndarray) -> np.ndarray:
    """Limit the eigenvalues of `cov` (n, 6) by those of `cov0`, which replaces invalid rows."""
    cov = np.where(np.isfinite(cov).all(axis=1, keepdims=True), cov, cov0)
    reference = np.linalg.eigvalsh(unpack_symmetric(cov0))
    values, vectors = np.linalg.eigh(unpack_symmetric(cov))
    low, high = STRETCH_RANGE[0] ** 2 * reference[:, :1], STRETCH_RANGE[1] ** 2 * reference[:, 2:]
    values = np.clip(values, np.maximum(low, 0.0), high)
    matrices = (vectors * values[:, None, :]) @ vectors.transpose(0, 2, 1)
    return pack_symmetric(matrices)


def _rotation_svd(F: np.ndarray) -> np.ndarray:
    """Return the proper polar factors (n, 3, 3) by singular value decomposition."""
    F = np.where(np.isfinite(F).all(axis=(1, 2), keepdims=True), F, np.eye(3))
    u, _, vt = np.linalg.svd(F)
    u[:, :, 2] *= np.sign(np.linalg.det(u @ vt))[:, None]
    return u @ vt
