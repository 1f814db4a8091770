"""Who touches whom between two sorts: segments, node blocks, and the nodes that ranks share.

A patch covers its block and reaches one node into the block before it and three into the one after,
along each axis. So two patches share nodes exactly when their blocks are neighbours (or the same),
and a node block is complete once all patches of the 27 blocks around it are added. Each rank adds
those of its own segments; of the nodes that its patches and another rank's both reach, the two give
each other what they summed. Everything here follows from the census: sender and receiver agree
without asking.
"""

from typing import NamedTuple

import numpy as np

from ..planning.plan import Plane
from .blocks import EDGE, Lattice
from .census import Census
from .overlap import NEIGHBOURS, number, shared_masks

_MARGIN = 4  # blocks around this rank's own that the dense maps cover


class Shared(NamedTuple):
    """What this rank and another exchange of one layer, in the order of blocks and phases: node
    blocks, and which of their 64 nodes by the bits of a mask."""

    send_blocks: np.ndarray  # (n,)
    send_masks: np.ndarray  # (n,) uint64
    receive_blocks: np.ndarray  # (m,)
    receive_masks: np.ndarray  # (m,) uint64


class Topology(NamedTuple):
    """Tables of one rank. Segments are its own, in the order of the census."""

    code: np.ndarray  # (segments,) block
    group: np.ndarray  # (segments,)
    block: np.ndarray  # (segments, 3)
    takes: dict[str, np.ndarray]  # by layer: (segments,) bool: its particles contribute
    border: np.ndarray  # (segments,) bool: reaches nodes that another rank reaches
    table: np.ndarray  # (segments, 27) node blocks around each
    first: np.ndarray  # (blocks + 1,) node blocks of each block
    phase: np.ndarray  # (node blocks,)
    at: np.ndarray  # (blocks, 3)
    meets: np.ndarray  # (blocks,) bool: contact is possible here
    waits: np.ndarray  # (blocks,) bool: other ranks add to its sums
    solid: np.ndarray  # (blocks,) row among the collider's blocks, or -1
    asked: dict[str, np.ndarray]  # by layer: (node blocks,) bool: somebody adds to it
    shared: dict[int, dict[str, Shared]]  # by rank, by layer


class Near(NamedTuple):
    """Fluids keep the stress's impulses apart from momentum near what they share space with."""

    shares: np.ndarray  # (phases, phases) bool: which do
    contact: np.ndarray  # (phases, phases) bool: whether a pair asks for volumes and offsets
    fluid: np.ndarray  # (phases,) bool
    every: bool  # elsewhere too, and all other phases (FLIP)


class Needs(NamedTuple):
    """What a scene asks of the tables."""

    phase_of: np.ndarray  # (groups,)
    contact: bool  # phases may touch at all
    apart: bool | Near  # where the stress's impulses are kept apart from momentum: True: everywhere
    hues: np.ndarray  # (groups,) coefficients of colour that travel with every step
    surface: np.ndarray = np.zeros(0, bool)  # (phases,) contact knows the surfaces of its bodies
    planes: tuple[Plane, ...] = ()  # walls that push these by contact
    rubs: bool = False  # some of these rub against something

    @property
    def layers(self) -> list[str]:
        """Names of all layers, in the order in which they are summed."""
        hues = [hue(k) for k in range(int(self.hues.max(initial=0)))]
        more = ["impulses"] * bool(self.apart) + ["shear"] * self.rubs
        return ["momentum", "offsets", *more, *hues]


def hue(coefficient: int) -> str:
    """The layer of a coefficient of colour."""
    return f"colour {coefficient}"


