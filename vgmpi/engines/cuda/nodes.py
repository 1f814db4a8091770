"""Kernels at the nodes: the loops of a card around kernels/grid.py and its kin.

A team of 16 threads does a block. Where the processor has a vector of four nodes with four numbers
each, a thread has one of the sixteen; where it walks over nodes, a thread has every sixteenth.
"""

import numpy as np
from numba import cuda

from ...kernels import grid, restore
from ...kernels.given import Ghosts, Given
from ...kernels.grid import Apart
from ...kernels.layers import colour
from ...kernels.members import Room as Members
from ...kernels.sums import take_up
from ...kernels.touch import Room
from ...lanes import lanes, nodes, rows, wide
from .numbers import PLAIN
from .particle import TEAMWORK, VIEWS, place, spread
from .team import each, meet, number, rank
from .words import SIMULATED, Mode

BLOCK = 256
TEAM = TEAMS = 16
WORDS = PHASES = PAIRS = 1
REAL = None
BITS_OF_SUM = np.uint64((1 << 52) - 1)
TWELVE, TWENTY_FOUR, THIRTY_SIX = np.uint64(12), np.uint64(24), np.uint64(36)
FIFTY_TWO = np.uint64(52)


# ---- a vector of a row's four nodes, by threads -------------------------------------------------


def load(row, at):
    return row[at + (cuda.threadIdx.x & 15)]


def store(row, at, value):
    row[at + (cuda.threadIdx.x & 15)] = value


def repeat(row, at):
    return row[at + (cuda.threadIdx.x & 3)]


def _from_lane(value, lane):
    """The value that a thread of this half of a warp has."""
    half = cuda.threadIdx.x & 16
    return cuda.shfl_sync(0xFFFF << half, value, half + lane)


def _from_thread(value, lane):
    """The same for the simulator, which has no shuffles."""
    pool, team = cuda.shared.array((TEAMS, 16), REAL), cuda.threadIdx.x // 16
    pool[team, cuda.threadIdx.x & 15] = value
    meet()
    found = pool[team, lane]
    meet()
    return found


from_lane = _from_thread if SIMULATED else _from_lane


def fourth_of(row):
    return from_lane(row, (cuda.threadIdx.x & 15) | 3)


def with_fourth(row, other):
    return row if (cuda.threadIdx.x & 3) < 3 else other


def squared(row):
    square, first = row * row, cuda.threadIdx.x & 12
    x = from_lane(square, first)
    y = from_lane(square, first + 1)
    z = from_lane(square, first + 2)
    return (x + y) + z


def velocity(row, push, least):
    mass = from_lane(row, (cuda.threadIdx.x & 15) | 3)
    moved = row / mass + push
    moved = moved if mass > least else REAL(0.0)
    return moved if (cuda.threadIdx.x & 3) < 3 else row


def largest(value):
    """The largest of four nodes, of numbers that a node's threads share."""
    a = from_lane(value, 0)
    b = from_lane(value, 4)
    c = from_lane(value, 8)
    d = from_lane(value, 12)
    return max(max(a, b), max(c, d))


def words_of(example):
    return WORDS


def settled(nb, blocks, layer, report, which):
    """sums.take_up: there are no copies on a card."""
    if layer.asked[nb] != 0:
        to, at, r = BLOCK * nb, BLOCK * WORDS * nb, 16 * WORDS * blocks.phase[nb]
        for c in range(rank(), BLOCK, 16):
            first = layer.rest[r + (c & 15)]
            value = layer.sums[at + c] - first
            layer.sums[at + c] = first
            bad = not abs(value) < first * np.float64(1.0 / wide.ROOM)
            if WORDS == 2:
                second = layer.rest[r + 16 + (c & 15)]
                value = value + (layer.sums[at + BLOCK + c] - second)
                layer.sums[at + BLOCK + c] = second
            layer.nodes[to + c] = REAL(value)
            if bad:
                cuda.atomic.min(report, which, nb + 1)


