"""Particle shifting: liquids keep their volume although particles crowd and spread.

Every few steps, in the step of no time that the transfer correction makes, two things follow from
one nodal field, the fullness E: the part of a node's cell that particles, colliders and the mirror
images at walls fill (docs/explanation/transfer-schemes.md).

- The logarithm theta of a particle's volume ratio relaxes to what the fullness says, at the rate
  |C| of the flow's own strain: a liquid at rest and small waves are left alone.
- A particle moves down the gradient of the fullness above 1, which separates particles that crowd
  between nodes, where pressure cannot see them. Velocities stay, so momentum is exact. Particles
  that lie on a wall, where images cancel that gradient, move off it.
- In spray the velocity gradient loses its trace: a drop of a few particles would swing between
  pressure and tension at the speed of sound, undamped, and its rate would set the time step.

References:
    Xu, Stansby, Laurence (2009): Accuracy and stability in incompressible SPH (ISPH) based on the
    projection method and a new approach. J. Comput. Phys. 228, 6703-6725 (shifting of particles).
"""

from typing import NamedTuple

import numpy as np

from vgmpi.kernels.grid.contact_impulses import half_space_fraction
from vgmpi.kernels.grid.divided_nodes import distance_of_phase, half_of, is_divided
from vgmpi.kernels.particle_records import AFFINE, STATE, load_tensor
from vgmpi.kernels.simd.cooperative import strided_range, sync_threads
from vgmpi.kernels.simd.row_ops import (
    add_fixed_point,
    broadcast,
    fourth_of,
    horizontal_max,
    load_records,
)
from vgmpi.kernels.simd.vector16 import load, pointer, store
from vgmpi.kernels.transfer.g2p import squared_norm
from vgmpi.kernels.transfer.liquid_volume import clamp_to_unit
from vgmpi.kernels.transfer.transfer_correction import (
    excess_of,
    move_particles,
    relax_state,
    set_fourth_number,
    store_excess,
)
from vgmpi.kernels.wall_boundary import SEPARATE, SIDE
from vgmpi.materials.tensor_math.select import select
from vgmpi.runtime.jit import device_function

# [-] Below a plane surface 1 - fullness is (MARGIN + MARGIN_GROWTH (1 - fullness)) of the change of
# the fullness per cell (tests/kernels/test_plane_surface.py). Only what is missing beyond that
# counts, and not in spray: from MIN_FILL on, fully from FULL_FILL on.
MARGIN, MARGIN_GROWTH, MIN_FILL, FULL_FILL = 0.2, 1.3, 0.65, 0.75
MAX_FILL_ERROR = 0.5  # [-] largest relative error of the fullness that relaxation sees
TOLERATED_FILL = 1.02  # [-] fullness above which particles are shifted
SHIFT_FACTOR = 0.2  # [cells2] displacement per gradient of the fullness per cell
MAX_SHIFT_CELLS = 0.05  # [cells] largest displacement
SPRAY_FILL, LIQUID_FILL = 0.25, 0.5  # [-] fullness of spray, and of what is not spray
WALL_GAP_CELLS = 0.52  # [cells] least distance from a position's limit, 0.5 beyond a wall


class NodeFill(NamedTuple):
    """Masses or volumes that fill a node's cell, by phase, and the boundaries that cut cells."""

    space: np.ndarray  # (phases,) [1/kg or 1/m3] inverse of what fills a cell, 0: not counted
    by_volume: np.ndarray  # (phases,) bool: liquids of several densities, whose volumes count
    shifts: np.ndarray  # (phases,) bool: a liquid whose particles are shifted
    colliders: np.ndarray  # (blocks, 64, 4) normal and distance [m] of colliders, or (0, 64, 4)
    cells: np.ndarray  # (3,) cells of the domain
    kinds: np.ndarray  # (3, 2) wall kinds


class ShiftConstants(NamedTuple):
    """Constants of a shift."""

    duration: float  # [s] of the steps since the last shift, in the working precision
    cell_units: float  # units of the fixed-point positions per cell
    dither_x: float  # [position units] added before positions are rounded down
    dither_y: float
    dither_z: float


@device_function
def wall_share(fill, i, j, k):
    """Return the part of a node's cell inside the mirroring walls of the domain.

    Args:
        fill: What fills the cells, NodeFill.
        i, j, k: Node indices in the domain.
    """
    share = 1.0
    for a in range(3):
        node = i if a == 0 else (j if a == 1 else k)
        if node == 0 and 0 < fill.kinds[a, 0] < SEPARATE:
            share *= 0.5
        if node == fill.cells[a] and 0 < fill.kinds[a, 1] < SEPARATE:
            share *= 0.5
    return share


@device_function
def touches_separating_wall(fill, block):
    """Return whether a separating wall cuts the cell of a node of a block.

    Args:
        fill: What fills the cells, NodeFill.
        block: Coordinates of the block, shape (3,).
    """
    result = False
    for a in range(3):
        result = result or (fill.kinds[a, 0] == SEPARATE and block[a] < 1)
        highest = 4 * block[a] + 2
        result = result or (fill.kinds[a, 1] == SEPARATE and highest >= fill.cells[a] - 1)
    return result


