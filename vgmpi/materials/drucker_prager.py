"""Sand: Hencky elasticity inside the Drucker-Prager cone, carried as b_e - I and v_c.

The return mapping is that of Klar et al. 2016 (Drucker-Prager Elastoplasticity for Sand Animation):
on the cone the volume is kept (no dilatancy), beyond its apex the sand is open and carries no
stress. The opening is counted in v_c, the logarithm of the opened volume, and must close again
before stress returns (Tampubolon et al. 2017, Multi-species Simulation of Porous Sand and Water
Mixtures). Cohesion moves the apex into tension.
"""

import math
from typing import Annotated, ClassVar, Literal, NamedTuple

import numpy as np

from vgmpi.materials.tensor_math.select import select
from vgmpi.materials.tensor_math.symmetric_eigen import eigen
from vgmpi.runtime.config.schema import Quantity

from .material import ElastoplasticMaterial, Family, lame, material
from .tensor_math import hencky


class Law(NamedTuple):
    """Parameters of the law."""

    mu: float  # [Pa] shear modulus
    lam: float  # [Pa] Lame's first parameter
    slope: float  # [-] norm of the strain deviator on the cone per mean strain below the apex
    apex_strain: float  # [-] mean logarithmic strain at the apex of the cone
    density: float  # [kg/m3] bulk density at rest


@material
class Sand(ElastoplasticMaterial):
    """Granular material: Drucker-Prager plasticity with volume correction."""

    kind: Literal["sand"]
    density: Annotated[float, Quantity("kg/m3", gt=0)] = 2650.0
    """density of the grains; the bulk density is (1 - porosity) times it"""
    porosity: Annotated[float, Quantity("1", ge=0, lt=1)] = 0.4
    """fraction of the rest volume that is pore space"""
    youngs_modulus: Annotated[float, Quantity("Pa", gt=0)] = 1e6
    """stiffness of the bulk; loose sand has 1e7, a smaller value allows longer time steps"""
    poisson_ratio: Annotated[float, Quantity("", ge=0, lt=0.5)] = 0.3
    """of the bulk"""
    friction_angle: Annotated[float, Quantity("rad", gt=0, lt=1.5707)] = math.radians(32)
    """friction angle, measured in the test that `friction_angle_test` names"""
    friction_angle_test: Literal["slope", "plane-strain", "triaxial"] = "slope"
    """test in which friction_angle was measured. slope: angle of repose of flowing sand;
    plane-strain: plane strain test; triaxial: triaxial compression"""
    cohesion: Annotated[float, Quantity("Pa", ge=0)] = 0.0
    """shear strength at zero pressure, as of moist sand; tensile strength up to cohesion /
    tan(angle)"""
    friction: Annotated[float, Quantity("", ge=0)] = 0.5
    """Coulomb friction coefficient at contacts without a contact coupling"""

    Law: ClassVar = Law
    cost: ClassVar = 2.5
    family: ClassVar[Family] = "sand"
    carries: ClassVar = {"B": (0.0,) * 6, "v_c": (0.0,)}
    # grains of quartz; angles and stiffness of loose and dense sand: Bowles, Foundation Analysis
    # and Design, 5th ed. 1996 (dense: pressed along an axis, with the dilatancy of dense sand);
    # cohesion of moist sand, some 1 kPa, in shear boxes: Richefeu, El Youssoufi and Radjai, Phys.
    # Rev. E 73 (2006) 051304. Quartz sand of Lube et al. 2004 and 2005, beads of Lajeunesse,
    # Monnier and Homsy, Phys. Fluids 17 (2005) 103302: their angles of repose
    presets: ClassVar[dict[str, dict]] = {
        "dry sand": {"porosity": 0.42, "youngs_modulus": 1e7, "friction_angle": math.radians(32)},
        "dense sand": {
            "porosity": 0.34,
            "youngs_modulus": 5e7,
            "friction_angle": math.radians(40),
            "friction_angle_test": "triaxial",
        },
        "wet sand": {
            "porosity": 0.42,
            "youngs_modulus": 1e7,
            "friction_angle": math.radians(33),
            "cohesion": 1000.0,
        },
        "quartz sand": {"porosity": 0.4, "youngs_modulus": 1e7, "friction_angle": math.radians(31)},
        "glass beads": {
            "density": 2500.0,
            "porosity": 0.38,
            "youngs_modulus": 1e7,
            "friction_angle": math.radians(22),
        },
    }

    @property
    def bulk_density(self) -> float:
        """Return the mass per volume at rest, pores included [kg/m3]."""
        return (1.0 - self.porosity) * self.density

    @property
    def solid_share(self) -> float:
        """Return the volume fraction of the grains at rest."""
        return 1.0 - self.porosity

    def law(self) -> NamedTuple:
        """Return the numbers of the law in SI units."""
        mu, lam = lame(self.youngs_modulus, self.poisson_ratio)
        sine = math.sin(self.friction_angle)
        # Klar has |dev tau| = 3 alpha p, p the mean pressure: alpha such that principal stresses
        # meet Mohr-Coulomb's ratio (1 + sin) / (1 - sin)
        alpha = math.sqrt(2 / 3) * 2 * sine / (3 - sine)
        if self.friction_angle_test == "plane-strain":
            alpha = math.sqrt(2) * sine / 3
        elif self.friction_angle_test == "slope":
            # sand that keeps its volume slides along planes at 45 degrees to the principal axes,
            # where shear over pressure is not the tangent but the sine of plane strain (Davis 1968)
            alpha = math.sqrt(2) * math.tan(self.friction_angle) / 3
        bulk = 3 * lam + 2 * mu  # three times the bulk modulus: mean stress per mean strain
        tip = self.cohesion / math.tan(self.friction_angle) / bulk
        return Law(mu, lam, 3 * alpha * bulk / (2 * mu), tip, self.bulk_density)

    @staticmethod
    def advance(law, state, L, dt):
        """Return the state after a step dt [s] of L = grad v [1/s].

        Args:
            law: Parameters of the law.
            state: State of the particle.
            L: Velocity gradient, nine components, row by row [1/s].
            dt: Time step [s].
        """
        b, v_c = hencky.trial_strain_measure(state[:6], L, dt), state[6]
        d, q = eigen(b)
        mean, s, size = hencky.split_volumetric_deviatoric(hencky.principal_log_strains(d))
        # opened volume closes first: the sand is open while the sum is above the apex
        shift = v_c * (1.0 / 3.0)
        over = mean + shift - law.apex_strain
        opens = over >= 0.0
        reach = -law.slope * over
        factor = select(size > reach, reach / np.maximum(size, 1e-30) - 1.0, 0.0)
        factor = select(opens, -1.0, factor)
        shift = select(opens, law.apex_strain - mean, shift)
        c = (shift + factor * s[0], shift + factor * s[1], shift + factor * s[2])
        b00, b11, b22, b01, b02, b12 = hencky.apply_plastic_corrector(b, d, q, c)
        return (b00, b11, b22, b01, b02, b12, 3.0 * np.maximum(over, 0.0))
