"""Snow: elastic up to critical stretches, then it packs and hardens or tears and softens; carried
as b_e - I and ln Jp.

Plasticity and hardening of Stomakhin et al. 2013 (A Material Point Method for Snow Simulation):
principal stretches stay within [1 - theta_c, 1 + theta_s], what is cut off goes into the plastic
volume ratio Jp, and both moduli are multiplied by exp(xi (1 - Jp)), here within [1 / limit, limit].
The elasticity is Hencky's instead of the fixed corotated one: it is the same to first order in
strains, which here stay below a few percent, needs no rotation, and shares its text with the other
laws that yield.
"""

import math
from typing import Annotated, ClassVar, Literal, NamedTuple

import numpy as np

from ..device import hencky
from ..device.eigen import eigen
from ..tables import Quantity
from .base import Family, Material, lame, material


class Law(NamedTuple):
    mu: float  # shear modulus at Jp = 1 [Pa]
    lam: float  # Lame's first parameter at Jp = 1 [Pa]
    low: float  # least logarithmic principal strain [-]
    high: float  # largest [-]
    xi: float  # hardening [-]
    limit: float  # of the hardening's exponent, to both sides [-]
    density: float  # at rest [kg/m3]


@material
class Snow(Material):
    """Snow that packs and breaks: critical stretches, hardening exp(xi (1 - Jp))."""

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
    """nor rise above 1 plus this; smaller is brittle"""
    hardening: Annotated[float, Quantity("", ge=0, le=50)] = 10.0
    """xi of exp(xi (1 - Jp)); larger is icier"""
    hardening_limit: Annotated[float, Quantity("", ge=1, le=1000)] = 20.0
    """the factor stays between this and its inverse; the time step shrinks with its root"""
    friction: Annotated[float, Quantity("", ge=0)] = 0.3
    """Coulomb coefficient at contacts, where no coupling names one"""

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
            "hardening": 5.0,
        },
        "packed snow": {
            "density": 400.0,
            "youngs_modulus": 1.4e5,
            "critical_compression": 2.5e-2,
            "critical_stretch": 7.5e-3,
            "hardening": 10.0,
        },
    }

    @property
    def stiffening(self) -> float:
        """At Jp = 0, if the limit lets it."""
        return min(self.hardening_limit, math.exp(self.hardening))

    def law(self) -> Law:
        mu, lam = lame(self.youngs_modulus, self.poisson_ratio)
        return Law(
            mu=mu,
            lam=lam,
            low=math.log1p(-self.critical_compression),
            high=math.log1p(self.critical_stretch),
            xi=self.hardening,
            limit=math.log(self.hardening_limit),
            density=self.density,
        )

    @staticmethod
    def advance(law, state, L, dt):
        b = hencky.moved(state[:6], L, dt)
        d, q = eigen(b)
        e0, e1, e2 = hencky.strains(d)
        c0, c1, c2 = cut(law, e0), cut(law, e1), cut(law, e2)
        b00, b11, b22, b01, b02, b12 = hencky.yielded(b, d, q, (c0, c1, c2))
        return (b00, b11, b22, b01, b02, b12, state[6] - (c0 + c1 + c2))

    @staticmethod
    def stress(law, state, L):
        h = hardened(law, state[6])
        return hencky.stress(h * law.mu, h * law.lam, state[:6])

    @staticmethod
    def volume_ratio(law, state):
        return hencky.volume_ratio(state[:6])

    @staticmethod
    def wave_speed2(law, state):
        h = hardened(law, state[6])
        return h * hencky.stiffest(law.mu, law.lam, state[:6]) / law.density

    @staticmethod
    def energy(law, state):
        h = hardened(law, state[6])
        return h * hencky.energy(law.mu, law.lam, state[:6])


def cut(law, e):
    """What is missing from strain e to the elastic range: 0 inside."""
    return np.minimum(law.high - e, 0.0) + np.maximum(law.low - e, 0.0)


def hardened(law, ln_jp):
    """Factor on the moduli."""
    return np.exp(np.minimum(np.maximum(-law.xi * np.expm1(ln_jp), -law.limit), law.limit))
