"""Drag: a fluid flows through the pores of a sand.

They share space: of the fluid's pressure the sand bears the share of its grains (buoyancy), the
fluid the share of the pores. Their relative motion is slowed by c = n^2 rho_w g / k [kg/(m3 s)], n
porosity, k hydraulic conductivity (Darcy; Tampubolon 2017), over the bulk volume both fill.
"""

from typing import Annotated, ClassVar, Literal

from ..tables import Quantity, Table
from .base import DRAG, coupling

GRAVITY = 9.80665  # [m/s2] under which a hydraulic conductivity is measured


@coupling
class Drag(Table):
    """A fluid that flows through the pores of a sand."""

    between: tuple[str, str]
    """a fluid and a sand"""
    kind: Literal["drag"]
    permeability: Annotated[float, Quantity("m/s", gt=0)]
    """hydraulic conductivity: the speed at which the fluid sinks through resting sand under its own
    weight; fine sand 1e-5 .. 1e-4, coarse sand 1e-3 .. 1e-2, gravel above"""

    rule: ClassVar = DRAG
    printed: ClassVar = False

    @staticmethod
    def refuses(a: type, b: type) -> str:
        """Why materials a and b cannot be coupled so; "" where they can."""
        if {a.family, b.family} != {"fluid", "sand"}:
            return "drag is between a fluid and a sand"
        return ""

    def coefficient(self, porosity: float, density: float) -> float:
        """c [kg/(m3 s)] of a sand of this porosity and a fluid of this density [kg/m3]."""
        return porosity**2 * density * GRAVITY / self.permeability
