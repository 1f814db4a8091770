"""Differences and means between cells and their nodes, for planes of 16 in blocks of 64.

A cell stands in the place of its lowest node; a plane of 16 is a vector. Tables of neighbors have
eight blocks: bit 2 of the index steps along x, bit 1 along y, bit 0 along z, down in `low` and up
in `high`. Each cell and each node sums in one order, so that the result does not depend on ranks
and threads.
"""

from vgmpi.kernels.simd.row_ops import (
    shift_from_above,
    shift_from_below,
    shift_from_north,
    shift_from_south,
)
from vgmpi.kernels.simd.vector16 import load
from vgmpi.kernels.wall_boundary import OPEN, RELEASING, SLIP, STICK
from vgmpi.runtime.jit import always_inline


@always_inline
def _cells_below(values, blocks, first, plane):
    """Return the plane of cells, and those one step down along z, along y, and along both."""
    own = load(values, 64 * blocks[first] + plane)
    below = load(values, 64 * blocks[first + 1] + plane)
    south = load(values, 64 * blocks[first + 2] + plane)
    south_below = load(values, 64 * blocks[first + 3] + plane)
    z = shift_from_below(below, own)
    both = shift_from_south(shift_from_below(south_below, south), z)
    return own, z, shift_from_south(south, own), both


@always_inline
def _nodes_above(values, size, blocks, first, plane):
    """Return the plane of nodes, and those one step up along z, along y, and along both.

    Args:
        values: Nodal numbers, flat.
        size: Numbers of a block.
        blocks: Blocks at and above.
        first: First of four of them.
        plane: Offset of the plane in a block.
    """
    own = load(values, size * blocks[first] + plane)
    above = load(values, size * blocks[first + 1] + plane)
    north = load(values, size * blocks[first + 2] + plane)
    north_above = load(values, size * blocks[first + 3] + plane)
    z = shift_from_above(own, above)
    both = shift_from_north(z, shift_from_above(north, north_above))
    return own, z, shift_from_north(own, north), both


@always_inline
def _nodes_of_cells(values, size, blocks, b, x, offset):
    """Return the numbers of the eight nodes of the cells of a plane, west and east.

    Args:
        values: Nodal numbers, flat.
        size: Numbers of a block.
        blocks: Blocks at and above each block, eight of them.
        b: Block.
        x: Number of the plane in the block.
        offset: Offset of the numbers in a block.
    """
    first, plane = (8 * b, 16 * (x + 1)) if x < 3 else (8 * b + 4, 0)
    west = _nodes_above(values, size, blocks, 8 * b, offset + 16 * x)
    return west, _nodes_above(values, size, blocks, first, offset + plane)


@always_inline
def differences_below(values, blocks, first, plane):
    """Return sum, difference along y and difference along z of the four cells at each node.

    Args:
        values: Numbers of cells, flat.
        blocks: Blocks at and below.
        first: First of four of them.
        plane: Offset of the plane in a block.
    """
    own, z, y, both = _cells_below(values, blocks, first, plane)
    return (both + y) + (z + own), (both + y) - (z + own), (both + z) - (y + own)


@always_inline
def mean_of_nodes(values, blocks, b, x):
    """Return the means over the eight nodes of the cells of a plane.

    Args:
        values: Numbers of nodes, flat.
        blocks: Blocks at and above each block, eight of them.
        b: Block.
        x: Number of the plane in the block.
    """
    (o, z, y, yz), (p, pz, py, pyz) = _nodes_of_cells(values, 64, blocks, b, x, 0)
    return 0.125 * (((o + z) + (y + yz)) + ((p + pz) + (py + pyz)))


@always_inline
def mean_of_axes(inverse, blocks, b, x):
    """Return the means over the eight nodes of the sums of the inverse masses over the axes.

    Args:
        inverse: Inverse masses of nodes, three of each, flat.
        blocks: Blocks at and above each block, eight of them.
        b: Block.
        x: Number of the plane in the block.
    """
    total = 0.0 * load(inverse, 192 * b)
    for a in range(3):
        (o, z, y, yz), (p, pz, py, pyz) = _nodes_of_cells(inverse, 192, blocks, b, x, 64 * a)
        total = total + (((o + z) + (y + yz)) + ((p + pz) + (py + pyz)))
    return 0.125 * total


