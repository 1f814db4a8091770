"""Pressure at boundaries: what walls and colliders stop, let go and take up.

The system holds nodes at walls and shares them with colliders (pressure_system.py). Around its
solution, separating walls release nodes or hold them with friction, nodes without pressure around
them are stopped as they approach something, and the reactions of walls and colliders are recorded:
of the impulse D^T phi of a node, a collider takes its share, and a wall what it holds of the rest.
"""

import numpy as np

from vgmpi.kernels.colliders.sdf_sampling import set_node_indices
from vgmpi.kernels.reaction_impulses import (
    add_contact_reaction,
    add_pressure_reaction,
    add_wall_reaction,
    set_block,
    set_collider,
    set_node,
    set_wall,
)
from vgmpi.kernels.simd.vector16 import pointer, store
from vgmpi.kernels.wall_boundary import RELEASING, apply_coulomb_friction
from vgmpi.runtime.jit import always_inline, kernel

from ..liquid_rows import filled_part, mean_velocity, part_of_row, response_of_liquids
from ..pressure_system import MAX_MOVE, MIN_NODE_FILL
from .cell_stencils import (
    corner_node,
    corner_sign,
    differences_below,
    holding_wall,
    is_held,
    node_index,
)

# [cells] distances from a collider at which approach is stopped wholly, and not at all
STOP_DISTANCE, FREE_DISTANCE = 0.25, 1.05
OUTWARD_DEPTH, OUTWARD_RATE = 1.0, 2.0  # [cells] of nodes that push out of colliders, [-] per step


