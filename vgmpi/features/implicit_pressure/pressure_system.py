"""System of the implicit pressure: cells that hold liquid, and what its solution does to the nodes.

Potentials phi belong to cells, velocities to nodes [cells/s]. With D the divergence of the eight
nodes of a cell, M the masses of the nodes, relative to that of a full cell, and theta the share of
a node that the liquid has, where colliders of the velocity V have the rest,

    D theta^2 M^-1 D^T phi = -D (theta v + (1 - theta) V),        v = v + theta M^-1 D^T phi

With several liquids, v is their mean by volume, and M^-1 their response (liquid_rows.py).

(docs/explanation/implicit-pressure.md).
"""

from typing import Any, NamedTuple

import numpy as np

from vgmpi.kernels.grid.contact_impulses import half_space_fraction
from vgmpi.kernels.simd.row_ops import (
    shift_from_above,
    shift_from_below,
    shift_from_north,
    shift_from_south,
)
from vgmpi.kernels.simd.vector16 import load, pointer, store
from vgmpi.kernels.wall_boundary import OPEN, RELEASING, SLIP, STICK
from vgmpi.materials.tensor_math.select import select
from vgmpi.runtime.aligned_arrays import aligned_zeros
from vgmpi.runtime.jit import always_inline, kernel

from .kernels.cell_stencils import (
    differences_below,
    divergence,
    is_held,
    mean_of_axes,
    mean_of_nodes,
    node_index,
)
from .kernels.collider_faces import (
    CLOSED_DEPTHS,
    curvature_at,
    distance_beside,
    find_faces,
    has_dry_side,
    has_opposite_faces,
)
from .liquid_rows import (
    filled_part,
    mean_velocity,
    part_of_row,
    set_parts,
)

SURFACE_FILL = 0.5  # [-] cells that are filled less have no pressure: they are the surface
MIN_NODE_FILL = 1e-9  # [-] lighter nodes do not respond
MAX_MOVE = 0.3  # [cells] largest correction of a position along an axis in a step
# [-] Cells of which colliders leave less do not say whether they are full: a few particles decide.
# They have pressure if a neighbor has it, some times over, and no node of theirs is nearly empty.
MIN_FREE_PART, INWARD_STEPS, EMPTY_PART = 0.3, 3, 0.1
MIN_SHARE = 1e-3  # [-] liquid that has less of a node does not respond: its velocity would be vast
# The part of a node that a face leaves is that of its tangent plane, moved by half the variance of
# the spline, 1/4, times the curvature of the face: so convex bodies have their volume.
CURVATURE_SHIFT, CURVED_DISTANCE = 0.125, 2.0  # [cells^2], [cells]
MIN_PORE = 0.05  # [-] cells of solids in which liquid has less have no pressure
MIN_POROSITY = 0.05  # [-] least part of what grains and liquid have that the liquid has
MIN_MEETING_PART = 0.02  # [-] part of a node from which on a solid meets what else has some of it
RESOLVED_SHARE = 0.5  # [-] where colliders leave less, liquid has no more than its volume
MIN_PRESSURE, MAX_PRESSURE = -0.9, 15.0  # [-] of particles, relative to the Tait coefficient


class PressureFields(NamedTuple):
    """Numbers of the cells and nodes of a rank, flat, in the working precision; 64 of a block."""

    region: np.ndarray  # 1 for the cells that this rank computes, else 0
    fill: np.ndarray  # volume of the liquids at nodes; those on walls stand for both sides
    guess: np.ndarray  # pressure times filled share at the nodes, from particles
    filled: np.ndarray  # filled part of what colliders leave of cells with pressure, else 0
    cover: np.ndarray  # above 0 in cells with liquid and beyond walls
    phi: np.ndarray  # potential
    free_part: np.ndarray  # part of nodes that colliders leave
    share: np.ndarray  # part of nodes that the liquid has
    empty: np.ndarray  # 1 for nodes next to colliders with next to no liquid, else 0
    excess: np.ndarray  # liquid of cells less what colliders leave
    covered: np.ndarray  # 1 for cells of which colliders leave next to nothing, else 0
    solid: np.ndarray  # part of nodes that solids and their pinned parts have by their volume
    meeting: np.ndarray  # 1 for nodes at which solids meet each other
    solid_part: np.ndarray  # the same so that all parts sum up to 1
    solid_scale: np.ndarray  # ratio of the two
    pinned: np.ndarray  # part of nodes that pinned parts of solids have, which are not on the grid
    pinned_part: np.ndarray  # the same, less what colliders have, as part of `solid_part`
    grains: np.ndarray  # part of nodes that grains have by their volume
    grain_part: np.ndarray  # the same so that all parts sum up to 1
    grain_scale: np.ndarray  # ratio of the two


