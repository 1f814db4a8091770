"""The nodes of a block that two patches share, as bits: index maths alone."""

import numpy as np

from ..device.jit import kernel

NEIGHBOURS = np.array([(i, j, k) for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1)])

# along an axis, the nodes 0..3 of the block at e that a patch reaches which begins two nodes before
# block 0, and one of the block at d: [d + 1][e + 1], a bit each
_ALONG = (
    (0b1000, 0b0111, 0b0000),
    (0b1000, 0b1111, 0b0111),
    (0b0000, 0b1000, 0b0111),
)


def _masks() -> np.ndarray:
    """Of the block at NEIGHBOURS[e], the nodes that the patches of a block and of the one at
    NEIGHBOURS[d] share: (27, 27) uint64 by [d, e], bit 16 i + 4 j + k for node (i, j, k)."""
    out = np.zeros((27, 27), np.uint64)
    for d, e in np.ndindex(27, 27):
        x, y, z = (_ALONG[p + 1][q + 1] for p, q in zip(NEIGHBOURS[d], NEIGHBOURS[e], strict=True))
        for i, j, k in np.ndindex(4, 4, 4):
            if x >> i & 1 and y >> j & 1 and z >> k & 1:
                out[d, e] |= np.uint64(1 << (16 * i + 4 * j + k))
    return out


MASKS = _masks()


@kernel
def number(at, phase, around, steps, phases):
    """Number the node blocks that the patches of segments touch, ascending by place and phase.

    at: (n,) place of each segment's block on a dense map; around: (places,) bool: of the node
    blocks there are those that this rank has a use for; steps: (27,) from a place to those around
    it. Returns place * phases + phase of each, and the table (n, 27) of them, -1 where there is
    none.
    """
    most = len(around) * phases
    numbers = np.zeros(most, np.int32)
    for s in range(len(at)):
        for e in range(27):
            to = at[s] + steps[e]
            if around[to]:
                numbers[to * phases + phase[s]] = 1
    used = 0
    for n in range(most):
        used += numbers[n]
        numbers[n] = used - 1 if numbers[n] else -1
    nodes = np.empty(used, np.int64)
    for n in range(most):
        if numbers[n] >= 0:
            nodes[numbers[n]] = n
    table = np.full((len(at), 27), -1)
    for s in range(len(at)):
        for e in range(27):
            to = at[s] + steps[e]
            if around[to]:
                table[s, e] = numbers[to * phases + phase[s]]
    return nodes, table


@kernel
def _shared(at, who, takes, table, who_at, steps, others, count, masks):
    sends = np.zeros((others, count), np.uint64)
    receives = np.zeros((others, count), np.uint64)
    reaches = np.zeros(len(at), np.bool_)
    for s in range(len(at)):
        mine = who[s] == others
        for d in range(27):
            other = who_at[at[s] + steps[d]]
            # nodes of ours that another's patch reaches, and of another's that one of ours does
            if other < 0 or mine == (other == others):
                continue
            reaches[s] |= mine
            if not takes[s]:
                continue
            for e in range(27):
                if masks[d, e] != 0 and table[s, e] >= 0:
                    if mine:
                        sends[other, table[s, e]] |= masks[d, e]
                    else:
                        receives[who[s], table[s, e]] |= masks[d, e]
    return sends, receives, reaches


def shared_masks(at, who, takes, table, who_at, steps, others: int, count: int):
    """Which nodes of each node block this rank gives to every other, and gets from it: two arrays
    (others, count) of masks; and which segments reach nodes that another rank reaches.

    at, steps: as of `number`; who: (n,) number of each segment's rank, `others` for this one;
    takes: (n,) bool: whether a segment has something to give; who_at: by place, -1 for nobody.
    """
    return _shared(at, who, takes, table, who_at, steps, others, count, MASKS)
