"""3x3 tensors as nine scalars, row by row.

The functions serve every engine: plain numbers, arrays and compiled code.
"""

import numpy as np


def det_minus_one(h):
    """Return det(I + H) - 1 from H (nine scalars), exact to rounding for small H."""
    h0, h1, h2, h3, h4, h5, h6, h7, h8 = h
    first = h0 + h4 + h8
    second = (h0 * h4 - h1 * h3) + (h0 * h8 - h2 * h6) + (h4 * h8 - h5 * h7)
    third = h0 * (h4 * h8 - h5 * h7) - h1 * (h3 * h8 - h5 * h6) + h2 * (h3 * h7 - h4 * h6)
    return first + second + third


def left_cauchy_green_minus_one(h):
    """Return b - I = H + H^T + H H^T for F = I + H, as (00, 11, 22, 01, 02, 12)."""
    h0, h1, h2, h3, h4, h5, h6, h7, h8 = h
    return (
        2.0 * h0 + h0 * h0 + h1 * h1 + h2 * h2,
        2.0 * h4 + h3 * h3 + h4 * h4 + h5 * h5,
        2.0 * h8 + h6 * h6 + h7 * h7 + h8 * h8,
        h1 + h3 + h0 * h3 + h1 * h4 + h2 * h5,
        h2 + h6 + h0 * h6 + h1 * h7 + h2 * h8,
        h5 + h7 + h3 * h6 + h4 * h7 + h5 * h8,
    )


def update_deformation_gradient(h, L, dt):
    """Return H + dt (L + L H), the H of F <- (I + dt L) F for F = I + H; nine scalars each."""
    a0, a1, a2, a3, a4, a5, a6, a7, a8 = h
    c0, c1, c2, c3, c4, c5, c6, c7, c8 = L
    return (
        a0 + dt * (c0 + c0 * a0 + c1 * a3 + c2 * a6),
        a1 + dt * (c1 + c0 * a1 + c1 * a4 + c2 * a7),
        a2 + dt * (c2 + c0 * a2 + c1 * a5 + c2 * a8),
        a3 + dt * (c3 + c3 * a0 + c4 * a3 + c5 * a6),
        a4 + dt * (c4 + c3 * a1 + c4 * a4 + c5 * a7),
        a5 + dt * (c5 + c3 * a2 + c4 * a5 + c5 * a8),
        a6 + dt * (c6 + c6 * a0 + c7 * a3 + c8 * a6),
        a7 + dt * (c7 + c6 * a1 + c7 * a4 + c8 * a7),
        a8 + dt * (c8 + c6 * a2 + c7 * a5 + c8 * a8),
    )


def max_principal_stretch_squared_bound(b):
    """Return a bound on the largest eigenvalue of b, from B = b - I (00, 11, 22, 01, 02, 12).

    The bound is the largest sum of absolute values in a row.
    """
    b00, b11, b22, b01, b02, b12 = b
    r0 = np.abs(1.0 + b00) + np.abs(b01) + np.abs(b02)
    r1 = np.abs(1.0 + b11) + np.abs(b01) + np.abs(b12)
    r2 = np.abs(1.0 + b22) + np.abs(b02) + np.abs(b12)
    return np.maximum(r0, np.maximum(r1, r2))


def transpose(a):
    """Return A^T (nine scalars)."""
    a0, a1, a2, a3, a4, a5, a6, a7, a8 = a
    return (a0, a3, a6, a1, a4, a7, a2, a5, a8)


def product(a, b):
    """Return A B (nine scalars each)."""
    a0, a1, a2, a3, a4, a5, a6, a7, a8 = a
    b0, b1, b2, b3, b4, b5, b6, b7, b8 = b
    return (
        a0 * b0 + a1 * b3 + a2 * b6,
        a0 * b1 + a1 * b4 + a2 * b7,
        a0 * b2 + a1 * b5 + a2 * b8,
        a3 * b0 + a4 * b3 + a5 * b6,
        a3 * b1 + a4 * b4 + a5 * b7,
        a3 * b2 + a4 * b5 + a5 * b8,
        a6 * b0 + a7 * b3 + a8 * b6,
        a6 * b1 + a7 * b4 + a8 * b7,
        a6 * b2 + a7 * b5 + a8 * b8,
    )


def product_transposed(a, b):
    """Return A B^T."""
    return product(a, transpose(b))


def cofactors(a):
    """Return the matrix of cofactors, det A times A^-T (nine scalars)."""
    a0, a1, a2, a3, a4, a5, a6, a7, a8 = a
    return (
        a4 * a8 - a5 * a7,
        a5 * a6 - a3 * a8,
        a3 * a7 - a4 * a6,
        a2 * a7 - a1 * a8,
        a0 * a8 - a2 * a6,
        a1 * a6 - a0 * a7,
        a1 * a5 - a2 * a4,
        a2 * a3 - a0 * a5,
        a0 * a4 - a1 * a3,
    )


