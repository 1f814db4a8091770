"""A law like that of sand, for tests: Hencky's elasticity with the return mapping of Drucker and
Prager and a volume correction (Klar 2016, Tampubolon 2017), carried as b_e - I and v_c.

It shows that a law with a yield surface is written like the others.
"""

from typing import Annotated, ClassVar, Literal, NamedTuple

import numpy as np

from vgmpi.device.eigen import eigen, reassemble
from vgmpi.device.select import select
from vgmpi.device.tensor import det_minus_one, full, moved_left_cauchy_green_minus_one
from vgmpi.materials.base import Family
from vgmpi.tables import Quantity, Table


class GrainsLaw(NamedTuple):
    mu: float  # shear modulus [Pa]
    lam: float  # Lame's first parameter [Pa]
    slope: float  # of the cone
    density: float  # at rest [kg/m3]


class Grains(Table):
    """Dry grains."""

    kind: Literal["grains"] = "grains"
    density: Annotated[float, Quantity("kg/m3", gt=0)] = 1500.0
    shear_modulus: Annotated[float, Quantity("Pa", gt=0)] = 4e5
    lame: Annotated[float, Quantity("Pa", gt=0)] = 6e5
    friction: Annotated[float, Quantity("", ge=0)] = 0.5

    Law: ClassVar = GrainsLaw
    cost: ClassVar = 2.0
    family: ClassVar[Family] = "solid"
    carries: ClassVar = {"B": (0.0,) * 6, "v_c": (0.0,)}
    kinematic_viscosity: ClassVar = 0.0

    def law(self) -> GrainsLaw:
        sine = np.sin(np.arctan(self.friction))
        slope = float(np.sqrt(2 / 3) * 2 * sine / (3 - sine))
        return GrainsLaw(self.shear_modulus, self.lame, slope, self.density)

    @staticmethod
    def advance(law, state, L, dt):
        b = moved_left_cauchy_green_minus_one(state[:6], tuple_of_step(L, dt))
        d, q = eigen(b)
        e = hencky(d)
        opened = state[6] + e[0] + e[1] + e[2]
        m0, m1, m2 = mapped(law, e, state[6])
        # the change of b_e alone is put back, so that what does not yield keeps all its digits
        change = (
            (1.0 + d[0]) * np.expm1(2.0 * (m0 - e[0])),
            (1.0 + d[1]) * np.expm1(2.0 * (m1 - e[1])),
            (1.0 + d[2]) * np.expm1(2.0 * (m2 - e[2])),
        )
        c = reassemble(q, change)
        return (
            b[0] + c[0],
            b[1] + c[1],
            b[2] + c[2],
            b[3] + c[3],
            b[4] + c[4],
            b[5] + c[5],
            opened - (m0 + m1 + m2),
        )

    @staticmethod
    def stress(law, state, L):
        d, q = eigen(state[:6])
        e0, e1, e2 = hencky(d)
        p = law.lam * (e0 + e1 + e2)
        two = 2.0 * law.mu
        return reassemble(q, (two * e0 + p, two * e1 + p, two * e2 + p))

    @staticmethod
    def volume_ratio(law, state):
        return np.sqrt(1.0 + det_minus_one(full(state[:6]))) * np.exp(state[6])

    @staticmethod
    def wave_speed2(law, state):
        return (law.lam + 2.0 * law.mu) / law.density * np.exp(-2.0 * np.minimum(state[6], 0.0))

    @staticmethod
    def energy(law, state):
        d, _ = eigen(state[:6])
        e0, e1, e2 = hencky(d)
        total = e0 + e1 + e2
        return law.mu * (e0 * e0 + e1 * e1 + e2 * e2) + 0.5 * law.lam * total**2


def tuple_of_step(L, dt):
    c0, c1, c2, c3, c4, c5, c6, c7, c8 = L
    return (dt * c0, dt * c1, dt * c2, dt * c3, dt * c4, dt * c5, dt * c6, dt * c7, dt * c8)


def hencky(d):
    """Logarithmic strains of b's eigenvalues 1 + d."""
    return 0.5 * np.log1p(d[0]), 0.5 * np.log1p(d[1]), 0.5 * np.log1p(d[2])


def mapped(law, e, correction):
    """Elastic strains on or inside the cone."""
    third = (e[0] + e[1] + e[2] + correction) * (1.0 / 3.0)
    mean = (e[0] + e[1] + e[2]) * (1.0 / 3.0)
    s0, s1, s2 = e[0] - mean, e[1] - mean, e[2] - mean
    size = np.sqrt(s0 * s0 + s1 * s1 + s2 * s2)
    # how far a deviator may reach under this pressure; in tension nothing is left
    reach = -third * law.slope * (9.0 * law.lam + 6.0 * law.mu) / (2.0 * law.mu)
    open_ = third >= 0.0
    keep = select(size > reach, reach / np.maximum(size, 1e-30), 1.0)
    keep, third = select(open_, 0.0, keep), select(open_, 0.0, third)
    return third + keep * s0, third + keep * s1, third + keep * s2
