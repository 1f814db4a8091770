"""Grid update of a step: nodal sums, momentum to velocity, couplings, contact and walls.

A node block is 4^3 nodes of one phase; block b holds base nodes 4 b - 1 .. 4 b + 2 of the domain.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.kernels.kernel_arguments import NODE_MASS_FLOOR, BlockContext, NodalFields, Sums
from vgmpi.kernels.reaction_impulses import set_block
from vgmpi.kernels.reproducible_sums import blocks_at, finalize_node_block, sums_at
from vgmpi.kernels.rigid.prescribed_motion import PrescribedSteps
from vgmpi.kernels.rigid.prescribed_transfer import set_prescribed_velocity
from vgmpi.kernels.simd.cooperative import sync_threads
from vgmpi.kernels.simd.row_ops import broadcast, tile, velocity
from vgmpi.kernels.simd.vector16 import load, pointer, store
from vgmpi.kernels.wall_boundary import apply_wall_conditions
from vgmpi.materials.couplings.interaction import CONTACT
from vgmpi.runtime.jit import borrowing_kernel, device_function

from .collider_hold import pushed_phase
from .contact import apply_contact, has_several_parties
from .divided_nodes import part_phases, unite_phases
from .node_stages import (
    add_own_impulses,
    after_stress,
    after_walls,
    before_stress,
)

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


@borrowing_kernel
def update(blocks, tables, summed, shear, stress, pair_rules, walls, phases, solids, scratch, step,
           report):  # fmt: skip
    """Compute the velocities [m/s] at the nodes of some blocks, in place of momentum.

    Args:
        blocks, tables, summed: Blocks to process, node blocks of the rank, common fields (in/out).
        shear, stress: Shear sums and separate stress impulses (in/out); each may be None.
        pair_rules: Interaction of each pair of phases, shape (phases, phases), or None: contact.
        walls, phases, step: See kernels/kernel_arguments.py.
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
        fields = NodalFields(
            rows.phase, cell_mass, last, nodes, impulse_sums.nodes, moments.nodes
        )  # fmt: skip
    first, phase_of = pointer(tables.first), rows.phase
    push = tile(step.gravity_increment, 0)
    for b in blocks:
        n0, n1, has_impulses = first[b], first[b + 1], False
        set_block(scratch.reactions, b)
        is_converted = stress is not None and stress.is_converted != 0
        for nb in range(n0, n1):
            finalize_node_block(nb, rows, moments, report, 1)
            if shear is not None:
                finalize_node_block(nb, rows, shears, report, 2 if stress is None else 3)
            if stress is not None:
                has_impulses |= impulse_sums.has_terms[nb] != 0
            if is_converted:
                continue
            finalize_node_block(nb, rows, momentum_sums, report, 0)
            if stress is not None:
                finalize_node_block(nb, rows, impulse_sums, report, 2)
            momentum_to_velocity(nb, nodes, push, NODE_MASS_FLOOR * cell_mass[phase_of[nb]])
        block = _context(b, n0, n1, tables, last)
        set_prescribed_velocity(block, nodes, phase_of, solids.motions, step.dx)
        if stress is not None:
            if has_impulses:
                before_stress(stress.kind, block, fields, push)
                if stress.adds_own:
                    add_own_impulses(block, fields, stress.shared)
                after_stress(stress.kind, block, fields, stress.scratch, walls, phases, step)
        unite_phases(phases, block, tables.solid[b], phase_of, nodes, moments.nodes, step.dx)
        touches = block.may_touch and _may_touch(
            block, tables.solid[b], phase_of, solids, pair_rules, step
        )
        if CONTACT_ENABLED and touches:
            apply_contact(block, tables, tables.solid[b], nodes, moments.nodes, shears, solids,
                          walls, phases, pair_rules, step, scratch)  # fmt: skip
        _stop_at_walls(block, tables.solid[b], nodes, moments.nodes, walls, phase_of, phases,
                       solids, scratch, step.dx)  # fmt: skip
        if stress is not None:
            after_walls(stress.kind, block, has_impulses, fields, stress.scratch, step.dx)


@borrowing_kernel
def convert_momentum(blocks, tables, momentum, impulses, phases, step, report):
    """Convert the sums of momentum and stress impulses of some blocks, and find velocities.

    It is the first part of `update`, for features that change the impulses before the second one.

    Args:
        blocks, tables: Blocks to process, node blocks of the rank.
        momentum, impulses: Sums of momentum and of separate stress impulses (in/out).
        phases, step, report: See `update`.
    """
    rows, momentum_sums, impulse_sums = blocks_at(tables), sums_at(momentum), sums_at(impulses)
    cell_mass, first = pointer(phases.min_cell_mass), pointer(tables.first)
    push = tile(step.gravity_increment, 0)
    for b in blocks:
        for nb in range(first[b], first[b + 1]):
            finalize_node_block(nb, rows, momentum_sums, report, 0)
            finalize_node_block(nb, rows, impulse_sums, report, 2)
            tiny = NODE_MASS_FLOOR * cell_mass[rows.phase[nb]]
            momentum_to_velocity(nb, momentum_sums.nodes, push, tiny)


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
def _may_touch(block, solid, phase, solids, pair_rules, step):
    """Return whether contact acts between two phases of a block, or one and a rigid boundary.

    Args:
        block: Context of the block.
        solid: Row of the block in solids, or -1.
        phase: Phases of the node blocks.
        solids: Rigid boundaries.
        pair_rules: Interaction of each pair of phases, or None.
        step: Constants of the step.
    """
    if not has_several_parties(block, solid, solids, step.dx):
        return False
    if pair_rules is None or solid >= 0 or block.at_wall:
        return True
    if pair_rules is not None:
        for a in range(block.n0, block.n1):
            for b in range(block.n0, a):
                if pair_rules[phase[a], phase[b]] == CONTACT:
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