class NodeReactions(NamedTuple):
    """Sums of reactions at the nodes of a rank."""

    sums: Any  # reaction sums, or None
    pinned: np.ndarray  # (blocks + 1, 64) row of the pinned part at each node, -1 for none; or none


class ColliderNodes(NamedTuple):
    """Colliders at the nodes of blocks near them, as StaticColliders and MovingColliders do."""

    row: np.ndarray  # (blocks,) row of each block, or -1
    nodes: np.ndarray  # (n, 64, 4) outward normal and distance [m]
    moves: np.ndarray  # (n, 64, 3) velocity [m/s], or no rows
    number: np.ndarray  # (n, 64) number of the nearest collider, or no rows
    body: np.ndarray  # (n, 64) number of a free body, -1 for other colliders, or no rows


def pressure_fields(blocks: int, real: np.dtype) -> PressureFields:
    """Return fields of zeros for some blocks and the row of no block."""
    return PressureFields(*(aligned_zeros(64 * (blocks + 1), real) for _ in PressureFields._fields))


@kernel
def set_nodes(rows, liquids, velocity, fields, level):
    """Read the nodes of some blocks, as if nothing held them.

    Args:
        rows: Blocks to process, shape (n,).
        liquids: LiquidRows (parts out).
        velocity: Velocity [m/s] and mass [kg] of the nodes, shape (rows, 256).
        fields: PressureFields (out).
        level: LevelFields (out).
    """
    real = fields.fill.dtype.type
    zero, unity = real(0.0), real(1.0)
    per_length, per_volume = real(1.0 / liquids.dx), liquids.per_volume
    for b in rows:
        first, last = liquids.first[b], liquids.first[b + 1]
        density = liquids.density[liquids.phase[first]]
        if last - first == 1 and density > 0:
            per_cell = liquids.per_cell[liquids.phase[first]]
            for q in range(64):
                fill = velocity[first, 4 * q + 3] * per_cell
                is_light = not fill > MIN_NODE_FILL
                response = zero if is_light else unity / (fill * density)
                scale = zero if is_light else per_length
                for a in range(3):
                    level.u[192 * b + 64 * a + q] = scale * velocity[first, 4 * q + a]
                    level.inverse[192 * b + 64 * a + q] = response
                fields.fill[64 * b + q] = fill
                fields.guess[64 * b + q] = per_volume * liquids.pressures[first, 4 * q + 3]
                if len(liquids.parts) > 0:
                    liquids.parts[64 * first + q] = zero if is_light else unity
        else:
            for q in range(64):
                fill = filled_part(b, q, liquids, velocity)
                response, guess = zero, zero
                if fill > MIN_NODE_FILL:
                    response = set_parts(b, q, fill, liquids, velocity)
                for a in range(3):
                    mean = mean_velocity(b, q, a, fill, liquids, velocity)
                    level.u[192 * b + 64 * a + q] = per_length * mean if response > 0 else zero
                    level.inverse[192 * b + 64 * a + q] = response
                for r in range(first, last):
                    guess += liquids.pressures[r, 4 * q + 3]
                    if not response > 0:
                        liquids.parts[64 * r + q] = zero
                fields.fill[64 * b + q], fields.guess[64 * b + q] = fill, per_volume * guess
        for q in range(64 * b, 64 * b + 64):
            fields.free_part[q] = fields.share[q] = unity
            fields.empty[q] = zero


