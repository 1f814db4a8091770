"""Sands in whose pores liquid flows: what drag and pressure do to a node's grains and its liquid.

The drag kappa = dt c V acts on the relative motion of a sand and the liquid of the mass m at a
node. It is implicit: the liquid follows the sand by f = kappa / (m + kappa), and the sand carries
the mass f m besides its own, so that with a pressure

    (M + f m + beta dt^2 K) dv_s = (theta_s + f theta_l) D^T phi - f m (v_s - v_l)
    dv_l                         = f (v_s + dv_s - v_l) + theta_l / (m + kappa) D^T phi

Liquids follow alike, with the drag of all. Where several sands share a node, each has the part of
the liquid that its grains have of all grains. See docs/explanation/implicit-pressure.md.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.runtime.aligned_arrays import aligned_zeros
from vgmpi.runtime.jit import kernel

from ..liquid_rows import volume_of_row
from .cell_stencils import count_images, node_index

MIN_LIQUID = 1e-9  # [-] nodes with less of a full cell have none


class PoreRows(NamedTuple):
    """A sand at the nodes of the blocks of a rank, flat, 64 of a block, and the row of no block."""

    follows: np.ndarray  # part f of its motion that the liquid follows, times its part of it
    mobility: np.ndarray  # rough change of velocity per impulse, 192 of a block
    per_impulse: float  # impulse per mass of a full cell of it, per that of the liquid


class SandDrag(NamedTuple):
    """Drag in a step, for a sand."""

    phase: int
    coefficients: np.ndarray  # (phases,) [kg/(m3 s)] with each phase
    grain_volumes: np.ndarray  # (phases,) [m3/kg] of sands with pores, 0 of other phases
    porosity: float
    unit: float  # [kg] mass of a full cell of it
    dt: float  # [s]


def pore_rows(blocks: int, per_impulse: float, real: np.dtype) -> PoreRows:
    """Return fields of zeros for some blocks and the row of no block."""
    follows, mobility = (aligned_zeros(size * (blocks + 1), real) for size in (64, 192))
    return PoreRows(follows, mobility, real.type(per_impulse))


@kernel
def hold_stuck_nodes(blocks, lattice, walls, velocity):
    """Hold the nodes of a sand that friction has stopped on walls.

    What pushes them in this step is within the friction, as far as single nodes can tell.

    Args:
        blocks: SolidBlocks (loose in/out).
        lattice: Blocks, Lattice.
        walls: Walls of the domain.
        velocity: Velocity [m/s] and mass [kg], shape (node blocks, 256).
    """
    zero = blocks.loose.dtype.type(0)
    for i in blocks.occupied:
        for q in range(64):
            is_stuck = False
            for a in range(3):
                node = node_index(blocks.block_of[i], q, a, lattice)
                is_stuck |= node == 0 and walls.friction[a, 0] > 0
                is_stuck |= node == walls.cells[a] and walls.friction[a, 1] > 0
            for a in range(3):
                is_stuck &= velocity[blocks.rows[i], 4 * q + a] == 0
            for a in range(3 if is_stuck else 0):
                blocks.loose[192 * i + 64 * a + q] = zero


@kernel
def find_drag(blocks, liquids, drag, velocity, pores, followed, carried, impulses):
    """Find what drag does to a sand at its nodes.

    Args:
        blocks: SolidBlocks.
        liquids: LiquidRows.
        drag: SandDrag.
        velocity: Velocity [m/s] and mass [kg], shape (node blocks, 256).
        pores: PoreRows (follows out).
        followed: Sum of `follows` of all sands, flat (in/out).
        carried: Mass that it carries, in units, flat, 64 of each of its blocks (out).
        impulses: Per unit [m/s], flat, 192 of each (out).
    """
    per_unit, volume_of_cell = 1.0 / drag.unit, 1.0 / float(liquids.per_volume)
    mean = np.zeros(3)
    real = velocity.dtype.type
    for i in blocks.occupied:
        b, own_row = blocks.block_of[i], blocks.rows[i]
        first, last = liquids.first[b], liquids.first[b + 1]
        for q in range(64):
            n = 64 * i + q
            carried[n] = real(0)
            for a in range(3):
                impulses[192 * i + 64 * a + q] = real(0)
            grains = float(velocity[own_row, 4 * q + 3]) * drag.grain_volumes[drag.phase]
            if not grains > 0 or not blocks.is_attached[n] > 0:
                continue
            all_grains, volume, mass = 0.0, 0.0, 0.0
            mean[:] = 0.0
            for r in range(first, last):
                phase = liquids.phase[r]
                own = float(velocity[r, 4 * q + 3])
                all_grains += own * drag.grain_volumes[phase]
                if drag.coefficients[phase] > 0:
                    volume += float(volume_of_row(r, q, liquids, velocity)) * volume_of_cell
                    mass += own
                    for a in range(3):
                        mean[a] += own * float(velocity[r, 4 * q + a])
            if not volume > MIN_LIQUID * volume_of_cell or not mass > 0:
                continue
            part, exchange = grains / all_grains, 0.0
            for r in range(first, last):
                strength = drag.coefficients[liquids.phase[r]]
                if strength > 0:
                    own = float(volume_of_row(r, q, liquids, velocity)) * volume_of_cell
                    bulk = grains / (1.0 - drag.porosity) * (own / volume)
                    wet = own / drag.porosity * part
                    exchange += drag.dt * strength * min(bulk, wet)
            mass *= part
            follows = exchange / (mass + exchange)
            pores.follows[64 * b + q] = real(follows * part)
            followed[64 * b + q] += real(follows * part)
            carried[n] = real(per_unit * follows * mass)
            for a in range(3):
                slip = float(velocity[own_row, 4 * q + a]) - mean[a] * part / mass
                impulses[192 * i + 64 * a + q] = real(-per_unit * follows * mass * slip)


@kernel
def reduce_responses(rows, followed, level):
    """Leave the liquids of some blocks what they answer to the pressure apart from sands.

    Args:
        rows: Blocks to process, shape (n,).
        followed: See `find_drag`.
        level: LevelFields (inverse in/out).
    """
    unity = level.inverse.dtype.type(1)
    for b in rows:
        for a in range(3):
            for q in range(64):
                level.inverse[192 * b + 64 * a + q] *= unity - followed[64 * b + q]


@kernel
def release_liquids(rows, liquids, followed, velocity):
    """Leave the liquids of some blocks what they keep of their velocities beside sands.

    Args:
        rows: Blocks to process, shape (n,).
        liquids: LiquidRows.
        followed: See `find_drag`.
        velocity: Velocity [m/s] and mass [kg], shape (node blocks, 256) (in/out).
    """
    unity = velocity.dtype.type(1)
    for b in rows:
        for r in range(liquids.first[b], liquids.first[b + 1]):
            if not liquids.per_cell[liquids.phase[r]] > 0:
                continue
            for q in range(64):
                for a in range(3):
                    velocity[r, 4 * q + a] *= unity - followed[64 * b + q]


@kernel
def move_sand(blocks, factor, change, velocity):
    """Add changes to the velocities of a sand at its nodes.

    Args:
        blocks: SolidBlocks.
        factor: Factor of the changes.
        change: Flat, 192 of each block.
        velocity: Velocity [m/s] and mass [kg], shape (node blocks, 256) (in/out).
    """
    for i in blocks.occupied:
        for q in range(64):
            for a in range(3):
                velocity[blocks.rows[i], 4 * q + a] += factor * change[192 * i + 64 * a + q]


@kernel
def pull_liquids(blocks, liquids, pores, velocity):
    """Let the liquids follow a sand at its nodes.

    Args:
        blocks: SolidBlocks.
        liquids: LiquidRows.
        pores: PoreRows.
        velocity: Velocity [m/s] and mass [kg], shape (node blocks, 256) (in/out).
    """
    for i in blocks.occupied:
        b = blocks.block_of[i]
        for r in range(liquids.first[b], liquids.first[b + 1]):
            if not liquids.per_cell[liquids.phase[r]] > 0:
                continue
            for q in range(64):
                for a in range(3):
                    speed = velocity[blocks.rows[i], 4 * q + a]
                    velocity[r, 4 * q + a] += pores.follows[64 * b + q] * speed


@kernel
def push_liquids(blocks, liquids, pores, factor, change, velocity):
    """Let the liquids follow changes of the velocities of a sand at its nodes.

    Args:
        blocks, liquids, pores: See `pull_liquids`.
        factor, change: See `move_sand`.
        velocity: Velocity [m/s] and mass [kg], shape (node blocks, 256) (in/out).
    """
    for i in blocks.occupied:
        b = blocks.block_of[i]
        for r in range(liquids.first[b], liquids.first[b + 1]):
            if not liquids.per_cell[liquids.phase[r]] > 0:
                continue
            for q in range(64):
                for a in range(3):
                    moved = factor * change[192 * i + 64 * a + q]
                    velocity[r, 4 * q + a] += pores.follows[64 * b + q] * moved


@kernel
def read_grains(blocks, velocity, lattice, walls, per_mass, solid, fields):
    """Read the part of a sand's grains at its nodes, and add it to that of all.

    Args:
        blocks: SolidBlocks.
        velocity: Velocity [m/s] and mass [kg], shape (node blocks, 256).
        lattice: Blocks, Lattice.
        walls: Walls of the domain.
        per_mass: Volume of the grains per mass, in cells [1/kg].
        solid: SolidRows (theta and is_attached out).
        fields: PressureFields (grains in/out).
    """
    real = solid.theta.dtype.type
    for i in blocks.occupied:
        b = blocks.block_of[i]
        for q in range(64):
            images = real(count_images(b, q, lattice, walls))
            part = images * per_mass * velocity[blocks.rows[i], 4 * q + 3]
            part = min(max(part, real(0)), real(1)) * blocks.is_attached[64 * i + q]
            solid.theta[64 * b + q] = part
            fields.grains[64 * b + q] += part


@kernel
def add_rough_answers(blocks, lattice, walls, rough, solid, pores, fields, level):
    """Add rough answers of a sand's nodes to those of the liquid, which the sweeps of cells take.

    Where a wall holds the liquid, it holds the sand in its way, too.

    Args:
        blocks: SolidBlocks (loose in/out).
        lattice: Blocks, Lattice.
        walls: Walls of the domain.
        rough: Rough change of velocity by an impulse at each node alone, flat, 64 of each block.
        solid: SolidRows.
        pores: PoreRows (mobility out).
        fields: PressureFields.
        level: LevelFields (inverse in/out).
    """
    real = level.inverse.dtype.type
    for i in blocks.occupied:
        b = blocks.block_of[i]
        for q in range(64):
            n = 64 * b + q
            push = solid.theta[n] * fields.grain_scale[n] + pores.follows[n] * fields.share[n]
            for a in range(3):
                v = 192 * b + 64 * a + q
                node = node_index(b, q, a, lattice)
                is_on_wall = node <= 0 or node >= walls.cells[a]
                if is_on_wall and fields.share[n] > 0 and not level.inverse[v] > 0:
                    blocks.loose[192 * i + 64 * a + q] = real(0)
                mobility = rough[64 * i + q] * blocks.loose[192 * i + 64 * a + q]
                pores.mobility[v] = mobility
                level.inverse[v] += pores.per_impulse * push * push * mobility


@kernel
def set_pushes(blocks, solid, pores, fields):
    """Set theta to the part of the impulses that moves a sand, with the liquid that follows it.

    Args:
        blocks: SolidBlocks.
        solid: SolidRows (theta in/out).
        pores: PoreRows.
        fields: PressureFields.
    """
    for b in blocks.block_of[blocks.occupied]:
        for n in range(64 * b, 64 * (b + 1)):
            solid.theta[n] += pores.follows[n] * fields.share[n]


@kernel
def store_answer(blocks, answer, impulses, solid, pores):
    """Store the changes of the velocities of a sand at its nodes, beyond the rough ones.

    Args:
        blocks: SolidBlocks.
        answer, impulses: Changes, and the impulses, flat, 192 of each block.
        solid: SolidRows (shared out).
        pores: PoreRows.
    """
    for i in blocks.occupied:
        b = blocks.block_of[i]
        for a in range(3):
            for q in range(64):
                n, k = 192 * b + 64 * a + q, 192 * i + 64 * a + q
                excess = answer[k] - pores.mobility[n] * impulses[k]
                solid.shared[n] = solid.theta[64 * b + q] * excess


@kernel
def subtract_rough_answers(blocks, solid, pores, fields, level):
    """Leave in u and in `inverse` what a potential does to the liquid alone.

    Args:
        blocks: SolidBlocks.
        solid: SolidRows.
        pores: PoreRows.
        fields: PressureFields.
        level: LevelFields (u and inverse in/out).
    """
    zero = level.u.dtype.type(0)
    for b in blocks.block_of[blocks.occupied]:
        for q in range(64):
            push, is_wet = solid.theta[64 * b + q], fields.share[64 * b + q] > 0
            for a in range(3):
                n = 192 * b + 64 * a + q
                rough = pores.per_impulse * push * push * pores.mobility[n]
                if rough > 0:
                    remaining = max(level.inverse[n] - rough, zero) if is_wet else zero
                    level.u[n] *= remaining / level.inverse[n] if remaining > 0 else zero
                    level.inverse[n] = remaining


@kernel
def restore_rough_answers(blocks, solid, pores, fields, level):
    """Add the rough answers again where there is liquid, for what moves it.

    Args:
        blocks, solid, pores, fields: See `subtract_rough_answers`.
        level: LevelFields (inverse in/out).
    """
    for b in blocks.block_of[blocks.occupied]:
        for q in range(64):
            push = solid.theta[64 * b + q]
            for a in range(3):
                n = 192 * b + 64 * a + q
                if fields.share[64 * b + q] > 0:
                    level.inverse[n] += pores.per_impulse * push * push * pores.mobility[n]
