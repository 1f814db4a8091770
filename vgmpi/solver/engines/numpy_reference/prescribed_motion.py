"""Prescribed motion of bodies, in plain NumPy; see kernels/rigid/prescribed_transfer.py."""

import numpy as np

from vgmpi.kernels.rigid.prescribed_motion import (
    EFFECTIVE_MASS_FACTOR,
    PrescribedSteps,
)
from vgmpi.kernels.step_records import StepReport, dither_of_step
from vgmpi.kernels.transfer.g2p import OUT_OF_DOMAIN
from vgmpi.parallel.block_lattice import BLOCK_CENTER, BLOCK_EDGE
from vgmpi.parallel.particle_group import ParticleGroup


def prescribe(
    v: np.ndarray, heavy: np.ndarray, motion: PrescribedSteps, points: np.ndarray, dx: float
) -> None:
    """Set velocities and masses of prescribed bodies at the nodes.

    Args:
        v (in/out): Velocities, shape (phases, ..., 3) [m/s].
        heavy (in/out): Masses, shape (phases, ...); those of prescribed bodies are multiplied by
            EFFECTIVE_MASS_FACTOR.
        motion: Rigid motion of each phase.
        points: Positions of the nodes, shape (n, 3) [m].
        dx: Cell size [m].
    """
    for p in np.flatnonzero(motion.driven):
        x = points - motion.about[p]
        v[p] = (x @ motion.turn[p].T + motion.shift[p]).reshape(v[p].shape)
        heavy[p] *= EFFECTIVE_MASS_FACTOR


def carry(
    group: ParticleGroup, motion: PrescribedSteps, row: int, dx: float, dt: float, step: int
) -> StepReport:
    """Advect the particles of a body with a given motion and return the report.

    Args:
        group: Particles of the body (in/out).
        motion: Displacements of a step.
        row: Row of the body among them, -1 if it is at rest.
        dx: Cell size [m].
        dt: Length of the step [s].
        step: Number of the step, for the dither.
    """
    index = group.index()
    if row < 0:
        return StepReport(0.0, 0.0, (0.0,) * 3, [], [])
    turn = motion.turn[row]
    v = (group.positions() - motion.about[row]) @ turn.T + motion.shift[row]
    dither = np.array(dither_of_step(step))
    units = np.floor(2.0**group.bits * (dt / dx) * v + dither)
    group.xi[:, index] += units.T.astype(group.xi.dtype)
    group.put("v", index, v)
    group.put("C", index, np.tile(turn.ravel(), (len(index), 1)))
    R = np.eye(3) + dt * turn
    for name in ("H", "F"):
        if name in group.plan.channels:
            F = np.eye(3) + group.get(name, index).astype(float).reshape(-1, 3, 3)
            group.put(name, index, (R @ F - np.eye(3)).reshape(-1, 9))
    x = np.ldexp(group.xi[:, index].T.astype(np.float64), -group.bits)
    position = x + BLOCK_EDGE * np.repeat(group.block, group.count, axis=0) + BLOCK_CENTER
    cells = np.array(group.lattice.cells)
    outside = ~((position > -0.5) & (position < cells + 0.5)).all(1)
    failed = [(int(group.ids[index[k]]), OUT_OF_DOMAIN) for k in np.flatnonzero(outside)]
    return StepReport(0.0, float(np.abs(x).max()), (float(np.abs(v).max()), 0.0, 0.0), failed, [])
