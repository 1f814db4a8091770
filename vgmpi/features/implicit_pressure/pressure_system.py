"""System of the implicit pressure: cells that hold liquid, and sweeps that relax it.

Potentials phi belong to cells, velocities to nodes [cells/s]. With D the divergence of the eight
nodes of a cell and M the masses of the nodes, relative to that of a full cell,

    D M^-1 D^T phi = right,        u = u + M^-1 D^T phi.

A block has 64 cells, each in the place of its lowest node; a plane of 16 is a vector. Tables
of neighbors have eight blocks: bit 2 of the index steps along x, bit 1 along y, bit 0 along z, down
in `low` and up in `high`. Each cell and each node sums in one order, so that the result does not
depend on ranks and threads (docs/explanation/implicit-pressure.md).
"""

from typing import NamedTuple

import numpy as np

from vgmpi.kernels.simd.row_ops import (
    shift_from_above,
    shift_from_below,
    shift_from_north,
    shift_from_south,
)
from vgmpi.kernels.simd.vector16 import load, pointer, store
from vgmpi.kernels.wall_boundary import SLIP, STICK
from vgmpi.materials.tensor_math.select import select
from vgmpi.runtime.jit import always_inline, kernel

SURFACE_FILL = 0.5  # [-] cells that are filled less have no pressure: they are the surface
MIN_NODE_FILL = 1e-9  # [-] lighter nodes do not respond
MAX_MOVE = 0.3  # [cells] largest correction of a position along an axis in a step
MIN_PRESSURE, MAX_PRESSURE = -0.9, 15.0  # [-] of particles, relative to the Tait coefficient


class Lattice(NamedTuple):
    """Node blocks of a rank and their neighbors; the last row of all arrays is that of no block."""

    block: np.ndarray  # (n, 3) block coordinates
    low: np.ndarray  # (8 n,) blocks at and below each, see above
    high: np.ndarray  # (8 n,) blocks at and above each
    neighbors: np.ndarray  # (27 n,) blocks around each
    region: np.ndarray  # (64 n,) 1 for the cells that this rank computes, else 0


class PressureFields(NamedTuple):
    """Numbers of all cells and nodes, flat, in the working precision."""

    u: np.ndarray  # (192 (n + 1),) velocities or displacements, axis after axis in each block
    inverse: np.ndarray  # (192 (n + 1),) inverse masses by axis, 0 where a wall holds the node
    mass: np.ndarray  # (64 (n + 1),) of nodes; those on walls stand for both sides
    guess: np.ndarray  # (64 (n + 1),) pressure times filled share at the nodes, from particles
    filled: np.ndarray  # (64 (n + 1),) filled share of cells with pressure, else 0
    cover: np.ndarray  # (64 (n + 1),) above 0 in cells with liquid and beyond walls
    scale: np.ndarray  # (64 n,) inverse diagonal, 0 for cells without pressure
    right: np.ndarray  # (64 n,) right-hand side
    step: np.ndarray  # (64 n,) last change of phi
    phi: np.ndarray  # (64 (n + 1),) potential


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
def _differences_below(values, blocks, first, plane):
    """Return sum, difference along y and difference along z of the four cells at each node."""
    own, z, y, both = _cells_below(values, blocks, first, plane)
    return (both + y) + (z + own), (both + y) - (z + own), (both + z) - (y + own)


@kernel
def set_nodes(rows, lattice, cells, kinds, velocity, pressure, unit, dx, fields):
    """Read the nodes of some blocks.

    Args:
        rows: Blocks to process, shape (n,).
        lattice: Blocks, Lattice.
        cells: Cells of the domain, shape (3,).
        kinds: Kinds of the walls, shape (3, 2).
        velocity: Velocity [m/s] and mass [kg] of the nodes, shape (blocks, 256).
        pressure: Rest volume times relative pressure of the particles at the nodes [m3] as fourth
            number, shape (blocks, 256).
        unit: Mass of a full cell [kg].
        dx: Cell size [m].
        fields: PressureFields (out).
    """
    real = fields.mass.dtype.type
    per_cell, zero, unity = real(1.0 / unit), real(0.0), real(1.0)
    per_length, per_volume = real(1.0 / dx), real(1.0 / dx**3)
    for b in rows:
        for q in range(64):
            mass, images, inside = velocity[b, 4 * q + 3] * per_cell, unity, True
            for a in range(3):
                fields.u[192 * b + 64 * a + q] = velocity[b, 4 * q + a] * per_length
            inverse = unity / mass if mass > MIN_NODE_FILL else zero
            for a in range(3):
                fields.inverse[192 * b + 64 * a + q] = inverse
            for a in range(3):
                step = q // 16 if a == 0 else (q // 4 % 4 if a == 1 else q % 4)
                node = 4 * lattice.block[b, a] - 1 + step
                inside = inside and 0 <= node <= cells[a]
                if node == 0 or node == cells[a]:
                    kind = kinds[a, 0] if node == 0 else kinds[a, 1]
                    images *= real(2.0)
                    for c in range(3):
                        if kind == STICK or (kind == SLIP and c == a):
                            fields.inverse[192 * b + 64 * c + q] = zero
            if not inside:
                for a in range(3):
                    fields.inverse[192 * b + 64 * a + q] = zero
            fields.mass[64 * b + q] = images * mass if inside else zero
            guess = images * pressure[b, 4 * q + 3] * per_volume
            fields.guess[64 * b + q] = guess if inside else zero


