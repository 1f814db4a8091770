"""Exchange topology between two sorts: segments, node blocks, and nodes that ranks share.

A patch covers its block and reaches one node into the block before it and three into the one after,
along each axis. Two patches therefore share nodes exactly if their blocks are equal or neighbors,
and a node block is complete once the patches of the 27 blocks around it are added. Each rank adds
the patches of its own segments; for nodes that its patches and another rank's both reach, the two
exchange their sums. All tables follow from the census: sender and receiver agree without
communication.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from vgmpi.planning.plan import ContactWall

from .block_lattice import BLOCK_EDGE, BlockLattice
from .block_ownership import BlockDirectory
from .node_overlap import NEIGHBORS, number_node_blocks, shared_masks

# nodal fields near free bodies: velocity gradients, mean pressure
GRADIENTS = tuple(f"velocity gradient {a}" for a in "xyz")
NEAR_BODIES = (*GRADIENTS, "mean pressure")
# where a nodal field is summed: from all particles; from those that may touch another phase, a
# collider or a wall; from those near colliders and near the blocks of features
EVERYWHERE, NEAR_CONTACT, NEAR_SURFACES = "everywhere", "near contact", "near surfaces"
_MARGIN = 4  # [blocks] margin of the dense maps around this rank's own blocks


class SharedNodes(NamedTuple):
    """Nodes of one nodal field that this rank and another exchange.

    They are in the order of blocks and phases. A mask selects nodes of a block: a bit for each of
    its 64 nodes.
    """

    send_blocks: np.ndarray  # (n,)
    send_masks: np.ndarray  # (n,) uint64
    receive_blocks: np.ndarray  # (m,)
    receive_masks: np.ndarray  # (m,) uint64


class ExchangeTopology(NamedTuple):
    """Topology tables of one rank; segments are its own, in the order of the census."""

    code: np.ndarray  # (segments,) code of the block
    group: np.ndarray  # (segments,) number of the group
    block: np.ndarray  # (segments, 3) coordinates of the block
    contributes: dict[
        str, np.ndarray
    ]  # field -> (segments,) bool, True if its particles contribute
    border: np.ndarray  # (segments,) bool, True if it reaches nodes that another rank reaches
    table: np.ndarray  # (segments, 27) node blocks around each segment
    first: np.ndarray  # (blocks + 1,) first node block of each block
    phase: np.ndarray  # (node blocks,) number of the phase
    coordinates: np.ndarray  # (blocks, 3) coordinates of the block
    may_touch: np.ndarray  # (blocks,) bool, True if contact is possible
    receives_remote: np.ndarray  # (blocks,) bool, True if another rank adds to the block's sums
    solid: np.ndarray  # (blocks,) row among the collider's blocks, or -1
    has_terms: dict[str, np.ndarray]  # field -> (node blocks,) bool, True if a segment adds to it
    shared: dict[int, dict[str, SharedNodes]]  # rank -> field -> shared nodes


class StressProximity(NamedTuple):
    """Phases near which fluids sum stress impulses separately from momentum."""

    share_space: np.ndarray  # (phases, phases) bool, True if the pair shares space
    contact: np.ndarray  # (phases, phases) bool, True if the pair needs volumes and offsets
    fluid: np.ndarray  # (phases,) bool
    everywhere: np.ndarray  # (phases,) bool, True: separately everywhere


class FieldPlace(NamedTuple):
    """Nodal field besides momentum and offsets: where it is summed, and from whose particles."""

    name: str
    groups: np.ndarray  # (groups,) bool, groups whose particles contribute
    region: str = EVERYWHERE  # or NEAR_CONTACT, NEAR_SURFACES
    is_timeless: bool = False  # a step of no time sums it, and no other step


class TopologyRequirements(NamedTuple):
    """Requirements of a scene on the topology tables."""

    phase_of: np.ndarray  # (groups,) phase of each group
    contact: bool  # phases may touch at all
    separates_stress: (
        bool | StressProximity
    )  # where stress impulses are summed separately; True: everywhere
    fields: tuple[FieldPlace, ...] = ()
    surface: np.ndarray = np.zeros(0, bool)  # (phases,) True with surface descriptors
    planes: tuple[ContactWall, ...] = ()  # walls that act on such phases by contact
    at_surfaces: bool = False  # fields near surfaces are summed in the blocks of colliders alone
    in_contact: np.ndarray = np.zeros(0, bool)  # (phases,) True if they are summed where it touches

    @property
    def layers(self) -> list[str]:
        """Names of all nodal fields, in the order in which they are summed."""
        impulses = ["impulses"] * bool(self.separates_stress)
        return ["momentum", "offsets", *impulses, *(field.name for field in self.fields)]

    @property
    def near_surfaces(self) -> list[str]:
        """Names of the fields that are summed near surfaces alone."""
        return [field.name for field in self.fields if field.region == NEAR_SURFACES]

    @property
    def timeless_layers(self) -> list[str]:
        """Names of the nodal fields that a step of no time sums."""
        return ["momentum", *(field.name for field in self.fields if field.is_timeless)]

    @property
    def step_layers(self) -> list[str]:
        """Names of the nodal fields that a step sums."""
        timeless = [field.name for field in self.fields if field.is_timeless]
        return [name for name in self.layers if name not in timeless]


def counting_owner(tables: ExchangeTopology, rank: int) -> np.ndarray:
    """Return which nodes of its blocks this rank counts if each may count once, (blocks, 64) uint8.

    Of the ranks that reach a node, the lowest counts it.
    """
    taken = np.zeros(len(tables.phase), np.uint64)
    for other, layers in tables.shared.items():
        if other < rank and "momentum" in layers:
            taken[layers["momentum"].receive_blocks] |= layers["momentum"].receive_masks
    of_block = np.repeat(np.arange(len(tables.coordinates)), np.diff(tables.first))
    mask_of = np.zeros(len(tables.coordinates), np.uint64)
    np.bitwise_or.at(mask_of, of_block, taken)
    bits = mask_of[:, None] >> np.arange(64, dtype=np.uint64) & np.uint64(1)
    return (bits == 0).astype(np.uint8)


class _Box:
    """Dense maps over the blocks around this rank's own."""

    def __init__(self, own: np.ndarray):
        self.low = own.min(0) - _MARGIN
        self.shape = tuple(own.max(0) + _MARGIN + 1 - self.low)

    def contains(self, block: np.ndarray) -> np.ndarray:
        """Return True for the blocks (n, 3) inside the box."""
        return ((block >= self.low) & (block < self.low + self.shape)).all(1)

    def index_of(self, block: np.ndarray) -> np.ndarray:
        """Return the flat index of blocks (..., 3) inside the box."""
        b = block - self.low
        return (b[..., 0] * self.shape[1] + b[..., 1]) * self.shape[2] + b[..., 2]

    def block(self, index: np.ndarray) -> np.ndarray:
        """Return the block of each flat index, the inverse of `index_of`, shape (n, 3)."""
        return np.stack(np.unravel_index(index, self.shape), 1) + self.low

    @property
    def all_blocks(self) -> np.ndarray:
        """All blocks of the box, shape (n, 3)."""
        return self.block(np.arange(int(np.prod(self.shape))))

    def full(self, value, dtype) -> np.ndarray:
        """Return a map with one value."""
        return np.full(int(np.prod(self.shape)), value, dtype)

    @property
    def steps(self) -> np.ndarray:
        """Changes of the flat index to each of the 27 blocks around a block, shape (27,)."""
        return self.index_of(self.low + NEIGHBORS)

    def combine_with_neighbors(self, values: np.ndarray, combine) -> np.ndarray:
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
    """Segments of this rank, and those of other ranks at most one block away."""

    box: _Box
    flat_index: np.ndarray  # (n,) flat index in the box
    block: np.ndarray  # (n, 3)
    code: np.ndarray  # (n,)
    group: np.ndarray  # (n,)
    phase: np.ndarray  # (n,)
    owner: np.ndarray  # (n,)
    own: np.ndarray  # (n,) bool


