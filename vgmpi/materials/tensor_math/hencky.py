"""Hencky elasticity of laws with a yield surface, carried as B = b_e - I, for every engine.

psi = mu e : e + lam/2 (tr e)^2 of the logarithmic strains e_i = ln(1 + d_i) / 2, where 1 + d_i are
the eigenvalues of b_e = F_e F_e^T; the Kirchhoff stress 2 mu e + lam tr(e) I has its axes. A return
mapping is then that of the linear theory, exact at any strain (Simo and Hughes, Computational
Inelasticity, 1998, section 9.3). A law's `advance` reads

    b = trial_strain_measure(state[:6], L, dt)   trial state: the step is elastic
    d, q = eigen(b)
    e = principal_log_strains(d)
    c = ...                                    change of e by the return mapping, 0 if none
    return apply_plastic_corrector(b, d, q, c) + (...)      only the change is put back

so that an elastic step keeps all digits in single precision. `split_volumetric_deviatoric`
returns the parts of e that return mappings need; `stress`, `energy`, `volume_ratio` and
`acoustic_modulus_bound` are those of B.

B: (00, 11, 22, 01, 02, 12); mu, lam: Lame's parameters [Pa].
"""

import numpy as np

from .symmetric_eigen import eigen, from_principal
from .tensor import det_minus_one, moved_left_cauchy_green_minus_one, symmetric_to_full


def trial_strain_measure(b, L, dt):
    """Return the trial B after a step dt [s] of L = grad v [1/s] (nine scalars), all elastic."""
    c0, c1, c2, c3, c4, c5, c6, c7, c8 = L
    a = (dt * c0, dt * c1, dt * c2, dt * c3, dt * c4, dt * c5, dt * c6, dt * c7, dt * c8)
    return moved_left_cauchy_green_minus_one(b, a)


def principal_log_strains(d):
    """Return the principal logarithmic strains of the eigenvalues d of B."""
    return 0.5 * np.log1p(d[0]), 0.5 * np.log1p(d[1]), 0.5 * np.log1p(d[2])


def split_volumetric_deviatoric(e):
    """Return (mean, (s0, s1, s2), size) of strains: e_i = mean + s_i, size^2 = s : s."""
    mean = (e[0] + e[1] + e[2]) * (1.0 / 3.0)
    s0, s1, s2 = e[0] - mean, e[1] - mean, e[2] - mean
    return mean, (s0, s1, s2), np.sqrt(s0 * s0 + s1 * s1 + s2 * s2)


def apply_plastic_corrector(b, d, q, c):
    """Return B after its principal strains have changed by c.

    Args:
        b: Trial B.
        d, q: Eigenvalues and rotation of b.
        c: Changes of the principal strains, three scalars.
    """
    t00, t11, t22, t01, t02, t12 = from_principal(
        q,
        (
            (1.0 + d[0]) * np.expm1(2.0 * c[0]),
            (1.0 + d[1]) * np.expm1(2.0 * c[1]),
            (1.0 + d[2]) * np.expm1(2.0 * c[2]),
        ),
    )
    b00, b11, b22, b01, b02, b12 = b
    return (b00 + t00, b11 + t11, b22 + t22, b01 + t01, b02 + t02, b12 + t12)


def stress(mu, lam, b):
    """Return the Kirchhoff stress [Pa] (00, 11, 22, 01, 02, 12) of B."""
    d, q = eigen(b)
    e0, e1, e2 = principal_log_strains(d)
    p = lam * (e0 + e1 + e2)
    return from_principal(q, (2.0 * mu * e0 + p, 2.0 * mu * e1 + p, 2.0 * mu * e2 + p))


def energy(mu, lam, b):
    """Return the energy density psi [J/m3] of B."""
    d, _ = eigen(b)
    e0, e1, e2 = principal_log_strains(d)
    total = e0 + e1 + e2
    return mu * (e0 * e0 + e1 * e1 + e2 * e2) + 0.5 * lam * (total * total)


def volume_ratio(b):
    """Return J_e = sqrt(det b_e)."""
    return np.sqrt(1.0 + det_minus_one(symmetric_to_full(b)))


def acoustic_modulus_bound(mu, lam, b):
    """Return a bound on rho0 c^2 [Pa] of every plane wave in the state B, reached at rest.

    The second derivative of psi along F -> (I + e m n^T) F, |m| = |n| = 1, in the axes of b_e is
        lam (m.n)^2 + mu (1 + (m.n)^2) - (m.n) sum tau_i m_i n_i + mu sum e_i (n_i^2 - m_i^2)
        + mu sum over pairs (y coth y - 1) (m_i n_j + m_j n_i)^2,   y = e_i - e_j,
    with y coth y - 1 <= y^2 / 3 and a sum of squares of at most 4/3. No eigenvalue is needed: those
    of b_e lie within two sizes of its deviator, and the smallest is no less than 4 det / tr^2.
    """
    b00, b11, b22, b01, b02, b12 = b
    third = 1.0 / 3.0
    mean = (b00 + b11 + b22) * third
    d0, d1, d2 = b00 - mean, b11 - mean, b22 - mean
    square = (d0 * d0 + d1 * d1 + d2 * d2) * (0.5 * third)
    two = 2.0 * np.sqrt(square + (b01 * b01 + b02 * b02 + b12 * b12) * third)
    determinant = 1.0 + det_minus_one(symmetric_to_full(b))
    middle = 3.0 * (1.0 + mean)
    floor = 4.0 * determinant / (middle * middle)
    high = 0.5 * np.log1p(mean + two)
    low = 0.5 * np.log1p(np.maximum(mean - two, floor - 1.0))
    compression = np.maximum(-0.5 * np.log(determinant), 0.0)
    spread = high - low
    max_strain = np.maximum(np.abs(high), np.abs(low))
    shear = 2.0 * (1.0 + max_strain) + spread * (1.0 + (4.0 / 9.0) * spread)
    return lam * (1.0 + compression) + mu * shear