@always_inline
def _mean_of_nodes(values, blocks, b, x):
    """Return the means over the eight nodes of the cells of a plane."""
    o, z, y, yz = _nodes_above(values, 64, blocks, 8 * b, 16 * x)
    first, plane = (8 * b, 16 * (x + 1)) if x < 3 else (8 * b + 4, 0)
    p, pz, py, pyz = _nodes_above(values, 64, blocks, first, plane)
    return 0.125 * (((o + z) + (y + yz)) + ((p + pz) + (py + pyz)))


@always_inline
def _shares_of_nodes(inverse, blocks, b, x):
    """Return the means over the eight nodes of the sums of the inverse masses over the axes."""
    total = 0.0 * load(inverse, 192 * b)
    first, plane = (8 * b, 16 * (x + 1)) if x < 3 else (8 * b + 4, 0)
    for a in range(3):
        o, z, y, yz = _nodes_above(inverse, 192, blocks, 8 * b, 64 * a + 16 * x)
        p, pz, py, pyz = _nodes_above(inverse, 192, blocks, first, 64 * a + plane)
        total = total + (((o + z) + (y + yz)) + ((p + pz) + (py + pyz)))
    return 0.125 * total


@always_inline
def _divergence(u, blocks, b, x):
    """Return the divergence of the nodal velocities in the cells of a plane."""
    first, plane = (8 * b, 16 * (x + 1)) if x < 3 else (8 * b + 4, 0)
    o, z, y, yz = _nodes_above(u, 192, blocks, 8 * b, 16 * x)
    p, pz, py, pyz = _nodes_above(u, 192, blocks, first, plane)
    total = ((p + pz) + (py + pyz)) - ((o + z) + (y + yz))
    o, z, y, yz = _nodes_above(u, 192, blocks, 8 * b, 64 + 16 * x)
    p, pz, py, pyz = _nodes_above(u, 192, blocks, first, 64 + plane)
    total = total + (((y + yz) - (o + z)) + ((py + pyz) - (p + pz)))
    o, z, y, yz = _nodes_above(u, 192, blocks, 8 * b, 128 + 16 * x)
    p, pz, py, pyz = _nodes_above(u, 192, blocks, first, 128 + plane)
    return 0.25 * (total + (((z + yz) - (o + y)) + ((pz + pyz) - (p + py))))


@kernel
def set_cells(rows, lattice, guess_scale, fields):
    """Find the cells of some blocks that hold liquid, and their right-hand side and first phi.

    Args:
        rows: Blocks to process, shape (n,).
        lattice: Blocks, Lattice.
        guess_scale: Factor of the nodes' guess [1/s].
        fields: PressureFields (in/out).
    """
    high, region, u = pointer(lattice.high), pointer(lattice.region), pointer(fields.u)
    inverse, mass, guess = pointer(fields.inverse), pointer(fields.mass), pointer(fields.guess)
    filled, scale, right = pointer(fields.filled), pointer(fields.scale), pointer(fields.right)
    phi, step = pointer(fields.phi), pointer(fields.step)
    for b in rows:
        for x in range(4):
            c = 64 * b + 16 * x
            fill = _mean_of_nodes(mass, high, b, x)
            share = 0.5 * _shares_of_nodes(inverse, high, b, x)
            zero = 0.0 * fill
            holds = (fill >= zero + SURFACE_FILL) & (load(region, c) > zero) & (share > zero)
            store(filled, c, select(holds, fill, zero))
            store(scale, c, select(holds, 1.0 / select(holds, share, zero + 1.0), zero))
            store(right, c, select(holds, zero - _divergence(u, high, b, x), zero))
            first = guess_scale * _mean_of_nodes(guess, high, b, x)
            store(phi, c, select(holds, first, zero))
            store(step, c, zero)


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
def set_excess(rows, lattice, fields):
    """Set the system of the correction of positions: what the cells of some blocks hold above 1.

    Cells that hold less count only where all cells around them hold liquid.

    Args:
        rows: Blocks to process, shape (n,).
        lattice: Blocks, Lattice.
        fields: PressureFields (in/out).
    """
    neighbors, cover, filled = (
        pointer(lattice.neighbors),
        pointer(fields.cover),
        pointer(fields.filled),
    )
    right, phi, step = pointer(fields.right), pointer(fields.phi), pointer(fields.step)
    for b in rows:
        low = _lowest_neighbors(cover, neighbors, b, -1)
        own = _lowest_neighbors(cover, neighbors, b, 0)
        for x in range(4):
            c = 64 * b + 16 * x
            high = _lowest_neighbors(cover, neighbors, b, x + 1)
            lowest = np.minimum(own, np.minimum(low, high))
            fill = load(filled, c)
            zero = 0.0 * fill
            excess = fill - 1.0
            excess = select(lowest > zero, excess, np.maximum(excess, zero))
            store(right, c, select(fill > zero, excess, zero))
            store(phi, c, zero)
            store(step, c, zero)
            low, own = own, high


