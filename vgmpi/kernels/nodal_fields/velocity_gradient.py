"""Velocity gradient of particles near free rigid bodies: m dx dv/dx_a [kg m/s], and the mass [kg].

The three fields, one for each axis a, tell the velocity of a flow at the surface of a body next to
a node: at a node D cells outside it the flow moves with v there, and with v - D n . grad v at the
surface. Walls do not mirror them: the mean is over the particles' own mass.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.kernels.particle_records import AFFINE, VOLUME
from vgmpi.kernels.simd.row_ops import broadcast, store_records
from vgmpi.kernels.simd.vector16 import load
from vgmpi.kernels.stencil_sums import scatter

from .field_protocol import MIRROR_NONE, accumulate, particle_contribution


class VelocityGradient(NamedTuple):
    """Contribution of the velocity gradient along one axis."""

    mirror: float  # code of nodal_fields/field_protocol.py
    dx: float  # [m] cell size
    density: float  # [kg/m3] rest density
    axis: float  # axis of the derivative


def kind(plan, group, axis: int) -> VelocityGradient:
    """Return the contribution of a group's particles to the field of an axis."""
    numbers = MIRROR_NONE, plan.dx, group.density, axis
    return VelocityGradient(*(plan.real.type(v) for v in numbers))


@particle_contribution.of(VelocityGradient)
def _gradient(kind, law, count, offset, cap, f, extra, peak, records, dt):
    o = broadcast(f, 0.0)
    first = AFFINE + np.int64(kind.axis)
    for n in range(0, count, 16):
        p = offset + n
        mass = kind.density * load(f, p + VOLUME * cap)
        k = kind.dx * mass
        a = k * load(f, p + first * cap)
        b = k * load(f, p + (first + 3) * cap)
        c = k * load(f, p + (first + 6) * cap)
        store_records(records, 16 * n, (a, b, c, mass, o, o, o, o, o, o, o, o, o, o, o, o))


@accumulate.of(VelocityGradient)
def _add(kind, count, records, weights, base, patch):
    scatter(count, records, weights, base, patch)
