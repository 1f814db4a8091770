"""Elastic solid: fixed corotated model (Stomakhin et al., Energetically Consistent Invertible
Elasticity, 2012), carried as H = F - I.

psi = mu sum (s_i - 1)^2 + lam/2 (J - 1)^2 of the principal stretches s_i. They come from the
eigenvalues of b = F F^T, so that no rotation is needed: with 1 + d_i those eigenvalues, s_i - 1 =
d_i / (1 + s_i) keeps small strains.
"""

from typing import ClassVar, Literal, NamedTuple

import numpy as np

from ..device.eigen import eigen, reassemble
from ..device.tensor import (
    det_minus_one,
    largest_stretch2,
    left_cauchy_green_minus_one,
)
from .base import material
from .stretching import Stretching


class Law(NamedTuple):
    mu: float  # shear modulus [Pa]
    lam: float  # Lame's first parameter [Pa]
    density: float  # at rest [kg/m3]


@material
class Corotated(Stretching):
    """Elastic solid whose stress stays in proportion to its stretch (fixed corotated): softer than
    kind "elastic" where it is pressed, and costs more.
    """

    kind: Literal["corotated"]  # type: ignore[assignment]

    Law: ClassVar = Law
    cost: ClassVar = 2.0

    @staticmethod
    def stress(law, state, L):
        d, q = eigen(left_cauchy_green_minus_one(state))
        s0, s1, s2 = np.sqrt(1.0 + d[0]), np.sqrt(1.0 + d[1]), np.sqrt(1.0 + d[2])
        grown = det_minus_one(state)
        p = law.lam * grown * (1.0 + grown)
        two = 2.0 * law.mu
        return reassemble(
            q,
            (
                two * s0 * (d[0] / (1.0 + s0)) + p,
                two * s1 * (d[1] / (1.0 + s1)) + p,
                two * s2 * (d[2] / (1.0 + s2)) + p,
            ),
        )

    @staticmethod
    def wave_speed2(law, state):
        # along F -> (I + e m n^T) F the second derivative of J is 0 and that of the stretches' sum
        # of squares 2 n.b n; turning with the rotation only takes from it
        J = 1.0 + det_minus_one(state)
        a2 = largest_stretch2(left_cauchy_green_minus_one(state))
        return (2.0 * law.mu * a2 + law.lam * (J * J)) / law.density

    @staticmethod
    def energy(law, state):
        d, _ = eigen(left_cauchy_green_minus_one(state))
        s0 = d[0] / (1.0 + np.sqrt(1.0 + d[0]))
        s1 = d[1] / (1.0 + np.sqrt(1.0 + d[1]))
        s2 = d[2] / (1.0 + np.sqrt(1.0 + d[2]))
        grown = det_minus_one(state)
        return law.mu * (s0 * s0 + s1 * s1 + s2 * s2) + 0.5 * law.lam * (grown * grown)