@kernel
def respond(rows, lattice, fields):
    """Set u to M^-1 D^T phi at the nodes of some blocks.

    Args:
        rows: Blocks to process, shape (n,).
        lattice: Blocks, Lattice.
        fields: PressureFields (in/out).
    """
    low, phi = pointer(lattice.low), pointer(fields.phi)
    inverse, u = pointer(fields.inverse), pointer(fields.u)
    for b in rows:
        s, y, z = _differences_below(phi, low, 8 * b + 4, 48)
        for x in range(4):
            s_next, y_next, z_next = _differences_below(phi, low, 8 * b, 16 * x)
            first = 192 * b + 16 * x
            store(u, first, 0.25 * load(inverse, first) * (s - s_next))
            first += 64
            store(u, first, 0.25 * load(inverse, first) * (y + y_next))
            first += 64
            store(u, first, 0.25 * load(inverse, first) * (z + z_next))
            s, y, z = s_next, y_next, z_next


@kernel
def relax(rows, lattice, weight, inertia, fields):
    """Make a Chebyshev sweep over the cells of some blocks; u is the response to phi.

    Args:
        rows: Blocks to process, shape (n,).
        lattice: Blocks, Lattice.
        weight, inertia: Factors of the residual and of the last change.
        fields: PressureFields (in/out).
    """
    high, u, phi = pointer(lattice.high), pointer(fields.u), pointer(fields.phi)
    scale, right, step = pointer(fields.scale), pointer(fields.right), pointer(fields.step)
    for b in rows:
        for x in range(4):
            c = 64 * b + 16 * x
            residual = load(right, c) - _divergence(u, high, b, x)
            change = weight * load(scale, c) * residual + inertia * load(step, c)
            store(step, c, change)
            store(phi, c, load(phi, c) + change)


@kernel
def sweep(cells, nodes, lattice, factors, fields):
    """Make all Chebyshev sweeps over a system whose cells no other thread or rank computes.

    Args:
        cells: Blocks of the cells, shape (n,).
        nodes: Blocks of the nodes around them, shape (m,).
        lattice: Blocks, Lattice.
        factors: Factors of the residual and of the last change by sweep, shape (sweeps, 2).
        fields: PressureFields (in/out).
    """
    for k in range(len(factors)):
        respond(nodes, lattice, fields)
        relax(cells, lattice, factors[k, 0], factors[k, 1], fields)


@kernel
def add_velocities(rows, dx, fields, velocity):
    """Add u to the velocities of the nodes of some blocks [m/s], shape (blocks, 256) (in/out)."""
    size = fields.u.dtype.type(dx)
    for b in rows:
        for q in range(64):
            for a in range(3):
                velocity[b, 4 * q + a] += size * fields.u[192 * b + 64 * a + q]


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
        p, _, _ = _differences_below(phi, low, 8 * b + 4, 48)
        v, _, _ = _differences_below(filled, low, 8 * b + 4, 48)
        for x in range(4):
            p_next, _, _ = _differences_below(phi, low, 8 * b, 16 * x)
            v_next, _, _ = _differences_below(filled, low, 8 * b, 16 * x)
            total, fill = p + p_next, v + v_next
            zero = 0.0 * total
            mean = pressure_scale * total / select(fill > zero, fill, zero + 1.0)
            mean = np.minimum(np.maximum(mean, zero + MIN_PRESSURE), zero + MAX_PRESSURE)
            store(guess, 64 * b + 16 * x, mean)
            p, v = p_next, v_next


@kernel
def store_moves(rows, fields, moves):
    """Store displacements [cells] and relative pressure of the nodes of some blocks.

    Args:
        rows: Blocks to process, shape (n,).
        fields: PressureFields with displacements in u and pressures in `guess`.
        moves: Displacement, pressure, shape (blocks, 256) (out).
    """
    limit = fields.u.dtype.type(MAX_MOVE)
    for b in rows:
        for q in range(64):
            for a in range(3):
                move = fields.u[192 * b + 64 * a + q]
                moves[b, 4 * q + a] = min(max(move, -limit), limit)
            moves[b, 4 * q + 3] = fields.guess[64 * b + q]
