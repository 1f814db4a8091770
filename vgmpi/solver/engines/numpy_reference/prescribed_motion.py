"""Prescribed motion of bodies and colliders, in plain NumPy.

See kernels/rigid/prescribed_transfer.py and kernels/colliders/sdf_sampling.py.
"""

import numpy as np

from vgmpi.kernels.colliders.moving_colliders import MovingColliders
from vgmpi.kernels.colliders.sdf_sampling import SampledSdf
from vgmpi.kernels.rigid.prescribed_motion import (
    EFFECTIVE_MASS_FACTOR,
    PrescribedSteps,
)
from vgmpi.kernels.step_records import StepReport, dither_of_step
from vgmpi.kernels.transfer.g2p import OUT_OF_DOMAIN
from vgmpi.parallel.block_lattice import BLOCK_CENTER, BLOCK_EDGE
from vgmpi.parallel.particle_group import ParticleGroup

from .dense_grid import Dense


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


def nearest_collider(
    table: SampledSdf, points: np.ndarray, dt: float, dx: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the nearest moving collider at points.

    Args:
        table: Sampled signed distances and motions of the colliders.
        points: Positions, shape (n, 3) [m].
        dt: Length of the step [s].
        dx: Cell size [m].

    Returns:
        Outward normal and distance, shape (n, 4) [m]; index of the collider, shape (n,); mean
        velocity of its surface in the step, shape (n, 3) [m/s].
    """
    nodes, moves = np.zeros((len(points), 4)), np.zeros((len(points), 3))
    collider_number = np.zeros(len(points), np.int64)
    nodes[:, 3] = np.inf
    for m in range(len(table.first)):
        center, R = table.about[m], table.rotation[m]
        local = (points - center - table.move[m]) @ R + center
        inside, distance, gradient = sample(table, m, local)
        norm = np.linalg.norm(gradient, axis=1)
        chosen = (distance < nodes[inside, 3]) & (norm > 0)
        closest = np.flatnonzero(inside)[chosen]
        normal = (gradient[chosen] / norm[chosen, None]) @ R.T
        nodes[closest] = np.column_stack([normal, distance[chosen]])
        surface = points[closest] - np.clip(distance[chosen], -2 * dx, 2 * dx)[:, None] * normal
        body = (surface - center - table.move[m]) @ R
        end = body @ table.rotation_end[m].T + center + table.move_end[m]
        moves[closest], collider_number[closest] = (end - surface) / dt, m
    return nodes, collider_number, moves


def distance_from_colliders(
    movers: MovingColliders | None, dense: Dense, at_rest: np.ndarray
) -> np.ndarray | None:
    """Return the distance of each node from the nearest collider [m], None without colliders.

    Args:
        movers: Moving colliders where they are now, or None.
        dense: Background grid.
        at_rest: Normal and distance of static colliders at the nodes, shape (..., 4); else empty.
    """
    if movers is not None:
        return nearest_collider(movers.table, dense.points(), 1.0, dense.dx)[0][:, 3]
    return at_rest[..., 3] if at_rest.size else None


def sample(
    table: SampledSdf, m: int, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Interpolate the distance of one collider and its gradient linearly from its lattice.

    Args:
        table: Sampled colliders.
        m: Index of the collider.
        points: Points in the body frame, shape (n, 3) [m].

    Returns:
        Points inside the lattice, shape (n,) bool; distance [m] of those k, shape (k,); its
        gradient times the spacing [m], shape (k, 3).
    """
    s = (points - table.start[m]) / table.spacing
    corner = np.floor(s).astype(np.int64)
    inside = ((corner >= 0) & (corner <= table.shape[m] - 2)).all(axis=1)
    corner, s = corner[inside], s[inside] - corner[inside]
    grid = table.values[table.first[m] :][: np.prod(table.shape[m])].reshape(table.shape[m])
    slopes = np.stack(
        [np.gradient(grid, axis=a) for a in range(3)], -1
    )  # central differences within the lattice
    distance, gradient = np.zeros(len(s)), np.zeros((len(s), 3))
    for step in np.ndindex(2, 2, 2):
        place = tuple((corner + step).T)
        weight = np.where(step, s, 1 - s).prod(axis=1)
        distance += weight * grid[place]
        gradient += weight[:, None] * slopes[place]
    return inside, distance, gradient