NODES = Mode(
    "nodes",
    PLAIN | TEAMWORK | {
        lanes.load: load, lanes.store: store, lanes.place: place, rows.spread: spread,
        rows.repeat: repeat, rows.largest: largest, nodes.fourth_of: fourth_of,
        nodes.with_fourth: with_fourth, nodes.squared: squared, nodes.velocity: velocity,
        take_up: settled, wide.words_of: words_of,
    },
    {},
    VIEWS,
)  # fmt: skip


# ---- what a thread has to itself ----------------------------------------------------------------


def own_given(given, now, at, pairs, places):
    """The sums of what rigid things give, with a thread's own notes. now: (3,); at: (6,)."""
    if given is None:
        return None
    return Given(
        given.sums, given.quanta, given.counts, now, at[:3], at[3:], pairs, places, given.first,
        given.dx,
    )  # fmt: skip


def own_ghosts(ghosts, now, at):
    if ghosts is None:
        return None
    given = own_given(ghosts.given, now, at, ghosts.given.pairs, ghosts.given.places)
    return Ghosts(
        given, ghosts.slot, ghosts.low, ghosts.mass, ghosts.share, ghosts.kept, ghosts.weighs
    )


# both are None where what they are given is
own_given.like = own_ghosts.like = 0  # type: ignore[attr-defined]


