"""Tait equation of state of weakly compressible liquids, for every engine.

p = k (J^-gamma - 1), carried as theta = ln J, with theta = 0 at rest; k is the stiffness [Pa], the
bulk modulus at rest is k gamma.
"""

import numpy as np


def stress(k, gamma, theta):
    """Return the Kirchhoff stress -J p [Pa], without the difference of two numbers near 1."""
    return -k * np.expm1(-gamma * theta) * np.exp(theta)


def relative_bulk_modulus(gamma, theta):
    """Return rho0 c^2 relative to its value at rest, k gamma."""
    return np.exp((1.0 - gamma) * theta)


def energy(k, gamma, theta):
    """Return the integral of -p dJ from 1 [J/m3]; gamma > 1."""
    g = gamma - 1.0
    return k * (np.expm1(-g * theta) / g + np.expm1(theta))