@device_function
def share_outside_walls(fill, i, j, k):
    """Return the part of a node's cell that separating walls leave free.

    Args:
        fill: What fills the cells, NodeFill.
        i, j, k: Node indices in the domain.
    """
    share = 1.0
    for a in range(3):
        node = i if a == 0 else (j if a == 1 else k)
        if fill.kinds[a, 0] == SEPARATE:
            share *= 1.0 - half_space_fraction(1.0 * node)
        if fill.kinds[a, 1] == SEPARATE:
            share *= 1.0 - half_space_fraction(1.0 * (fill.cells[a] - node))
    return share


@device_function
def fill_of_phase(fill, volumes, nodes, nb, phase, offset):
    """Return the part of a node's cell that a phase fills.

    Args:
        fill: What fills the cells, NodeFill.
        volumes: Rest volumes of the nodes, flat; read where liquids differ in density.
        nodes: Velocity and mass of the nodes, flat.
        nb, phase: Node block of the phase.
        offset: Offset of the node's fourth number in its block.
    """
    amount = volumes[256 * nb + offset] if fill.by_volume[phase] else nodes[256 * nb + offset]
    return fill.space[phase] * amount


@set_fourth_number.register(NodeFill)
def store_fullness(fill, b, tables, nodes, volumes, phases, dx):
    """Store the fullness at the nodes of liquids that are shifted.

    Args:
        fill: What fills the cells.
        b, tables, nodes, volumes, phases, dx: See `set_fourth_number`; volumes are rest volumes.
    """
    n0, n1, phase_of = tables.first[b], tables.first[b + 1], pointer(tables.phase)
    block, solid, first = tables.coordinates[b], tables.solid[b], -1
    for nb in range(n0, n1):
        if fill.shifts[phase_of[nb]] and first < 0:
            first = nb
    if first < 0:
        return
    near_wall = touches_separating_wall(fill, block)
    sync_threads()
    for q in strided_range(64):
        o = 256 * first + 4 * q + 3
        if is_divided(phases, solid, q, dx):
            _store_divided_fullness(fill, b, tables, nodes, volumes, phases, dx, q)
            continue
        total = fill_of_phase(fill, volumes, nodes, n0, phase_of[n0], 4 * q + 3)
        for nb in range(n0 + 1, n1):
            total += fill_of_phase(fill, volumes, nodes, nb, phase_of[nb], 4 * q + 3)
        nodes[o] = total
        if near_wall or (solid >= 0 and len(fill.colliders) > 0):
            i, j = 4 * block[0] - 1 + q // 16, 4 * block[1] - 1 + q // 4 % 4
            k = 4 * block[2] - 1 + q % 4
            free = share_outside_walls(fill, i, j, k)
            if solid >= 0 and len(fill.colliders) > 0:
                free *= 1.0 - half_space_fraction(fill.colliders[solid, q, 3] / dx)
            nodes[o] += (1.0 - free) * wall_share(fill, i, j, k)
        for nb in range(first + 1, n1):
            if fill.shifts[phase_of[nb]]:
                nodes[256 * nb + 4 * q + 3] = nodes[o]
    sync_threads()


@device_function
def _store_divided_fullness(fill, b, tables, nodes, volumes, phases, dx, q):
    """Store the fullness on either side of a thin wall, for which the wall is a half space.

    Args:
        fill, b, tables, nodes, volumes, phases, dx: See `set_fourth_number`.
        q: Node in its block.
    """
    n0, n1, phase_of = tables.first[b], tables.first[b + 1], pointer(tables.phase)
    block, solid = tables.coordinates[b], tables.solid[b]
    front = back = 0.0
    for nb in range(n0, n1):
        amount = fill_of_phase(fill, volumes, nodes, nb, phase_of[nb], 4 * q + 3)
        if half_of(phases, phase_of[nb]) >= 0:
            front += amount
        if half_of(phases, phase_of[nb]) <= 0:
            back += amount
    i, j, k = 4 * block[0] - 1 + q // 16, 4 * block[1] - 1 + q // 4 % 4, 4 * block[2] - 1 + q % 4
    outside, share = share_outside_walls(fill, i, j, k), wall_share(fill, i, j, k)
    for nb in range(n0, n1):
        p = phase_of[nb]
        if fill.shifts[p]:
            d = distance_of_phase(phases, p, solid, q)
            free = outside * (1.0 - half_space_fraction(d / dx))
            total = front if half_of(phases, p) >= 0 else back
            nodes[256 * nb + 4 * q + 3] = total + (1.0 - free) * share


@excess_of.register(ShiftConstants)
def _(shift, fullness):
    return np.maximum(fullness - TOLERATED_FILL, 0.0 * fullness)


