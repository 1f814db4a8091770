"""What functions for 16 particles mean for a thread that has one.

Vectors are numbers, `count` is 1, and records, weights and what is set aside are arrays of the
thread's own, so that those of the next particle begin at 0.
"""

import numpy as np
from numba import cuda

from ...kernels import beside, driven, g2p, patches, records, rowsums, walls
from ...kernels.layers import offsets
from ...lanes import lanes, parts, rows
from ...lanes import team as lanes_team
from . import team
from .numbers import PLAIN
from .words import Mode, constants

PATCH = records.PATCH
REAL = None


def load(row, at):
    return row[at]


def store(row, at, value):
    row[at] = value


def place(array):
    return array


def spread(like, value):
    return REAL(value)


def first_lanes(value, count):
    return value


def largest(value):
    return value


def sound(value, low, high, count):
    return 1 if value > low and value < high else 0


def only(mask, value):
    return value if mask & 1 else REAL(0.0)


def store_records(array, at, numbers):
    array[at], array[at + 1], array[at + 2], array[at + 3] = numbers[:4]
    array[at + 4], array[at + 5], array[at + 6], array[at + 7] = numbers[4:8]
    array[at + 8], array[at + 9], array[at + 10], array[at + 11] = numbers[8:12]
    array[at + 12], array[at + 13], array[at + 14], array[at + 15] = numbers[12:]


def load_records(array, at):
    first = (
        array[at], array[at + 1], array[at + 2], array[at + 3], array[at + 4], array[at + 5],
        array[at + 6], array[at + 7],
    )  # fmt: skip
    second = (
        array[at + 8], array[at + 9], array[at + 10], array[at + 11], array[at + 12],
        array[at + 13], array[at + 14], array[at + 15],
    )  # fmt: skip
    return first + second


def store_whole(array, at, value):
    array[at] = np.int32(value)


def offsets_record(kind, count, volumes, first, record):
    """One pattern times a volume: see layers/offsets.py."""
    volume = volumes[first]
    for k in range(16):
        fourth = 1.0 if k == 3 else 0.0
        diagonal = 1.0 if k == 4 or k == 9 or k == 14 else 0.0
        record[k] = volume * (kind.share * (fourth - kind.dx * diagonal))


def repeat(array, at, like):
    """Of the four numbers of a node the one that is this thread's (transfer.py)."""
    return array[at + (team.rank() & 3)]


# ---- a row of a patch: one number of one node, of which `o` says the number ---------------------


def part_load(array, at, like):
    return array[at]


def nothing(array, node, nodes):
    return REAL(0.0)


def steps(array, node, nodes):
    return REAL(node)


def middle(array, node, nodes):
    return -0.375 if node == 0 else (0.5 if node == 1 else -0.125)


def change(array, node, nodes):
    return 0.5 if node == 1 else -0.25


def _gathers(name):
    """The rows' sums of a record (kernels/rowsums.py) by the text of their three nodes."""
    of = rowsums.SUMS[name][1]
    first, second, third = of(0, 1), of(1, 1), of(2, 1)

    def moments(count, record, weights, base, patch):
        for c in range(4):
            o = base[0] + c
            a = first(weights, 0, patch, o)
            b = second(weights, 0, patch, o)
            d = third(weights, 0, patch, o)
            for q in range(4):
                record[4 * q + c] = (a[q] + b[q]) + d[q]

    def values(count, record, weights, base, patch):
        for c in range(4):
            o = base[0] + c
            a = first(weights, 0, patch, o)
            b = second(weights, 0, patch, o)
            d = third(weights, 0, patch, o)
            record[c] = (a[0] + b[0]) + d[0]

    return values if name == "values" else moments


def gather(patch, grid, blocks, box):
    """The nodes of a patch from the 27 node blocks around it, by a team."""
    for q in team.each(PATCH):
        i, j, n = (q >> 8) + 3, ((q >> 5) & 7) + 3, ((q >> 2) & 7) + 3
        nb = blocks[(i >> 2) * 9 + (j >> 2) * 3 + (n >> 2)]
        patch[q] = grid[256 * nb + (i & 3) * 64 + (j & 3) * 16 + (n & 3) * 4 + (q & 3)]
    team.meet()


def node_of(patch, a, plane, i, j):
    """The node (i, j) of a plane across axis a, of a flat patch."""
    if a == 0:
        return patch[256 * plane + 32 * i + 4 * j : 256 * plane + 32 * i + 4 * j + 4]
    if a == 1:
        return patch[256 * i + 32 * plane + 4 * j : 256 * i + 32 * plane + 4 * j + 4]
    return patch[256 * i + 32 * j + 4 * plane : 256 * i + 32 * j + 4 * plane + 4]


def nodes_of(patch):
    """A patch by nodes: here it stays flat (`node_of`)."""
    return patch


def flat(array):
    """Arrays of a card are."""
    return array


def patch_of(real, k):
    """The patch of what is gathered beside velocity."""
    return real[(k + 1) * PATCH : (k + 2) * PATCH]


def note(report, number, reason):
    """Keep the lowest id of the particles that went wrong, and why. report: g2p's, here maxima and
    that."""
    if number * 8 + reason < report[1][0]:
        report[1][0] = number * 8 + reason


def tell(report, fastest, far, quick, stretching, carried, turning, motion, dx):
    """Maxima as they are: the host makes rates of them."""
    maxima = report[0]
    maxima[0], maxima[1] = max(maxima[0], fastest), max(maxima[1], far)
    maxima[2], maxima[3] = max(maxima[2], quick), max(maxima[3], stretching)
    maxima[4], maxima[5] = max(maxima[4], carried), max(maxima[5], turning)


def went(report, far, speed, squared):
    """The same of what is driven."""
    cuda.atomic.max(report[0], 1, far)
    cuda.atomic.max(report[0], 4, speed)
    cuda.atomic.max(report[0], 5, squared)


TEAMWORK = {
    lanes_team.each: team.each, lanes_team.meet: team.meet, lanes_team.count_up: team.count_up,
    lanes_team.flat: flat,
}  # fmt: skip
VIEWS = frozenset({patch_of, node_of, nodes_of, flat})
PARTICLE = Mode(
    "particle",
    PLAIN | TEAMWORK | {
        lanes.load: load, lanes.store: store, lanes.place: place, rows.spread: spread,
        rows.first_lanes: first_lanes, rows.largest: largest, rows.sound: sound, rows.only: only,
        rows.store_records: store_records, rows.load_records: load_records,
        rows.store_whole: store_whole, offsets._offsets: offsets_record,
        parts.load: part_load, parts.store: store, parts.repeat: repeat, parts.nothing: nothing,
        parts.steps: steps, parts.stretch: part_load,
        parts.slope_middle: middle, parts.slope_change: change,
        rowsums.moments: _gathers("moments"), rowsums.slopes: _gathers("slopes"),
        rowsums.values: _gathers("values"), patches.gather: gather, records.patch_of: patch_of,
        walls._node: node_of, patches.nodes_of: nodes_of,
        g2p.note: note, g2p.tell: tell, driven.went: went,
    },
    # a thread's own batch is one particle
    constants({"BATCH": 1, "CHANGE": 5, "QUARTERS": False}, records, beside, rowsums),
    VIEWS,
)  # fmt: skip
