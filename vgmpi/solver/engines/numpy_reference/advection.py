"""Advection of particles and what bounds the next step, in plain NumPy; see kernels/transfer."""

import numpy as np

from vgmpi.kernels.kernel_arguments import (
    J_MAX,
    J_MIN,
    MAX_VOLUME_STRAIN_PER_STEP,
)
from vgmpi.kernels.step_records import StepReport, dither_of_step
from vgmpi.kernels.transfer import g2p
from vgmpi.materials.material import law_function
from vgmpi.parallel.block_lattice import BLOCK_EDGE
from vgmpi.parallel.particle_group import ParticleGroup
from vgmpi.planning.plan import Plan

from .group_channels import get_channel


def advect(
    group: ParticleGroup, plan: Plan, dt: float, v: np.ndarray, trace: np.ndarray, law: tuple,
    state: tuple, step: int,
) -> StepReport:  # fmt: skip
    """Move the particles of a group; return what bounds the next step, and failed particles.

    Args:
        group: Particles (in/out).
        plan: Plan of the run.
        dt: Length of the step [s].
        v: Velocities with which positions move, shape (n, 3) [m/s].
        trace: Absolute trace of the velocity gradient, shape (n,) [1/s].
        law, state: Law of the group, and its state after the step.
        step: Number of the step, for the dither.
    """
    dx, index = plan.dx, group.index()
    J = np.broadcast_to(law_function(law, "volume_ratio")(law, state), trace.shape)
    wave2 = np.broadcast_to(law_function(law, "wave_speed2")(law, state), trace.shape)
    wave2 = wave2 * group.plan.wave.factor
    if group.plan.stores_porosity:
        porosity = get_channel(group, "share")[:, 0]
        wave2 = (
            wave2 * (1.0 + (1.0 / porosity - 1.0) * group.plan.wave.density_ratio)
            + group.plan.wave.added
        )
    shift = dt / dx * v
    intact, tame = (J > J_MIN) & (J < J_MAX), (wave2 > -1.0) & (wave2 < g2p.FASTEST_WAVE**2)
    slow = np.abs(shift).max(1) < 1.0
    good = intact & tame & slow
    dither = np.array(dither_of_step(step))
    units = np.floor(2.0**group.bits * np.where(good[:, None], shift, 0.0) + dither)
    group.xi[:, index] += units.T.astype(group.xi.dtype)
    x = np.ldexp(group.xi[:, index].T.astype(np.float64), -group.bits)
    position = x + BLOCK_EDGE * np.repeat(group.block, group.count, axis=0)
    inside = ((position > -2.0) & (position < np.array(plan.cells) - 1.0)).all(1)
    speed = np.linalg.norm(v, axis=1)
    rates = (np.sqrt(np.maximum(wave2, 0.0)) + speed) / (plan.time_step.cfl * dx)
    rates = np.maximum(rates, speed / (plan.time_step.max_cells * dx))
    rates = np.maximum(rates, trace / MAX_VOLUME_STRAIN_PER_STEP)
    reason = np.select(
        [~intact, ~tame, ~slow, ~inside],
        [g2p.INVALID_VOLUME, g2p.NOT_FINITE, g2p.CFL_EXCEEDED, g2p.OUT_OF_DOMAIN],
        0,
    )
    failed = [(int(group.ids[index[k]]), int(reason[k])) for k in np.flatnonzero(reason)]
    rate = float(np.where(good, rates, 0.0).max())
    bounds = float(np.abs(v[good]).max(initial=0.0)), 0.0, 0.0
    return StepReport(rate, float(np.abs(x).max()), bounds, failed, [])
