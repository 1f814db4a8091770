"""Nodes of a liquid with an implicit viscosity: their masses, and what walls and colliders hold."""

from typing import NamedTuple

import numpy as np

from vgmpi.kernels.colliders.surface_flow import FULL_WEIGHT_CELLS, touches_surface
from vgmpi.kernels.grid.phase_nodes import count_images, is_held_at_wall
from vgmpi.runtime.jit import device_function, kernel

MIN_NODE_FILL = 1e-9  # [-] lighter nodes are no part of the system
HELD_FILL = 8.0  # [-] share of a node to which the liquid sticks: neighbors say how full a cell is


class CollidersNearby(NamedTuple):
    """Colliders at the nodes of blocks near them, and where liquids stick to them."""

    surfaces: np.ndarray  # (n, 64, 4) outward normal and distance [m]
    number: np.ndarray  # (n, 64) number of the nearest collider, or without rows
    sticks: np.ndarray  # (colliders or 1,) bool, whether the liquid sticks to each
    velocities: np.ndarray  # (node blocks, 256) velocities and masses
    offsets: np.ndarray  # (node blocks, 256) values of the field of offsets


@kernel
def set_nodes(rows, nodes, walls, unit, velocity, fields, before, after):
    """Read the nodes of some blocks, and what walls hold of them.

    Args:
        rows: Blocks to process, shape (n,).
        nodes: PhaseNodes.
        walls: Walls of the domain.
        unit: Mass of a full cell [kg].
        velocity: Velocity [m/s] and mass [kg], shape (node blocks, 256).
        fields: viscous_sweeps.py ViscousFields (out).
        before, after: Velocities of the sweeps, flat (out).
    """
    real = before.dtype.type
    per_cell = real(1.0 / unit)
    for b in rows:
        nb = nodes.node_block[b]
        for q in range(64):
            mass = velocity[nb, 4 * q + 3] * per_cell
            images, is_inside = count_images(nodes.block[b], q, walls.kinds, walls.cells)
            counts = is_inside and nodes.region[b, q] and mass > MIN_NODE_FILL
            fields.fill[64 * b + q] = real(images) * mass if counts else real(0)
            for a in range(3):
                n = 192 * b + 64 * a + q
                v = velocity[nb, 4 * q + a] if counts else real(0)
                fields.star[n] = before[n] = after[n] = v
                fields.step[n] = 0
                moves = counts and not is_held_at_wall(
                    nodes.block[b], q, a, v, walls.kinds, walls.cells
                )
                fields.inverse[n] = real(1) / mass if moves else real(0)


@kernel
def hold_at_colliders(rows, nodes, phase, phases, colliders, dx, fields, has_normals):
    """Hold the nodes of some blocks near colliders.

    Nodes that touch one, at most half a cell outside, keep their velocity along the normal, and
    where the liquid sticks in all directions.

    Args:
        rows: Blocks to process, shape (n,).
        nodes: PhaseNodes.
        phase, phases: Number of the phase, and constants of the phases.
        colliders: CollidersNearby.
        dx: Cell size [m].
        fields: viscous_sweeps.py ViscousFields (in/out).
        has_normals: Whether colliders hold nodes of a block, shape (blocks,) (out).
    """
    real = fields.fill.dtype.type
    for b in rows:
        has_normals[b] = False
        for q in range(64):
            for a in range(3 if len(fields.normal) > 0 else 0):
                fields.normal[192 * b + 64 * a + q] = 0
            surface = colliders.surfaces[nodes.solid[b], q]
            d = float(surface[3])
            if not (fields.fill[64 * b + q] > 0 and abs(d) < 1.5 * dx):
                continue
            if d > FULL_WEIGHT_CELLS * dx or not touches_surface(
                colliders, phases, phase, nodes.node_block[b], q, surface, d, dx
            ):
                continue
            number = colliders.number[nodes.solid[b], q] if len(colliders.number) > 0 else 0
            if colliders.sticks[number]:
                fields.fill[64 * b + q] = real(HELD_FILL)
                for a in range(3):
                    fields.inverse[192 * b + 64 * a + q] = 0
            elif len(fields.normal) > 0:
                has_normals[b] = True
                _store_normal(b, q, surface, fields)


@device_function
def _store_normal(b, q, surface, fields):
    """Store the normal of a collider at a node without its parts along which a wall holds it."""
    total = 0.0
    for a in range(3):
        n = 192 * b + 64 * a + q
        if fields.inverse[n] > 0:
            total += float(surface[a]) ** 2
    for a in range(3):
        n = 192 * b + 64 * a + q
        if fields.inverse[n] > 0 and total > 0.0:
            fields.normal[n] = surface[a] / np.sqrt(total)


@kernel
def store_velocities(rows, nodes, walls, fields, velocity, result):
    """Store the velocities of the nodes of some blocks.

    Args:
        rows: Blocks to process, shape (n,).
        nodes: PhaseNodes.
        walls: Walls of the domain.
        fields: viscous_sweeps.py ViscousFields.
        velocity: Velocities after the last sweep [m/s], flat.
        result: Velocity and mass, shape (node blocks, 256) (in/out).
    """
    for b in rows:
        nb = nodes.node_block[b]
        for q in range(64):
            for a in range(3):
                n = 192 * b + 64 * a + q
                if fields.inverse[n] > 0:
                    v = velocity[n]
                    # a separate wall stops what now moves into it
                    is_stopped = is_held_at_wall(nodes.block[b], q, a, v, walls.kinds, walls.cells)
                    result[nb, 4 * q + a] = velocity.dtype.type(0) if is_stopped else v