def _block(blocks, tables, summed, shear, apart, rules, walls, phases, solids, given, step, report):
    """Contact, walls and all between, of the team's block: kernels/grid.py."""
    v = cuda.local.array((PHASES + 2, 3), np.float64)
    slope = cuda.local.array((PHASES, 3), np.float64)
    change = cuda.local.array((PHASES, 3), np.float64)
    masses = cuda.local.array((2, PHASES), np.float64)
    here = cuda.local.array((2, PHASES), np.int64)
    of_pairs = cuda.local.array((3, PAIRS), np.int64)
    normals = cuda.local.array((PAIRS, 7), np.float64)
    impulse = cuda.local.array((PAIRS, 4), np.float64)
    places = cuda.local.array((PAIRS, 3), np.float64)
    friction = cuda.local.array(PAIRS, np.float64)
    row = cuda.local.array(PHASES, np.float64)
    plane = cuda.local.array(4, np.float64)
    now = cuda.local.array(3, np.int64)
    at = cuda.local.array(6, np.float64)
    plane[3] = 0
    for c in range(3 * (PHASES + 2)):
        v[c // 3, c % 3] = 0
    for c in range(3 * PHASES):
        slope[c // 3, c % 3] = 0
    mine = own_given(given, now, at, of_pairs[2], places)
    room = Room(
        v, masses[0], masses[1], here[0], slope, change, normals, impulse, friction, of_pairs[0],
        of_pairs[1], here[1], plane, row, mine,
    )  # fmt: skip
    grid.update(
        blocks, tables, summed, shear, apart, rules, walls, phases, solids, room, step, report
    )


def update(blocks, tables, summed, shear, apart, rules, walls, phases, solids, given, step, report):
    """Velocities at the nodes of blocks, no impulses kept apart."""
    q = number()
    if q < len(blocks):
        _block(blocks[q : q + 1], tables, summed, shear, None, rules, walls, phases, solids, given,
               step, report)  # fmt: skip


def update_apart(
    blocks, tables, summed, shear, apart, rules, walls, phases, solids, given, step, report
):  # fmt: skip
    """Velocities at the nodes of blocks where impulses are kept apart."""
    of = cuda.local.array((3, PHASES), np.int64)
    numbers = cuda.local.array((2, PHASES), np.float64)
    of_two = cuda.local.array((2, PHASES * PHASES), np.float64)
    M = cuda.local.array(16 * PHASES, REAL)
    V = cuda.local.array(16 * PHASES + 16, REAL)
    U = cuda.local.array(16 * PHASES, REAL)
    K = cuda.local.array(16 * PHASES * PHASES, REAL)
    S = cuda.local.array(16 * PHASES, REAL)
    R = cuda.local.array(16 * PHASES, REAL)
    room = Members(
        of[0], of[1], of[2], numbers[0], numbers[1], of_two[0], of_two[1], M, V, U, K, S, R
    )
    q = number()
    if q < len(blocks):
        own = Apart(
            apart.impulses, apart.flux, apart.drift, apart.change, apart.noted, room, apart.tables
        )
        _block(blocks[q : q + 1], tables, summed, shear, own, rules, walls, phases, solids, given,
               step, report)  # fmt: skip


def settle(blocks, tables, momentum, as_one, phases, step, report):
    """Velocities of a step of no time: kernels/restore.py."""
    q = number()
    if q < len(blocks):
        restore.settle(blocks[q : q + 1], tables, momentum, as_one, phases, step, report)


def blend(blocks, tables, layer, set_of, report, k):
    """Mean colours: kernels/layers/colour.py."""
    q = number()
    if q < len(blocks):
        colour.blend(blocks[q : q + 1], tables, layer, set_of, report, k)


# ---- sums for other ranks -----------------------------------------------------------------------


def reset(sums, rest, phase):
    """Put sums to rest, a node block a team: kernels/sums.py."""
    q = number()
    if q < len(phase):
        for w in range(WORDS):
            for c in each(BLOCK):
                sums[BLOCK * (WORDS * q + w) + c] = rest[phase[q], w, c & 15]


def pack(numbers, tails, blocks, masks, first, sums):
    """Sums of some nodes as a message, kernels/sums.py; first: (m,) number of the first of each."""
    q = number()
    if q < len(blocks):
        mask = masks[q]
        count = cuda.popc(mask)
        for node in each(64):
            bit = np.uint64(1) << np.uint64(node)
            if mask & bit != np.uint64(0):
                for w in range(WORDS):
                    n = first[q] + w * count + _before(mask, bit)
                    at = BLOCK * (WORDS * blocks[q] + w) + 4 * node
                    a = sums[at].view(np.uint64) & BITS_OF_SUM
                    b = sums[at + 1].view(np.uint64) & BITS_OF_SUM
                    c = sums[at + 2].view(np.uint64) & BITS_OF_SUM
                    last = sums[at + 3].view(np.uint64) & BITS_OF_SUM
                    numbers[3 * n] = a | (last << FIFTY_TWO)
                    numbers[3 * n + 1] = b | ((last >> TWELVE) << FIFTY_TWO)
                    numbers[3 * n + 2] = c | ((last >> TWENTY_FOUR) << FIFTY_TWO)
                    tails[n] = np.uint16(last >> THIRTY_SIX)


def unpack(numbers, tails, blocks, masks, first, sums, rest, phase):
    """Add what another rank summed, the inverse of `pack`."""
    q = number()
    if q < len(blocks):
        mask = masks[q]
        count = cuda.popc(mask)
        for node in each(64):
            bit = np.uint64(1) << np.uint64(node)
            if mask & bit != np.uint64(0):
                for w in range(WORDS):
                    n = first[q] + w * count + _before(mask, bit)
                    at = BLOCK * (WORDS * blocks[q] + w) + 4 * node
                    last = np.uint64(tails[n]) << THIRTY_SIX
                    for c in range(3):
                        whole = numbers[3 * n + c]
                        last = last | ((whole >> FIFTY_TWO) << np.uint64(12 * c))
                        r = rest[phase[blocks[q]], w, (4 * node + c) & 15]
                        sums[at + c] += _unpacked(whole, r)
                    r = rest[phase[blocks[q]], w, (4 * node + 3) & 15]
                    sums[at + 3] += _unpacked(last, r)


def _before(mask, bit):
    """How many nodes of a mask come before that of a bit."""
    return cuda.popc(mask & (bit - np.uint64(1)))


def _unpacked(whole, r):
    """What 52 bits of a sum say, less what it rests at."""
    sign = r.view(np.uint64) & ~BITS_OF_SUM
    return ((whole & BITS_OF_SUM) | sign).view(np.float64) - r