def build_topology(
    census: BlockDirectory,
    lattice: BlockLattice,
    rank: int,
    needs: TopologyRequirements,
    solid=None,
    features: Iterable = (),
) -> ExchangeTopology:
    """Build the topology tables of a rank.

    Args:
        census: Segments of this rank and nearby ones.
        lattice: Lattice of the blocks.
        rank: This rank.
        needs: Requirements of the scene.
        solid: Function from blocks (n, 3) to rows among the collider's blocks or -1; None without
            colliders.
        features: Features of the run: the same functions, with `phases` of which particles are
            needed near their blocks, shape (phases,) bool.
    """
    mine = census.owner == rank
    if not mine.any():
        return _empty_topology(needs)
    block = lattice.block(census.code)
    box = _Box(block[mine])
    rows = np.flatnonzero(box.contains(block))
    index, phase = box.index_of(block[rows]), needs.phase_of[census.group[rows]]
    contributes = _who_contributes(box, index, phase, census.group[rows], needs, solid)
    for feature in (feature for feature in features if feature.phases.any()):
        close_by = _by_solid(box, feature)[index] & feature.phases[phase]
        contributes |= {name: contributes[name] | close_by for name in needs.near_surfaces}
    is_own = box.full(False, bool)
    is_own[index[mine[rows]]] = True
    is_nearby = box.combine_with_neighbors(is_own, np.logical_or)
    selected = is_nearby[index]
    row = rows[selected]
    segments = _Segments(
        box, index[selected], block[row], census.code[row], census.group[row], phase[selected],
        census.owner[row], mine[row],
    )  # fmt: skip
    return _tables(
        segments, {name: m[selected] for name, m in contributes.items()}, is_nearby, rank, needs,
        solid,
    )  # fmt: skip


