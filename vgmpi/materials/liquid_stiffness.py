"""Common keys of liquids in a scene: density, stiffness and tension."""

import math
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import model_validator

from vgmpi.runtime.config.schema import Quantity

from .material import Family, Material, field_error

GRAVITY = 9.81  # [m/s2] acceleration of gravity for the pressure at a depth
WAYS = "tait_coefficient, max_speed or max_depth (the last two with max_compression)"
NEVER = 100.0  # [-] theta = ln J that no particle reaches: the solver stops at J = 5


class Liquid(Material):
    """Keys of liquids."""

    density: Annotated[float, Quantity("kg/m3", gt=0)] = 1000.0
    """at rest"""
    tait_coefficient: Annotated[float, Quantity("Pa", gt=0)] = 2e5
    """coefficient k of the Tait equation p = k (J^-gamma - 1), gamma times smaller than the bulk
    modulus at rest; the time step is proportional to 1 / sqrt(k). A smaller
    value than in reality is usual, as long as the density changes little. Alternatives: max_speed,
    max_depth"""
    max_speed: Annotated[float, Quantity("m/s", gt=0)] | None = None
    """instead of tait_coefficient: expected maximum speed. The speed of sound is then max_speed /
    sqrt(max_compression): 10 max_speed for 1 %"""
    max_depth: Annotated[float, Quantity("m", gt=0)] | None = None
    """instead of tait_coefficient: maximum depth of the liquid. Its weight at 9.81 m/s2 then
    compresses it by `max_compression` at the bottom"""
    max_compression: Annotated[float, Quantity("1", gt=0, le=0.1)] = 0.01
    """allowed relative change of density at max_speed or max_depth; only with one of them"""
    tait_exponent: Annotated[float, Quantity("", ge=1, le=20)] = 7.0
    """exponent of the same equation of state"""
    tension: Literal["on", "off"] = "on"
    """off: no negative pressure; the liquid separates instead, and its volume never exceeds the
    rest volume"""

    family: ClassVar[Family] = "fluid"
    friction: ClassVar = 0.0

    @staticmethod
    def is_liquid(law: tuple) -> bool:
        """Return True."""
        return True

    @model_validator(mode="after")
    def _one_stiffness(self):
        """Check that the stiffness is given in one way, and compute it."""
        keys = [
            k for k in ("tait_coefficient", "max_speed", "max_depth") if k in self.model_fields_set
        ]
        keys = [k for k in keys if getattr(self, k) is not None]
        if len(keys) > 1:
            message = f"{keys[0]} already says how stiff it is: give one of {WAYS}"
            raise field_error(self, keys[1], message)
        relative = keys in (["max_speed"], ["max_depth"])
        if "max_compression" in self.model_fields_set and not relative:
            message = "needs max_speed or max_depth, at which it is reached"
            raise field_error(
                self, "max_compression", f"{message}; stiffness is given by one of {WAYS}"
            )
        if relative:
            # the table shows the resulting stiffness
            object.__setattr__(self, "tait_coefficient", self._stiffness())
        return self

    def _stiffness(self) -> float:
        """Return k [Pa] for the allowed compression."""
        if self.max_speed is not None:
            return self.density * self.max_speed**2 / (self.max_compression * self.tait_exponent)
        assert self.max_depth is not None
        return self.density * GRAVITY * self.max_depth / (self.max_compression * self.tait_exponent)

    def theta_under(self, weight: float | np.ndarray) -> np.ndarray:
        """Return ln J at rest under a weight, in its shape.

        From dp/dz = -density g / J with this law's p follows J^(1 - gamma) = 1 + (1 - 1 / gamma)
        weight / k.

        Args:
            weight: Weight per area without compression, density g depth [Pa].
        """
        gamma = max(self.tait_exponent, 1.0 + 1e-6)
        return -np.log1p((1.0 - 1.0 / gamma) * weight / self.tait_coefficient) / (gamma - 1.0)

    def theta_at(self, pressure: np.ndarray, coefficient: float) -> np.ndarray:
        """Return ln J at which the law has a pressure with another Tait coefficient, in its shape.

        Args:
            pressure: Pressure [Pa].
            coefficient: The coefficient [Pa].
        """
        return -np.log1p(pressure / coefficient) / self.exponent

    def theta_stretched(self, tension: float) -> float:
        """Return ln J under a tension, infinite from k on, which this law's p does not exceed.

        Args:
            tension: Negative pressure [Pa].
        """
        strength = self.tait_coefficient
        return -math.log1p(-tension / strength) / self.exponent if tension < strength else math.inf

    @property
    def exponent(self) -> float:
        """Return gamma, kept above 1 by a single-precision margin for the energy's formula."""
        return max(self.tait_exponent, 1.0 + 1e-6)

    @property
    def max_theta(self) -> float:
        """Return the largest theta = ln J."""
        return NEVER if self.tension == "on" else 0.0
