"""Grid update of a step: nodal sums, momentum to velocity, couplings, contact and walls.

A node block is 4^3 nodes of one phase; block b holds base nodes 4 b - 1 .. 4 b + 2 of the domain.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.kernels.kernel_arguments import NODE_MASS_FLOOR, Sums
from vgmpi.kernels.reaction_impulses import set_block
from vgmpi.kernels.reproducible_sums import blocks_at, finalize_node_block, sums_at
from vgmpi.kernels.rigid.prescribed_motion import PrescribedSteps
from vgmpi.kernels.rigid.prescribed_transfer import set_prescribed_velocity
from vgmpi.kernels.simd.cooperative import flat_pointer, strided_range, sync_threads
from vgmpi.kernels.simd.row_ops import broadcast, fourth_of, tile, velocity, with_fourth
from vgmpi.kernels.simd.vector16 import load, pointer, store
from vgmpi.kernels.wall_boundary import apply_wall_conditions, project_tangential
from vgmpi.materials.couplings.interaction import CONTACT
from vgmpi.materials.tensor_math.select import select
from vgmpi.runtime.jit import borrowing_kernel, device_function

from .collider_hold import pushed_phase
from .contact import apply_contact, has_several_parties
from .divided_nodes import part_phases, unite_phases
from .mixture_coupling import BlockContext, NodalFields, couple_block, store_mixture_values
from .mixture_workspace import to_pointers

CONTACT_ENABLED = True  # whether contact is compiled in; the GPU engine sets it per scene


class RigidBoundaries(NamedTuple):
    """Boundaries that no body deflects: colliders and bodies with prescribed motion.

    Colliders are stored at the nodes of the blocks close to them.
    """

    nodes: np.ndarray  # (n, 64, 4) outward normal and distance [m] of the nearest collider
    moves: np.ndarray  # (n, 64, 3) [m/s] its velocity; (0, 64, 3) if all are at rest
    collider_number: np.ndarray  # (n, 64) its number; (0, 64) if all have the same friction
    motions: PrescribedSteps  # prescribed motion by phase, empty if there is none
    free: np.ndarray  # (colliders,) bool: a free body, which couples after all others; or empty


class CommonFields(NamedTuple):
    """Nodal fields that every scene has."""

    momentum: Sums
    offsets: Sums


class SeparatedStress(NamedTuple):
    """Stress impulses that are kept separate from momentum, and what follows from them."""

    impulses: Sums  # [kg m/s], and volumes [m3]
    # (node blocks, 256) quantities gathered besides velocity; any array where there is none
    flux: np.ndarray  # volume flux [m/s]
    drift: np.ndarray  # drift velocity [m/s]
    change: np.ndarray  # change of velocity [m/s]
    needs_change: int  # whether the change is needed (FLIP)
    workspace: tuple  # MixtureWorkspace, scratch of the calling thread
    tables: tuple  # MixtureTables


@borrowing_kernel
def update(blocks, tables, summed, shear, stress, rules, walls, phases, solids, scratch, step,
           report):  # fmt: skip
    """Compute the velocities [m/s] at the nodes of some blocks, in place of momentum.

    Args:
        blocks, tables, summed: Blocks to process, node blocks of the rank, common fields (in/out).
        shear, stress: Shear sums and separate stress impulses (in/out); each may be None.
        rules, walls, phases, step: See kernels/kernel_arguments.py; rules may be None.
        solids, scratch, report: Boundaries, scratch of the thread, overflows by field (out).
    """
    momentum, offsets = summed.momentum, summed.offsets
    rows, momentum_sums, moments = blocks_at(tables), sums_at(momentum), sums_at(offsets)
    nodes, last, cell_mass = (
        momentum_sums.nodes,
        pointer(walls.cells),
        pointer(phases.min_cell_mass),
    )
    shears = None if shear is None else sums_at(shear)
    if stress is not None:
        impulse_sums = sums_at(stress.impulses)
        fields = _fields(rows, cell_mass, last, nodes, impulse_sums.nodes, moments.nodes, stress)
        if rules is not None:
            work, pairs = to_pointers(stress.workspace, stress.tables)
    first, phase_of = pointer(tables.first), rows.phase
    push = tile(step.gravity_increment, 0)
    for b in blocks:
        n0, n1, has_impulses = first[b], first[b + 1], False
        set_block(scratch.reactions, b)
        for nb in range(n0, n1):
            finalize_node_block(nb, rows, momentum_sums, report, 0)
            finalize_node_block(nb, rows, moments, report, 1)
            if stress is not None:
                finalize_node_block(nb, rows, impulse_sums, report, 2)
                has_impulses |= impulse_sums.has_terms[nb] != 0
            if shear is not None:
                finalize_node_block(nb, rows, shears, report, 2 if stress is None else 3)
            momentum_to_velocity(nb, nodes, push, NODE_MASS_FLOOR * cell_mass[phase_of[nb]])
        block = _context(b, n0, n1, tables, last)
        set_prescribed_velocity(block, nodes, phase_of, solids.motions, step.dx)
        if stress is not None:
            noted = has_impulses and stress.needs_change
            if noted:
                _store_velocity_before(block, fields, push)
            if has_impulses and rules is None:
                _add_stress_impulse(block, fields)
            if rules is not None:
                if noted:
                    _add_stress_impulse_unshared(block, fields, pairs)
                if has_impulses:
                    if block.at_wall and block.may_touch:
                        _project_offsets(moments.nodes, block, walls, phases, phase_of)
                    couple_block(block, fields, work, pairs, step.dt, step.dx)
        unite_phases(phases, block, tables.solid[b], phase_of, nodes, moments.nodes, step.dx)
        touches = block.may_touch and _may_touch(
            block, tables.solid[b], phase_of, solids, rules, step
        )
        if CONTACT_ENABLED and touches:
            apply_contact(block, tables, tables.solid[b], nodes, moments.nodes, shears, solids,
                          walls, phases, rules, step, scratch)  # fmt: skip
        _stop_at_walls(block, tables.solid[b], nodes, moments.nodes, walls, phase_of, phases,
                       solids, scratch, step.dx)  # fmt: skip
        if stress is not None:
            if rules is not None:
                store_mixture_values(block, has_impulses, fields, work, pairs, step.dx)
            if noted:
                _store_velocity_change(block, fields)


@device_function
def _fields(rows, cell_mass, cells, grid, forces, offsets, stress):
    """Return the nodal arrays that couplings need, as pointers; rows: NodeBlockPointers."""
    return NodalFields(
        rows.phase, cell_mass, cells, grid, forces, offsets,
        flat_pointer(stress.flux), flat_pointer(stress.drift), flat_pointer(stress.change),
    )  # fmt: skip


@device_function
def _stop_at_walls(block, solid, velocities, offsets, walls, phase, phases, solids, work, dx):
    """Apply the wall conditions to the velocities of a block, on both sides of thin walls.

    Args:
        block, solid: Context of the block; its row in solids, or -1.
        velocities, offsets: Nodal velocities (in/out) and field of offsets, (256 node blocks,).
        walls: Walls of the domain.
        phase, phases: Phase of each node block, and constants of the phases.
        solids, work: Rigid boundaries, and scratch of the thread.
        dx: Cell size [m].
    """
    low = block.low_x, block.low_y, block.low_z
    if block.at_wall:
        sync_threads()
    for nb in range(block.n0, block.n1 if block.at_wall else block.n0):
        if len(solids.motions.driven) > 0 and solids.motions.driven[phase[nb]]:
            continue  # the motion of this phase is prescribed
        kinds = walls.kinds if phases.liquid[phase[nb]] else walls.kinds_for_solids
        if phases.at_walls[phase[nb]]:
            kinds = walls.kinds_for_surfaces
        pushed = pushed_phase(block, solid, nb, phase, phases, solids, offsets, dx, work.plane)
        apply_wall_conditions(
            velocities, 256 * nb, low, walls.cells, kinds, walls.friction, work.reactions, pushed,
            solids, phases,
        )  # fmt: skip
    part_phases(phases, block, phase, velocities)


@device_function
def _may_touch(block, solid, phase, solids, rules, step):
    """Return whether contact acts between two phases of a block, or one and a rigid boundary.

    Args:
        block: Context of the block.
        solid: Row of the block in solids, or -1.
        phase: Phases of the node blocks.
        solids: Rigid boundaries.
        rules: Interaction rules, or None.
        step: Constants of the step.
    """
    if not has_several_parties(block, solid, solids, step.dx):
        return False
    if rules is None or solid >= 0 or block.at_wall:
        return True
    if rules is not None:
        for a in range(block.n0, block.n1):
            for b in range(block.n0, a):
                if rules.pair[phase[a], phase[b]] == CONTACT:
                    return True
    return False


@device_function
def momentum_to_velocity(nb, nodes, push, tiny):
    """Divide momentum by mass and add `push`, at the nodes of one node block.

    Args:
        nb: Node block.
        nodes: Momentum and mass, then velocity (in/out), shape (256 node blocks,).
        push: Velocity change by gravity [m/s], as a vector.
        tiny: Mass [kg] below which a node stays at rest.
    """
    for c in range(256 * nb, 256 * (nb + 1), 16):
        store(nodes, c, velocity(load(nodes, c), push, broadcast(nodes, tiny)))


@device_function
def _store_velocity_change(block, fields):
    """Store the change of velocity since `_store_velocity_before`."""
    for c in range(256 * block.n0, 256 * block.n1, 16):
        store(fields.change, c, load(fields.grid, c) - load(fields.change, c))


@device_function
def _store_velocity_before(block, fields, push):
    """Store the velocities of a block before gravity's `push` and separate impulses.

    Nodes without mass are at rest before and after.
    """
    for nb in range(block.n0, block.n1):
        tiny = broadcast(fields.grid, NODE_MASS_FLOOR * fields.min_cell_mass[fields.phase[nb]])
        for c in range(256 * nb, 256 * (nb + 1), 16):
            row = load(fields.grid, c)
            store(fields.change, c, select(fourth_of(row) > tiny, row - push, row))


@device_function
def _add_stress_impulse(block, fields):
    """Add the separate stress impulses to the velocities of a block."""
    for nb in range(block.n0, block.n1):
        _add_impulse_of_node_block(nb, fields)


@device_function
def _add_impulse_of_node_block(nb, fields):
    """Add the separate stress impulses to the velocities of one node block."""
    tiny = broadcast(fields.grid, NODE_MASS_FLOOR * fields.min_cell_mass[fields.phase[nb]])
    for c in range(256 * nb, 256 * (nb + 1), 16):
        row = load(fields.grid, c)
        m = fourth_of(row)
        change = select(m > tiny, load(fields.forces, c) / m, 0.0)
        store(fields.grid, c, with_fourth(row + change, row))


@device_function
def _add_stress_impulse_unshared(block, fields, rules):
    """Add the separate stress impulses of all phases but fluids that share space.

    The pressure of those fluids acts on other phases too (mixture_coupling.py). rules:
    MixtureTables as
    pointers.
    """
    for nb in range(block.n0, block.n1):
        p = fields.phase[nb]
        if rules.mixture_set[p] < 0 or rules.fluid[p] == 0:
            _add_impulse_of_node_block(nb, fields)
            for c in range(256 * nb, 256 * (nb + 1), 16):  # the impulse has acted
                row = load(fields.forces, c)
                store(fields.forces, c, with_fourth(0.0 * row, row))


@device_function
def _project_offsets(offsets, block, walls, phases, phase_of):
    """Remove the component across walls from the offsets (256 node blocks,) of a block."""
    for nb in range(block.n0, block.n1):
        kinds = walls.kinds if phases.liquid[phase_of[nb]] else walls.kinds_for_solids
        for node in strided_range(64):
            i, j, k = block.low_x + node // 16, block.low_y + node // 4 % 4, block.low_z + node % 4
            project_tangential(offsets, 256 * nb + 4 * node, i, j, k, walls.cells, kinds)
    sync_threads()


@device_function
def _context(b, n0, n1, tables, last):
    """Return the context of block b; last: cells of the domain."""
    low = (
        4 * tables.coordinates[b, 0] - 1,
        4 * tables.coordinates[b, 1] - 1,
        4 * tables.coordinates[b, 2] - 1,
    )
    return BlockContext(n0, n1, tables.may_touch[b], _at_wall(low, last), low[0], low[1], low[2])


@device_function
def _at_wall(low, cells):
    """Return whether a block whose first node is `low` has a node on or beyond a wall."""
    for a in range(3):
        if low[a] <= 0 or low[a] + 3 >= cells[a]:
            return True
    return False