def _tables(
    segments: _Segments, contributes: dict, is_nearby, rank: int, needs: TopologyRequirements, solid
) -> ExchangeTopology:
    """Build the tables from the segments on this rank and near it."""
    box, own = segments.box, segments.own
    phases = int(needs.phase_of.max()) + 1
    nodes, table = number_node_blocks(
        segments.flat_index, segments.phase, is_nearby, box.steps, phases
    )
    flat = nodes // phases
    new = np.flatnonzero(np.diff(flat, prepend=-1))
    first = np.append(new, len(nodes))
    blocks = box.block(flat[new])
    solid_of = np.full(len(new), -1, np.int64) if solid is None else solid(blocks)
    active = {name: _touched(table[mask], len(nodes)) for name, mask in contributes.items()}
    is_summed = {}  # field -> (node blocks,) bool, for the fields that are summed in some alone
    if needs.at_surfaces:
        is_near_solid = np.repeat(solid_of >= 0, np.diff(first))
        is_summed = dict.fromkeys(needs.near_surfaces, is_near_solid)
        active |= {name: active[name] & mask for name, mask in is_summed.items()}
    may_touch = ((np.diff(first) > 1) & needs.contact) | (solid_of >= 0) | _at_plane(blocks, needs)
    may_touch &= np.logical_or.reduceat(active["offsets"], new)
    shared, border, waits = _shared(segments, contributes, table, is_summed, len(nodes))
    return ExchangeTopology(
        code=segments.code[own],
        group=segments.group[own],
        block=segments.block[own],
        contributes={name: mask[own] for name, mask in contributes.items()},
        border=border[own],
        table=table[own],
        first=first,
        phase=nodes % phases,
        coordinates=blocks,
        may_touch=may_touch,
        receives_remote=np.logical_or.reduceat(waits, new),
        solid=solid_of,
        has_terms=active,
        shared=shared,
    )


def _touched(table: np.ndarray, count: int) -> np.ndarray:
    """Return True for each of `count` node blocks that is in a table (n, 27), where -1 is none."""
    is_touched = np.zeros(count + 1, bool)
    is_touched[table] = True
    return is_touched[:count]


def _shared(segments: _Segments, contributes: dict, table, is_summed: dict, count: int):
    """Return the nodes that this rank shares with each other, by field.

    Fields in `is_summed` are shared in its node blocks alone. Also returns True for the segments
    that reach such nodes, and for the node blocks (count,) to which other ranks add.
    """
    border, waits = np.zeros(len(segments.flat_index), bool), np.zeros(count, bool)
    others = np.unique(segments.owner[~segments.own])
    if not len(others):
        return {}, border, waits
    # index_at: number of the rank by place; -1: none, len(others): this rank
    index_at = segments.box.full(-1, np.int32)
    who = np.searchsorted(others, segments.owner)
    who[segments.own] = len(others)
    index_at[segments.flat_index] = who
    result: dict[int, dict[str, SharedNodes]] = {int(r): {} for r in others}
    for name, mask in contributes.items():
        if not mask.any() and name != "momentum":
            continue
        out = shared_masks(
            segments.flat_index, who, mask, table, index_at, segments.box.steps, len(others), count
        )
        sends, receives, reaches = out
        if name in is_summed:
            sends[:, ~is_summed[name]] = receives[:, ~is_summed[name]] = 0
        border |= reaches
        for k, r in enumerate(others):
            sent, received = np.flatnonzero(sends[k]), np.flatnonzero(receives[k])
            waits[received] = True
            result[int(r)][name] = SharedNodes(
                sent, sends[k, sent], received, receives[k, received]
            )
    return result, border, waits


