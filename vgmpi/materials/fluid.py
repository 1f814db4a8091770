"""Weakly compressible fluid: pressure by the Tait equation, carried as theta = ln J."""

from typing import Annotated, ClassVar, Literal, NamedTuple

import numpy as np

from ..device import tait
from ..tables import Quantity
from .base import material
from .liquid import Liquid


class Law(NamedTuple):
    k: float  # stiffness [Pa]; the bulk modulus is k gamma
    gamma: float  # stiffening exponent [-]
    mu: float  # dynamic viscosity [Pa s]
    c2: float  # squared speed of sound at rest [m2/s2]
    most: float  # largest theta


@material
class Fluid(Liquid):
    """Water-like liquid: p = k (J^-gamma - 1), Newtonian viscosity."""

    kind: Literal["fluid"]
    viscosity: Annotated[float, Quantity("Pa s", ge=0)] = 0.0
    """dynamic viscosity"""

    Law: ClassVar = Law
    cost: ClassVar = 1.0
    carries: ClassVar = {"theta": (0.0,)}
    # at 20 C. Water, glycerine, mercury: CRC Handbook of Chemistry and Physics, 97th ed., section
    # 6; olive oil: Rao, Rheology of Fluid and Semisolid Foods, 2nd ed. 2007; honey, which varies
    # tenfold with its water: Yanniotis et al., J. Food Eng. 72 (2006) 372
    presets: ClassVar[dict[str, dict]] = {
        "water": {"density": 998.0, "viscosity": 1.0e-3},
        "honey": {"density": 1420.0, "viscosity": 10.0},
        "oil": {"density": 911.0, "viscosity": 0.084},
        "glycerine": {"density": 1261.0, "viscosity": 1.41},
        "mercury": {"density": 13546.0, "viscosity": 1.55e-3},
    }

    def law(self) -> Law:
        c2 = self.bulk_modulus * self.gamma / self.density
        return Law(self.bulk_modulus, self.exponent, self.viscosity, c2, self.most)

    @property
    def kinematic_viscosity(self) -> float:  # type: ignore[override]
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
        return (np.minimum(state[0] + dt * (L[0] + L[4] + L[8]), law.most),)

    @staticmethod
    def stress(law, state, L):
        theta = state[0]
        t = tait.stress(law.k, law.gamma, theta)
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
        return law.c2 * tait.stiffening(law.gamma, state[0])

    @staticmethod
    def energy(law, state):
        return tait.energy(law.k, law.gamma, state[0])