@kernel
def hold_at_walls(rows, lattice, walls, fields, level):
    """Hold the nodes of some blocks at walls, and let those on walls stand for both sides.

    Args:
        rows: Blocks with nodes on walls or beyond, shape (n,).
        lattice: Blocks, Lattice.
        walls: Walls of the domain.
        fields: PressureFields (in/out).
        level: LevelFields (in/out).
    """
    zero = fields.fill.dtype.type(0.0)
    for b in rows:
        for q in range(64):
            images, inside = 1, True
            for a in range(3):
                node = node_index(b, q, a, lattice)
                kind = walls.kinds[a, 0] if node <= 0 else walls.kinds[a, 1]
                is_inside = 0 <= node <= walls.cells[a]
                inside = inside and (is_inside or kind == OPEN)
                if (node == 0 or node == walls.cells[a]) and kind != OPEN:
                    images *= 2
                    for c in range(3):
                        if kind == STICK or (kind in (SLIP, RELEASING) and c == a):
                            level.inverse[192 * b + 64 * c + q] = zero
                            level.u[192 * b + 64 * c + q] = zero
            if not inside:
                images = 0
                for a in range(3):
                    level.inverse[192 * b + 64 * a + q] = zero
            fields.fill[64 * b + q] *= images
            fields.guess[64 * b + q] *= images


@kernel
def share_nodes(rows, lattice, walls, dx, colliders, fields, level):
    """Share the nodes of some blocks between liquids, colliders and deformable solids.

    Args:
        rows: Blocks near colliders and solids, shape (n,).
        lattice: Blocks, Lattice.
        walls: Walls of the domain.
        dx: Cell size [m].
        colliders: ColliderNodes.
        fields: PressureFields, with `fill` known around the nodes of this rank (in/out).
        level: LevelFields (in/out).
    """
    for b in rows:
        if _has_liquid_around(b, lattice, fields):
            _share_block(b, lattice, walls, dx, colliders, fields, level)


@always_inline
def _has_liquid_around(b, lattice, fields):
    """Return whether a block or one next to it has nodes with liquid: cells near it may be wet."""
    for n in range(27 * b, 27 * b + 27):
        for q in range(64 * lattice.neighbors[n], 64 * lattice.neighbors[n] + 64):
            if fields.fill[q] > 0:
                return True
    return False


@always_inline
def _share_block(b, lattice, walls, dx, colliders, fields, level):
    """Share the nodes of a block, see `share_nodes`."""
    faces, min_fill = np.empty((27, 4)), EMPTY_PART * RESOLVED_SHARE
    real, row = fields.fill.dtype.type, colliders.row[b]
    for q in range(64):
        distance = colliders.nodes[row, q, 3] / dx if row >= 0 else colliders.nodes.dtype.type(9.0)
        is_free = row >= 0 and len(colliders.body) > 0 and colliders.body[row, q] >= 0
        is_thin = is_closed = False
        if row >= 0 and not is_free and CLOSED_DEPTHS[0] < -distance < CLOSED_DEPTHS[1]:
            count = find_faces(b, q, lattice, colliders, dx, fields.fill, min_fill, faces)
            is_thin = has_opposite_faces(count, faces)
            is_closed = is_thin and has_dry_side(count, faces)
        if row >= 0 and abs(distance) < CURVED_DISTANCE and not is_thin:
            distance += CURVATURE_SHIFT * curvature_at(b, q, lattice, colliders) / dx
        free_part = real(0.0 if is_closed else 1.0 - half_space_fraction(distance))
        wet, of_solids = fields.fill[64 * b + q], fields.solid[64 * b + q]
        pinned = fields.pinned[64 * b + q]
        shared = min(pinned, real(1.0) - free_part)  # with what holds it
        of_solids, pinned = of_solids - shared, pinned - shared
        taken = real(1.0) - free_part + of_solids
        free_part = max(free_part - of_solids, real(0.0))
        share = min(free_part, wet) if free_part < RESOLVED_SHARE else free_part
        free_part = _pores_beside_grains(64 * b + q, free_part, wet, fields)
        share, grain_part = min(share, free_part), fields.grain_part[64 * b + q]
        if wet <= MIN_NODE_FILL or share < MIN_SHARE:
            share = real(0.0)
        fields.free_part[64 * b + q], fields.share[64 * b + q] = free_part, share
        is_empty = free_part >= RESOLVED_SHARE and wet < EMPTY_PART * free_part
        meets_collider = row >= 0 and taken > of_solids > MIN_MEETING_PART
        touches = fields.meeting[64 * b + q] > 0 or (
            meets_collider and not fields.pinned[64 * b + q] > 0
        )
        fields.empty[64 * b + q] = real(is_empty or touches)
        collider_share = real(1.0) - share - grain_part if free_part < 1.0 else real(0.0)
        if of_solids > 0:
            fields.solid_scale[64 * b + q] = (real(1.0) - share - grain_part) / taken
            fields.solid_part[64 * b + q] = of_solids * fields.solid_scale[64 * b + q]
            fields.pinned_part[64 * b + q] = pinned * fields.solid_scale[64 * b + q]
            collider_share -= fields.solid_part[64 * b + q]
        for a in range(3):
            n = 192 * b + 64 * a + q
            level.inverse[n] *= share * share
            level.u[n] *= share
            if row < 0 or is_free or len(colliders.moves) == 0:
                continue
            part = collider_share
            if is_held(b, q, a, lattice, walls):
                part = min(part, real(_share_beyond(b, q, a, lattice, walls, dx, colliders)))
            level.u[n] += part * real(colliders.moves[row, q, a] / dx)


