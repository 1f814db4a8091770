"""Tait's equation of state of weakly compressible liquids, p = k (J^-gamma - 1), carried as theta =
ln J: for every engine.

k: stiffness [Pa], the bulk modulus at rest is k gamma; theta = 0 at rest.
"""

import numpy as np


def stress(k, gamma, theta):
    """Kirchhoff stress -J p [Pa], without the difference of two numbers near 1."""
    return -k * np.expm1(-gamma * theta) * np.exp(theta)


def stiffening(gamma, theta):
    """rho0 c^2 relative to that at rest, k gamma."""
    return np.exp((1.0 - gamma) * theta)


def energy(k, gamma, theta):
    """The integral of -p dJ from 1 [J/m3]; gamma > 1."""
    g = gamma - 1.0
    return k * (np.expm1(-g * theta) / g + np.expm1(theta))
