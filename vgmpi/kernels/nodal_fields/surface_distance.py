"""Nodal volumes and offsets, from which contact and couplings get surfaces and volume gradients.

The field holds volumes V [m3] and offsets V (x_p - x_i) [m4] (contact.py,
features/mixtures/kernels.py). For a solid
with a resolved surface it holds mass times the normal at the node m (n + K (x_i - x_p)) [kg], and
mass times the node's distance m (d + n . (x_i - x_p)) [kg m] instead. Both are those of the current
surface: n along F^-T n0, K along F^-T K0 F^-1, the distance shorter by the length of F^-T n0. K
corrects the error of particles to one side of a node on a round body. In the first of the two sums
each particle is weighted by the reliability of its normal, the length of n0: small at edges.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.kernels.particle_records import STATE, VOLUME, load_tensor
from vgmpi.kernels.reproducible_sums import next_power_of_two
from vgmpi.kernels.simd.material_dispatch import load_state_vector, volume_ratio
from vgmpi.kernels.simd.row_ops import diagonal, fourth, store_records
from vgmpi.kernels.simd.vector16 import load, store
from vgmpi.materials.tensor_math.select import select
from vgmpi.materials.tensor_math.tensor import cofactors, product, product_transposed
from vgmpi.runtime.jit import device_function

from .field_protocol import MIRROR_MOMENT, accumulate, particle_contribution
from .momentum import by_weights


class Offsets(NamedTuple):
    """Contribution of rest volumes."""

    mirror: float  # code of nodal_fields/field_protocol.py
    share: float  # [-] volume fraction of the material itself at rest
    dx: float  # [m] cell size


class CurrentVolumeMoments(NamedTuple):
    """Contribution of current volumes, for couplings, where the stress is kept separate."""

    mirror: float  # code of nodal_fields/field_protocol.py
    share: float  # [-] volume fraction of the material itself at rest
    dx: float  # [m] cell size


class SurfaceDistance(NamedTuple):
    """Contribution of the resolved surface of a body."""

    mirror: float  # code of nodal_fields/field_protocol.py
    dx: float  # [m] cell size
    density: float  # [kg/m3] rest density
    gradient: float  # first channel of F - I
    surface: float  # first channel of the normal and the distance at rest


MAX_DEPTH_CELLS = 4.0  # [cells] depth below a surface at which the distance is cut off


def kind(plan, group) -> Offsets | CurrentVolumeMoments | SurfaceDistance:
    """Return the contribution of a group's particles."""
    real = plan.real.type
    if group.surface:
        gradient = group.channels.first("F" if group.tracks_deformation else "H")
        numbers = plan.dx, group.density, gradient, group.channels.first("surface")
        return SurfaceDistance(real(MIRROR_MOMENT), *(real(v) for v in numbers))
    contribution = CurrentVolumeMoments if group.separates_stress else Offsets
    return contribution(*(real(v) for v in (MIRROR_MOMENT, group.share, plan.dx)))


def accumulator_range(plan) -> np.ndarray:
    """Return the scales of the sums, powers of two, shape (phases, 4).

    They are the volume of a cell times its width, and its volume; for a resolved surface the mass
    of a cell, and that times the largest depth.
    """
    moment, volume = next_power_of_two(plan.dx**4), next_power_of_two(plan.dx**3)
    out = np.tile([moment, moment, moment, volume], (len(plan.phases), 1))
    for row, phase in zip(out, plan.phases, strict=True):
        if phase.surface:
            mass, depth_moment = next_power_of_two(
                [phase.max_cell_mass, phase.max_cell_mass * MAX_DEPTH_CELLS * plan.dx]
            )
            row[:] = mass, mass, mass, depth_moment
    return out


@device_function
def current_volumes(law, count, offset, cap, f, volumes):
    """Compute the current volumes [m3] of some particles.

    Args:
        law: Material parameters of the group.
        count: Number of particles.
        offset: Index of the first particle.
        cap: Stride of channels.
        f: Particle channels, flat.
        volumes: Volumes (out), shape (BATCH,) [m3].
    """
    for n in range(0, count, 16):
        p = offset + n
        J = volume_ratio(law, load_state_vector(law, f, p + STATE * cap, cap))
        store(volumes, n, J * load(f, p + VOLUME * cap))


@device_function
def _offsets(kind, count, volumes, first, records):
    """Store records that are one pattern times a volume, volumes[first...]."""
    pattern = kind.share * (fourth(records) - kind.dx * diagonal(records))
    for n in range(count):
        store(records, 16 * n, volumes[first + n] * pattern)


@particle_contribution.register(Offsets)
def _rest(kind, law, count, offset, cap, f, extra, peak, records, dt):
    _offsets(kind, count, f, offset + VOLUME * cap, records)


@particle_contribution.register(CurrentVolumeMoments)
def _present(kind, law, count, offset, cap, f, extra, peak, records, dt):
    current_volumes(law, count, offset, cap, f, extra)
    _offsets(kind, count, extra, 0, records)


@particle_contribution.register(SurfaceDistance)
def _surface(kind, law, count, offset, cap, f, extra, peak, records, dt):
    max_depth = MAX_DEPTH_CELLS * kind.dx
    for n in range(0, count, 16):
        p = offset + n
        q, s = p + np.int64(kind.gradient) * cap, p + np.int64(kind.surface) * cap
        h0, h1, h2, h3, h4, h5, h6, h7, h8 = load_tensor(f, q, cap)
        F = (1.0 + h0, h1, h2, h3, 1.0 + h4, h5, h6, h7, 1.0 + h8)
        x, y, z, d = load(f, s), load(f, s + cap), load(f, s + 2 * cap), load(f, s + 3 * cap)
        xx, xy, xz = load(f, s + 4 * cap), load(f, s + 5 * cap), load(f, s + 6 * cap)
        yy, yz, zz = load(f, s + 7 * cap), load(f, s + 8 * cap), load(f, s + 9 * cap)
        c = cofactors(F)  # J F^-T
        J = F[0] * c[0] + F[1] * c[1] + F[2] * c[2]
        a = c[0] * x + c[1] * y + c[2] * z
        b = c[3] * x + c[4] * y + c[5] * z
        e = c[6] * x + c[7] * y + c[8] * z
        size2 = a * a + b * b + e * e
        reliability = np.sqrt(x * x + y * y + z * z)
        k = select(size2 > 0.0, 1.0 / np.sqrt(size2), 0.0)
        shrinks = J * reliability * k  # 1 / |F^-T n0|
        mass = kind.density * load(f, p + VOLUME * cap)
        d = mass * np.minimum(np.maximum(shrinks * d, -max_depth), max_depth)
        K = product_transposed(product(c, (xx, xy, xz, xy, yy, yz, xz, yz, zz)), c)
        curve = mass * kind.dx * reliability * shrinks / (J * J)
        k = k * mass
        a, b, e = k * a, k * b, k * e
        steep = kind.dx * a, kind.dx * b, kind.dx * e
        a, b, e = reliability * a, reliability * b, reliability * e
        store_records(
            records,
            16 * n,
            (
                a, b, e, d,
                curve * K[0], curve * K[1], curve * K[2], steep[0],
                curve * K[1], curve * K[4], curve * K[5], steep[1],
                curve * K[2], curve * K[5], curve * K[8], steep[2],
            ),
        )  # fmt: skip


for _kind in (Offsets, CurrentVolumeMoments, SurfaceDistance):
    accumulate.register(_kind)(by_weights)
