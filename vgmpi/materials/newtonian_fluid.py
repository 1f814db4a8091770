"""Weakly compressible fluid: pressure by the Tait equation, carried as theta = ln J."""

from typing import Annotated, ClassVar, Literal, NamedTuple

import numpy as np

from vgmpi.runtime.config.schema import Quantity

from .liquid_stiffness import Liquid
from .material import material
from .tensor_math import tait
from .tensor_math.tensor import log_volume_change


class Law(NamedTuple):
    """Parameters of the law."""

    k: float  # [Pa] stiffness; the bulk modulus is k gamma
    gamma: float  # [-] stiffening exponent
    mu: float  # [Pa s] dynamic viscosity
    sound_speed_squared: float  # [m2/s2] squared speed of sound at rest
    max_theta: float  # [-] largest theta


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

    def law(self) -> NamedTuple:
        """Return the numbers of the law in SI units."""
        c2 = self.tait_coefficient * self.tait_exponent / self.density
        return Law(self.tait_coefficient, self.exponent, self.viscosity, c2, self.max_theta)

    @property
    def kinematic_viscosity(self) -> float:  # type: ignore[override]
        """Return the kinematic viscosity [m2/s], which bounds the time step by diffusion."""
        return self.viscosity / self.density

    def hydrostatic_theta(self, weight: np.ndarray) -> np.ndarray:
        """Return ln J at rest under a weight, shape (n,).

        Args:
            weight: Weight per area without compression, density g depth, shape (n,) [Pa].
        """
        return self.theta_under(weight)

    @staticmethod
    def advance(law, state, L, dt):
        """Return the state after a step dt [s] of L = grad v [1/s].

        Args:
            law: Parameters of the law.
            state: State of the particle.
            L: Velocity gradient, nine components, row by row [1/s].
            dt: Time step [s].
        """
        return (np.minimum(state[0] + log_volume_change(L, dt), law.max_theta),)

    @staticmethod
    def stress(law, state, L):
        """Return the Kirchhoff stress (00, 11, 22, 01, 02, 12) [Pa]."""
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
        """Return the volume ratio J."""
        return np.exp(state[0])

    @staticmethod
    def wave_speed2(law, state):
        """Return the squared wave speed [m2/s2]."""
        return law.sound_speed_squared * tait.relative_bulk_modulus(law.gamma, state[0])

    @staticmethod
    def energy(law, state):
        """Return the elastic energy per rest volume [J/m3]."""
        return tait.energy(law.k, law.gamma, state[0])
