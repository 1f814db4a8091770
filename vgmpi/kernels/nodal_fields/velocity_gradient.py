"""Velocity gradients at the nodes: near free rigid bodies, and along normals of resolved surfaces.

Near free bodies m dx dv/dx_a [kg m/s] and the mass [kg]: three fields, one for each axis a, tell
the velocity of a flow at the surface of a body next to a node: at a node D cells outside it the
flow moves with v there, and with v - D n . grad v at the surface. Walls do not mirror them: the
mean is over the particles' own mass.

At resolved surfaces the change of momentum per cell along the outward normal: the field m dx C n
[kg m/s] tells contact the velocity of a surface next to a node: a node D cells outside a body with
velocity v there sees its surface move with v - D dx C n. A rolling body is at rest where it
touches, and not at the neighboring nodes.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.kernels.particle_records import AFFINE, VOLUME, load_tensor
from vgmpi.kernels.simd.row_ops import broadcast, store_records
from vgmpi.kernels.simd.vector16 import load
from vgmpi.materials.tensor_math.select import select
from vgmpi.materials.tensor_math.tensor import cofactors
from vgmpi.runtime.jit import device_function

from .field_protocol import MIRROR_NONE, MIRROR_VECTOR, accumulate, particle_contribution
from .momentum import by_weights


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


@particle_contribution.register(VelocityGradient)
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


accumulate.register(VelocityGradient)(by_weights)


class Shear(NamedTuple):
    """Contribution of velocity slopes at a resolved surface."""

    mirror: float  # code of nodal_fields/field_protocol.py
    dx: float  # [m] cell size
    density: float  # [kg/m3] rest density
    gradient: float  # first channel of F - I
    surface: float  # first channel of the normal at rest


def surface_kind(plan, group) -> Shear:
    """Return the contribution of a group's particles."""
    gradient = group.channels.first("F" if group.tracks_deformation else "H")
    numbers = MIRROR_VECTOR, plan.dx, group.density, gradient, group.channels.first("surface")
    return Shear(*(plan.real.type(v) for v in numbers))


@device_function
def _normal(kind, p, cap, f):
    """Return the current outward surface normals of 16 particles."""
    q, s = p + np.int64(kind.gradient) * cap, p + np.int64(kind.surface) * cap
    h0, h1, h2, h3, h4, h5, h6, h7, h8 = load_tensor(f, q, cap)
    c = cofactors((1.0 + h0, h1, h2, h3, 1.0 + h4, h5, h6, h7, 1.0 + h8))
    x, y, z = load(f, s), load(f, s + cap), load(f, s + 2 * cap)
    a = c[0] * x + c[1] * y + c[2] * z
    b = c[3] * x + c[4] * y + c[5] * z
    e = c[6] * x + c[7] * y + c[8] * z
    size2 = a * a + b * b + e * e
    k = select(size2 > 0.0, 1.0 / np.sqrt(size2), 0.0)
    return k * a, k * b, k * e


@particle_contribution.register(Shear)
def _shear(kind, law, count, offset, cap, f, extra, peak, records, dt):
    o = broadcast(f, 0.0)
    for n in range(0, count, 16):
        p = offset + n
        x, y, z = _normal(kind, p, cap, f)
        c0, c1, c2, c3, c4, c5, c6, c7, c8 = load_tensor(f, p + AFFINE * cap, cap)
        m = kind.dx * kind.density * load(f, p + VOLUME * cap)
        a = m * (c0 * x + c1 * y + c2 * z)
        b = m * (c3 * x + c4 * y + c5 * z)
        e = m * (c6 * x + c7 * y + c8 * z)
        store_records(records, 16 * n, (a, b, e, o, o, o, o, o, o, o, o, o, o, o, o, o))


accumulate.register(Shear)(by_weights)
