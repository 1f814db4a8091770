"""Eigenvalues and eigenvectors of symmetric 3x3 tensors, for every engine: no branch, no loop.

A symmetric tensor is six scalars (00, 11, 22, 01, 02, 12), a rotation nine, row by row.
"""

import numpy as np

from .select import select

_MIN_SIZE = 1e-18  # smaller deviators count as zero: single-precision squares are denormal
_NEGLIGIBLE = 1e-17  # a number this small is lost in a sum with 1


def eigen(a):
    """Return the eigenvalues d of a symmetric tensor and its rotation q: a = q diag(d) q^T.

    The isolated eigenvalue is the root of a cubic, its eigenvector a column of the cofactors; the
    remainder is a 2x2 tensor across it, diagonalized by one Jacobi rotation. So nearly equal
    eigenvalues cost no accuracy. The result is exact to a few roundings of the norm of a; for
    numbers that are not finite all d are NaN.

    Args:
        a: Strains (00, 11, 22, 01, 02, 12): a deviation of 1e-18 from a multiple of the unit tensor
            is not seen, the square of 1e19 is infinite in single precision.

    Returns:
        d, three scalars in no order, and q, nine scalars, eigenvectors as columns, det 1.

    References:
        Eberly, A Robust Eigensolver for 3x3 Symmetric Matrices.
    """
    a00, a11, a22, a01, a02, a12 = a
    mean = (a00 + a11 + a22) * (1.0 / 3.0)
    d00, d11, d22 = a00 - mean, a11 - mean, a22 - mean
    square = (d00 * d00 + d11 * d11 + d22 * d22) * (1.0 / 6.0)
    square = square + (a01 * a01 + a02 * a02 + a12 * a12) * (1.0 / 3.0)
    # the eigenvalues are within 2 sizes of the mean
    size = np.maximum(np.sqrt(square), _MIN_SIZE)
    inverse = 1.0 / size
    d01, d02, d12 = _visible(a01 * inverse), _visible(a02 * inverse), _visible(a12 * inverse)
    d = (d00 * inverse, d11 * inverse, d22 * inverse, d01, d02, d12)
    u, w, v = _frame(d, _isolated(d))
    # the tensor across v
    du, dw = _times(d, u), _times(d, w)
    e0, e1, across = _dot(u, du), _dot(w, dw), _visible(_dot(u, dw))
    e2 = (d[0] + d[1] + d[2]) - (e0 + e1)
    c, s, t = _turn(e1 - e0, across)
    u, w = _turned(u, w, c, s)
    values = (mean + size * (e0 - t * across), mean + size * (e1 + t * across), mean + size * e2)
    return values, (u[0], w[0], v[0], u[1], w[1], v[1], u[2], w[2], v[2])


def _visible(x):
    """Return x, or 0 if it is lost in a sum with 1: products of denormal numbers are slow."""
    return select(np.abs(x) <= _NEGLIGIBLE, 0.0, x)


