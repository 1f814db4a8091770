"""Nodes of a solid that answer to impulses together: their masses, and light nodes in tow.

A node that holds little of a solid has next to no mass, yet the stiffness of the cells around it is
that of its neighbors. It follows these: its velocity is their mean T, by mass, and they take its
mass and its impulses by T^T. So the masses that are left bound the stiffness, and momentum is
exact. Light nodes without a heavy neighbor are on their own. What pulls a light node and its
neighbors apart moves both, so that at rest the forces of each node balance, and moments do.

A node that a pinned part holds is HELD_MASS times as heavy for the system: it does not move, and
what it takes up of the impulses is known to the last digit.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.kernels.grid.cell_stiffness import CELLS
from vgmpi.kernels.grid.phase_nodes import (
    EDGE,
    PATCH,
    count_images,
    gather_patch,
    node_index_of,
)
from vgmpi.kernels.simd.vector16 import load, pointer, store
from vgmpi.kernels.wall_boundary import OPEN, SLIP, STICK
from vgmpi.materials.tensor_math.select import select
from vgmpi.runtime.aligned_arrays import aligned_zeros
from vgmpi.runtime.jit import always_inline, kernel

BORDER = 48  # numbers around a patch, of which EDGE^2 and a vector are read
# [-] No cell is stiffer than one so many times as full as the lightest of its nodes with what
# follows it: this bounds the eigenvalues.
MAX_CELL_FILL = 2.0
MIN_NODE_FILL = 1e-9  # [-] lighter nodes have no velocity
HEAVY_FILL = 0.1  # [-] nodes that hold less, relative to the fullest around them, follow others
RELATIVE_RESPONSE = 0.5  # [-] factor: the neighbors of light nodes are light, too
HELD_MASS = 2.0**30  # [-] factor on the mass of nodes that are held


class SolidFields(NamedTuple):
    """Numbers of the nodes and cells of a solid in blocks, flat, in the working precision.

    A block has 64 numbers of nodes, or 192 in three directions, axis after axis.
    """

    fill: np.ndarray  # filled share of the space around a node
    mass: np.ndarray  # mass of a node, relative to a full cell's
    loose: np.ndarray  # 1 for the directions in which no wall holds a node, 192 of a block
    follows: np.ndarray  # inverse sum of the weights of the neighbors that a light node follows
    is_heavy: np.ndarray  # 1 for nodes that follow none
    is_attached: np.ndarray  # 1 for nodes that are heavy or follow others
    inverse: np.ndarray  # inverse of the mass of a node and of what follows it
    support: np.ndarray  # that mass, with images at walls; of light nodes that of what they follow
    inverse_own: np.ndarray  # inverse of the mass of a node alone
    relative_response: np.ndarray  # of a light node and what it follows to what pulls them apart
    is_held: np.ndarray  # 1 for nodes that a pinned part holds
    uptake: np.ndarray  # impulse over mass and change of velocity: 1, but vast for those nodes
    cells: np.ndarray  # stiffness of the 5 x 5 x 5 cells of a block, in its patch, PATCH numbers


def solid_fields(blocks: int, real: np.dtype) -> SolidFields:
    """Return fields of zeros for some blocks and the row of no block."""
    sizes = (64, 64, 192, 64, 64, 64, 64, 64, 64, 64, 64, 64, PATCH)
    return SolidFields(*(aligned_zeros((blocks + 1) * size, real) for size in sizes))


class Ties(NamedTuple):
    """Ties of nodes to others: each of `nodes` with its `others` and their weights."""

    nodes: np.ndarray  # (n,) 64 block + number in it
    first: np.ndarray  # (n + 1,) first tie of each
    others: np.ndarray  # (ties,) 64 block + number in it
    weights: np.ndarray  # (ties,)


@kernel
def set_nodes(rows, nodes, walls, unit, velocity, nodal, marks, fields):
    """Read the nodes of some blocks, and what walls and pinned parts hold of them.

    Args:
        rows: Blocks to process, shape (n,).
        nodes: PhaseNodes.
        walls: Walls of the domain.
        unit: Mass of a full cell [kg].
        velocity: Velocity [m/s] and mass [kg], shape (node blocks, 256).
        nodal: Stress impulses [kg m/s], shape (node blocks, 256).
        marks: 1 at nodes that pinned parts hold, shape (node blocks, 64), or no rows.
        fields: SolidFields (out).
    """
    real, kinds, extent = fields.fill.dtype.type, walls.kinds_for_solids, walls.cells
    per_cell = real(1.0 / unit)
    for b in rows:
        nb, at_wall = nodes.node_block[b], _is_at_wall(nodes.block[b], extent)
        for q in range(64):
            mass = velocity[nb, 4 * q + 3] * per_cell
            images, is_inside = 1, True
            if at_wall:
                images, is_inside = count_images(nodes.block[b], q, kinds, extent)
            is_own = is_inside and nodes.region[b, q]
            counts = is_own and mass > MIN_NODE_FILL
            fields.mass[64 * b + q] = mass if counts else real(0)
            fields.fill[64 * b + q] = real(images) * mass if counts else real(0)
            is_held = counts and len(marks) > 0 and marks[nb, q] > 0
            fields.is_held[64 * b + q] = real(1) if is_held else real(0)
            fields.uptake[64 * b + q] = real(HELD_MASS) if is_held else real(1)
            own = mass * fields.uptake[64 * b + q]
            fields.inverse_own[64 * b + q] = real(1) / own if counts else real(0)
            for a in range(3):
                is_loose = is_own
                if at_wall and is_own:
                    speed = velocity[nb, 4 * q + a]
                    pulled = speed + nodal[nb, 4 * q + a] / (mass * unit) if counts else speed
                    is_loose = not (
                        _is_held(nodes.block[b], q, a, speed, kinds, extent)
                        and _is_held(nodes.block[b], q, a, pulled, kinds, extent)
                    )
                fields.loose[192 * b + 64 * a + q] = real(1) if is_loose else real(0)


@always_inline
def _is_at_wall(block, extent):
    """Return whether a block has nodes on the walls or beyond them."""
    result = False
    for a in range(3):
        first = node_index_of(block, 0, a)
        result = result or first <= 0 or first + 3 >= extent[a]
    return result


@always_inline
def _is_held(block, q, axis, speed, kinds, extent):
    """Return whether a wall holds a node along an axis, or stops its speed."""
    for a in range(3):
        node = node_index_of(block, q, a)
        for side in range(2):
            if node == side * extent[a]:
                kind = kinds[a, side]
                leaves = speed > 0 if side == 0 else speed < 0
                if kind == STICK or (a == axis and (kind == SLIP or (kind != OPEN and not leaves))):
                    return True
    return False


@always_inline
def _weight(i, j, k):
    """Return the weight of a neighbor by its place: 1, 1/2 and 1/4 across faces, edges, corners."""
    distance = abs(i - 1) + abs(j - 1) + abs(k - 1)
    return 1.0 if distance == 1 else (0.5 if distance == 2 else 0.25)


@always_inline
def _place(q):
    """Return the place of a node of a block in its patch."""
    return EDGE * (EDGE * (q // 16 + 1) + q // 4 % 4 + 1) + q % 4 + 1


@kernel
def find_heavy_nodes(rows, neighbors, fields):
    """Find the nodes of some blocks that hold enough beside the fullest one around them.

    Args:
        rows: Blocks to process, shape (n,).
        neighbors: Rows of the 27 blocks around each, flat.
        fields: SolidFields, with the fill around the nodes of this rank (in/out).
    """
    real = fields.fill.dtype.type
    patch, line, plane, fullest = _wide_patches(fields.fill.dtype)
    for b in rows:
        gather_patch(fields.fill, 64, 0, neighbors, b, patch, BORDER)
        _take_largest(pointer(patch), pointer(line), 1)
        _take_largest(pointer(line), pointer(plane), EDGE)
        _take_largest(pointer(plane), pointer(fullest), EDGE * EDGE)
        for q in range(64):
            place = BORDER + _place(q)
            is_heavy = patch[place] > 0 and (
                patch[place] >= real(HEAVY_FILL) * fullest[place] or fields.is_held[64 * b + q] > 0
            )
            fields.is_heavy[64 * b + q] = real(1) if is_heavy else real(0)


@always_inline
def _wide_patches(real):
    """Return four patches with room around them."""
    size = PATCH + 2 * BORDER
    return np.zeros(size, real), np.zeros(size, real), np.zeros(size, real), np.zeros(size, real)


@always_inline
def _take_largest(values, out, step):
    """Set a patch to the largest numbers of each place and the two beside it along an axis."""
    for c in range(BORDER, BORDER + PATCH, 16):
        larger = np.maximum(load(values, c - step), load(values, c + step))
        store(out, c, np.maximum(load(values, c), larger))


@always_inline
def _add_half_beside(values, out, step):
    """Set a patch to the numbers of each place and half of the two beside it along an axis."""
    for c in range(BORDER, BORDER + PATCH, 16):
        sums = load(values, c - step) + load(values, c + step)
        store(out, c, load(values, c) + 0.5 * sums)


@kernel
def attach_nodes(rows, neighbors, fields):
    """Find the neighbors that the light nodes of some blocks follow.

    Args:
        rows: Blocks to process, shape (n,).
        neighbors: Rows of the 27 blocks around each, flat.
        fields: SolidFields, with heavy nodes around those of this rank (in/out).
    """
    real = fields.fill.dtype.type
    patch, line, plane, sums = _wide_patches(fields.fill.dtype)
    heavy = np.zeros(PATCH + 2 * BORDER, fields.fill.dtype)
    for b in rows:
        gather_patch(fields.fill, 64, 0, neighbors, b, patch, BORDER)
        gather_patch(fields.is_heavy, 64, 0, neighbors, b, heavy, BORDER)
        for place in range(BORDER, BORDER + PATCH):
            patch[place] *= heavy[place]
        _add_half_beside(pointer(patch), pointer(line), 1)
        _add_half_beside(pointer(line), pointer(plane), EDGE)
        _add_half_beside(pointer(plane), pointer(sums), EDGE * EDGE)
        for q in range(64):
            n, first, place = 64 * b + q, 192 * b + q, BORDER + _place(q)
            is_loose = (
                fields.loose[first] + fields.loose[first + 64] + fields.loose[first + 128] > 0
            )
            is_light = not heavy[place] > 0
            # twice the sum: see the weights of `_weight`
            total = real(2) * sums[place] if is_light and is_loose else real(0)
            fields.follows[n] = real(1) / total if total > 0 else real(0)
            is_attached = not is_light or total > 0
            fields.is_attached[n] = real(1) if is_attached else real(0)


@kernel
def set_cells(rows, neighbors, is_cell, stiffness, fields):
    """Set the stiffness of the cells of some blocks, each as full as its nodes are in the mean.

    MAX_CELL_FILL bounds it. Cells have none unless all their nodes are heavy or follow others.

    Args:
        rows: Blocks to process, shape (n,).
        neighbors: Rows of the 27 blocks around each, flat.
        is_cell: See `cells_of_patch`.
        stiffness: Factor of a full cell.
        fields: SolidFields, with nodes around those of this rank (in/out).
    """
    fill, attached = np.zeros(PATCH, fields.fill.dtype), np.zeros(PATCH, fields.fill.dtype)
    support = np.zeros(PATCH, fields.fill.dtype)
    limit = fields.fill.dtype.type(MAX_CELL_FILL)
    marks, cells = pointer(is_cell), pointer(fields.cells)
    for b in rows:
        gather_patch(fields.fill, 64, 0, neighbors, b, fill, 0)
        gather_patch(fields.is_attached, 64, 0, neighbors, b, attached, 0)
        gather_patch(fields.support, 64, 0, neighbors, b, support, 0)
        for c in range(0, CELLS, 16):
            lowest = limit * _least_of_nodes(pointer(support), c)
            total, tied = _sum_of_nodes(pointer(fill), c), _sum_of_nodes(pointer(attached), c)
            value = stiffness * load(marks, c) * np.minimum(0.125 * total, lowest)
            store(
                cells,
                PATCH * b + c,
                select(tied > 7.5 + 0.0 * tied, value, 0.0 * value),
            )


@always_inline
def _least_of_nodes(values, c):
    """Return the smallest of the numbers of the eight nodes of cells."""
    low = np.minimum(
        np.minimum(load(values, c), load(values, c + 1)),
        np.minimum(load(values, c + 6), load(values, c + 7)),
    )
    high = np.minimum(
        np.minimum(load(values, c + 36), load(values, c + 37)),
        np.minimum(load(values, c + 42), load(values, c + 43)),
    )
    return np.minimum(low, high)


@always_inline
def _sum_of_nodes(values, c):
    """Return the sums over the eight nodes of cells."""
    low = (load(values, c) + load(values, c + 1)) + (load(values, c + 6) + load(values, c + 7))
    high = load(values, c + 36) + load(values, c + 37)
    return low + (high + (load(values, c + 42) + load(values, c + 43)))


@kernel
def find_ties(rows, neighbors, fields, of_light, counts, ties):
    """Find which nodes the light nodes of some blocks follow, or which ones follow the heavy ones.

    Args:
        rows: Blocks to process, shape (n,).
        neighbors: Rows of the 27 blocks around each, flat.
        fields: SolidFields, with nodes around those of this rank.
        of_light: Whether the nodes are those that follow.
        counts: Number of nodes and of ties (out); what has no place is counted only.
        ties: Room for the ties (out).
    """
    real = fields.fill.dtype.type
    fill, follows = np.zeros(PATCH, fields.fill.dtype), np.zeros(PATCH, fields.fill.dtype)
    heavy = np.zeros(PATCH, fields.fill.dtype)
    number, count = 0, 0
    for b in rows:
        gather_patch(fields.fill, 64, 0, neighbors, b, fill, 0)
        gather_patch(fields.is_heavy, 64, 0, neighbors, b, heavy, 0)
        gather_patch(fields.follows, 64, 0, neighbors, b, follows, 0)
        for q in range(64):
            place, before = _place(q), count
            if (follows[place] > 0) != of_light or (not of_light and not heavy[place] > 0):
                continue
            for o in range(27):
                i, j, k = o // 9, o // 3 % 3, o % 3
                other = place + EDGE * (EDGE * (i - 1) + j - 1) + k - 1
                weight = real(0)
                if of_light and heavy[other] > 0:
                    weight = real(_weight(i, j, k)) * fill[other] * follows[place]
                elif not of_light and follows[other] > 0 and o != 13:
                    weight = real(_weight(i, j, k)) * fill[place] * follows[other]
                if weight > 0:
                    if count < len(ties.others):
                        ties.others[count] = _neighbor(b, q, i, j, k, neighbors)
                        ties.weights[count] = weight
                    count += 1
            if count > before:
                if number < len(ties.nodes):
                    ties.nodes[number], ties.first[number + 1] = 64 * b + q, count
                number += 1
    counts[0], counts[1] = number, count


@always_inline
def _neighbor(b, q, i, j, k, neighbors):
    """Return 64 block + number of the node beside a node, at the place (i, j, k) of 3 x 3 x 3."""
    x, y, z = q // 16 + i + 3, q // 4 % 4 + j + 3, q % 4 + k + 3
    block = neighbors[27 * b + 9 * (x // 4) + 3 * (y // 4) + z // 4]
    return 64 * block + 16 * (x % 4) + 4 * (y % 4) + z % 4


@kernel
def set_inverse(rows, ties, fields):
    """Set the inverse masses of the nodes of some blocks with what follows them.

    Args:
        rows: Blocks to process, shape (n,).
        ties: Ties of heavy nodes to those that follow them.
        fields: SolidFields, with masses around the nodes of this rank (in/out).
    """
    real = fields.fill.dtype.type
    for b in rows:
        for n in range(64 * b, 64 * (b + 1)):
            is_own = fields.mass[n] > 0 and not fields.follows[n] > 0
            fields.inverse[n] = real(1) / fields.mass[n] if is_own else real(0)
    for t in range(len(ties.nodes)):
        n = ties.nodes[t]
        total = fields.mass[n]
        for k in range(ties.first[t], ties.first[t + 1]):
            total += ties.weights[k] * fields.mass[ties.others[k]]
        if fields.inverse[n] > 0:
            fields.inverse[n] = real(1) / total


@kernel
def set_support(rows, ties, fields):
    """Set the support of the nodes of some blocks.

    Args:
        rows: Blocks to process, shape (n,).
        ties: Ties of light nodes to those that they follow.
        fields: SolidFields, with inverse masses around the nodes of this rank (in/out).
    """
    real = fields.fill.dtype.type
    for b in rows:
        for n in range(64 * b, 64 * (b + 1)):
            if fields.is_held[n] > 0:  # nothing bounds the stiffness beside it
                fields.support[n] = real(1)
            elif fields.is_heavy[n] > 0 and fields.inverse[n] > 0:
                images = fields.fill[n] / fields.mass[n]
                fields.support[n] = images / fields.inverse[n]
            else:
                fields.support[n] = real(0)
    for t in range(len(ties.nodes)):
        total = real(0)
        for k in range(ties.first[t], ties.first[t + 1]):
            inverse = fields.inverse[ties.others[k]]
            total += ties.weights[k] / inverse if inverse > 0 else real(0)
        fields.support[ties.nodes[t]] = total


@kernel
def hold_nodes(rows, fields):
    """Make the nodes of some blocks that pinned parts hold as heavy as such nodes are.

    Args:
        rows: Blocks to process, shape (n,).
        fields: SolidFields (inverse in/out).
    """
    for b in rows:
        for n in range(64 * b, 64 * (b + 1)):
            if fields.is_held[n] > 0:
                fields.inverse[n] = fields.inverse_own[n]


@kernel
def set_relative_response(rows, ties, trace, fields):
    """Set by what part light nodes move apart from their neighbors, as stiff as the cells there.

    Args:
        rows: Blocks to process, shape (n,): those of the ties.
        ties: Ties of light nodes to those that they follow.
        trace: See kernels/grid/cell_stiffness.py, of each block, shape (n,).
        fields: SolidFields (relative_response in/out).
    """
    real = fields.fill.dtype.type
    for n in ties.nodes:
        diagonal = (real(4) - trace[n // 64]) / real(9)  # of a cell
        first, total = PATCH * (n // 64) + _place(n % 64), real(0)
        for o in range(8):
            total += fields.cells[first - o % 2 - EDGE * (o // 2 % 2) - EDGE * EDGE * (o // 4)]
        mass = fields.mass[n]
        part = mass / (mass + diagonal * total) if mass > 0 else real(0)
        fields.relative_response[n] = real(RELATIVE_RESPONSE) * part