def counted(tables: Topology, rank: int) -> np.ndarray:
    """Which nodes of its blocks this rank counts where each may count once: of the ranks that reach
    a node the lowest does. (blocks, 64) uint8."""
    taken = np.zeros(len(tables.phase), np.uint64)
    for other, layers in tables.shared.items():
        if other < rank and "momentum" in layers:
            taken[layers["momentum"].receive_blocks] |= layers["momentum"].receive_masks
    of_block = np.repeat(np.arange(len(tables.at)), np.diff(tables.first))
    here = np.zeros(len(tables.at), np.uint64)
    np.bitwise_or.at(here, of_block, taken)
    bits = here[:, None] >> np.arange(64, dtype=np.uint64) & np.uint64(1)
    return (bits == 0).astype(np.uint8)


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

    def block(self, at: np.ndarray) -> np.ndarray:
        """Inverse of `at`: (n, 3)."""
        return np.stack(np.unravel_index(at, self.shape), 1) + self.low

    @property
    def every(self) -> np.ndarray:
        """All blocks: (n, 3)."""
        return self.block(np.arange(int(np.prod(self.shape))))

    def full(self, value, dtype) -> np.ndarray:
        return np.full(int(np.prod(self.shape)), value, dtype)

    @property
    def steps(self) -> np.ndarray:
        """What `at` changes by to each of the 27 blocks around: (27,)."""
        return self.at(self.low + NEIGHBOURS)

    def spread(self, values: np.ndarray, combine) -> np.ndarray:
        """Combine each block's value with those of the blocks around it."""
        grid = values.reshape(self.shape)
        for a in range(3):
            out = grid.copy()
            low, high = [slice(None)] * 3, [slice(None)] * 3
            low[a], high[a] = slice(None, -1), slice(1, None)
            combine(out[tuple(low)], grid[tuple(high)], out=out[tuple(low)])
            combine(out[tuple(high)], grid[tuple(low)], out=out[tuple(high)])
            grid = out
        return grid.reshape(-1)


class _Segments(NamedTuple):
    """Segments of this rank and those of others a block away."""

    box: _Box
    at: np.ndarray  # (n,) place in the box
    block: np.ndarray  # (n, 3)
    code: np.ndarray  # (n,)
    group: np.ndarray  # (n,)
    phase: np.ndarray  # (n,)
    owner: np.ndarray  # (n,)
    own: np.ndarray  # (n,) bool


def build(census: Census, lattice: Lattice, rank: int, needs: Needs, solid=None) -> Topology:
    """Tables of `rank`. solid: blocks (n, 3) -> row among the collider's blocks or -1, or None
    where the scene has no collider."""
    mine = census.owner == rank
    if not mine.any():
        return _nothing(needs)
    block = lattice.block(census.code)
    box = _Box(block[mine])
    rows = np.flatnonzero(box.holds(block))
    at, phase = box.at(block[rows]), needs.phase_of[census.group[rows]]
    takes = _who_contributes(box, at, phase, census.group[rows], needs, solid)
    is_own = box.full(False, bool)
    is_own[at[mine[rows]]] = True
    around = box.spread(is_own, np.logical_or)
    here = around[at]
    row = rows[here]
    near = _Segments(
        box, at[here], block[row], census.code[row], census.group[row], phase[here],
        census.owner[row], mine[row],
    )  # fmt: skip
    return _tables(near, {name: found[here] for name, found in takes.items()}, around, rank, needs,
                   solid)  # fmt: skip


def _tables(near: _Segments, takes: dict, around, rank: int, needs: Needs, solid) -> Topology:
    box, own = near.box, near.own
    phases = int(needs.phase_of.max()) + 1
    nodes, table = number(near.at, near.phase, around, box.steps, phases)
    flat = nodes // phases
    new = np.flatnonzero(np.diff(flat, prepend=-1))
    first = np.append(new, len(nodes))
    at = box.block(flat[new])
    solid_of = np.full(len(new), -1, np.int64) if solid is None else solid(at)
    asked = {name: _touched(table[found], len(nodes)) for name, found in takes.items()}
    meets = ((np.diff(first) > 1) & needs.contact) | (solid_of >= 0) | _at_plane(at, needs)
    meets &= np.logical_or.reduceat(asked["offsets"], new)
    shared, border, waits = _shared(near, takes, table, rank, len(nodes))
    return Topology(
        code=near.code[own],
        group=near.group[own],
        block=near.block[own],
        takes={name: found[own] for name, found in takes.items()},
        border=border[own],
        table=table[own],
        first=first,
        phase=nodes % phases,
        at=at,
        meets=meets,
        waits=np.logical_or.reduceat(waits, new),
        solid=solid_of,
        asked=asked,
        shared=shared,
    )


def _touched(table: np.ndarray, count: int) -> np.ndarray:
    """Which of `count` node blocks stand in a table (n, 27), -1 for none: (count,) bool."""
    found = np.zeros(count + 1, bool)
    found[table] = True
    return found[:count]


