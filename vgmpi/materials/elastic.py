"""Elastic solid: compressible neo-Hookean, carried as H = F - I."""

from typing import ClassVar, Literal, NamedTuple

import numpy as np

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
class Elastic(Stretching):
    """Rubber-like solid: tau = mu (b - I) + lam ln J I."""

    kind: Literal["elastic"]  # type: ignore[assignment]

    Law: ClassVar = Law
    cost: ClassVar = 1.4

    @staticmethod
    def stress(law, state, L):
        b00, b11, b22, b01, b02, b12 = left_cauchy_green_minus_one(state)
        p = law.lam * np.log1p(det_minus_one(state))
        mu = law.mu
        return (mu * b00 + p, mu * b11 + p, mu * b22 + p, mu * b01, mu * b02, mu * b12)

    @staticmethod
    def wave_speed2(law, state):
        # uniaxial stretch a: rho0 c^2 = mu (a^2 + 1) + lam (1 - ln J); the largest a^2 by row sums
        # of b
        a2 = largest_stretch2(left_cauchy_green_minus_one(state))
        soft = np.maximum(1.0 - np.log1p(det_minus_one(state)), 0.0)
        return (law.mu * (1.0 + a2) + law.lam * soft) / law.density

    @staticmethod
    def energy(law, state):
        b00, b11, b22, _, _, _ = left_cauchy_green_minus_one(state)
        log_j = np.log1p(det_minus_one(state))
        return 0.5 * law.mu * (b00 + b11 + b22 - 2.0 * log_j) + 0.5 * law.lam * log_j * log_j
