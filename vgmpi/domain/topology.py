"""Who touches whom between two sorts: patches, node blocks, and the parts of patches that
neighbours need.

A patch covers its block and reaches one node into the block before it and three into the one after,
along each axis. So two patches share nodes exactly when their blocks are neighbours (or the same),
and a node block is complete once all patches of the 27 blocks around it are there. Everything here
follows from the census, which all ranks share: sender and receiver agree without asking.
"""

from typing import NamedTuple

import numpy as np

from ..device.jit import kernel
from .blocks import Lattice
from .migrate import Census

NEIGHBOURS = np.array([(i, j, k) for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1)])
_MARGIN = 4  # blocks around this rank's own that the dense maps cover


class Topology(NamedTuple):
    """Tables of one rank. Patches are numbered in key order, own and ghost together."""

    row: np.ndarray  # (patches,) row of the census
    own: np.ndarray  # (patches,) bool
    block: np.ndarray  # (patches, 3)
    offsets: np.ndarray  # (patches,) bool: somebody asks for its volumes and offsets
    split: np.ndarray  # (patches,) bool: keeps the stress's impulses apart from momentum
    table: np.ndarray  # (own patches, 27) node blocks around each
    first: np.ndarray  # (blocks + 1,) node blocks of each block
    phase: np.ndarray  # (node blocks,)
    block_at: np.ndarray  # (blocks, 3)
    meets: np.ndarray  # (blocks,) bool: contact is possible here
    waits: np.ndarray  # (blocks,) bool: patches of other ranks are part of its sum
    solid_of: np.ndarray  # (blocks,) row among the collider's blocks, or -1
    pull_first: np.ndarray  # (node blocks + 1,)
    pull_patch: np.ndarray  # patches that touch each node block, by (group, key)
    asked: np.ndarray  # (node blocks,) bool: patches with offsets touch it
    forced: np.ndarray  # (node blocks,) bool: patches with impulses kept apart touch it
    pull_code: np.ndarray  # where the node block lies from the patch's block, see kernels/grid.py
    sends: list  # per neighbour rank: (rank, patches, low (n, 3), high (n, 3))
    receives: list


class Apart(NamedTuple):
    """Which patches keep the stress's impulses apart from momentum."""

    everywhere: bool  # all of them
    shares: np.ndarray | None  # (n, n) bool, of phases: or fluids near one they share space with
    contact: np.ndarray | None  # (n, n) bool: whether a pair asks for volumes and offsets
    fluid: np.ndarray | None  # (n,) bool


class _Box:
    """Dense maps over the blocks around this rank's own."""

    def __init__(self, own: np.ndarray):
        self.low = own.min(0) - _MARGIN
        self.shape = tuple(own.max(0) + _MARGIN + 1 - self.low)

    def holds(self, block: np.ndarray) -> np.ndarray:
        return ((block >= self.low) & (block < self.low + self.shape)).all(1)

    def at(self, block: np.ndarray) -> np.ndarray:
        """Flat index of blocks (..., 3) inside the box."""
        b = block - self.low
        return (b[..., 0] * self.shape[1] + b[..., 1]) * self.shape[2] + b[..., 2]

    def full(self, value, dtype) -> np.ndarray:
        return np.full(int(np.prod(self.shape)), value, dtype)

    def spread(self, values: np.ndarray, reach: int, combine) -> np.ndarray:
        """Combine each block's value with those of blocks at most `reach` away along every axis."""
        grid = values.reshape(self.shape)
        for a in range(3):
            out = grid.copy()
            for d in range(1, reach + 1):
                low, high = [slice(None)] * 3, [slice(None)] * 3
                low[a], high[a] = slice(None, -d), slice(d, None)
                combine(out[tuple(low)], grid[tuple(high)], out=out[tuple(low)])
                combine(out[tuple(high)], grid[tuple(low)], out=out[tuple(high)])
            grid = out
        return grid.reshape(-1)


