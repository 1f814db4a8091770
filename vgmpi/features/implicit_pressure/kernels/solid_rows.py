"""Deformable solids in the system of the pressure: G = D theta - <theta> D of a solid.

A solid takes its part theta of the impulse D^T phi of a node, less the pressure on its own volume:
<theta> is the mean of a cell. So it feels the pressure at its surface, G^T phi, and its volume is
that of its law. What the impulses do to its nodes, its own feature knows (a `DeformableSolid`), so
that the system has G I^-1 G^T besides the response of the liquid.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.kernels.colliders.sdf_sampling import set_node_indices
from vgmpi.kernels.reaction_impulses import (
    add_contact_reaction,
    set_block,
    set_collider,
    set_node,
)
from vgmpi.kernels.simd.vector16 import load, pointer, store
from vgmpi.materials.tensor_math.select import select
from vgmpi.runtime.aligned_arrays import aligned_zeros
from vgmpi.runtime.jit import always_inline, kernel

from ..liquid_rows import filled_part
from ..pressure_system import MIN_MEETING_PART
from .cell_stencils import (
    count_images,
    differences_below,
    divergence,
    is_held,
    mean_of_nodes,
)

FULL_NODE, CROWDED_NODE = 0.75, 0.5  # [-] filled part at which approach ends wholly, and not at all


class SolidBlocks(NamedTuple):
    """Blocks of nodes of a solid on a rank, see `DeformableSolid`."""

    occupied: np.ndarray  # numbers of those of its n blocks with nodes at which impulses reach it
    rows: np.ndarray  # (n,) among the node blocks of the rank
    block_of: np.ndarray  # (n,) among its blocks
    is_attached: np.ndarray  # 1 for nodes at which impulses reach it, flat, 64 of each
    loose: np.ndarray  # 1 for directions in which no wall holds a node, flat, 192 of each


class SolidRows(NamedTuple):
    """A solid at the nodes and cells of a rank, flat, 64 of a block or 192 in three directions."""

    theta: np.ndarray  # part of a node that the solid has
    is_attached: np.ndarray  # 1 for nodes at which impulses reach it
    mean: np.ndarray  # mean part of the nodes of a cell, 0 where one of them is not attached
    weighted: np.ndarray  # the same times a potential
    u: np.ndarray  # velocities of its nodes [cells/s]
    shared: np.ndarray  # the same times its part


def solid_rows(blocks: int, real: np.dtype) -> SolidRows:
    """Return fields of zeros for some blocks and the row of no block."""
    sizes = (64, 64, 64, 64, 192, 192)
    return SolidRows(*(aligned_zeros((blocks + 1) * size, real) for size in sizes))


@kernel
def read_parts(blocks, nodal, lattice, walls, per_volume, solid, fields):
    """Read the part of a solid at its nodes, and add it to that of all.

    Args:
        blocks: SolidBlocks.
        nodal: Volume in the fourth number [m3], shape (node blocks, 256).
        lattice: Blocks, Lattice.
        walls: Walls of the domain.
        per_volume: Inverse volume of a cell [1/m3].
        solid: SolidRows (out).
        fields: PressureFields (solid and meeting in/out).
    """
    real, total, rows, attached = (
        solid.theta.dtype.type,
        fields.solid,
        blocks.rows,
        blocks.is_attached,
    )
    for i in blocks.occupied:
        b = blocks.block_of[i]
        for q in range(64):
            images = real(count_images(b, q, lattice, walls))
            part = images * per_volume * nodal[rows[i], 4 * q + 3]
            part = min(max(part, real(0)), real(1)) * attached[64 * i + q]
            solid.theta[64 * b + q] = part
            solid.is_attached[64 * b + q] = attached[64 * i + q] if images > 0 else real(0)
            if part > MIN_MEETING_PART and total[64 * b + q] > MIN_MEETING_PART:
                fields.meeting[64 * b + q] = real(1)
            total[64 * b + q] += part


@kernel
def scale_parts(blocks, scale, solid):
    """Scale the parts of a solid so that those of all that shares a node sum up to 1.

    Args:
        blocks: SolidBlocks.
        scale: Factors of the nodes, flat.
        solid: SolidRows (in/out).
    """
    for b in blocks.block_of[blocks.occupied]:
        for n in range(64 * b, 64 * (b + 1)):
            solid.theta[n] *= scale[n]


@kernel
def set_means(rows, lattice, solid):
    """Set the mean parts of a solid in the cells of some blocks.

    Args:
        rows: Blocks to process, shape (n,).
        lattice: Blocks, Lattice.
        solid: SolidRows (in/out).
    """
    theta, attached, mean = pointer(solid.theta), pointer(solid.is_attached), pointer(solid.mean)
    high = pointer(lattice.high)
    for b in rows:
        for x in range(4):
            value = mean_of_nodes(theta, high, b, x)
            tied = mean_of_nodes(attached, high, b, x)
            store(
                mean,
                64 * b + 16 * x,
                select(tied > 0.99 + 0.0 * tied, value, 0.0 * value),
            )


@kernel
def read_velocities(blocks, velocity, per_length, solid):
    """Read the velocities of a solid at its nodes.

    Args:
        blocks: SolidBlocks.
        velocity: Velocity [m/s] and mass [kg], shape (node blocks, 256).
        per_length: Inverse cell size [1/m].
        solid: SolidRows (u and shared out).
    """
    for i in blocks.occupied:
        b = blocks.block_of[i]
        for a in range(3):
            for q in range(64):
                n = 192 * b + 64 * a + q
                v = per_length * velocity[blocks.rows[i], 4 * q + a]
                v *= blocks.loose[192 * i + 64 * a + q]
                solid.u[n] = v
                solid.shared[n] = solid.theta[64 * b + q] * v


@kernel
def set_tractions(blocks, lattice, factor, potential, solid, impulses):
    """Set the impulses G^T of a potential on the nodes of a solid.

    Args:
        blocks: SolidBlocks.
        lattice: Blocks, Lattice.
        factor: Factor of the impulses.
        potential: Numbers of cells, flat.
        solid: SolidRows, with the potential in `weighted`.
        impulses: Flat, 192 of each of the n (out).
    """
    low, phi, own = pointer(lattice.low), pointer(potential), pointer(solid.weighted)
    theta, out = pointer(solid.theta), pointer(impulses)
    for i in blocks.occupied:
        b = blocks.block_of[i]
        s, y, z = differences_below(phi, low, 8 * b + 4, 48)
        t, v, w = differences_below(own, low, 8 * b + 4, 48)
        for x in range(4):
            s_next, y_next, z_next = differences_below(phi, low, 8 * b, 16 * x)
            t_next, v_next, w_next = differences_below(own, low, 8 * b, 16 * x)
            part, n = load(theta, 64 * b + 16 * x), 192 * i + 16 * x
            quarter = 0.25 * factor
            store(out, n, quarter * (part * (s - s_next) - (t - t_next)))
            store(out, n + 64, quarter * (part * (y + y_next) - (v + v_next)))
            store(out, n + 128, quarter * (part * (z + z_next) - (w + w_next)))
            s, y, z, t, v, w = s_next, y_next, z_next, t_next, v_next, w_next


@kernel
def store_answer(blocks, answer, solid):
    """Store the changes of the velocities of a solid at its nodes.

    Args:
        blocks: SolidBlocks.
        answer: Flat, 192 of each block [cells/s].
        solid: SolidRows (u and shared out).
    """
    for i in blocks.occupied:
        b = blocks.block_of[i]
        for a in range(3):
            for q in range(64):
                n = 192 * b + 64 * a + q
                solid.u[n] = answer[192 * i + 64 * a + q]
                solid.shared[n] = solid.theta[64 * b + q] * solid.u[n]


@kernel
def add_divergence(rows, lattice, sign, solid, level, values):
    """Add G of the velocities of a solid to numbers of the cells with pressure of some blocks.

    Args:
        rows: Blocks to process, shape (n,).
        lattice: Blocks, Lattice.
        sign: 1, or -1 to subtract it.
        solid: SolidRows.
        level: LevelFields.
        values: Numbers of the cells, flat (in/out).
    """
    high, u, shared, mean = (
        pointer(lattice.high), pointer(solid.u), pointer(solid.shared), pointer(solid.mean)
    )  # fmt: skip
    scale, out = pointer(level.scale), pointer(values)
    for b in rows:
        for x in range(4):
            c = 64 * b + 16 * x
            own = divergence(shared, high, b, x) - load(mean, c) * divergence(u, high, b, x)
            change = sign * select(load(scale, c) > 0.0 * own, own, 0.0 * own)
            store(out, c, load(out, c) + change)


@kernel
def add_velocities(blocks, uptake, dx, change, velocity):
    """Add changes to the velocities of a solid at its nodes.

    What is held takes up what would change the velocity of its mass: a reaction that follows.

    Args:
        blocks: SolidBlocks.
        uptake: See `DeformableSolid`.
        dx: Cell size [m].
        change: Flat, 192 of each block [cells/s].
        velocity: See `read_velocities` (in/out).
    """
    for i in blocks.occupied:
        for q in range(64):
            factor = dx * uptake[64 * i + q]
            for a in range(3):
                velocity[blocks.rows[i], 4 * q + a] += factor * change[192 * i + 64 * a + q]


@always_inline
def _value_beside(values, lattice, b, q, axis, step):
    """Return the number of the node one step from a node along an axis."""
    size = 16 if axis == 0 else (4 if axis == 1 else 1)
    place = q // size % 4 + step
    side = 1 if 0 <= place < 4 else (2 if place > 3 else 0)
    offset = 13 + (side - 1) * (9 if axis == 0 else (3 if axis == 1 else 1))
    block = lattice.neighbors[27 * b + offset]
    return values[64 * block + q + size * (place % 4 - q // size % 4)]


@kernel
def stop_at_solids(rows, lattice, walls, is_solid, liquids, fields, velocity, reactions):
    """Stop the approach of liquids to solids at nodes where no pressure acts on them.

    Args:
        rows: Blocks to process, shape (n,).
        lattice: Blocks, Lattice.
        walls: Walls of the domain, which hold their nodes.
        is_solid: Whether a phase is a deformable solid, shape (phases,) bool.
        liquids: LiquidRows.
        fields: PressureFields, with `solid` known around the nodes of this rank; `cover` becomes
            above 0 at nodes with pressure around them.
        velocity: Velocity [m/s] and mass [kg], shape (rows, 256) (velocities in/out).
        reactions: NodeReactions (sums in/out).
    """
    low, filled, wet = pointer(lattice.low), pointer(fields.filled), pointer(fields.cover)
    normal, total = np.zeros(3), fields.solid
    for b in rows:
        set_block(reactions.sums, b)
        first, last = liquids.first[b], liquids.first[b + 1]
        lower, _, _ = differences_below(filled, low, 8 * b + 4, 48)
        for x in range(4):
            upper, _, _ = differences_below(filled, low, 8 * b, 16 * x)
            store(wet, 64 * b + 16 * x, lower + upper)
            lower = upper
        for q in range(64):
            own = total[64 * b + q]
            if fields.cover[64 * b + q] > 0 or not own > 0:
                continue
            crowd = own + filled_part(b, q, liquids, velocity)
            part = min((crowd - CROWDED_NODE) / (FULL_NODE - CROWDED_NODE), 1.0)
            if not part > 0 or not crowd > own:
                continue
            length = 0.0
            for a in range(3):
                rise = _value_beside(total, lattice, b, q, a, 1) - _value_beside(
                    total, lattice, b, q, a, -1
                )
                normal[a] = -rise if not is_held(b, q, a, lattice, walls) else 0.0
                length += normal[a] * normal[a]
            if not length > 0.0:
                continue
            for a in range(3):
                normal[a] /= np.sqrt(length)
            for r in range(first, last):
                if not liquids.per_cell[liquids.phase[r]] > 0 or not velocity[r, 4 * q + 3] > 0:
                    continue
                for s in range(first, last):
                    if not is_solid[liquids.phase[s]] or not velocity[s, 4 * q + 3] > 0:
                        continue
                    approach = 0.0
                    for a in range(3):
                        slip = float(velocity[r, 4 * q + a]) - float(velocity[s, 4 * q + a])
                        approach -= slip * normal[a]
                    if not approach > 0.0:
                        continue
                    of_liquid = float(velocity[r, 4 * q + 3])
                    of_solid = float(velocity[s, 4 * q + 3])
                    impulse = part * approach / (of_liquid + of_solid)
                    for a in range(3):
                        push = impulse * normal[a]
                        velocity[r, 4 * q + a] += velocity.dtype.type(push * of_solid)
                        velocity[s, 4 * q + a] -= velocity.dtype.type(push * of_liquid)
                if fields.pinned_part[64 * b + q] > MIN_MEETING_PART:
                    _stop_at_pinned_part(b, q, r, part, normal, lattice, velocity, reactions)


@always_inline
def _stop_at_pinned_part(b, q, r, part, normal, lattice, velocity, reactions):
    """Stop the approach of a liquid to a pinned part, which is at rest.

    Args:
        b, q, r: Block, number of the node, and row of the liquid.
        part: Part of the approach that ends.
        normal: Outward normal of the solid, shape (3,).
        lattice, velocity, reactions: See `stop_at_solids`.
    """
    before, none, ijk, approach = np.zeros(3), np.zeros(4), np.zeros(3, np.int64), 0.0
    for a in range(3):
        before[a] = velocity[r, 4 * q + a]
        approach -= before[a] * normal[a]
    for a in range(3):
        push = part * max(approach, 0.0) * normal[a]
        velocity[r, 4 * q + a] += velocity.dtype.type(push)
    if reactions.pinned[b, q] >= 0:
        set_node_indices(ijk, lattice.block[b], q)
        set_node(reactions.sums, q, ijk[0], ijk[1], ijk[2])
        set_collider(reactions.sums, reactions.pinned[b, q], none)
        after = velocity[r, 4 * q : 4 * q + 4]
        add_contact_reaction(reactions.sums, before, after, float(after[3]), np.zeros(3), 0, 0)
