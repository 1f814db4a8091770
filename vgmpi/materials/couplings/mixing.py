"""Mixing: two fluids move through each other, each with a velocity of its own.

They share space and pressure. The difference of their velocities decays within
slip_relaxation_time, and each drifts to where there is less of it (mixture model of Ren et al.
2014): u_k = -D (grad a_k / a_k - sum_l c_l grad a_l / a_l), D the diffusivity, a_k volume
fractions, c_k mass fractions. The momenta of all drifts sum to zero. Under gravity the slip settles
at v_1 - v_2 = -tau grad p (1 / rho_1 - 1 / rho_2), tau the slip_relaxation_time.
"""

from typing import Annotated, ClassVar, Literal

from vgmpi.materials.material import Material
from vgmpi.runtime.config.schema import Quantity, StrictModel

from .interaction import MIXING, coupling


@coupling
class Mixing(StrictModel):
    """Two fluids that mix. Fluids that mix with one another, also by way of a third, form a group
    and have the same diffusivity and slip_relaxation_time.
    """

    between: tuple[str, str]
    """two fluids"""
    kind: Literal["mixing"]
    diffusivity: Annotated[float, Quantity("m2/s", ge=0)] = 0.0
    """diffusivity; at most cell^2 / 6 per step"""
    slip_relaxation_time: Annotated[float, Quantity("s", ge=0)] = 0.0
    """relaxation time of the velocity difference between the two fluids; 0: no slip"""

    rule: ClassVar = MIXING
    printed: ClassVar = False

    @staticmethod
    def refuses(a: Material, b: Material) -> str:
        """Return why materials a and b cannot be coupled, or an empty string."""
        if a.family != "fluid" or b.family != "fluid":
            return "mixing is between two fluids"
        return ""


@coupling
class MixingPaper(Mixing):
    """Mixing by the paper's printed equations: for comparison only.

    The drift has the other sign, which un-mixes, and both fluids move with the mean velocity before
    their share of the force acts: so their slip is proportional to the time step.
    """

    kind: Literal["mixing-versagauss"]  # type: ignore[assignment]

    printed: ClassVar = True