def _who_contributes(
    box, index, phase, group, needs: TopologyRequirements, solid
) -> dict[str, np.ndarray]:
    """Return by field whether the particles of segments (n,) contribute to it.

    Volumes and offsets are needed if a patch of another phase, or the collider, can share a node
    with the segment's patch: it is at most one block away. Anything else that touches such a node
    touches both.
    """
    every = np.ones(len(index), bool)
    near_solid = ~every if solid is None else _by_solid(box, solid)[index]
    contributes = {name: every for name in needs.layers}
    wanted = near_solid.copy()
    if needs.contact:
        wanted |= _several_phases(box, index, phase)[index]
    if needs.separates_stress is True:
        contributes["impulses"] = every
    elif needs.separates_stress:
        separate = needs.separates_stress
        close = _close(box, index, phase, int(needs.phase_of.max()) + 1)[:, index]
        sharing = (separate.share_space[phase].T & close).any(0) & separate.fluid[phase]
        contributes["impulses"] = sharing | separate.everywhere[phase]
        wanted &= (separate.contact[phase].T & close).any(0) | near_solid
    if needs.planes:
        close_by = box.combine_with_neighbors(_at_plane(box.all_blocks, needs), np.logical_or)[
            index
        ]
        wanted = wanted | (close_by & needs.surface[phase])
    contributes["offsets"] = wanted
    at_solids = wanted & needs.in_contact[phase] if needs.in_contact.any() else ~every
    regions = {EVERYWHERE: every, NEAR_CONTACT: wanted, NEAR_SURFACES: near_solid | at_solids}
    for field in needs.fields:
        contributes[field.name] = regions[field.region] & field.groups[group]
    return contributes


def _several_phases(box, index, phase) -> np.ndarray:
    """Return True for each block of the box at most one block from segments of several phases."""
    lowest, highest = box.full(1 << 30, np.int64), box.full(-1, np.int64)
    np.minimum.at(lowest, index, phase)
    np.maximum.at(highest, index, phase)
    return box.combine_with_neighbors(lowest, np.minimum) < box.combine_with_neighbors(
        highest, np.maximum
    )


def _close(box, index, phase, phases: int) -> np.ndarray:
    """Return True if a phase has patches at most one block away, (phases, blocks of the box)."""
    result = np.empty((phases, int(np.prod(box.shape))), bool)
    for k in range(phases):
        has_phase = box.full(False, bool)
        has_phase[index[phase == k]] = True
        result[k] = box.combine_with_neighbors(has_phase, np.logical_or)
    return result


def _at_plane(block: np.ndarray, needs: TopologyRequirements) -> np.ndarray:
    """Return True for the blocks (n, 3) that hold a node of a wall acting by contact, or beyond."""
    result = np.zeros(len(block), bool)
    for plane in needs.planes:
        for node in (plane.node, plane.node + 2 * plane.side - 1):
            result |= block[:, plane.axis] == (node + 1) // BLOCK_EDGE
    return result


def _by_solid(box, solid) -> np.ndarray:
    """Return True for each block of the box that is at most one block from the collider."""
    return box.combine_with_neighbors(solid(box.all_blocks) >= 0, np.logical_or)


def _empty_topology(needs: TopologyRequirements) -> ExchangeTopology:
    """Return the empty tables of an idle rank."""
    none, places, no = np.zeros(0, np.int64), np.zeros((0, 3), np.int64), np.zeros(0, bool)
    by_layer = {name: no for name in needs.layers}
    return ExchangeTopology(
        code=none, group=none, block=places, contributes=by_layer, border=no,
        table=np.zeros((0, 27), np.int64), first=np.zeros(1, np.int64), phase=none,
        coordinates=places,
        may_touch=no, receives_remote=no, solid=none, has_terms=by_layer, shared={},
    )  # fmt: skip