def det(a):
    """Return det A (nine scalars); use `det_minus_one` for I + H with small H."""
    a0, a1, a2, a3, a4, a5, a6, a7, a8 = a
    return a0 * (a4 * a8 - a5 * a7) - a1 * (a3 * a8 - a5 * a6) + a2 * (a3 * a7 - a4 * a6)


def inverse(a):
    """Return A^-1 (nine scalars); det A must not be 0."""
    c0, c1, c2, c3, c4, c5, c6, c7, c8 = cofactors(a)
    k = 1.0 / (a[0] * c0 + a[1] * c1 + a[2] * c2)
    return (k * c0, k * c3, k * c6, k * c1, k * c4, k * c7, k * c2, k * c5, k * c8)


def symmetric_to_full(s):
    """Return the nine scalars of a symmetric tensor given by six (00, 11, 22, 01, 02, 12)."""
    s00, s11, s22, s01, s02, s12 = s
    return (s00, s01, s02, s01, s11, s12, s02, s12, s22)


def moved_left_cauchy_green_minus_one(b, a):
    """Return (I + A) (I + B) (I + A)^T - I for symmetric B = b - I.

    It is B after a step of A = dt grad v, exact to rounding for small A and B.

    Args:
        b: B, six scalars (00, 11, 22, 01, 02, 12).
        a: A, nine scalars.
    """
    b00, b11, b22, b01, b02, b12 = b
    # P = A + A B; the result is B + P + P^T + P A^T
    p = product(a, symmetric_to_full(b))
    p0, p1, p2 = a[0] + p[0], a[1] + p[1], a[2] + p[2]
    p3, p4, p5 = a[3] + p[3], a[4] + p[4], a[5] + p[5]
    p6, p7, p8 = a[6] + p[6], a[7] + p[7], a[8] + p[8]
    return (
        b00 + (2.0 * p0 + (p0 * a[0] + p1 * a[1] + p2 * a[2])),
        b11 + (2.0 * p4 + (p3 * a[3] + p4 * a[4] + p5 * a[5])),
        b22 + (2.0 * p8 + (p6 * a[6] + p7 * a[7] + p8 * a[8])),
        b01 + (p1 + p3 + (p0 * a[3] + p1 * a[4] + p2 * a[5])),
        b02 + (p2 + p6 + (p0 * a[6] + p1 * a[7] + p2 * a[8])),
        b12 + (p5 + p7 + (p3 * a[6] + p4 * a[7] + p5 * a[8])),
    )


def _refine(r):
    """Return (R + R^-T) / 2: a stretch s of R becomes (s + 1 / s) / 2."""
    c0, c1, c2, c3, c4, c5, c6, c7, c8 = cofactors(r)
    r0, r1, r2, r3, r4, r5, r6, r7, r8 = r
    k = 0.5 / (r0 * c0 + r1 * c1 + r2 * c2)
    return (
        0.5 * r0 + k * c0,
        0.5 * r1 + k * c1,
        0.5 * r2 + k * c2,
        0.5 * r3 + k * c3,
        0.5 * r4 + k * c4,
        0.5 * r5 + k * c5,
        0.5 * r6 + k * c6,
        0.5 * r7 + k * c7,
        0.5 * r8 + k * c8,
    )


def rotation(f):
    """Return R of F = V R, V symmetric and positive: the rotation closest to F.

    Higham's iteration is exact to rounding for stretches between 1/10 and 10. Stresses of isotropic
    laws need no R: they follow from the eigenvalues of b (symmetric_eigen.py), which keep small
    strains.

    Args:
        f: Nine scalars, det F > 0.
    """
    return _refine(_refine(_refine(_refine(_refine(_refine(_refine(_refine(f))))))))


def log_volume_change(L, dt):
    """Return ln det(I + dt L) to second order.

    Positions move by dt v, so that space around a particle changes by the determinant of I + dt L.
    In a steady rotation at the rate w the velocity that moves particles along the chord of their
    circle has the divergence -w^2 dt: the second order cancels it.

    Args:
        L: Velocity gradient, nine components, row by row [1/s].
        dt: Time step [s].
    """
    squares = L[0] * L[0] + L[4] * L[4] + L[8] * L[8]
    products = L[1] * L[3] + L[2] * L[6] + L[5] * L[7]
    return dt * (L[0] + L[4] + L[8] - dt * (0.5 * squares + products))
