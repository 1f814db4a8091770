"""Elastic solid: fixed corotated model, carried as H = F - I.

psi = mu sum (s_i - 1)^2 + lam/2 (J - 1)^2 of the principal stretches s_i (Stomakhin et al.,
Energetically Consistent Invertible Elasticity, 2012). The stretches follow from the eigenvalues of
b = F F^T, so that no rotation is needed: with 1 + d_i those eigenvalues, s_i - 1 = d_i / (1 + s_i)
keeps small strains.
"""

from typing import ClassVar, Literal, NamedTuple

import numpy as np

from vgmpi.materials.tensor_math.symmetric_eigen import eigen, from_principal
from vgmpi.materials.tensor_math.tensor import (
    det_minus_one,
    left_cauchy_green_minus_one,
    max_principal_stretch_squared_bound,
)

from .material import HyperelasticMaterial, material


class Law(NamedTuple):
    """Parameters of the law."""

    mu: float  # [Pa] shear modulus
    lam: float  # [Pa] Lame's first parameter
    density: float  # [kg/m3] density at rest


@material
class Corotated(HyperelasticMaterial):
    """Fixed corotated elastic solid, with stress proportional to stretch: softer in compression
    than kind "elastic", and slower.
    """

    kind: Literal["corotated"]  # type: ignore[assignment]

    Law: ClassVar = Law
    cost: ClassVar = 2.0

    @staticmethod
    def stress(law, state, L):
        """Return the Kirchhoff stress (00, 11, 22, 01, 02, 12) [Pa]."""
        d, q = eigen(left_cauchy_green_minus_one(state))
        s0, s1, s2 = np.sqrt(1.0 + d[0]), np.sqrt(1.0 + d[1]), np.sqrt(1.0 + d[2])
        volume_strain = det_minus_one(state)
        p = law.lam * volume_strain * (1.0 + volume_strain)
        two = 2.0 * law.mu
        return from_principal(
            q,
            (
                two * s0 * (d[0] / (1.0 + s0)) + p,
                two * s1 * (d[1] / (1.0 + s1)) + p,
                two * s2 * (d[2] / (1.0 + s2)) + p,
            ),
        )

    @staticmethod
    def wave_speed2(law, state):
        """Return a bound on the squared wave speed [m2/s2]."""
        # along F -> (I + e m n^T) F the second derivative of J is 0 and that of the stretches' sum
        # of squares 2 n.b n; the rotation only reduces it
        J = 1.0 + det_minus_one(state)
        a2 = max_principal_stretch_squared_bound(left_cauchy_green_minus_one(state))
        return (2.0 * law.mu * a2 + law.lam * (J * J)) / law.density

    @staticmethod
    def energy(law, state):
        """Return the elastic energy per rest volume [J/m3]."""
        d, _ = eigen(left_cauchy_green_minus_one(state))
        s0 = d[0] / (1.0 + np.sqrt(1.0 + d[0]))
        s1 = d[1] / (1.0 + np.sqrt(1.0 + d[1]))
        s2 = d[2] / (1.0 + np.sqrt(1.0 + d[2]))
        volume_strain = det_minus_one(state)
        return law.mu * (s0 * s0 + s1 * s1 + s2 * s2) + 0.5 * law.lam * (
            volume_strain * volume_strain
        )
