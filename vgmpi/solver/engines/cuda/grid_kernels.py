"""GPU loops of the grid update, around kernels/grid/update.py and related modules.

A team of 16 threads processes a block. Where the CPU has a vector of four nodes with four numbers
each, a thread has one of the sixteen numbers; where the CPU walks over nodes, a thread has every
sixteenth node.
"""

import numpy as np
from numba import cuda

from vgmpi.features.mixtures.workspace import MixtureWorkspace
from vgmpi.kernels.grid import update as grid
from vgmpi.kernels.grid.contact_impulses import ContactWorkspace
from vgmpi.kernels.grid.node_stages import SeparatedStress
from vgmpi.kernels.nodal_fields import carried_values
from vgmpi.kernels.reaction_impulses import GhostNodes, ReactionSums
from vgmpi.kernels.reproducible_sums import finalize_node_block
from vgmpi.kernels.simd import reproducible_add, row_ops, vector16
from vgmpi.kernels.transfer import transfer_correction

from .particle_intrinsics import TEAMWORK, VIEWS, broadcast, place
from .scalar_math import PLAIN
from .thread_block import each, meet, number, rank
from .translation_types import SIMULATED, TranslationMode

BLOCK = 256
TEAM = TEAMS = 16
WORDS = PHASES = PAIRS = 1
REAL = None
BITS_OF_SUM = np.uint64((1 << 52) - 1)
TWELVE, TWENTY_FOUR, THIRTY_SIX = np.uint64(12), np.uint64(24), np.uint64(36)
FIFTY_TWO = np.uint64(52)


# ---- a vector of a row's four nodes, by threads -------------------------------------------------


def load(row, index):
    """Return the number of this thread in a row."""
    return row[index + (cuda.threadIdx.x & 15)]


def store(row, index, value):
    """Store the number of this thread in a row."""
    row[index + (cuda.threadIdx.x & 15)] = value


def repeat(row, index):
    """Return the quantity of this thread, one of four of all nodes."""
    return row[index + (cuda.threadIdx.x & 3)]


def _from_lane(value, lane):
    """Return the value of a thread of this half warp."""
    half = cuda.threadIdx.x & 16
    return cuda.shfl_sync(0xFFFF << half, value, half + lane)


def _from_thread(value, lane):
    """Return the value of a thread; for the simulator, which has no shuffles."""
    pool, team = cuda.shared.array((TEAMS, 16), REAL), cuda.threadIdx.x // 16
    pool[team, cuda.threadIdx.x & 15] = value
    meet()
    result = pool[team, lane]
    meet()
    return result


from_lane = _from_thread if SIMULATED else _from_lane


def fourth_of(row):
    """Return the fourth number of this thread's node."""
    return from_lane(row, (cuda.threadIdx.x & 15) | 3)


def with_fourth(row, other):
    """Return the row with the fourth numbers of another."""
    return row if (cuda.threadIdx.x & 3) < 3 else other


def squared(row):
    """Return x^2 + y^2 + z^2 of this thread's node."""
    square, first = row * row, cuda.threadIdx.x & 12
    x = from_lane(square, first)
    y = from_lane(square, first + 1)
    z = from_lane(square, first + 2)
    return (x + y) + z


def velocity(row, push, min_mass):
    """Return velocity after `push`, and mass; nodes of small mass are at rest."""
    mass = from_lane(row, (cuda.threadIdx.x & 15) | 3)
    moved = row / mass + push
    moved = moved if mass > min_mass else REAL(0.0)
    return moved if (cuda.threadIdx.x & 3) < 3 else row


def horizontal_max(value):
    """Return the largest of four nodes, for numbers that threads of a node share."""
    a = from_lane(value, 0)
    b = from_lane(value, 4)
    c = from_lane(value, 8)
    d = from_lane(value, 12)
    return max(max(a, b), max(c, d))


def words_of(example):
    """Return the number of words of a sum."""
    return WORDS