@always_inline
def _pores_beside_grains(n, free_part, wet, fields):
    """Return what grains leave of what colliders and solids leave of a node.

    Without liquid they have all of it for the pressure.

    Args:
        n: Number of the node.
        free_part: What colliders and solids leave.
        wet: Volume of the liquids.
        fields: PressureFields (grain_part and grain_scale out).
    """
    real, grains = fields.fill.dtype.type, fields.grains[n]
    fields.grain_part[n] = real(0.0)
    if not grains > 0:
        return free_part
    fraction = grains / max(grains + wet, free_part)
    part = free_part * min(fraction, real(1.0 - MIN_POROSITY))
    fields.grain_part[n] = part if wet > MIN_NODE_FILL else free_part
    fields.grain_scale[n] = fields.grain_part[n] / grains
    return free_part - part


@always_inline
def _share_beyond(b, q, axis, lattice, walls, dx, colliders):
    """Return what a collider has of the node beyond a wall across an axis, 1 on no such wall.

    What moves along a wall pushes there as elsewhere, and so does what passes through it; a
    collider that leaves it does not.
    """
    index = node_index(b, q, axis, lattice)
    if 0 < index < walls.cells[axis]:
        return 1.0
    distance = distance_beside(b, q, axis, -1 if index <= 0 else 1, lattice, colliders)
    return half_space_fraction(distance / dx) if distance < np.inf else 0.0


