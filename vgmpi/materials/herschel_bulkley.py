"""Yield-stress fluid: Tait pressure, elastic shear and Herschel-Bulkley flow.

The state is theta = ln J and B = b_e - I, where b_e is the elastic left Cauchy-Green tensor without
its volume (det b_e = 1). The deviator of stress is mu dev(b_e) (Simo and Hughes, Computational
Inelasticity, 1998, box 9.1). An additive strain would need a rate that follows rotation and has no
energy; b_e moves as (I + dt L) b_e (I + dt L)^T, which is objective by itself, and needs no
eigenvalues. The flow (materials/tensor_math/viscoplastic_flow.py) is implicit, so that viscosity
does not bound the time step.
"""

import math
from typing import Annotated, ClassVar, Literal, NamedTuple

import numpy as np

from vgmpi.materials.tensor_math.tensor import (
    det_minus_one,
    log_volume_change,
    symmetric_to_full,
)
from vgmpi.runtime.config.schema import Quantity

from .liquid_stiffness import Liquid
from .material import material
from .tensor_math import hencky, tait, viscoplastic_flow


class Law(NamedTuple):
    """Parameters of the law."""

    k: float  # [Pa] stiffness; the bulk modulus is k gamma
    gamma: float  # [-] stiffening exponent
    max_theta: float  # [-] largest theta
    mu: float  # [Pa] shear modulus
    yield_stress: float  # [Pa] yield stress in shear
    log_consistency: float  # [-] ln(K / 1 Pa s^n)
    flow_index: float  # [-] flow index n
    density: float  # [kg/m3] density at rest