@always_inline
def _push_across(b, q, axis, lattice, fields):
    """Return D^T phi at a node along an axis."""
    total = 0.0
    for corner in range(8):  # of the cells around it, those below it where a bit is 0
        cell = 0
        block_row = 8 * b
        for a in range(3):
            step = q // 16 if a == 0 else (q // 4 % 4 if a == 1 else q % 4)
            size = 16 if a == 0 else (4 if a == 1 else 1)
            weight = 4 if a == 0 else (2 if a == 1 else 1)
            place = step + ((corner // weight) % 2) - 1
            if place < 0:
                place += 4
                block_row += weight
            cell += size * place
        phi = fields.phi[64 * lattice.low[block_row] + cell]
        total -= 0.25 * corner_sign(corner, axis) * phi
    return total


@always_inline
def _separating_side(b, q, axis, lattice, walls):
    """Return 1 or -1 at a node on a separating wall across an axis, the way into the domain."""
    node = node_index(b, q, axis, lattice)
    if node == 0 and walls.kinds[axis, 0] == RELEASING:
        return 1
    if node == walls.cells[axis] and walls.kinds[axis, 1] == RELEASING:
        return -1
    return 0


@always_inline
def _kick_across(b, q, axis, lattice, liquids, velocity, fields):
    """Return what the potential adds to the mean velocity of a node along an axis [cells/s]."""
    fill = filled_part(b, q, liquids, velocity)
    if not fill > 0.0:
        return 0.0
    response = response_of_liquids(b, q, fill, liquids, velocity)
    return response * fields.share[64 * b + q] * _push_across(b, q, axis, lattice, fields)


@kernel
def release_nodes(rows, lattice, walls, liquids, velocity, fields, level):
    """Let nodes on separating walls answer along the normal where phi leaves them going away.

    Those next to colliders stay held.

    Args:
        rows: Blocks to process, shape (n,).
        lattice: Blocks, Lattice.
        walls: Walls of the domain.
        liquids: LiquidRows.
        velocity: Velocities [m/s] and masses [kg], shape (rows, 256).
        fields: PressureFields.
        level: LevelFields (in/out).
    """
    real = level.u.dtype.type
    for b in rows:
        for q in range(64):
            fill = filled_part(b, q, liquids, velocity)
            if not fill > MIN_NODE_FILL or fields.free_part[64 * b + q] < 1:
                continue
            for a in range(3):
                side = _separating_side(b, q, a, lattice, walls)
                speed = float(mean_velocity(b, q, a, fill, liquids, velocity)) / liquids.dx
                if side == 0 or not side * speed > 0.0:
                    continue
                kick = _kick_across(b, q, a, lattice, liquids, velocity, fields)
                if side * (speed + kick) > 0.0:
                    response = response_of_liquids(b, q, fill, liquids, velocity)
                    level.inverse[192 * b + 64 * a + q] = response
                    level.u[192 * b + 64 * a + q] = real(speed)


@kernel
def hold_at_separating_walls(rows, lattice, walls, liquids, fields, level, velocity, reaction):
    """Stop what approaches separating walls, with friction by what the pressure presses.

    Args:
        rows: Blocks to process, shape (n,).
        lattice: Blocks, Lattice.
        walls: Walls of the domain.
        liquids: LiquidRows.
        fields: PressureFields.
        level: LevelFields.
        velocity: Velocities [m/s] and masses [kg], shape (rows, 256) (velocities in/out).
        reaction: Reaction sums (in/out), or None.
    """
    before, first = np.zeros(3), np.zeros(3, np.int64)
    for b in rows:
        set_block(reaction, b)
        for a in range(3):
            first[a] = 4 * lattice.block[b, a] - 1
        for q in range(64):
            for a in range(3):
                side = _separating_side(b, q, a, lattice, walls)
                if side == 0:
                    continue
                is_free, kick = level.inverse[192 * b + 64 * a + q] > 0, 0.0
                if not is_free:
                    kick = liquids.dx * _kick_across(b, q, a, lattice, liquids, velocity, fields)
                friction = walls.friction[a, 0] if side > 0 else walls.friction[a, 1]
                plane = 0 if side > 0 else walls.cells[a]
                for r in range(liquids.first[b], liquids.first[b + 1]):
                    if not liquids.per_cell[liquids.phase[r]] > 0:
                        continue
                    for c in range(3):
                        before[c] = velocity[r, 4 * q + c]
                    push = max(-side * float(velocity[r, 4 * q + a]), 0.0)
                    if not is_free or push > 0.0:
                        velocity[r, 4 * q + a] = 0
                    if not is_free:
                        push = max(-side * kick * part_of_row(r, q, liquids), 0.0)
                    if push > 0.0:
                        apply_coulomb_friction(velocity[r], 4 * q, friction * push)
                    add_wall_reaction(
                        reaction, a, int(side < 0), plane, q, first, before,
                        velocity[r, 4 * q : 4 * q + 4],
                    )  # fmt: skip


@kernel
def rub_sand(blocks, lattice, walls, unit, fields, level, velocity, reaction):
    """Slow a sand on separating walls by friction, by what the pressure presses on its grains.

    Args:
        blocks: SolidBlocks.
        lattice: Blocks, Lattice.
        walls: Walls of the domain.
        unit: Impulse of the cells [kg m/s].
        fields: PressureFields.
        level: LevelFields.
        velocity: Velocities [m/s] and masses [kg], shape (rows, 256) (velocities in/out).
        reaction: Reaction sums (in/out), or None.
    """
    before, first = np.zeros(3), np.zeros(3, np.int64)
    for i in blocks.occupied:
        b, r = blocks.block_of[i], blocks.rows[i]
        set_block(reaction, b)
        for a in range(3):
            first[a] = 4 * lattice.block[b, a] - 1
        for q in range(64):
            for a in range(3):
                side = _separating_side(b, q, a, lattice, walls)
                is_held = side != 0 and not level.inverse[192 * b + 64 * a + q] > 0
                mass = float(velocity[r, 4 * q + 3])
                if not is_held or not fields.share[64 * b + q] > 0 or not mass > 0:
                    continue
                press = -side * _push_across(b, q, a, lattice, fields)
                if not press > 0.0:
                    continue
                for c in range(3):
                    before[c] = velocity[r, 4 * q + c]
                friction = walls.friction[a, 0] if side > 0 else walls.friction[a, 1]
                press *= unit * fields.grain_part[64 * b + q] / mass
                apply_coulomb_friction(velocity[r], 4 * q, friction * press)
                add_wall_reaction(
                    reaction, a, int(side < 0), 0 if side > 0 else walls.cells[a], q, first, before,
                    velocity[r, 4 * q : 4 * q + 4],
                )  # fmt: skip


@kernel
def stop_at_colliders(rows, lattice, walls, liquids, colliders, fields, velocity, reaction):
    """Stop the approach of nodes to colliders where no pressure acts on them.

    No cell around them has any, or they are closed: these move along the normal as the collider
    does. Free bodies do so themselves.

    Args:
        rows: Blocks to process, shape (n,).
        lattice: Blocks, Lattice.
        walls: Walls of the domain, which hold their nodes.
        liquids: LiquidRows.
        colliders: ColliderNodes.
        fields: PressureFields; `cover` becomes above 0 at nodes with pressure around them.
        velocity: Velocities [m/s], shape (rows, 256) (in/out).
        reaction: Reaction sums (in/out), or None.
    """
    low, filled, wet = pointer(lattice.low), pointer(fields.filled), pointer(fields.cover)
    before, after, move, ijk = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3, np.int64)
    for b in rows:
        row = colliders.row[b]
        if row < 0:
            continue
        set_block(reaction, b)
        lower, _, _ = differences_below(filled, low, 8 * b + 4, 48)
        for x in range(4):
            upper, _, _ = differences_below(filled, low, 8 * b, 16 * x)
            store(wet, 64 * b + 16 * x, lower + upper)
            lower = upper
        for q in range(64):
            distance = colliders.nodes[row, q, 3] / liquids.dx
            is_free = len(colliders.body) > 0 and colliders.body[row, q] >= 0
            is_closed = not fields.free_part[64 * b + q] > 0
            has_pressure = fields.cover[64 * b + q] > 0 and not is_closed
            if has_pressure or is_free or not distance < FREE_DISTANCE:
                continue
            part = min((FREE_DISTANCE - distance) / (FREE_DISTANCE - STOP_DISTANCE), 1.0)
            for r in range(liquids.first[b], liquids.first[b + 1]):
                if not liquids.per_cell[liquids.phase[r]] > 0:
                    continue
                approach = 0.0
                for a in range(3):
                    if len(colliders.moves) > 0:
                        move[a] = colliders.moves[row, q, a]
                    speed = float(velocity[r, 4 * q + a]) - move[a]
                    approach -= speed * colliders.nodes[row, q, a]
                stopped = approach if is_closed else max(approach, 0.0)
                for a in range(3):
                    before[a] = velocity[r, 4 * q + a]
                    if not is_held(b, q, a, lattice, walls):
                        change = part * stopped * colliders.nodes[row, q, a]
                        velocity[r, 4 * q + a] += velocity.dtype.type(change)
                    after[a] = velocity[r, 4 * q + a]
                if len(colliders.number) > 0:
                    set_node_indices(ijk, lattice.block[b], q)
                    set_node(reaction, q, ijk[0], ijk[1], ijk[2])
                    set_collider(reaction, colliders.number[row, q], colliders.nodes[row, q])
                    mass = velocity[r, 4 * q + 3]
                    add_contact_reaction(reaction, before, after, mass, move, 0, 0)


@kernel
def reserve_nodes(rows, liquids, colliders, fields, reserved):
    """Mark the nodes at which colliders do not act later: all but those of free bodies in spray.

    Args:
        rows: Blocks to process, shape (n,).
        liquids: LiquidRows.
        colliders: ColliderNodes.
        fields: PressureFields, see `stop_at_colliders`.
        reserved: 1 at such nodes, shape (rows, 64) (out).
    """
    for b in rows:
        row = colliders.row[b]
        for q in range(64):
            is_free = row >= 0 and len(colliders.body) > 0 and colliders.body[row, q] >= 0
            for r in range(liquids.first[b], liquids.first[b + 1]):
                if liquids.per_cell[liquids.phase[r]] > 0:
                    reserved[r, q] = fields.cover[64 * b + q] > 0 or not is_free


@kernel
def record_pressure(rows, lattice, walls, colliders, potential, fields, level, reactions):
    """Record what colliders, walls and pinned parts take up of the impulses of some blocks' cells.

    Args:
        rows: Blocks to process, shape (n,).
        lattice: Blocks, Lattice.
        walls: Walls of the domain.
        colliders: ColliderNodes.
        potential: Impulse [kg m/s] of the cells that this rank counts, else 0, flat.
        fields: PressureFields.
        level: LevelFields.
        reactions: NodeReactions (sums in/out).
    """
    reaction, pinned = reactions.sums, reactions.pinned
    push, move, ijk = np.zeros(3), np.zeros(3), np.zeros(3, np.int64)
    none = np.zeros(4)
    for b in rows:
        for q in range(64):
            quarter = 0.25 * float(potential[64 * b + q])
            if quarter == 0.0:
                continue
            for corner in range(8):
                block, node = corner_node(b, q, corner, lattice)
                if block >= len(colliders.row):
                    continue
                set_node_indices(ijk, lattice.block[block], node)
                set_node(reaction, node, ijk[0], ijk[1], ijk[2])
                share, row = fields.share[64 * block + node], colliders.row[block]
                grain_part = fields.grain_part[64 * block + node]
                others = 1.0 - share - grain_part - fields.solid_part[64 * block + node]
                is_shared = row >= 0 and fields.free_part[64 * block + node] < 1 and others > 0
                if is_shared and (len(colliders.body) == 0 or colliders.body[row, node] < 0):
                    for a in range(3):
                        push[a] = -corner_sign(corner, a) * others * quarter
                        move[a] = colliders.moves[row, node, a] if len(colliders.moves) > 0 else 0.0
                    set_collider(reaction, colliders.number[row, node], colliders.nodes[row, node])
                    add_pressure_reaction(reaction, colliders.number[row, node], push, move)
                of_pinned = fields.pinned_part[64 * block + node]
                if of_pinned > 0 and pinned[block, node] >= 0:
                    for a in range(3):
                        push[a] = -corner_sign(corner, a) * of_pinned * quarter
                        move[a] = 0.0
                    set_collider(reaction, pinned[block, node], none)
                    add_pressure_reaction(reaction, pinned[block, node], push, move)
                for a in range(3):
                    wall = holding_wall(block, node, a, lattice, walls)
                    if wall < 0 or level.inverse[192 * block + 64 * a + node] > 0:
                        continue
                    for c in range(3):
                        push[c] = move[c] = 0.0
                    push[a] = -corner_sign(corner, a) * (share + grain_part) * quarter
                    set_wall(reaction, wall // 2, wall % 2, none)
                    add_pressure_reaction(reaction, reaction.first + wall, push, move)


@kernel
def stop_moves(rows, lattice, walls, liquids, moves):
    """Stop displacements of nodes on separating walls that lead beyond these.

    Args:
        rows: Blocks to process, shape (n,).
        lattice: Blocks, Lattice.
        walls: Walls of the domain.
        liquids: LiquidRows.
        moves: See `store_moves` (in/out).
    """
    for b in rows:
        for q in range(64):
            for a in range(3):
                side = _separating_side(b, q, a, lattice, walls)
                for r in range(liquids.first[b], liquids.first[b + 1]):
                    if side * moves[r, 4 * q + a] < 0:
                        moves[r, 4 * q + a] = 0


@kernel
def push_out_of_colliders(rows, liquids, colliders, moves):
    """Move liquids out of colliders by the nodes deep in them.

    Particles at a surface hardly reach these: only what has got in moves.

    Args:
        rows: Blocks to process, shape (n,): those near colliders.
        liquids: LiquidRows.
        colliders: ColliderNodes.
        moves: See `store_moves` (in/out).
    """
    for b in rows:
        row = colliders.row[b]
        for q in range(64):
            depth = -colliders.nodes[row, q, 3] / liquids.dx - OUTWARD_DEPTH
            if not depth > 0:
                continue
            push = min(OUTWARD_RATE * depth, MAX_MOVE)
            for r in range(liquids.first[b], liquids.first[b + 1]):
                if liquids.per_cell[liquids.phase[r]] > 0:
                    for a in range(3):
                        outward = push * colliders.nodes[row, q, a]
                        moves[r, 4 * q + a] += moves.dtype.type(outward)