def settled(nb, blocks, layer, report, which):
    """Read the sums of a block and reset them (finalize_node_block); the GPU has no copies.

    Args:
        nb, blocks: Index of the node block and table of blocks.
        layer: Nodal field (in/out).
        report, which: Overflow report (in/out) and its entry.
    """
    if layer.has_terms[nb] != 0:
        to, offset, r = BLOCK * nb, BLOCK * WORDS * nb, 16 * WORDS * blocks.phase[nb]
        for c in range(rank(), BLOCK, 16):
            first = layer.bias[r + (c & 15)]
            value = layer.sums[offset + c] - first
            layer.sums[offset + c] = first
            bad = not abs(value) < first * np.float64(1.0 / reproducible_add.ROOM)
            if WORDS == 2:
                second = layer.bias[r + 16 + (c & 15)]
                value = value + (layer.sums[offset + BLOCK + c] - second)
                layer.sums[offset + BLOCK + c] = second
            layer.nodes[to + c] = REAL(value)
            if bad:
                cuda.atomic.min(report, which, nb + 1)


NODES = TranslationMode(
    "nodes",
    PLAIN | TEAMWORK | {
        vector16.load: load, vector16.store: store, vector16.pointer: place,
        row_ops.broadcast: broadcast,
        row_ops.tile: repeat, row_ops.horizontal_max: horizontal_max,
        row_ops.fourth_of: fourth_of,
        row_ops.with_fourth: with_fourth, row_ops.squared: squared,
        row_ops.velocity: velocity,
        finalize_node_block: settled, reproducible_add.words_of: words_of,
    },
    {},
    VIEWS,
)  # fmt: skip


# ---- workspace of a thread ----------------------------------------------------------------------


def own_given(reactions, now, point, pairs, places):
    """Return the reaction sums with the workspace of a thread, or None.

    Args:
        reactions: Shared reaction sums, or None.
        now, point: Workspace of the thread, shapes (3,) and (6,).
        pairs, places: Workspace of its contact pairs.
    """
    if reactions is None:
        return None
    return ReactionSums(
        reactions.sums, reactions.quanta, reactions.counts, now, point[:3], point[3:], pairs,
        places, reactions.first, reactions.dx,
    )  # fmt: skip


def own_ghosts(ghosts, now, point):
    """Return the ghost record with the workspace of a thread, or None."""
    if ghosts is None:
        return None
    reactions = own_given(
        ghosts.reactions, now, point, ghosts.reactions.pairs, ghosts.reactions.places
    )
    return GhostNodes(
        reactions, ghosts.slot, ghosts.low, ghosts.mass, ghosts.share, ghosts.change_share,
        ghosts.holds_mass,
    )  # fmt: skip


# Both return None for None (index of the argument that decides).
own_given.like = own_ghosts.like = 0  # type: ignore[attr-defined]