def _dot(a, b):
    """Return the dot product of two vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _times(s, v):
    """Return symmetric tensor times vector."""
    s00, s11, s22, s01, s02, s12 = s
    x, y, z = v
    return (s00 * x + s01 * y + s02 * z, s01 * x + s11 * y + s12 * z, s02 * x + s12 * y + s22 * z)


def _isolated(d):
    """Return the eigenvalue most distant from the others, for trace 0 and d : d = 6."""
    d00, d11, d22, d01, d02, d12 = d
    half = d00 * (d11 * d22 - d12 * d12) - d01 * (d01 * d22 - d12 * d02)
    half = 0.5 * (half + d02 * (d01 * d12 - d11 * d02))
    # the eigenvalue is 2 c with 4 c^3 - 3 c = r, c = cos(acos(r) / 3): a polynomial through
    # Chebyshev's points, to 2e-9, and one step of Newton
    r = np.abs(half)
    r2 = r * r
    low = (0.866025405599564 + 0.16666637114459312 * r) + r2 * (
        -0.04810444145461756 + 0.02460429680494765 * r
    )
    high = (-0.01510727520943827 + 0.009383330672620772 * r) + r2 * (
        (-0.004929691292929874 + 0.0017648569477158788 * r) - 0.0003028542202729437 * r2
    )
    c = low + (r2 * r2) * high
    c = c - (c * (4.0 * c * c - 3.0) - r) / (12.0 * c * c - 3.0)
    return np.copysign(2.0 * c, half)


def _frame(d, value):
    """Return right-handed unit vectors (u, w, v); v belongs to an isolated eigenvalue."""
    d00, d11, d22, d01, d02, d12 = d
    n0, n1, n2 = d00 - value, d11 - value, d22 - value
    # cofactors: v v^T times the product of the distances to the other eigenvalues, 6 to 9
    k00, k11, k22 = n1 * n2 - d12 * d12, n0 * n2 - d02 * d02, n0 * n1 - d01 * d01
    k01, k02, k12 = d02 * d12 - d01 * n2, d01 * d12 - d02 * n1, d01 * d02 - d12 * n0
    both = np.maximum(k00, k11)
    second, third = k11 > k00, k22 > both
    x = select(third, k02, select(second, k01, k00))
    y = select(third, k12, select(second, k11, k01))
    z = select(third, k22, select(second, k12, k02))
    # a multiple of the unit tensor leaves rounding errors only, and any frame will do
    x = select(np.maximum(both, k22) > 0.1, x, 1.0)
    # Duff et al., Building an Orthonormal Basis, Revisited; here for a vector of any length
    length = np.sqrt(x * x + y * y + z * z)
    sum_length = length + np.abs(z)
    inverse = 1.0 / (length * sum_length)
    sign = np.copysign(1.0, z)
    across = -x * y * inverse
    inverse_length = sum_length * inverse
    v = (x * inverse_length, y * inverse_length, z * inverse_length)
    u = (1.0 - x * x * inverse, across, -sign * v[0])
    return u, (sign * across, sign - sign * y * y * inverse, -v[1]), v


def _turn(difference, across):
    """Return (cos, sin, tan) of the smaller angle that makes a symmetric 2x2 tensor diagonal."""
    size = np.maximum(np.abs(difference), _NEGLIGIBLE)
    twice = 2.0 * select(difference < 0.0, -across, across)
    sum_length = size + np.sqrt(size * size + twice * twice)
    length = np.sqrt(sum_length * sum_length + twice * twice)
    inverse = 1.0 / (sum_length * length)
    along = sum_length * inverse
    return sum_length * along, twice * along, twice * length * inverse


def _turned(u, w, c, s):
    """Return vectors u and w rotated in their plane.

    Where contraction lets one product of a sum escape its rounding, it is the first one: c w.
    """
    return (
        (c * u[0] - s * w[0], c * u[1] - s * w[1], c * u[2] - s * w[2]),
        (c * w[0] + s * u[0], c * w[1] + s * u[1], c * w[2] + s * u[2]),
    )


def from_principal(q, d):
    """Return Q diag(d) Q^T as (00, 11, 22, 01, 02, 12): an isotropic function.

    Args:
        q: Rotation, nine scalars, row by row.
        d: Eigenvalues of the function, three scalars.
    """
    q0, q1, q2, q3, q4, q5, q6, q7, q8 = q
    d0, d1, d2 = d
    x0, x1, x2 = d0 * q0, d1 * q1, d2 * q2
    y0, y1, y2 = d0 * q3, d1 * q4, d2 * q5
    return (
        x0 * q0 + x1 * q1 + x2 * q2,
        y0 * q3 + y1 * q4 + y2 * q5,
        d0 * q6 * q6 + d1 * q7 * q7 + d2 * q8 * q8,
        x0 * q3 + x1 * q4 + x2 * q5,
        x0 * q6 + x1 * q7 + x2 * q8,
        y0 * q6 + y1 * q7 + y2 * q8,
    )
