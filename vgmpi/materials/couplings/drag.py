"""Drag: a fluid flows through the pores of a sand.

They share space: the sand bears the fluid's pressure in proportion to the volume fraction of its
grains (buoyancy), the fluid in proportion to that of the pores. Their relative motion is damped by
c = n^2 rho_w g / k [kg/(m3 s)], n porosity, k hydraulic conductivity (Darcy; Tampubolon et al.
2017), over the bulk volume that both fill.
"""

from typing import Annotated, ClassVar, Literal

from vgmpi.materials.material import Material
from vgmpi.runtime.config.schema import Quantity, StrictModel

from .interaction import DRAG, coupling

GRAVITY = 9.80665  # [m/s2] standard gravity, for which hydraulic conductivities are defined


@coupling
class Drag(StrictModel):
    """Drag of a fluid that flows through the pores of a sand."""

    between: tuple[str, str]
    """a fluid and a sand"""
    kind: Literal["drag"]
    hydraulic_conductivity: Annotated[float, Quantity("m/s", gt=0)]
    """hydraulic conductivity: the speed at which the fluid seeps through resting sand under its own
    weight; fine sand 1e-5 .. 1e-4, coarse sand 1e-3 .. 1e-2, gravel above"""

    rule: ClassVar = DRAG
    printed: ClassVar = False

    @staticmethod
    def refuses(a: Material, b: Material) -> str:
        """Return why materials a and b cannot be coupled, or an empty string."""
        if {a.family, b.family} != {"fluid", "sand"}:
            return "drag is between a fluid and a sand"
        return ""

    def coefficient(self, porosity: float, density: float) -> float:
        """Return the drag coefficient c [kg/(m3 s)].

        Args:
            porosity: Porosity of the sand [-].
            density: Density of the fluid [kg/m3].
        """
        return porosity**2 * density * GRAVITY / self.hydraulic_conductivity


@coupling
class DragPaper(Drag):
    """Drag by the paper's printed equations: for comparison only.

    The exchange at a node is c m_s m_w / (m_s + m_w), without the time step and of no consistent
    unit: the slip loses the same fraction in a step of any length, so that half the step doubles
    the drag. It is solved implicitly here as well, since the published form has no stable step of
    its own.
    """

    kind: Literal["drag-versagauss"]  # type: ignore[assignment]

    printed: ClassVar = True