def build(
    census: Census,
    lattice: Lattice,
    rank: int,
    phase_of: np.ndarray,
    contact: bool,
    solid,
    apart: Apart | None = None,
) -> Topology:
    """Tables of `rank`. phase_of: (groups,) phase of each group; contact: whether phases may touch
    at all; solid: blocks (n, 3) -> row among the collider's blocks or -1, or None where the scene
    has no collider; apart: where the stress's impulses are kept apart from momentum, or None."""
    block = lattice.block(census.code)
    mine = census.owner == rank
    if not mine.any():
        return _nothing()
    box = _Box(block[mine])
    near = np.flatnonzero(box.holds(block))
    at = box.at(block[near])
    is_own = box.full(False, bool)
    is_own[at[mine[near]]] = True
    around = box.spread(is_own, 1, np.logical_or)
    row = near[around[at]]
    block = block[row]
    own = mine[row]
    phase = phase_of[census.group[row]]
    phases = int(phase_of.max()) + 1

    target = block[:, None, :] + NEIGHBOURS  # (patches, 27, 3)
    where = box.at(target)
    node = np.where(around[where], where * phases + phase[:, None], -1)
    # within a node block by group, then key: groups are transferred one after the other
    order = np.argsort(census.group[row], kind="stable")
    nodes, begin, patches, codes, table = _pull_lists(node, order, phases * len(around))

    flat = nodes // phases
    new = np.flatnonzero(np.diff(flat, prepend=-1))
    block_at = target[patches[begin[new]], codes[begin[new]]]
    first = np.append(new, len(nodes))
    solid_of = np.full(len(new), -1, np.int64) if solid is None else solid(block_at)
    wanted = _wants_offset(box, lattice, census, near, at, phase_of, contact, solid)[box.at(block)]
    split = np.zeros(len(row), bool)
    if apart is not None:
        split |= apart.everywhere
        if apart.shares is not None:
            close = _close(box, at, phase_of[census.group[near]], phases)[:, box.at(block)]
            split = (apart.shares[phase].T & close).any(0) & apart.fluid[phase]
            wanted &= (apart.contact[phase].T & close).any(0) | _by_solid(box, solid, block)
    meets = ((np.diff(first) > 1) & contact) | (solid_of >= 0)
    meets &= np.logical_or.reduceat(wanted[patches], begin[new])
    return Topology(
        row=row,
        own=own,
        block=block,
        offsets=wanted,
        split=split,
        table=table[own],
        first=first,
        phase=nodes % phases,
        block_at=block_at,
        meets=meets,
        waits=np.logical_or.reduceat(~own[patches], begin[new]),
        solid_of=solid_of,
        pull_first=begin,
        pull_patch=patches,
        asked=np.logical_or.reduceat(wanted[patches], begin[:-1]),
        forced=np.logical_or.reduceat(split[patches], begin[:-1]),
        pull_code=codes,
        sends=_traffic(block, own, census.owner[row], box, rank, sending=True),
        receives=_traffic(block, own, census.owner[row], box, rank, sending=False),
    )


@kernel
def _pull_lists(node, order, most):
    """Number the node blocks in use and list the patches that touch each.

    node: (patches, 27) which of `most` possible node blocks each patch touches, -1 for one nobody
    here needs; order: (patches,) of the sums. Returns the node blocks in use, ascending; where the
    list of each begins; patch and place 0..26 of every entry; node with the new numbers.
    """
    count = np.zeros(most, np.int64)
    total = 0
    for p in range(len(node)):
        for k in range(27):
            if node[p, k] >= 0:
                count[node[p, k]] += 1
                total += 1
    number = np.full(most, -1)
    used = 0
    for n in range(most):
        if count[n] > 0:
            number[n] = used
            used += 1
    nodes, begin = np.empty(used, np.int64), np.zeros(used + 1, np.int64)
    for n in range(most):
        if count[n] > 0:
            nodes[number[n]] = n
            begin[number[n] + 1] = begin[number[n]] + count[n]
    at = begin.copy()
    patch, code = np.empty(total, np.int64), np.empty(total, np.int64)
    table = np.full(node.shape, -1)
    for p in order:
        for k in range(27):
            if node[p, k] >= 0:
                n = number[node[p, k]]
                patch[at[n]], code[at[n]], table[p, k] = p, k, n
                at[n] += 1
    return nodes, begin, patch, code, table