@kernel
def set_cells(rows, lattice, guess_scale, has_solids, has_grains, fields, level):
    """Find the cells of some blocks that hold liquid, and their right-hand side and first phi.

    Args:
        rows: Blocks to process, shape (n,).
        lattice: Blocks, Lattice.
        guess_scale: Factor of the nodes' guess [1/s].
        has_solids, has_grains: Whether deformable solids, and grains of sands, have parts of
            nodes.
        fields: PressureFields (in/out).
        level: LevelFields (in/out).
    """
    high, region, u = pointer(lattice.high), pointer(fields.region), pointer(level.u)
    inverse, amount, guess = pointer(level.inverse), pointer(fields.fill), pointer(fields.guess)
    filled, phi = pointer(fields.filled), pointer(fields.phi)
    scale, residual = pointer(level.scale), pointer(level.residual)
    correction, remainder = pointer(level.correction), pointer(level.remainder)
    free_part, empty = pointer(fields.free_part), pointer(fields.empty)
    solid_part, liquid_part = pointer(fields.solid_part), pointer(fields.share)
    pinned_part = pointer(fields.pinned_part)
    excess, covered = pointer(fields.excess), pointer(fields.covered)
    grains = pointer(fields.grain_part)
    for b in rows:
        for x in range(4):
            c = 64 * b + 16 * x
            fill, free = mean_of_nodes(amount, high, b, x), mean_of_nodes(free_part, high, b, x)
            share = 0.5 * mean_of_axes(inverse, high, b, x)
            zero = 0.0 * fill
            is_covered = free <= zero + MIN_FREE_PART
            if has_grains:
                grain = mean_of_nodes(grains, high, b, x)
                is_covered = free + grain <= zero + MIN_FREE_PART
            relative = fill / np.maximum(free, zero + MIN_PORE)
            is_own = load(region, c) > zero
            may_hold = is_own & (share > zero)
            is_wet = may_hold & ~is_covered & (relative >= zero + SURFACE_FILL)
            store(filled, c, select(is_wet, relative, zero))
            store(excess, c, fill - free)
            store(covered, c, select(is_covered & is_own, zero + 1.0, zero))
            borders_air = mean_of_nodes(empty, high, b, x) > zero
            if has_solids:  # a solid feels no pressure within, and the system would be singular
                part = mean_of_nodes(solid_part, high, b, x)
                part = part - mean_of_nodes(pinned_part, high, b, x)
                pore = mean_of_nodes(liquid_part, high, b, x)
                borders_air = borders_air | ((part > zero + 0.5) & (pore < zero + MIN_PORE))
            may_hold = is_wet | (may_hold & is_covered & ~borders_air)
            store(scale, c, select(may_hold, 1.0 / select(may_hold, share, zero + 1.0), zero))
            store(residual, c, select(may_hold, zero - divergence(u, high, b, x), zero))
            first = guess_scale * mean_of_nodes(guess, high, b, x)
            has_liquid = fill > zero + MIN_NODE_FILL
            first = first * select(is_covered, 1.0 / select(has_liquid, fill, zero + 1.0),
                                   1.0 / np.maximum(free, zero + MIN_PORE))  # fmt: skip
            store(phi, c, select(may_hold, first, zero))
            store(correction, c, zero)
            store(remainder, c, zero)


@always_inline
def _lowest_neighbors(cover, neighbors, b, x):
    """Return the smallest numbers of the nine cells around each cell of plane x, from -1 to 4."""
    first, plane = 27 * b + 9, 16 * x
    if x < 0:
        first, plane = 27 * b, 48
    if x > 3:
        first, plane = 27 * b + 18, 0
    low = _lowest_along_z(cover, neighbors, first, plane)
    own = _lowest_along_z(cover, neighbors, first + 3, plane)
    high = _lowest_along_z(cover, neighbors, first + 6, plane)
    sides = np.minimum(shift_from_south(low, own), shift_from_north(own, high))
    return np.minimum(own, sides)


@always_inline
def _lowest_along_z(cover, neighbors, first, plane):
    """Return the smallest of the numbers of each cell and its two neighbors along z."""
    below = load(cover, 64 * neighbors[first] + plane)
    own = load(cover, 64 * neighbors[first + 1] + plane)
    above = load(cover, 64 * neighbors[first + 2] + plane)
    sides = np.minimum(shift_from_below(below, own), shift_from_above(own, above))
    return np.minimum(own, sides)


@kernel
def spread_inward(rows, lattice, fields, level):
    """Let covered cells of some blocks have pressure if cells around them have it.

    Args:
        rows: Blocks to process, shape (n,).
        lattice: Blocks, Lattice.
        fields: PressureFields with 0 in `cover` at cells with pressure (in/out).
        level: LevelFields.
    """
    neighbors, cover = pointer(lattice.neighbors), pointer(fields.cover)
    filled, covered, scale = pointer(fields.filled), pointer(fields.covered), pointer(level.scale)
    for b in rows:
        low = _lowest_neighbors(cover, neighbors, b, -1)
        own = _lowest_neighbors(cover, neighbors, b, 0)
        for x in range(4):
            c = 64 * b + 16 * x
            high = _lowest_neighbors(cover, neighbors, b, x + 1)
            lowest = np.minimum(own, np.minimum(low, high))
            zero = 0.0 * lowest
            gains = (lowest <= zero) & (load(covered, c) > zero) & (load(scale, c) > zero)
            store(filled, c, select(gains, zero + 1.0, load(filled, c)))
            low, own = own, high


