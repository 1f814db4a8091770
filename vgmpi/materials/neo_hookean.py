"""Elastic solid: compressible neo-Hookean, carried as H = F - I."""

from typing import ClassVar, Literal, NamedTuple

import numpy as np

from vgmpi.materials.tensor_math.tensor import (
    det_minus_one,
    left_cauchy_green_minus_one,
    max_principal_stretch_squared_bound,
)

from .material import HyperelasticMaterial, material


class Law(NamedTuple):
    """Parameters of the law."""

    mu: float  # [Pa] shear modulus
    lam: float  # [Pa] Lame's first parameter
    density: float  # [kg/m3] density at rest


@material
class Elastic(HyperelasticMaterial):
    """Rubber-like solid: tau = mu (b - I) + lam ln J I."""

    kind: Literal["elastic"]  # type: ignore[assignment]

    Law: ClassVar = Law
    cost: ClassVar = 1.4

    @staticmethod
    def stress(law, state, L):
        """Return the Kirchhoff stress (00, 11, 22, 01, 02, 12) [Pa]."""
        b00, b11, b22, b01, b02, b12 = left_cauchy_green_minus_one(state)
        p = law.lam * np.log1p(det_minus_one(state))
        mu = law.mu
        return (mu * b00 + p, mu * b11 + p, mu * b22 + p, mu * b01, mu * b02, mu * b12)

    @staticmethod
    def wave_speed2(law, state):
        """Return a bound on the squared wave speed [m2/s2]."""
        # uniaxial stretch a: rho0 c^2 = mu (a^2 + 1) + lam (1 - ln J); row sums of b bound a^2
        a2 = max_principal_stretch_squared_bound(left_cauchy_green_minus_one(state))
        soft = np.maximum(1.0 - np.log1p(det_minus_one(state)), 0.0)
        return (law.mu * (1.0 + a2) + law.lam * soft) / law.density

    @staticmethod
    def energy(law, state):
        """Return the elastic energy per rest volume [J/m3]."""
        b00, b11, b22, _, _, _ = left_cauchy_green_minus_one(state)
        log_j = np.log1p(det_minus_one(state))
        return 0.5 * law.mu * (b00 + b11 + b22 - 2.0 * log_j) + 0.5 * law.lam * log_j * log_j