def _wants_offset(box, lattice, census, near, at, phase_of, contact, solid) -> np.ndarray:
    """Per block of the box: whether its patches need volume and offset.

    They do where a patch of another phase, or the collider, can share a node with them: at most a
    block away. What else touches such a node touches both.
    """
    wants = box.full(False, bool)
    if contact:
        phase = phase_of[census.group[near]]
        lowest, highest = box.full(1 << 30, np.int64), box.full(-1, np.int64)
        np.minimum.at(lowest, at, phase)
        np.maximum.at(highest, at, phase)
        lowest = box.spread(lowest, 1, np.minimum)
        highest = box.spread(highest, 1, np.maximum)
        wants |= lowest < highest
    if solid is not None:
        grid = np.stack(np.meshgrid(*(np.arange(n) for n in box.shape), indexing="ij"), -1).reshape(
            -1, 3
        )
        wants |= box.spread(solid(grid + box.low) >= 0, 1, np.logical_or)
    return wants


def _close(box, at, phase, phases: int) -> np.ndarray:
    """Whether a phase has patches at most a block away: (phases, blocks of the box)."""
    found = np.empty((phases, len(box.full(False, bool))), bool)
    for k in range(phases):
        here = box.full(False, bool)
        here[at[phase == k]] = True
        found[k] = box.spread(here, 1, np.logical_or)
    return found


def _by_solid(box, solid, block) -> np.ndarray:
    """Whether the collider is at most a block away: (patches,)."""
    if solid is None:
        return np.zeros(len(block), bool)
    near = block[:, None, :] + NEIGHBOURS
    return (solid(near.reshape(-1, 3)).reshape(len(block), 27) >= 0).any(1)


def _traffic(block, own, owner, box, rank, sending) -> list:
    """Which patches travel to or from each neighbour rank, and the box of nodes of each that the
    receiver needs.

    The receiver needs the nodes its own patches reach: for a neighbour at offset +1 the last four
    of the eight nodes along that axis, at -1 the first four, at 0 all; the smallest box around
    these for all its blocks there.
    """
    if own.all():
        return []
    rank_at = box.full(-1, np.int64)
    rank_at[box.at(block)] = owner
    around = rank_at[box.at(block[:, None, :] + NEIGHBOURS)]  # (patches, 27)
    if sending:
        patch, code = np.nonzero(own[:, None] & (around != rank) & (around >= 0))
        other = around[patch, code]
    else:
        patch, code = np.nonzero(~own[:, None] & (around == rank))
        other = owner[patch]
    low = np.where(NEIGHBOURS[code] == 1, 4, 0)
    high = np.where(NEIGHBOURS[code] == -1, 4, 8)
    out = []
    for r in np.unique(other):
        here = other == r
        patches, start = np.unique(patch[here], return_index=True)
        out.append(
            (
                int(r),
                patches,
                np.minimum.reduceat(low[here], start),
                np.maximum.reduceat(high[here], start),
            )
        )
    return out


def _nothing() -> Topology:
    """An idle rank's tables."""
    none, one = np.zeros(0, np.int64), np.zeros(1, np.int64)
    no, places = none.astype(bool), np.zeros((0, 3), np.int64)
    return Topology(
        none, no, places, no, no, np.zeros((0, 27), np.int64), one, none, places, no, no, none, one,
        none, no, no, none, [], [],
    )  # fmt: skip