@material
class Paste(Liquid):
    """Yield-stress fluid, such as mud, jam or ketchup (Herschel-Bulkley): in simple shear, tau =
    yield_stress + consistency_index (shear rate)^flow_index. Viscosity does not limit the time
    step.
    """

    kind: Literal["paste"]
    yield_stress: Annotated[float, Quantity("Pa", ge=0)]
    """shear stress below which the material does not flow"""
    consistency_index: Annotated[float, Quantity("", gt=0)]
    """consistency index K [Pa s^n]: shear stress beyond the yield stress at a shear rate of 1 /s"""
    flow_index: Annotated[float, Quantity("", ge=0.2, le=2)] = 1.0
    """flow index n; 1: Bingham, below 1: shear-thinning"""
    shear_modulus: Annotated[float, Quantity("Pa", gt=0)]
    """elastic shear modulus below the yield stress; the model is exact while stresses are well
    below it. The time step is proportional to the inverse of its square root"""

    Law: ClassVar = Law
    cost: ClassVar = 2.0
    carries: ClassVar = {"theta": (0.0,), "B": (0.0,) * 6}
    # foods and toothpaste: Steffe, Rheological Methods in Food Process Engineering, 2nd ed. 1996,
    # appendix 6 (yields of jam and mayonnaise vary threefold between products); mud: Coussot,
    # Mudflow Rheology and Dynamics, 1997 (n = 1/3, K about a third of the yield stress). Moduli:
    # the yield is reached at shears of 5 to 20 %
    presets: ClassVar[dict[str, dict]] = {
        "mud": {
            "density": 1600.0,
            "yield_stress": 100.0,
            "consistency_index": 35.0,
            "flow_index": 1 / 3,
            "shear_modulus": 2000.0,
        },
        "jam": {
            "density": 1320.0,
            "yield_stress": 30.0,
            "consistency_index": 20.0,
            "flow_index": 0.4,
            "shear_modulus": 500.0,
        },
        "ketchup": {
            "density": 1140.0,
            "yield_stress": 32.0,
            "consistency_index": 18.7,
            "flow_index": 0.27,
            "shear_modulus": 400.0,
        },
        "toothpaste": {
            "density": 1300.0,
            "yield_stress": 200.0,
            "consistency_index": 120.0,
            "flow_index": 0.28,
            "shear_modulus": 2500.0,
        },
        "mayonnaise": {
            "density": 910.0,
            "yield_stress": 80.0,
            "consistency_index": 6.4,
            "flow_index": 0.55,
            "shear_modulus": 700.0,
        },
    }

    def law(self) -> NamedTuple:
        """Return the numbers of the law in SI units."""
        return Law(
            self.tait_coefficient,
            self.exponent,
            self.max_theta,
            self.shear_modulus,
            self.yield_stress,
            math.log(self.consistency_index),
            self.flow_index,
            self.density,
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
        theta = np.minimum(state[0] + log_volume_change(L, dt), law.max_theta)
        b = _without_volume(hencky.trial_strain_measure(state[1:], L, dt))
        d00, d11, d22, mean, shear = _deviator(b)
        # shear: sqrt(s : s / 2) / mu of s = mu dev(b_e)
        excess = np.maximum(law.mu * shear - law.yield_stress, 0.0)
        # b_e relaxes in proportion to its mean (Simo and Hughes, equation 9.2.13)
        stiffness = law.mu * dt * (1.0 + mean)
        flow_fraction = viscoplastic_flow.herschel_bulkley(
            np.maximum(excess, 1e-20), stiffness, law.log_consistency, law.flow_index
        )
        r = -flow_fraction * excess / np.maximum(law.mu * shear, 1e-20)
        b00, b11, b22, b01, b02, b12 = b
        b00, b11, b22 = b00 + r * d00, b11 + r * d11, b22 + r * d22
        b01, b02, b12 = b01 + r * b01, b02 + r * b02, b12 + r * b12
        m = _to_unit_volume((b00, b11, b22, b01, b02, b12))
        return (theta, b00 + m, b11 + m, b22 + m, b01, b02, b12)

    @staticmethod
    def stress(law, state, L):
        """Return the Kirchhoff stress (00, 11, 22, 01, 02, 12) [Pa]."""
        t = tait.stress(law.k, law.gamma, state[0])
        mu = law.mu
        d00, d11, d22, _, _ = _deviator(state[1:])
        return (
            t + mu * d00,
            t + mu * d11,
            t + mu * d22,
            mu * state[4],
            mu * state[5],
            mu * state[6],
        )

    @staticmethod
    def volume_ratio(law, state):
        """Return the volume ratio J."""
        return np.exp(state[0])

    @staticmethod
    def wave_speed2(law, state):
        """Return a bound on the squared wave speed [m2/s2]."""
        # second derivative of mu/2 tr(b_e) along F -> (I + e m n^T) F, c = m.n, with T = tr b_e:
        # mu (n.b n - 4/3 c n.b m + 5/9 c^2 T); n.b m - c n.b n is at most half the eigenvalues'
        # spread times sqrt(1 - c^2), and the eigenvalues lie within w of T / 3
        _, _, _, mean, shear = _deviator(state[1:])
        w = 1.1547005383792517 * shear
        along = (4.0 / 3.0) * (1.0 + mean) + (1.0 / 3.0) * w
        bound = np.maximum(along, 1.0 + mean + w) + (2.0 / 3.0) * w
        bulk = law.k * law.gamma * tait.relative_bulk_modulus(law.gamma, state[0])
        return (bulk + law.mu * bound) / law.density

    @staticmethod
    def energy(law, state):
        """Return the elastic energy per rest volume [J/m3]."""
        shear = 0.5 * law.mu * (state[1] + state[2] + state[3])
        return tait.energy(law.k, law.gamma, state[0]) + shear


def _deviator(b):
    """Return the diagonal of dev(B), the mean of B's diagonal, and sqrt(dev : dev / 2)."""
    b00, b11, b22, b01, b02, b12 = b
    mean = (b00 + b11 + b22) * (1.0 / 3.0)
    d00, d11, d22 = b00 - mean, b11 - mean, b22 - mean
    half = 0.5 * (d00 * d00 + d11 * d11 + d22 * d22)
    return d00, d11, d22, mean, np.sqrt(half + (b01 * b01 + b02 * b02 + b12 * b12))


def _without_volume(b):
    """Return B of b_e scaled to det b_e = 1, exact to rounding for small B."""
    g = np.expm1((-1.0 / 3.0) * np.log1p(det_minus_one(symmetric_to_full(b))))
    b00, b11, b22, b01, b02, b12 = b
    return (
        b00 + (g + g * b00),
        b11 + (g + g * b11),
        b22 + (g + g * b22),
        b01 + g * b01,
        b02 + g * b02,
        b12 + g * b12,
    )


def _to_unit_volume(b):
    """Return the number that, added to the diagonal, restores det b_e = 1 to second order.

    A smaller deviator has a smaller mean, and stress depends on the deviator alone.
    """
    b00, b11, b22, b01, b02, b12 = b
    pairs = b00 * b11 + b00 * b22 + b11 * b22 - (b01 * b01 + b02 * b02 + b12 * b12)
    return -det_minus_one(symmetric_to_full(b)) / (3.0 + 2.0 * (b00 + b11 + b22) + pairs)
