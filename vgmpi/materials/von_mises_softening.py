"""Plasticine: Hencky elasticity with a von Mises yield surface that shrinks with damage.

The state is b_e - I and the accumulated plastic strain. The radial return works in principal
logarithmic strains (Simo and Hughes, Computational Inelasticity, 1998, boxes 3.1 and 9.1). Damage
grows with plastic strain from 0 to 1 at the softening strain and stays; the yield stress falls in a
straight line from its first value to the residual one. A softening body concentrates its strain in
bands as thin as the grid allows: how it tears depends on the cell.
"""

import math
from typing import Annotated, ClassVar, Literal, NamedTuple

import numpy as np
from pydantic import model_validator

from vgmpi.materials.tensor_math.symmetric_eigen import eigen
from vgmpi.runtime.config.schema import Quantity

from .material import ElastoplasticMaterial, Family, field_error, lame, material
from .tensor_math import hencky


class Law(NamedTuple):
    """Parameters of the law."""

    mu: float  # [Pa] shear modulus
    lam: float  # [Pa] Lame's first parameter
    strain: float  # [-] norm of the strain deviator at first yield
    residual: float  # [-] norm of the strain deviator at yield under full damage
    slope: float  # [-] decrease per plastic strain until then
    density: float  # [kg/m3] density at rest


@material
class Plasticine(ElastoplasticMaterial):
    """Plasticine or clay: von Mises plasticity with softening."""

    kind: Literal["plasticine"]
    density: Annotated[float, Quantity("kg/m3", gt=0)] = 1700.0
    """at rest"""
    youngs_modulus: Annotated[float, Quantity("Pa", gt=0)]
    """stiffness in tension; the time step is proportional to the inverse of its square root"""
    poisson_ratio: Annotated[float, Quantity("", ge=0, lt=0.5)] = 0.4
    """0.5 would be incompressible"""
    yield_stress: Annotated[float, Quantity("Pa", gt=0)]
    """initial yield stress in tension"""
    residual_yield_stress: Annotated[float, Quantity("Pa", gt=0)] | None = None
    """yield stress at full damage; at most yield_stress, which is the default"""
    softening_strain: Annotated[float, Quantity("", gt=0)] = 0.5
    """plastic strain in tension at full damage"""
    friction: Annotated[float, Quantity("", ge=0)] = 0.5
    """Coulomb friction coefficient at contacts without a contact coupling"""

    Law: ClassVar = Law
    cost: ClassVar = 2.5
    family: ClassVar[Family] = "solid"
    carries: ClassVar = {"B": (0.0,) * 6, "plastic_strain": (0.0,)}
    # plasticine: density and flow stress at slow strain Zulauf and Zulauf, J. Struct. Geol. 26
    # (2004) 725, modulus some hundred times the flow stress; potter's clay, undrained, stiff enough
    # to hold its shape, and its sensitivity of 2 to 4: Terzaghi, Peck and Mesri, Soil Mechanics in
    # Engineering Practice, 3rd ed. 1996, articles 7 and 20
    presets: ClassVar[dict[str, dict]] = {
        "plasticine": {
            "density": 1700.0,
            "youngs_modulus": 5e6,
            "poisson_ratio": 0.4,
            "yield_stress": 6e4,
            "residual_yield_stress": 4e4,
            "softening_strain": 0.5,
        },
        "clay": {
            "density": 1900.0,
            "youngs_modulus": 4e6,
            "poisson_ratio": 0.45,
            "yield_stress": 4e4,
            "residual_yield_stress": 1.5e4,
            "softening_strain": 0.3,
        },
    }

    @model_validator(mode="after")
    def _falls_gently(self):
        """Check that the yield stress falls no faster than the elastic unloading."""
        residual = (
            self.yield_stress if self.residual_yield_stress is None else self.residual_yield_stress
        )
        if residual > self.yield_stress:
            raise field_error(self, "residual_yield_stress", "must be at most yield_stress")
        three_mu = 3 * self.youngs_modulus / (2 * (1 + self.poisson_ratio))
        min_strain = (self.yield_stress - residual) / three_mu
        if self.softening_strain <= 2 * min_strain:
            message = (
                "the stress would fall faster than it can be unloaded: must be more than"
                f" {2 * min_strain:.3g}, twice (yield_stress - residual_yield_stress) / 3 shear"
                " moduli"
            )
            raise field_error(self, "softening_strain", message)
        # the table shows the value in use
        object.__setattr__(self, "residual_yield_stress", residual)
        return self

    def law(self) -> NamedTuple:
        """Return the numbers of the law in SI units."""
        mu, lam = lame(self.youngs_modulus, self.poisson_ratio)
        # a uniaxial stress Y has a deviator of norm sqrt(2/3) Y = 2 mu |s|
        factor = math.sqrt(2 / 3) / (2 * mu)
        assert self.residual_yield_stress is not None
        first, last = factor * self.yield_stress, factor * self.residual_yield_stress
        return Law(mu, lam, first, last, (first - last) / self.softening_strain, self.density)

    @staticmethod
    def advance(law, state, L, dt):
        """Return the state after a step dt [s] of L = grad v [1/s].

        Args:
            law: Parameters of the law.
            state: State of the particle.
            L: Velocity gradient, nine components, row by row [1/s].
            dt: Time step [s].
        """
        b, plastic_strain = hencky.trial_strain_measure(state[:6], L, dt), state[6]
        d, q = eigen(b)
        _, s, size = hencky.split_volumetric_deviatoric(hencky.principal_log_strains(d))
        root = 0.816496580927726  # sqrt(2/3): plastic strain in tension per norm of its deviator
        # the strength is the larger of the falling line and the residual one, so the flow is the
        # smaller of those that each of them requires
        falling = (size - (law.strain - law.slope * plastic_strain)) / (1.0 - root * law.slope)
        over = np.maximum(np.minimum(falling, size - law.residual), 0.0)
        r = -over / np.maximum(size, 1e-30)
        c = hencky.apply_plastic_corrector(b, d, q, (r * s[0], r * s[1], r * s[2]))
        b00, b11, b22, b01, b02, b12 = c
        return (b00, b11, b22, b01, b02, b12, plastic_strain + root * over)
