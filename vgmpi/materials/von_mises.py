"""Metal: Hencky elasticity, von Mises yield surface and linear isotropic hardening.

The state is b_e - I and the accumulated plastic strain. The radial return in principal logarithmic
strains (Simo and Hughes, Computational Inelasticity, 1998, boxes 3.1 and 9.1) keeps the volume, and
is exact for any step.
"""

import math
from typing import Annotated, ClassVar, Literal, NamedTuple

import numpy as np

from vgmpi.materials.tensor_math.symmetric_eigen import eigen
from vgmpi.runtime.config.schema import Quantity

from .material import ElastoplasticMaterial, Family, lame, material
from .tensor_math import hencky


class Law(NamedTuple):
    """Parameters of the law."""

    mu: float  # [Pa] shear modulus
    lam: float  # [Pa] Lame's first parameter
    strain: float  # [-] norm of the strain deviator at first yield
    slope: float  # [-] its growth per accumulated plastic strain
    density: float  # [kg/m3] density at rest


@material
class Metal(ElastoplasticMaterial):
    """Metal: von Mises plasticity with linear hardening."""

    kind: Literal["metal"]
    density: Annotated[float, Quantity("kg/m3", gt=0)] = 7850.0
    """at rest"""
    youngs_modulus: Annotated[float, Quantity("Pa", gt=0)]
    """stiffness in tension; the time step is proportional to the inverse of its square root"""
    poisson_ratio: Annotated[float, Quantity("", ge=0, lt=0.5)] = 0.3
    """0.5 would be incompressible"""
    yield_stress: Annotated[float, Quantity("Pa", gt=0)]
    """initial yield stress in tension"""
    hardening_modulus: Annotated[float, Quantity("Pa", ge=0)] = 0.0
    """increase of the yield stress per plastic strain in tension"""
    friction: Annotated[float, Quantity("", ge=0)] = 0.3
    """Coulomb friction coefficient at contacts without a contact coupling"""

    Law: ClassVar = Law
    cost: ClassVar = 2.5
    family: ClassVar[Family] = "solid"
    carries: ClassVar = {"B": (0.0,) * 6, "plastic_strain": (0.0,)}
    # densities, elastic constants and yield stresses of annealed metal: Ashby and Jones,
    # Engineering Materials 1; hardening: roughly the line from there to the true tensile strength
    presets: ClassVar[dict[str, dict]] = {
        "steel": {
            "density": 7850.0,
            "youngs_modulus": 2.1e11,
            "poisson_ratio": 0.29,
            "yield_stress": 2.2e8,
            "hardening_modulus": 1.5e9,
        },
        "copper": {
            "density": 8930.0,
            "youngs_modulus": 1.3e11,
            "poisson_ratio": 0.34,
            "yield_stress": 6e7,
            "hardening_modulus": 7e8,
        },
        "lead": {
            "density": 11340.0,
            "youngs_modulus": 1.6e10,
            "poisson_ratio": 0.44,
            "yield_stress": 1.1e7,
            "hardening_modulus": 2.4e7,
        },
    }

    def law(self) -> NamedTuple:
        """Return the numbers of the law in SI units."""
        mu, lam = lame(self.youngs_modulus, self.poisson_ratio)
        # a uniaxial stress Y has a deviator of norm sqrt(2/3) Y = 2 mu |s|
        factor = math.sqrt(2 / 3) / (2 * mu)
        return Law(
            mu, lam, factor * self.yield_stress, factor * self.hardening_modulus, self.density
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
        b, hardness = hencky.trial_strain_measure(state[:6], L, dt), state[6]
        d, q = eigen(b)
        _, s, size = hencky.split_volumetric_deviatoric(hencky.principal_log_strains(d))
        root = 0.816496580927726  # sqrt(2/3): plastic strain in tension per norm of its deviator
        over = np.maximum(size - (law.strain + law.slope * hardness), 0.0)
        flow = over / (1.0 + root * law.slope)
        factor = -flow / np.maximum(size, 1e-30)
        c = (factor * s[0], factor * s[1], factor * s[2])
        b00, b11, b22, b01, b02, b12 = hencky.apply_plastic_corrector(b, d, q, c)
        return (b00, b11, b22, b01, b02, b12, hardness + root * flow)
