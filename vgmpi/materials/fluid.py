"""Weakly compressible fluid: pressure by the Tait equation, carried as theta = ln J."""

from typing import Annotated, ClassVar, Literal, NamedTuple

import numpy as np

from ..tables import Quantity
from .base import Family, Material, material


class Law(NamedTuple):
    k: float  # stiffness [Pa]; the bulk modulus is k gamma
    gamma: float  # stiffening exponent [-]
    mu: float  # dynamic viscosity [Pa s]
    c2: float  # squared speed of sound at rest [m2/s2]


@material
class Fluid(Material):
    """Water-like liquid: p = k (J^-gamma - 1), Newtonian viscosity."""

    kind: Literal["fluid"]
    density: Annotated[float, Quantity("kg/m3", gt=0)] = 1000.0
    """at rest"""
    bulk_modulus: Annotated[float, Quantity("Pa", gt=0)] = 2e5
    """stiffness k of p = k (J^-gamma - 1); the step shrinks with its root"""
    gamma: Annotated[float, Quantity("", ge=1, le=20)] = 7.0
    """exponent of the same law"""
    viscosity: Annotated[float, Quantity("Pa s", ge=0)] = 0.0
    """dynamic viscosity"""

    Law: ClassVar = Law
    cost: ClassVar = 1.0
    family: ClassVar[Family] = "fluid"
    carries: ClassVar = {"theta": (0.0,)}
    friction: ClassVar = 0.0

    def law(self) -> Law:
        c2 = self.bulk_modulus * self.gamma / self.density
        # gamma = 1 is the limit of the energy's formula, which divides by gamma - 1: stay off it by
        # what single precision can tell from 1
        return Law(self.bulk_modulus, max(self.gamma, 1.0 + 1e-6), self.viscosity, c2)

    @property
    def kinematic_viscosity(self) -> float:
        """[m2/s]: bounds the time step by diffusion."""
        return self.viscosity / self.density

    def theta_below(self, weight: np.ndarray) -> np.ndarray:
        """ln J (n,) at rest under `weight` [Pa], what density g depth is without compression.

        From dp/dz = -density g / J with this law's p: J^(1 - gamma) = 1 + (1 - 1 / gamma) weight
        / k.
        """
        gamma = max(self.gamma, 1.0 + 1e-6)
        return -np.log1p((1.0 - 1.0 / gamma) * weight / self.bulk_modulus) / (gamma - 1.0)

    @staticmethod
    def advance(law, state, L, dt):
        # the exact exponential of the volume's rate; (1 + dt tr L) is its first order and drifts
        return (state[0] + dt * (L[0] + L[4] + L[8]),)

    @staticmethod
    def stress(law, state, L):
        theta = state[0]
        t = -law.k * np.expm1(-law.gamma * theta) * np.exp(theta)
        # Newtonian: tau = J 2 mu dev(D), D = sym(L)
        m = law.mu * np.exp(theta)
        d = (L[0] + L[4] + L[8]) / 3.0
        return (
            t + 2.0 * m * (L[0] - d),
            t + 2.0 * m * (L[4] - d),
            t + 2.0 * m * (L[8] - d),
            m * (L[1] + L[3]),
            m * (L[2] + L[6]),
            m * (L[5] + L[7]),
        )

    @staticmethod
    def volume_ratio(law, state):
        return np.exp(state[0])

    @staticmethod
    def wave_speed2(law, state):
        return law.c2 * np.exp((1.0 - law.gamma) * state[0])

    @staticmethod
    def energy(law, state):
        # the integral of -p dJ from 1
        theta = state[0]
        g = law.gamma - 1.0
        return law.k * (np.expm1(-g * theta) / g + np.expm1(theta))