def _block(
    blocks,
    tables,
    summed,
    shear,
    separate,
    pair_rules,
    walls,
    phases,
    solids,
    reactions,
    step,
    report,
):
    """Update the nodes of the team's block (contact, walls and others): kernels/grid/update.py."""
    v = cuda.local.array((PHASES + 2, 3), np.float64)
    slope = cuda.local.array((PHASES, 3), np.float64)
    change = cuda.local.array((PHASES, 3), np.float64)
    masses = cuda.local.array((2, PHASES), np.float64)
    present = cuda.local.array((2, PHASES), np.int64)
    of_pairs = cuda.local.array((3, PAIRS), np.int64)
    normals = cuda.local.array((PAIRS, 10), np.float64)
    impulse = cuda.local.array((PAIRS, 4), np.float64)
    places = cuda.local.array((PAIRS, 3), np.float64)
    friction = cuda.local.array((2, PAIRS), np.float64)
    row = cuda.local.array(PHASES, np.float64)
    plane = cuda.local.array(4, np.float64)
    now = cuda.local.array(3, np.int64)
    point = cuda.local.array(6, np.float64)
    plane[3] = 0
    for c in range(3 * (PHASES + 2)):
        v[c // 3, c % 3] = 0
    for c in range(3 * PHASES):
        slope[c // 3, c % 3] = 0
    own_reactions = own_given(reactions, now, point, of_pairs[2], places)
    workspace = ContactWorkspace(
        v, masses[0], masses[1], present[0], slope, change, normals, impulse, friction[0],
        friction[1], of_pairs[0], of_pairs[1], present[1], plane, row, own_reactions,
    )  # fmt: skip
    grid.update(
        blocks, tables, summed, shear, separate, pair_rules, walls, phases, solids, workspace, step,
        report,
    )  # fmt: skip


def update(
    blocks,
    tables,
    summed,
    shear,
    separate,
    pair_rules,
    walls,
    phases,
    solids,
    reactions,
    step,
    report,
):
    """Compute velocities at the nodes of blocks without separate stress impulses.

    Args:
        blocks: Node blocks to process.
        tables: Table of node blocks.
        summed, shear, separate: Nodal fields (in/out).
        pair_rules, walls, phases, solids: Interaction rules, walls, phases and rigid bodies.
        reactions: Reaction sums, or None.
        step, report: Constants of the step, and overflow report (in/out).
    """
    q = number()
    if q < len(blocks):
        _block(blocks[q : q + 1], tables, summed, shear, None, pair_rules, walls, phases, solids,
               reactions, step, report)  # fmt: skip


def update_apart(
    blocks,
    tables,
    summed,
    shear,
    separate,
    pair_rules,
    walls,
    phases,
    solids,
    reactions,
    step,
    report,
):
    """Compute velocities at the nodes of blocks with separate stress impulses.

    Args:
        blocks: Node blocks to process.
        tables: Table of node blocks.
        summed, shear, separate: Nodal fields (in/out).
        pair_rules, walls, phases, solids: Interaction rules, walls, phases and rigid bodies.
        reactions: Reaction sums, or None.
        step, report: Constants of the step, and overflow report (in/out).
    """
    members = cuda.local.array((3, PHASES), np.int64)
    numbers = cuda.local.array((2, PHASES), np.float64)
    of_two = cuda.local.array((2, PHASES * PHASES), np.float64)
    M = cuda.local.array(16 * PHASES, REAL)
    V = cuda.local.array(16 * PHASES + 16, REAL)
    U = cuda.local.array(16 * PHASES, REAL)
    K = cuda.local.array(16 * PHASES * PHASES, REAL)
    S = cuda.local.array(16 * PHASES, REAL)
    R = cuda.local.array(16 * PHASES, REAL)
    workspace = MixtureWorkspace(
        members[0], members[1], members[2], numbers[0], numbers[1], of_two[0], of_two[1],
        M, V, U, K, S, R,
    )  # fmt: skip
    q = number()
    if q < len(blocks):
        own = SeparatedStress(
            separate.impulses, separate.shared, separate.adds_own, separate.kind, workspace,
            separate.is_converted,
        )  # fmt: skip
        _block(blocks[q : q + 1], tables, summed, shear, own, pair_rules, walls, phases, solids,
               reactions, step, report)  # fmt: skip


def settle(
    blocks, tables, momentum, as_one, phases, kind, extra, extra_field, step, report
):  # fmt: skip
    """Compute velocities in a step of no time: kernels/transfer/transfer_correction.py.

    Args:
        blocks, tables: Node blocks to process, and table of node blocks.
        momentum: Nodal field (in/out).
        as_one, phases: Phases that move with one velocity, and their tables.
        kind: Kind of a feature that takes part, or None.
        extra, extra_field: Sums of its field (in/out) or None, and their entry of the report.
        step, report: Constants of the step, and overflow report (in/out).
    """
    q = number()
    if q < len(blocks):
        transfer_correction.momentum_to_velocity_only(
            blocks[q : q + 1],
            tables,
            momentum,
            as_one,
            phases,
            kind,
            extra,
            extra_field,
            step,
            report,
        )


def blend(blocks, tables, layer, set_of, report, k):
    """Compute mean values: kernels/nodal_fields/carried_values.py.

    Args:
        blocks, tables: Node blocks to process, and table of node blocks.
        layer: Nodal field (in/out).
        set_of: Color set of each phase.
        report, k: Overflow report (in/out) and its entry.
    """
    q = number()
    if q < len(blocks):
        carried_values.average_over_phases(blocks[q : q + 1], tables, layer, set_of, report, k)


# ---- sums for other ranks -----------------------------------------------------------------------


def reset(sums, bias, phase):
    """Set sums to their bias, a node block per team: kernels/reproducible_sums.py."""
    q = number()
    if q < len(phase):
        for w in range(WORDS):
            for c in each(BLOCK):
                sums[BLOCK * (WORDS * q + w) + c] = bias[phase[q], w, c & 15]


def pack(numbers, tails, blocks, masks, first, sums):
    """Pack the sums of some nodes as a message, kernels/reproducible_sums.py.

    Args:
        numbers, tails (out): Message.
        blocks, masks: Node blocks and bits of their nodes.
        first: Index of the first sums of each block, shape (m,).
        sums: Sums of the nodal field.
    """
    q = number()
    if q < len(blocks):
        mask = masks[q]
        count = cuda.popc(mask)
        for node in each(64):
            bit = np.uint64(1) << np.uint64(node)
            if mask & bit != np.uint64(0):
                for w in range(WORDS):
                    n = first[q] + w * count + _before(mask, bit)
                    offset = BLOCK * (WORDS * blocks[q] + w) + 4 * node
                    a = sums[offset].view(np.uint64) & BITS_OF_SUM
                    b = sums[offset + 1].view(np.uint64) & BITS_OF_SUM
                    c = sums[offset + 2].view(np.uint64) & BITS_OF_SUM
                    last = sums[offset + 3].view(np.uint64) & BITS_OF_SUM
                    numbers[3 * n] = a | (last << FIFTY_TWO)
                    numbers[3 * n + 1] = b | ((last >> TWELVE) << FIFTY_TWO)
                    numbers[3 * n + 2] = c | ((last >> TWENTY_FOUR) << FIFTY_TWO)
                    tails[n] = np.uint16(last >> THIRTY_SIX)


def unpack(numbers, tails, blocks, masks, first, sums, bias, phase):
    """Add the sums of another rank, the inverse of `pack`.

    Args:
        numbers, tails: Message.
        blocks, masks: Node blocks and bits of their nodes.
        first: Index of the first sums of each block, shape (m,).
        sums (in/out): Sums of the nodal field.
        bias, phase: Bias of each phase, and phase of each block.
    """
    q = number()
    if q < len(blocks):
        mask = masks[q]
        count = cuda.popc(mask)
        for node in each(64):
            bit = np.uint64(1) << np.uint64(node)
            if mask & bit != np.uint64(0):
                for w in range(WORDS):
                    n = first[q] + w * count + _before(mask, bit)
                    offset = BLOCK * (WORDS * blocks[q] + w) + 4 * node
                    last = np.uint64(tails[n]) << THIRTY_SIX
                    for c in range(3):
                        packed = numbers[3 * n + c]
                        last = last | ((packed >> FIFTY_TWO) << np.uint64(12 * c))
                        r = bias[phase[blocks[q]], w, (4 * node + c) & 15]
                        sums[offset + c] += _unpacked(packed, r)
                    r = bias[phase[blocks[q]], w, (4 * node + 3) & 15]
                    sums[offset + 3] += _unpacked(last, r)


def _before(mask, bit):
    """Count the nodes of a mask that come before the node of a bit."""
    return cuda.popc(mask & (bit - np.uint64(1)))


def _unpacked(packed, r):
    """Return the sum in 52 bits minus its bias r."""
    sign = r.view(np.uint64) & ~BITS_OF_SUM
    return ((packed & BITS_OF_SUM) | sign).view(np.float64) - r