@always_inline
def divergence(u, blocks, b, x):
    """Return the divergence of the nodal velocities in the cells of a plane.

    Args:
        u: Velocities of nodes, flat.
        blocks: Blocks at and above each block, eight of them.
        b: Block.
        x: Number of the plane in the block.
    """
    (o, z, y, yz), (p, pz, py, pyz) = _nodes_of_cells(u, 192, blocks, b, x, 0)
    total = ((p + pz) + (py + pyz)) - ((o + z) + (y + yz))
    (o, z, y, yz), (p, pz, py, pyz) = _nodes_of_cells(u, 192, blocks, b, x, 64)
    total = total + (((y + yz) - (o + z)) + ((py + pyz) - (p + pz)))
    (o, z, y, yz), (p, pz, py, pyz) = _nodes_of_cells(u, 192, blocks, b, x, 128)
    return 0.25 * (total + (((z + yz) - (o + y)) + ((pz + pyz) - (p + py))))


@always_inline
def corner_node(b, q, corner, lattice):
    """Return the block and the number in it of a node of a cell.

    Args:
        b, q: Block and number of the cell.
        corner: Which of its nodes: bit 2 of it steps along x, bit 1 along y, bit 0 along z.
        lattice: Blocks, Lattice.
    """
    x, y, z = q // 16 + corner // 4, q // 4 % 4 + corner // 2 % 2, q % 4 + corner % 2
    block = lattice.high[8 * b + 4 * (x // 4) + 2 * (y // 4) + z // 4]
    return block, 16 * (x % 4) + 4 * (y % 4) + z % 4


@always_inline
def corner_sign(corner, axis):
    """Return 1 for a node at the upper side of its cell along an axis, else -1."""
    return 1.0 if corner // (4 if axis == 0 else (2 if axis == 1 else 1)) % 2 else -1.0


@always_inline
def node_index(b, q, axis, lattice):
    """Return the index in the domain of a node of a block along an axis.

    Args:
        b, q: Block, and number of the node in it.
        axis: The axis.
        lattice: Blocks, Lattice.
    """
    step = q // 16 if axis == 0 else (q // 4 % 4 if axis == 1 else q % 4)
    return 4 * lattice.block[b, axis] - 1 + step


@always_inline
def count_images(b, q, lattice, walls):
    """Return how many images a node stands for: twice as many on a wall, 0 beyond the domain.

    Args:
        b, q: Block, and number of the node in it.
        lattice: Blocks, Lattice.
        walls: Walls of the domain.
    """
    images = 1
    for a in range(3):
        node = node_index(b, q, a, lattice)
        for side in range(2):
            if node == side * walls.cells[a] and walls.kinds[a, side] != OPEN:
                images *= 2
        if not (0 <= node <= walls.cells[a]):
            images = 0
    return images


@always_inline
def holding_wall(b, q, axis, lattice, walls):
    """Return the number of a wall that holds a node along an axis, west to roof, or -1.

    Args:
        b, q, axis, lattice: See `node_index`.
        walls: Walls of the domain.
    """
    stick = -1
    for a in range(3):
        node = node_index(b, q, a, lattice)
        if 0 < node < walls.cells[a]:
            continue
        side = 0 if node <= 0 else 1
        kind = walls.kinds[a, side]
        if a == axis and kind in (STICK, SLIP, RELEASING):
            return 2 * a + side
        if kind == STICK:
            stick = 2 * a + side
    return stick


@always_inline
def is_held(b, q, axis, lattice, walls):
    """Return whether a wall holds a node along an axis.

    Args:
        b, q, axis, lattice, walls: See `holding_wall`.
    """
    return holding_wall(b, q, axis, lattice, walls) >= 0