@store_excess.register(ShiftConstants)
def _(shift, patch, excess, box):
    """Store the fullness above what is tolerated; the first three numbers mean nothing."""
    none = broadcast(patch, 0.0)
    limit, maximum = broadcast(patch, TOLERATED_FILL), broadcast(patch, 0.0)
    for i in range(box[0], box[1]):
        for j in range(box[2], box[3]):
            for o in range((i * SIDE + j) * SIDE * 4, (i * SIDE + j + 1) * SIDE * 4, 16):
                row = np.maximum(load(patch, o) - limit, none)
                store(excess, o, row)
                maximum = np.maximum(maximum, fourth_of(row))
    return horizontal_max(maximum) > 0.0


@relax_state.register(ShiftConstants)
def relax_volume(shift, f, p, cap, records, offset):
    """Relax theta of 16 particles to what the fullness says, and stop that spray breathes.

    Args:
        shift: Constants of the shift.
        f, p, cap, records, offset: See `relax_state`.
    """
    r = load_records(records, offset)
    fullness, x, y, z = r[3], r[7], r[11], r[15]
    theta, zero = load(f, p + STATE * cap), 0.0 * r[3]
    overfill = fullness * np.exp(theta) - 1.0
    surface_margin = 4.0 * MARGIN + (4.0 * MARGIN_GROWTH) * np.maximum(1.0 - fullness, zero)
    surface_margin = surface_margin * np.sqrt(x * x + y * y + z * z)
    interior = clamp_to_unit((fullness - MIN_FILL) * (1.0 / (FULL_FILL - MIN_FILL)))
    missing = interior * np.minimum(overfill + surface_margin, zero)
    error = np.maximum(overfill - surface_margin, zero) + missing
    error = np.minimum(error, zero + MAX_FILL_ERROR)
    store(f, p + STATE * cap, theta - (shift.duration * strain_rate(f, p, cap)) * error)
    remove_spray_divergence(f, p, cap, fullness)


@device_function
def remove_spray_divergence(f, p, cap, fullness):
    """Remove the trace of the velocity gradient of 16 particles as far as they are spray.

    Args:
        f: Particle channels, flat (in/out).
        p: Index of the first particle.
        cap: Stride of channels.
        fullness: Fullness at the particles [-].
    """
    xx, yy, zz = p + AFFINE * cap, p + (AFFINE + 4) * cap, p + (AFFINE + 8) * cap
    a, b, c = load(f, xx), load(f, yy), load(f, zz)
    spray = clamp_to_unit((LIQUID_FILL - fullness) * (1.0 / (LIQUID_FILL - SPRAY_FILL)))
    mean_divergence = spray * (a + b + c) * (1.0 / 3.0)
    store(f, xx, a - mean_divergence)
    store(f, yy, b - mean_divergence)
    store(f, zz, c - mean_divergence)


@device_function
def strain_rate(f, p, cap):
    """Return the Frobenius norm of the velocity gradient of 16 particles [1/s]."""
    return np.sqrt(squared_norm(load_tensor(f, p + AFFINE * cap, cap)))


@move_particles.register(ShiftConstants)
def shift_positions(shift, f, xi, p, cap, records, offset, limit):
    """Move 16 particles down the gradient of the excess of fullness, and off walls.

    Args:
        shift: Constants of the shift.
        f, xi, p, cap, records, offset, limit: See `move_particles`.
    """
    r = load_records(records, offset)
    k = -4.0 * SHIFT_FACTOR
    x, y, z = k * r[7], k * r[11], k * r[15]
    bound = broadcast(f, MAX_SHIFT_CELLS)
    scale = bound / np.maximum(np.sqrt(x * x + y * y + z * z), bound)
    wall_shift = np.minimum(SHIFT_FACTOR * r[3], bound)
    x, y, z, units = scale * x, scale * y, scale * z, shift.cell_units
    _shift_along(f, xi, p, x, wall_shift, limit[0], units, shift.dither_x)
    _shift_along(f, xi, p + cap, y, wall_shift, limit[1], units, shift.dither_y)
    _shift_along(f, xi, p + 2 * cap, z, wall_shift, limit[2], units, shift.dither_z)


@device_function
def _shift_along(f, xi, p, distance, wall_shift, limit, cell_units, dither):
    """Add distances [cells] along one axis, except what leads to a wall; move off a wall.

    Args:
        f: Particle channels; they supply the precision.
        xi: Fixed-point positions, flat (in/out).
        p: Index of the first of 16 positions.
        distance: Distances [cells].
        wall_shift: Distances of particles that lie on a wall [cells], at least 0.
        limit: Range of positions inside the domain, shape (2,) [cells].
        cell_units, dither: Units per cell; units added before rounding.
    """
    zero = 0.0 * distance
    low, high = (
        broadcast(f, limit[0] + WALL_GAP_CELLS),
        broadcast(f, limit[1] - WALL_GAP_CELLS),
    )
    x = add_fixed_point(xi, p, zero)
    distance = np.maximum(distance, np.minimum(low - x, zero))
    distance = np.minimum(distance, np.maximum(high - x, zero))
    distance = select(x < low, wall_shift, select(x > high, zero - wall_shift, distance))
    moves = np.minimum(abs(distance) * 1e30, zero + 1.0)  # what is not shifted is not dithered
    add_fixed_point(xi, p, cell_units * distance + dither * moves)
