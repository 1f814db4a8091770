"""Elastic solid: compressible neo-Hookean, carried as H = F - I."""

from typing import Annotated, ClassVar, Literal, NamedTuple

import numpy as np

from ..device.tensor import det_minus_one, left_cauchy_green_minus_one
from ..tables import Quantity
from .base import Family, Material, material


class Law(NamedTuple):
    mu: float  # shear modulus [Pa]
    lam: float  # Lame's first parameter [Pa]
    density: float  # at rest [kg/m3]


@material
class Elastic(Material):
    """Rubber-like solid: tau = mu (b - I) + lam ln J I."""

    kind: Literal["elastic"]
    density: Annotated[float, Quantity("kg/m3", gt=0)] = 1100.0
    """at rest"""
    youngs_modulus: Annotated[float, Quantity("Pa", gt=0)]
    """stiffness in tension"""
    poisson_ratio: Annotated[float, Quantity("", ge=0, lt=0.5)] = 0.3
    """0.5 would be incompressible; above 0.45 it bends too stiffly"""
    friction: Annotated[float, Quantity("", ge=0)] = 0.3
    """Coulomb coefficient against other solids, where no coupling names one"""

    Law: ClassVar = Law
    cost: ClassVar = 1.4
    family: ClassVar[Family] = "solid"
    # F - I, not F: in single precision an increment below 1e-8 added to 1 would be lost
    carries: ClassVar = {"H": (0.0,) * 9}

    def law(self) -> Law:
        E, nu = self.youngs_modulus, self.poisson_ratio
        return Law(E / (2 * (1 + nu)), E * nu / ((1 + nu) * (1 - 2 * nu)), self.density)

    @staticmethod
    def advance(law, state, L, dt):
        a0, a1, a2, a3, a4, a5, a6, a7, a8 = state
        c0, c1, c2, c3, c4, c5, c6, c7, c8 = L
        # F <- (I + dt L) F, hence H <- H + dt (L + L H)
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

    @staticmethod
    def stress(law, state, L):
        b00, b11, b22, b01, b02, b12 = left_cauchy_green_minus_one(state)
        p = law.lam * np.log1p(det_minus_one(state))
        mu = law.mu
        return (mu * b00 + p, mu * b11 + p, mu * b22 + p, mu * b01, mu * b02, mu * b12)

    @staticmethod
    def volume_ratio(law, state):
        return 1.0 + det_minus_one(state)

    @staticmethod
    def wave_speed2(law, state):
        # uniaxial stretch a: rho0 c^2 = mu (a^2 + 1) + lam (1 - ln J); the largest a^2 by row sums
        # of b
        b00, b11, b22, b01, b02, b12 = left_cauchy_green_minus_one(state)
        r0 = np.abs(1.0 + b00) + np.abs(b01) + np.abs(b02)
        r1 = np.abs(1.0 + b11) + np.abs(b01) + np.abs(b12)
        r2 = np.abs(1.0 + b22) + np.abs(b02) + np.abs(b12)
        a2 = np.maximum(r0, np.maximum(r1, r2))
        soft = np.maximum(1.0 - np.log1p(det_minus_one(state)), 0.0)
        return (law.mu * (1.0 + a2) + law.lam * soft) / law.density

    @staticmethod
    def energy(law, state):
        b00, b11, b22, _, _, _ = left_cauchy_green_minus_one(state)
        log_j = np.log1p(det_minus_one(state))
        return 0.5 * law.mu * (b00 + b11 + b22 - 2.0 * log_j) + 0.5 * law.lam * log_j * log_j
