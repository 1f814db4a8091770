"""Nodes of a liquid with an implicit viscosity: their masses, and what walls and colliders hold."""

from typing import NamedTuple

import numpy as np

from vgmpi.kernels.colliders.surface_flow import FULL_WEIGHT_CELLS, touches_surface
from vgmpi.kernels.wall_boundary import RELEASING, SEPARATE, SLIP, STICK
from vgmpi.runtime.jit import always_inline, device_function, kernel

MIN_NODE_FILL = 1e-9  # [-] lighter nodes are no part of the system
HELD_FILL = 8.0  # [-] share of a node to which the liquid sticks: neighbors say how full a cell is


class PhaseNodes(NamedTuple):
    """Blocks of nodes of a phase, and where their numbers are."""

    node_block: np.ndarray  # (n,) row of each among the node blocks of the rank
    solid: np.ndarray  # (n,) row of each among the blocks of colliders, or -1
    block: np.ndarray  # (n, 3) block coordinates
    region: np.ndarray  # (n, 64) bool, nodes that this rank computes


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
            images, is_inside = _images(nodes.block[b], q, walls)
            counts = is_inside and nodes.region[b, q] and mass > MIN_NODE_FILL
            fields.fill[64 * b + q] = real(images) * mass if counts else real(0)
            for a in range(3):
                n = 192 * b + 64 * a + q
                v = velocity[nb, 4 * q + a] if counts else real(0)
                fields.star[n] = before[n] = after[n] = v
                fields.step[n] = 0
                moves = counts and not _is_held(nodes.block[b], q, a, v, walls)
                fields.inverse[n] = real(1) / mass if moves else real(0)


@always_inline
def _node_index(block, q, axis):
    """Return the index of a node of a block along an axis."""
    step = q // 16 if axis == 0 else (q // 4 % 4 if axis == 1 else q % 4)
    return 4 * block[axis] - 1 + step


@always_inline
def _images(block, q, walls):
    """Return how many images the mass of a node stands for, and whether it is in the domain."""
    images, is_inside = 1, True
    for a in range(3):
        node = _node_index(block, q, a)
        is_inside = is_inside and 0 <= node <= walls.cells[a]
        for side in range(2):
            kind = walls.kinds[a, side]
            mirrors = kind == STICK or kind == SLIP or kind == RELEASING
            if node == side * walls.cells[a] and mirrors:
                images *= 2
    return images, is_inside


@always_inline
def _is_held(block, q, axis, speed, walls):
    """Return whether a wall holds a node along an axis.

    Args:
        block: Block of the node, shape (3,).
        q: Number of the node in its block.
        axis: The axis.
        speed: Velocity along it [m/s].
        walls: Walls of the domain.
    """
    for a in range(3):
        node = _node_index(block, q, a)
        for side in range(2):
            kind = walls.kinds[a, side]
            if node == side * walls.cells[a]:
                leaves = speed > 0 if side == 0 else speed < 0
                stops = (kind == SEPARATE or kind == RELEASING) and not leaves
                if kind == STICK or (a == axis and (kind == SLIP or stops)):
                    return True
    return False


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
                    is_stopped = _is_held(nodes.block[b], q, a, v, walls)
                    result[nb, 4 * q + a] = velocity.dtype.type(0) if is_stopped else v
