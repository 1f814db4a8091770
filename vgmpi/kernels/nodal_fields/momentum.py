"""Momentum [kg m/s] and mass [kg], with the stress impulse of a step unless that is kept separate.

The transfer is quadratic B-splines with APIC (Jiang et al. 2015) and the MLS force (Hu et al.
2018).
"""

from typing import NamedTuple

import numpy as np

from vgmpi.kernels.particle_records import AFFINE, STATE, VOLUME, load_tensor
from vgmpi.kernels.reproducible_sums import next_power_of_two
from vgmpi.kernels.simd.material_dispatch import load_state_vector, stress
from vgmpi.kernels.simd.row_ops import broadcast, max_ignore_nan, store_records
from vgmpi.kernels.simd.static_dispatch import static_dispatch
from vgmpi.kernels.simd.vector16 import first_n, load, store
from vgmpi.kernels.stencil_sums import scatter, scatter_slopes

from .field_protocol import MIRROR_IMPULSE, accumulate, particle_contribution


class Momentum(NamedTuple):
    """Contribution of momentum, mass and the stress impulse."""

    mirror: float  # code of nodal_fields/field_protocol.py
    splines: float  # 1: forces by the gradients of the B-splines, 0: by moments
    density: float  # [kg/m3] rest density
    affine: float  # 1: particles carry the velocity gradient (APIC), 0: they do not
    dx: float  # [m] cell size


class MomentumWithoutPressure(NamedTuple):
    """Contribution of momentum, mass and the impulse of deviatoric stress.

    Pressure acts by cells (liquid_volume.py) or by a feature.
    """

    mirror: float  # code of nodal_fields/field_protocol.py
    splines: float  # 1: forces by the gradients of the B-splines, 0: by moments
    density: float  # [kg/m3] rest density
    affine: float  # 1: particles carry the velocity gradient (APIC), 0: they do not
    dx: float  # [m] cell size


class MomentumWithoutStress(NamedTuple):
    """Contribution of momentum and mass; stress impulses are a field of their own."""

    mirror: float  # code of nodal_fields/field_protocol.py
    splines: float  # 1: forces by the gradients of the B-splines, 0: by moments
    density: float  # [kg/m3] rest density
    affine: float  # 1: particles carry the velocity gradient (APIC), 0: they do not
    dx: float  # [m] cell size


def contribution_kinds(
    plan, group
) -> tuple[Momentum | MomentumWithoutPressure, MomentumWithoutStress]:
    """Return the contributions of a group's particles with and without their stress."""
    real = plan.real.type
    numbers = [real(v) for v in (MIRROR_IMPULSE, plan.splines, group.density, plan.affine, plan.dx)]
    has_own_pressure = group.volume.by_cells or group.volume.separate_pressure
    kind = MomentumWithoutPressure if has_own_pressure else Momentum
    return kind(*numbers), MomentumWithoutStress(*numbers)


@static_dispatch
def stress_by_moments(kind, t00, t11, t22):
    """Return the normal stresses whose impulse goes with momentum.

    Args:
        kind: Contribution kind.
        t00, t11, t22: Normal stresses of 16 particles [Pa].
    """


@stress_by_moments.register(Momentum)
def _(kind, t00, t11, t22):
    return t00, t11, t22


@stress_by_moments.register(MomentumWithoutPressure)
def _(kind, t00, t11, t22):
    mean = (t00 + t11 + t22) * (1.0 / 3.0)
    return t00 - mean, t11 - mean, t22 - mean


def accumulator_range(plan, speed: float) -> np.ndarray:
    """Return the scales of the sums, powers of two, shape (phases, 4).

    They are the momentum of a full cell of a phase's densest material at a speed [m/s], a power of
    two, and its mass.
    """
    mass = next_power_of_two([phase.max_cell_mass for phase in plan.phases])
    fast = mass * speed
    return np.stack([fast, fast, fast, mass], 1)


@particle_contribution.register(Momentum)
@particle_contribution.register(MomentumWithoutPressure)
def _momentum(kind, law, count, offset, cap, f, extra, peak, records, dt):
    zero = broadcast(f, 0.0)
    dx = kind.dx
    four = broadcast(f, dt) * 4.0 / (dx * dx)  # as a vector: a plain number would be a double
    stress_peak, over = load(peak, 0), 1.0 / (kind.density * kind.density)
    for n in range(0, count, 16):
        p = offset + n
        L = load_tensor(f, p + AFFINE * cap, cap)
        c0, c1, c2, c3, c4, c5, c6, c7, c8 = L
        t00, t11, t22, t01, t02, t12 = stress(
            law, load_state_vector(law, f, p + STATE * cap, cap), L
        )
        size = t00 * t00 + t11 * t11 + t22 * t22 + t01 * t01 + t02 * t02 + t12 * t12
        stress_peak = max_ignore_nan(first_n(over * size, count - n), stress_peak)
        t00, t11, t22 = stress_by_moments(kind, t00, t11, t22)
        volume = load(f, p + VOLUME * cap)
        mass = kind.density * volume
        k, m = dx * four * volume, kind.affine * dx * mass
        store_records(
            records,
            16 * n,
            (
                mass * load(f, p), mass * load(f, p + cap), mass * load(f, p + 2 * cap), mass,
                m * c0 - k * t00, m * c3 - k * t01, m * c6 - k * t02, zero,
                m * c1 - k * t01, m * c4 - k * t11, m * c7 - k * t12, zero,
                m * c2 - k * t02, m * c5 - k * t12, m * c8 - k * t22, zero,
            ),
        )  # fmt: skip
    store(peak, 0, stress_peak)


@particle_contribution.register(MomentumWithoutStress)
def _inertia(kind, law, count, offset, cap, f, extra, peak, records, dt):
    zero = broadcast(f, 0.0)
    for n in range(0, count, 16):
        p = offset + n
        mass = kind.density * load(f, p + VOLUME * cap)
        m = kind.affine * kind.dx * mass
        c0, c1, c2, c3, c4, c5, c6, c7, c8 = load_tensor(f, p + AFFINE * cap, cap)
        v0, v1, v2 = load(f, p), load(f, p + cap), load(f, p + 2 * cap)
        store_records(
            records,
            16 * n,
            (
                mass * v0, mass * v1, mass * v2, mass,
                m * c0, m * c3, m * c6, zero, m * c1, m * c4, m * c7, zero,
                m * c2, m * c5, m * c8, zero,
            ),
        )  # fmt: skip


@accumulate.register(Momentum)
@accumulate.register(MomentumWithoutPressure)
@accumulate.register(MomentumWithoutStress)
def by_slopes(kind, count, records, weights, base, patch):
    """Add records to a patch, by weights or along the gradients of the B-splines.

    Args:
        kind: Contribution kind.
        count: Number of records.
        records, weights, base: See stencil_sums.scatter.
        patch: Patch (in/out), shape (2048,).
    """
    if kind.splines > 0.0:
        scatter_slopes(count, records, weights, base, patch)
    else:
        scatter(count, records, weights, base, patch)


def by_weights(kind, count, records, weights, base, patch):
    """Add records to a patch by weights, for fields of any kind.

    Args:
        kind: Contribution kind.
        count: Number of records.
        records, weights, base: See stencil_sums.scatter.
        patch: Patch (in/out), shape (2048,).
    """
    scatter(count, records, weights, base, patch)
