"""Common keys of liquids in a scene: density, stiffness and tension."""

from typing import Annotated, ClassVar, Literal

from pydantic import model_validator

from vgmpi.runtime.config.schema import Quantity

from .material import Family, Material, field_error

GRAVITY = 9.81  # [m/s2] acceleration of gravity for the pressure at a depth
WAYS = "bulk_modulus, max_speed or depth (the last two with compression)"
NEVER = 100.0  # [-] theta = ln J that no particle reaches: the solver stops at J = 5


class Liquid(Material):
    """Keys of liquids."""

    density: Annotated[float, Quantity("kg/m3", gt=0)] = 1000.0
    """at rest"""
    bulk_modulus: Annotated[float, Quantity("Pa", gt=0)] = 2e5
    """stiffness k of p = k (J^-gamma - 1); the step shrinks with its root. Softer than nature's is
    usual: what counts is that the density changes little. Instead of it max_speed or depth may be
    given"""
    max_speed: Annotated[float, Quantity("m/s", gt=0)] | None = None
    """instead of bulk_modulus: the fastest motion to come. Sound then travels at max_speed /
    sqrt(compression), which is 10 max_speed for 1 %"""
    depth: Annotated[float, Quantity("m", gt=0)] | None = None
    """instead of bulk_modulus: the deepest the liquid gets. Its weight at 9.81 m/s2 then compresses
    it by `compression` at the bottom"""
    compression: Annotated[float, Quantity("1", gt=0, le=0.1)] = 0.01
    """the relative change of density allowed at max_speed or depth; only with one of them"""
    gamma: Annotated[float, Quantity("", ge=1, le=20)] = 7.0
    """exponent of the same law"""
    tension: Literal["on", "off"] = "on"
    """off: it parts instead of being pulled, its volume never grows beyond that at rest"""

    family: ClassVar[Family] = "fluid"
    friction: ClassVar = 0.0

    @model_validator(mode="after")
    def _one_stiffness(self):
        """Check that the stiffness is given in one way, and compute it."""
        keys = [k for k in ("bulk_modulus", "max_speed", "depth") if k in self.model_fields_set]
        keys = [k for k in keys if getattr(self, k) is not None]
        if len(keys) > 1:
            message = f"{keys[0]} already says how stiff it is: give one of {WAYS}"
            raise field_error(self, keys[1], message)
        relative = keys in (["max_speed"], ["depth"])
        if "compression" in self.model_fields_set and not relative:
            message = "needs max_speed or depth, at which it is reached"
            raise field_error(
                self, "compression", f"{message}; stiffness is given by one of {WAYS}"
            )
        if relative:
            # the table shows the resulting stiffness
            object.__setattr__(self, "bulk_modulus", self._stiffness())
        return self

    def _stiffness(self) -> float:
        """Return k [Pa] for the allowed compression."""
        if self.max_speed is not None:
            return self.density * self.max_speed**2 / (self.compression * self.gamma)
        assert self.depth is not None
        return self.density * GRAVITY * self.depth / (self.compression * self.gamma)

    @property
    def exponent(self) -> float:
        """Return gamma, kept above 1 by a single-precision margin for the energy's formula."""
        return max(self.gamma, 1.0 + 1e-6)

    @property
    def most(self) -> float:
        """Return the largest theta = ln J."""
        return NEVER if self.tension == "on" else 0.0
