"""Base of hyperelastic solids that carry H = F - I: their keys, presets and the update of H."""

from typing import Annotated, ClassVar, NamedTuple

from vgmpi.materials.tensor_math.tensor import det_minus_one, update_deformation_gradient
from vgmpi.runtime.config.schema import Quantity

from .material import Family, Material, lame

# rubber (natural, unfilled), silicone, cork, wood (balsa, mean of its directions): Gibson and
# Ashby, Cellular Solids, 2nd ed. 1997, and Ashby, Materials Selection in Mechanical Design,
# 4th ed. 2011, appendix A; jelly, gelatine of some percent: Markidou et al., J. Food Eng. 68
# (2005) 295. Rubber, silicone and jelly have a Poisson ratio near 0.5, which locks: 0.45
ELASTIC_PRESETS: dict[str, dict] = {
    "rubber": {"density": 930.0, "youngs_modulus": 2e6, "poisson_ratio": 0.45},
    "silicone": {"density": 1150.0, "youngs_modulus": 5e5, "poisson_ratio": 0.45},
    "jelly": {"density": 1020.0, "youngs_modulus": 1e4, "poisson_ratio": 0.45},
    "cork": {"density": 170.0, "youngs_modulus": 2e7, "poisson_ratio": 0.05},
    "balsa": {"density": 160.0, "youngs_modulus": 1e9, "poisson_ratio": 0.3},
}


class HyperelasticMaterial(Material):
    """Base of laws with mu and lam [Pa] and density whose state begins with H = F - I.

    H has nine numbers; the update leaves further state variables unchanged. A subclass defines Law,
    cost, stress, wave_speed2 and energy; `carries` and `advance` if its state has more than H, and
    `law` if Law has more numbers.
    """

    kind: str
    density: Annotated[float, Quantity("kg/m3", gt=0)] = 1100.0
    """at rest"""
    youngs_modulus: Annotated[float, Quantity("Pa", gt=0)]
    """stiffness in tension, for small strains"""
    poisson_ratio: Annotated[float, Quantity("", ge=0, lt=0.5)] = 0.3
    """0.5 would be incompressible; too stiff in bending above 0.45"""
    friction: Annotated[float, Quantity("", ge=0)] = 0.3
    """Coulomb friction coefficient against other solids without a contact coupling"""

    family: ClassVar[Family] = "solid"
    # H instead of F: in single precision an increment below 1e-8 added to 1 would be lost
    carries: ClassVar = {"H": (0.0,) * 9}
    presets: ClassVar[dict[str, dict]] = ELASTIC_PRESETS

    def law(self) -> NamedTuple:
        """Return the numbers of the law in SI units."""
        return self.Law(*lame(self.youngs_modulus, self.poisson_ratio), self.density)

    @staticmethod
    def advance(law, state, L, dt):
        """Return the state after a step dt [s] of L = grad v [1/s].

        Args:
            law: Parameters of the law.
            state: State of the particle.
            L: Velocity gradient, nine components, row by row [1/s].
            dt: Time step [s].
        """
        return (*update_deformation_gradient(state[:9], L, dt), *state[9:])

    @staticmethod
    def volume_ratio(law, state):
        """Return the volume ratio J."""
        return 1.0 + det_minus_one(state[:9])
