"""Snow: elastic up to critical stretches, beyond which it packs and hardens or tears and softens.

The state is b_e - I and ln Jp. Plasticity and hardening are those of Stomakhin et al. 2013 (A
Material Point Method for Snow Simulation): principal stretches stay within [1 - theta_c, 1 +
theta_s], the excess goes into the plastic volume ratio Jp, and both moduli are multiplied by exp(xi
(1 - Jp)), here within [1 / limit, limit]. The elasticity is Hencky's instead of the fixed corotated
one: it is equal to first order in strains, which here stay below a few percent, needs no rotation,
and shares its text with the other laws that yield.
"""

import math
from typing import Annotated, ClassVar, Literal, NamedTuple

import numpy as np

from vgmpi.materials.tensor_math.symmetric_eigen import eigen
from vgmpi.runtime.config.schema import Quantity

from .material import Family, Material, lame, material
from .tensor_math import hencky


class Law(NamedTuple):
    """Parameters of the law."""

    mu: float  # [Pa] shear modulus at Jp = 1
    lam: float  # [Pa] Lame's first parameter at Jp = 1
    low: float  # [-] smallest logarithmic principal strain
    high: float  # [-] largest logarithmic principal strain
    xi: float  # [-] hardening
    limit: float  # [-] bound of the hardening exponent to both sides
    density: float  # [kg/m3] density at rest


@material
class Snow(Material):
    """Snow that compacts and breaks: critical stretches, hardening exp(xi (1 - Jp))."""

    kind: Literal["snow"]
    density: Annotated[float, Quantity("kg/m3", gt=0)] = 400.0
    """at rest, air included"""
    youngs_modulus: Annotated[float, Quantity("Pa", gt=0)] = 1.4e5
    """at rest"""
    poisson_ratio: Annotated[float, Quantity("", ge=0, lt=0.5)] = 0.2
    """at any hardening"""
    critical_compression: Annotated[float, Quantity("", gt=0, lt=0.5)] = 2.5e-2
    """principal stretches do not fall below 1 minus this; smaller is powdery"""
    critical_stretch: Annotated[float, Quantity("", gt=0, lt=1)] = 7.5e-3
    """principal stretches do not exceed 1 plus this; smaller is brittle"""
    hardening_coefficient: Annotated[float, Quantity("", ge=0, le=50)] = 10.0
    """xi of exp(xi (1 - Jp)); larger is icier"""
    max_hardening_factor: Annotated[float, Quantity("", ge=1, le=1000)] = 20.0
    """bounds of the hardening factor: this value and its inverse; the time step is proportional to
    the inverse of its square root"""
    friction: Annotated[float, Quantity("", ge=0)] = 0.3
    """Coulomb friction coefficient at contacts without a contact coupling"""

    Law: ClassVar = Law
    cost: ClassVar = 2.5
    family: ClassVar[Family] = "snow"
    carries: ClassVar = {"B": (0.0,) * 6, "ln_Jp": (0.0,)}
    # Stomakhin et al. 2013, its standard snow and the loosest of its variations; density of fresh
    # snow: Judson and Doesken, Bull. Amer. Meteor. Soc. 81 (2000) 1577
    presets: ClassVar[dict[str, dict]] = {
        "fresh snow": {
            "density": 100.0,
            "youngs_modulus": 4.8e4,
            "critical_compression": 1.9e-2,
            "critical_stretch": 5e-3,
            "hardening_coefficient": 5.0,
        },
        "packed snow": {
            "density": 400.0,
            "youngs_modulus": 1.4e5,
            "critical_compression": 2.5e-2,
            "critical_stretch": 7.5e-3,
            "hardening_coefficient": 10.0,
        },
    }

    @property
    def stiffening(self) -> float:
        """Return the hardening factor at Jp = 0, within its limit."""
        return min(self.max_hardening_factor, math.exp(self.hardening_coefficient))

    def law(self) -> NamedTuple:
        """Return the numbers of the law in SI units."""
        mu, lam = lame(self.youngs_modulus, self.poisson_ratio)
        return Law(
            mu=mu,
            lam=lam,
            low=math.log1p(-self.critical_compression),
            high=math.log1p(self.critical_stretch),
            xi=self.hardening_coefficient,
            limit=math.log(self.max_hardening_factor),
            density=self.density,
        )

    @staticmethod
    def advance(law, state, L, dt):
        """Return the state after a step dt [s] of L = grad v [1/s].

        Args:
            law: Parameters of the law.
            state: State of the particle.
            L: Velocity gradient, nine components, row by row [1/s].
            dt: Time step [s].
        """
        b = hencky.trial_strain_measure(state[:6], L, dt)
        d, q = eigen(b)
        e0, e1, e2 = hencky.principal_log_strains(d)
        c0, c1, c2 = clamp_excess(law, e0), clamp_excess(law, e1), clamp_excess(law, e2)
        b00, b11, b22, b01, b02, b12 = hencky.apply_plastic_corrector(b, d, q, (c0, c1, c2))
        return (b00, b11, b22, b01, b02, b12, state[6] - (c0 + c1 + c2))

    @staticmethod
    def stress(law, state, L):
        """Return the Kirchhoff stress (00, 11, 22, 01, 02, 12) [Pa]."""
        h = hardening_factor(law, state[6])
        return hencky.stress(h * law.mu, h * law.lam, state[:6])

    @staticmethod
    def volume_ratio(law, state):
        """Return the elastic volume ratio."""
        return hencky.volume_ratio(state[:6])

    @staticmethod
    def wave_speed2(law, state):
        """Return a bound on the squared wave speed [m2/s2]."""
        h = hardening_factor(law, state[6])
        return h * hencky.acoustic_modulus_bound(law.mu, law.lam, state[:6]) / law.density

    @staticmethod
    def energy(law, state):
        """Return the elastic energy per rest volume [J/m3]."""
        h = hardening_factor(law, state[6])
        return h * hencky.energy(law.mu, law.lam, state[:6])


def clamp_excess(law, e):
    """Return the change that brings strain e into the elastic range: 0 inside."""
    return np.minimum(law.high - e, 0.0) + np.maximum(law.low - e, 0.0)


def hardening_factor(law, ln_jp):
    """Return the hardening factor on the moduli."""
    return np.exp(np.minimum(np.maximum(-law.xi * np.expm1(ln_jp), -law.limit), law.limit))