@kernel
def set_excess(rows, lattice, fields, level):
    """Set the system of the correction of positions: what the cells of some blocks hold above 1.

    Cells that hold less count only where all cells around them hold liquid.

    Args:
        rows: Blocks to process, shape (n,).
        lattice: Blocks, Lattice.
        fields: PressureFields.
        level: LevelFields (in/out).
    """
    neighbors, cover, filled = (
        pointer(lattice.neighbors),
        pointer(fields.cover),
        pointer(fields.filled),
    )
    residual, surplus = pointer(level.residual), pointer(fields.excess)
    for b in rows:
        low = _lowest_neighbors(cover, neighbors, b, -1)
        own = _lowest_neighbors(cover, neighbors, b, 0)
        for x in range(4):
            c = 64 * b + 16 * x
            high = _lowest_neighbors(cover, neighbors, b, x + 1)
            lowest = np.minimum(own, np.minimum(low, high))
            fill = load(filled, c)
            zero = 0.0 * fill
            excess = load(surplus, c)
            excess = select(lowest > zero, excess, np.maximum(excess, zero))
            store(residual, c, select(fill > zero, excess, zero))
            low, own = own, high


@kernel
def add_velocities(rows, liquids, fields, level, velocity):
    """Add what u is for each liquid to the velocities of the nodes of some blocks.

    Args:
        rows: Blocks to process, shape (n,).
        liquids: LiquidRows.
        fields: PressureFields.
        level: LevelFields with responses to the potential in u.
        velocity: Velocities [m/s], shape (rows, 256) (in/out).
    """
    size = level.u.dtype.type(liquids.dx)
    for b in rows:
        for r in range(liquids.first[b], liquids.first[b + 1]):
            for q in range(64):
                share = fields.share[64 * b + q]
                per_share = size * part_of_row(r, q, liquids)
                if 0 < share < 1:
                    per_share /= share
                for a in range(3):
                    velocity[r, 4 * q + a] += per_share * level.u[192 * b + 64 * a + q]


@kernel
def store_node_pressure(rows, lattice, pressure_scale, fields):
    """Store the mean pressure of the liquid around the nodes of some blocks, in place of `guess`.

    Args:
        rows: Blocks to process, shape (n,).
        lattice: Blocks, Lattice.
        pressure_scale: Relative pressure per phi [s].
        fields: PressureFields (in/out).
    """
    low, phi = pointer(lattice.low), pointer(fields.phi)
    filled, guess = pointer(fields.filled), pointer(fields.guess)
    for b in rows:
        p, _, _ = differences_below(phi, low, 8 * b + 4, 48)
        v, _, _ = differences_below(filled, low, 8 * b + 4, 48)
        for x in range(4):
            p_next, _, _ = differences_below(phi, low, 8 * b, 16 * x)
            v_next, _, _ = differences_below(filled, low, 8 * b, 16 * x)
            total, fill = p + p_next, v + v_next
            zero = 0.0 * total
            mean = pressure_scale * total / select(fill > zero, fill, zero + 1.0)
            mean = np.minimum(np.maximum(mean, zero + MIN_PRESSURE), zero + MAX_PRESSURE)
            store(guess, 64 * b + 16 * x, mean)
            p, v = p_next, v_next


@kernel
def store_moves(rows, liquids, fields, level, moves):
    """Store displacements [cells] and relative pressure of the nodes of some blocks.

    Args:
        rows: Blocks to process, shape (n,).
        liquids: LiquidRows.
        fields: PressureFields with pressures in `guess`.
        level: LevelFields with displacements in u.
        moves: Displacement, pressure, shape (rows, 256) (out).
    """
    limit = level.u.dtype.type(MAX_MOVE)
    for b in rows:
        for r in range(liquids.first[b], liquids.first[b + 1]):
            for q in range(64):
                share, per_share = fields.share[64 * b + q], part_of_row(r, q, liquids)
                if 0 < share < 1:
                    per_share /= share
                for a in range(3):
                    move = per_share * level.u[192 * b + 64 * a + q]
                    moves[r, 4 * q + a] = min(max(move, -limit), limit)
                moves[r, 4 * q + 3] = fields.guess[64 * b + q]
