"""Nodes of a block that two patches share, as bit masks: index arithmetic alone."""

import numpy as np

from vgmpi.runtime.jit import kernel

NEIGHBORS = np.array([(i, j, k) for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1)])

# _ALONG[d + 1][e + 1] has a bit for each node 0 to 3, along one axis, of the block at e that two
# patches both reach: that of block 0, which begins two nodes before the block, and that of block d.
_ALONG = (
    (0b1000, 0b0111, 0b0000),
    (0b1000, 0b1111, 0b0111),
    (0b0000, 0b1000, 0b0111),
)


def _masks() -> np.ndarray:
    """Return the masks of the nodes that two patches share, shape (27, 27) uint64.

    Entry [d, e] is for the block at NEIGHBORS[e] and the patches of a block and of the one at
    NEIGHBORS[d]; bit 16 i + 4 j + k stands for node (i, j, k).
    """
    out = np.zeros((27, 27), np.uint64)
    for d, e in np.ndindex(27, 27):
        x, y, z = (_ALONG[p + 1][q + 1] for p, q in zip(NEIGHBORS[d], NEIGHBORS[e], strict=True))
        for i, j, k in np.ndindex(4, 4, 4):
            if x >> i & 1 and y >> j & 1 and z >> k & 1:
                out[d, e] |= np.uint64(1 << (16 * i + 4 * j + k))
    return out


SHARED_NODE_MASKS = _masks()


@kernel
def number_node_blocks(places, phase, is_used, steps, phases):
    """Number the node blocks that the patches of segments touch, ascending by place and phase.

    Args:
        places: Place of each segment's block on a dense map, shape (n,).
        phase: Phase of each segment, shape (n,).
        is_used: True for the node blocks that this rank uses, shape (places,).
        steps: Differences of place to the 27 blocks around a block, shape (27,).
        phases: Number of phases.

    Returns:
        place * phases + phase of each node block, and the table (n, 27) of their numbers, -1 if
        none.
    """
    max_count = len(is_used) * phases
    numbers = np.zeros(max_count, np.int32)
    for s in range(len(places)):
        for e in range(27):
            to = places[s] + steps[e]
            if is_used[to]:
                numbers[to * phases + phase[s]] = 1
    used = 0
    for n in range(max_count):
        used += numbers[n]
        numbers[n] = used - 1 if numbers[n] else -1
    nodes = np.empty(used, np.int64)
    for n in range(max_count):
        if numbers[n] >= 0:
            nodes[numbers[n]] = n
    table = np.full((len(places), 27), -1)
    for s in range(len(places)):
        for e in range(27):
            to = places[s] + steps[e]
            if is_used[to]:
                table[s, e] = numbers[to * phases + phase[s]]
    return nodes, table


@kernel
def _shared(places, who, contributes, table, who_at, steps, others, count, masks):
    """Return the masks of `shared_masks`, with the table of masks as an argument."""
    sends = np.zeros((others, count), np.uint64)
    receives = np.zeros((others, count), np.uint64)
    reaches = np.zeros(len(places), np.bool_)
    for s in range(len(places)):
        mine = who[s] == others
        for d in range(27):
            other = who_at[places[s] + steps[d]]
            # pairs of an own patch and another rank's, in either order
            if other < 0 or mine == (other == others):
                continue
            reaches[s] |= mine
            if not contributes[s]:
                continue
            for e in range(27):
                if masks[d, e] != 0 and table[s, e] >= 0:
                    if mine:
                        sends[other, table[s, e]] |= masks[d, e]
                    else:
                        receives[who[s], table[s, e]] |= masks[d, e]
    return sends, receives, reaches


def shared_masks(places, who, contributes, table, who_at, steps, others: int, count: int):
    """Return the nodes of each node block that this rank sends to, and receives from, every other.

    Args:
        places: Place of each segment's block on a dense map, shape (n,).
        who: Number of the rank of each segment, `others` for this rank, shape (n,).
        contributes: True if a segment contributes to the field, shape (n,).
        table: Node blocks around each segment, see `number_node_blocks`, shape (n, 27).
        who_at: Number of the rank by place, -1 for none.
        steps: Differences of place, see `number_node_blocks`, shape (27,).
        others: Number of other ranks.
        count: Number of node blocks.

    Returns:
        Masks to send and to receive, shape (others, count) each, and True for the segments that
        reach nodes that another rank reaches, shape (n,).
    """
    return _shared(places, who, contributes, table, who_at, steps, others, count, SHARED_NODE_MASKS)