def _shared(near: _Segments, takes: dict, table, rank: int, count: int):
    """The nodes that this rank and each other share, layer by layer; the segments that reach some;
    the node blocks (count,) to which others add."""
    border, waits = np.zeros(len(near.at), bool), np.zeros(count, bool)
    others = np.unique(near.owner[~near.own])
    if not len(others):
        return {}, border, waits
    index_at = near.box.full(-1, np.int32)  # which rank, by number: -1 none, len(others) this one
    who = np.searchsorted(others, near.owner)
    who[near.own] = len(others)
    index_at[near.at] = who
    found: dict[int, dict[str, Shared]] = {int(r): {} for r in others}
    for name, here in takes.items():
        if not here.any() and name != "momentum":
            continue
        out = shared_masks(near.at, who, here, table, index_at, near.box.steps, len(others), count)
        sends, receives, reaches = out
        border |= reaches
        for k, r in enumerate(others):
            gives, gets = np.flatnonzero(sends[k]), np.flatnonzero(receives[k])
            waits[gets] = True
            found[int(r)][name] = Shared(gives, sends[k, gives], gets, receives[k, gets])
    return found, border, waits


def _who_contributes(box, at, phase, group, needs: Needs, solid) -> dict[str, np.ndarray]:
    """By layer, whether the particles of segments (n,) contribute to it.

    Volumes and offsets are asked for where a patch of another phase, or the collider, can share a
    node with the segment's: at most a block away. What else touches such a node touches both.
    """
    every = np.ones(len(at), bool)
    takes = {name: every for name in needs.layers}
    wanted = _wants_offset(box, at, phase, needs.contact, solid)[at]
    if needs.apart is True:
        takes["impulses"] = every
    elif needs.apart:
        apart, close = needs.apart, _close(box, at, phase, int(needs.phase_of.max()) + 1)[:, at]
        sharing = (apart.shares[phase].T & close).any(0) & apart.fluid[phase]
        takes["impulses"] = sharing | apart.every
        beside = np.zeros(len(at), bool) if solid is None else _by_solid(box, solid)[at]
        wanted &= (apart.contact[phase].T & close).any(0) | beside
    if needs.planes:
        close_by = box.spread(_at_plane(box.every, needs), np.logical_or)[at]
        wanted = wanted | (close_by & needs.surface[phase])
    takes["offsets"] = wanted
    if needs.rubs:
        takes["shear"] = wanted & needs.surface[phase]
    for k in range(int(needs.hues.max(initial=0))):
        takes[hue(k)] = needs.hues[group] > k
    return takes


def _wants_offset(box, at, phase, contact: bool, solid) -> np.ndarray:
    """Per block of the box: whether its patches need volume and offset."""
    wants = box.full(False, bool)
    if contact:
        lowest, highest = box.full(1 << 30, np.int64), box.full(-1, np.int64)
        np.minimum.at(lowest, at, phase)
        np.maximum.at(highest, at, phase)
        wants |= box.spread(lowest, np.minimum) < box.spread(highest, np.maximum)
    if solid is not None:
        wants |= _by_solid(box, solid)
    return wants


def _close(box, at, phase, phases: int) -> np.ndarray:
    """Whether a phase has patches at most a block away: (phases, blocks of the box)."""
    found = np.empty((phases, int(np.prod(box.shape))), bool)
    for k in range(phases):
        here = box.full(False, bool)
        here[at[phase == k]] = True
        found[k] = box.spread(here, np.logical_or)
    return found


def _at_plane(block: np.ndarray, needs: Needs) -> np.ndarray:
    """Whether blocks (n, 3) hold a node of a wall that pushes by contact: (n,) bool."""
    found = np.zeros(len(block), bool)
    for plane in needs.planes:
        found |= block[:, plane.axis] == (plane.node + 1) // EDGE
    return found


def _by_solid(box, solid) -> np.ndarray:
    """Whether the collider is at most a block away: per block of the box."""
    return box.spread(solid(box.every) >= 0, np.logical_or)


def _nothing(needs: Needs) -> Topology:
    """An idle rank's tables."""
    none, places, no = np.zeros(0, np.int64), np.zeros((0, 3), np.int64), np.zeros(0, bool)
    by_layer = {name: no for name in needs.layers}
    return Topology(
        code=none, group=none, block=places, takes=by_layer, border=no,
        table=np.zeros((0, 27), np.int64), first=np.zeros(1, np.int64), phase=none, at=places,
        meets=no, waits=no, solid=none, asked=by_layer, shared={},
    )  # fmt: skip
