"""Foam: Hencky elasticity and viscous flow beyond a yield stress (Bingham), carried as b_e - I."""

import math
from typing import Annotated, ClassVar, Literal, NamedTuple

import numpy as np

from vgmpi.materials.tensor_math.symmetric_eigen import eigen
from vgmpi.runtime.config.schema import Quantity

from .material import ElastoplasticMaterial, Family, lame, material
from .tensor_math import hencky, viscoplastic_flow


class Law(NamedTuple):
    """Parameters of the law."""

    mu: float  # [Pa] shear modulus
    lam: float  # [Pa] Lame's first parameter
    strain: float  # [-] norm of the strain deviator at yield
    viscosity: float  # [Pa s] viscosity of the flow beyond yield
    density: float  # [kg/m3] density at rest


@material
class Foam(ElastoplasticMaterial):
    """Foam, such as shaving foam or whipped cream: elastic solid with viscous flow beyond its yield
    stress; in simple shear, tau = yield_stress + viscosity (shear rate). Unlike a paste it is
    compressible, and its bodies do not merge.
    """

    kind: Literal["foam"]
    density: Annotated[float, Quantity("kg/m3", gt=0)] = 80.0
    """at rest"""
    youngs_modulus: Annotated[float, Quantity("Pa", gt=0)]
    """stiffness in tension; the time step is proportional to the inverse of its square root"""
    poisson_ratio: Annotated[float, Quantity("", ge=0, lt=0.5)] = 0.3
    """0.5 would be incompressible"""
    yield_stress: Annotated[float, Quantity("Pa", ge=0)]
    """shear stress below which the material does not flow"""
    viscosity: Annotated[float, Quantity("Pa s", gt=0)]
    """shear stress beyond the yield stress per shear rate; does not bound the time step"""
    friction: Annotated[float, Quantity("", ge=0)] = 0.3
    """Coulomb friction coefficient at contacts without a contact coupling"""

    Law: ClassVar = Law
    cost: ClassVar = 2.5
    family: ClassVar[Family] = "solid"
    carries: ClassVar = {"B": (0.0,) * 6}
    # soap foam: Komatsu, Yamada and Fukushima, J. Soc. Cosmet. Chem. 29 (1978) 237 (shear modulus
    # 50 to 85 Pa, viscosity 1.5 to 2 Pa s, 10 to 25 cm3/g); yield near a tenth of the modulus,
    # shaving foam some three times as stiff: Weaire and Hutzler, The Physics of Foams, 1999,
    # chapter 8. The Poisson ratio is a choice: in volume a foam is as stiff as air, 1e5 Pa, far
    # stiffer than in shear
    presets: ClassVar[dict[str, dict]] = {
        "shaving foam": {
            "density": 80.0,
            "youngs_modulus": 700.0,
            "poisson_ratio": 0.45,
            "yield_stress": 25.0,
            "viscosity": 4.0,
        },
        "soap foam": {
            "density": 60.0,
            "youngs_modulus": 190.0,
            "poisson_ratio": 0.45,
            "yield_stress": 6.0,
            "viscosity": 1.8,
        },
        "whipped cream": {
            "density": 450.0,
            "youngs_modulus": 3000.0,
            "poisson_ratio": 0.45,
            "yield_stress": 60.0,
            "viscosity": 6.0,
        },
    }

    def law(self) -> NamedTuple:
        """Return the numbers of the law in SI units."""
        mu, lam = lame(self.youngs_modulus, self.poisson_ratio)
        # tau = sqrt(s : s / 2) = sqrt(2) mu |dev e|
        strain = self.yield_stress / (math.sqrt(2) * mu)
        return Law(mu, lam, strain, self.viscosity, self.density)

    @staticmethod
    def advance(law, state, L, dt):
        """Return the state after a step dt [s] of L = grad v [1/s].

        Args:
            law: Parameters of the law.
            state: State of the particle.
            L: Velocity gradient, nine components, row by row [1/s].
            dt: Time step [s].
        """
        b = hencky.trial_strain_measure(state, L, dt)
        d, q = eigen(b)
        _, s, size = hencky.split_volumetric_deviatoric(hencky.principal_log_strains(d))
        over = np.maximum(size - law.strain, 0.0) * viscoplastic_flow.bingham(
            law.mu * dt, law.viscosity
        )
        r = -over / np.maximum(size, 1e-30)
        return hencky.apply_plastic_corrector(b, d, q, (r * s[0], r * s[1], r * s[2]))
