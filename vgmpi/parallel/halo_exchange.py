"""Halo exchange: one exchange per step of the sums at nodes that patches of two ranks reach.

          rank 0 | rank 1
    ... [ b ][ c ] [ d ][ e ] ...       The patch of c reaches nodes of d, and the patch of d those
              ======                    of c: each rank sends its own sums at the nodes they share
                                        and adds the sums that it receives. The result does not
                                        depend on the order of the additions.

Border segments are transferred first, so that messages travel while the other segments are
processed. Each message begins with a header: the step and a checksum of the list of nodes, so that
ranks that disagree stop instead of adding the wrong numbers. The engine packs and adds.
"""

import zlib
from collections.abc import Collection, Sequence
from typing import Any, NamedTuple

import numpy as np

from .block_lattice import BlockLattice
from .block_ownership import BlockDirectory
from .communicator import SerialCommunicator
from .exchange_topology import (
    ExchangeTopology,
    SharedNodes,
    TopologyRequirements,
    build_topology,
)

_HEADER = 2  # [words] length of a message's header


class HaloError(RuntimeError):
    """A message does not carry the data that this rank expects."""


class FieldMessage(NamedTuple):
    """Section of a message with the sums of one nodal field, as an engine packs and adds it."""

    layer: str  # name of the nodal field
    blocks: np.ndarray  # (n,) node blocks
    masks: np.ndarray  # (n,) uint64, bits of their shared nodes
    numbers: np.ndarray  # (3 m,) uint64, view of the message, for m words of nodes
    tails: np.ndarray  # (m,) uint16, see kernels/reproducible_sums.py


class HaloExchange:
    """Message buffers and lists of nodes; rebuilt with the topology tables."""

    def __init__(
        self,
        ranks: SerialCommunicator,
        tables: ExchangeTopology,
        words: int,
        layers: Sequence[str] = (),
    ):
        """Allocate the buffers of all neighbors.

        Args:
            ranks: Communicator.
            tables: Topology of this rank.
            words: Doubles per sum.
            layers: Nodal fields to exchange, all by default.
        """
        self.rank = ranks.rank
        self.sends: list[_Message] = []
        self.receives: list[_Message] = []
        for rank, every in tables.shared.items():
            shared = {layer: every[layer] for layer in layers or every if layer in every}
            for messages, kind in ((self.sends, "send"), (self.receives, "receive")):
                message = _Message(rank, shared, kind, tables, words)
                if message.parts:
                    messages.append(message)
        self.bytes_sent = sum(m.buffer.nbytes for m in self.sends)  # [bytes] per step
        self.link = ranks.link(
            [(m.rank, m.buffer) for m in self.sends], [(m.rank, m.buffer) for m in self.receives]
        )

    def start(self, step: int, pack) -> None:
        """Pack every section by `pack(part)` and start sending.

        Collective among neighbors, together with `finish`.
        """
        for m in self.sends:
            m.head[:] = step, m.seal
            for part in m.parts:
                pack(part)
        self.link.start()

    def finish(self, step: int, add) -> None:
        """Add the received sections by `add(part)`, after `link.wait` has returned."""
        for m in self.receives:
            if m.head[0] != step or m.head[1] != m.seal:
                raise HaloError(
                    f"rank {self.rank}: message from rank {m.rank} is of step {m.head[0]},"
                    f" not {step}, or of another list of nodes"
                )
            for part in m.parts:
                add(part)


class _Message:
    """Buffer of one neighbor: header, then the sums of the nodes, field by field."""

    def __init__(
        self, rank: int, shared: dict[str, SharedNodes], kind: str, tables: ExchangeTopology, words
    ):
        self.rank = rank
        lists = {}
        for layer, lists_of in shared.items():
            sends = lists_of.send_blocks, lists_of.send_masks
            receives = lists_of.receive_blocks, lists_of.receive_masks
            lists[layer] = sends if kind == "send" else receives
        count = {k: words * int(np.bitwise_count(m).sum()) for k, (_, m) in lists.items()}
        size = {k: 3 * n + (n + 3) // 4 for k, n in count.items()}
        self.buffer = np.zeros(_HEADER + sum(size.values()), np.uint64)
        self.head = self.buffer[:_HEADER].view(np.int64)
        self.parts, offset, self.seal = [], _HEADER, 0
        for layer, (blocks, masks) in lists.items():
            if len(blocks):
                n = count[layer]
                numbers = self.buffer[offset : offset + 3 * n]
                tails = self.buffer[offset + 3 * n : offset + size[layer]].view(np.uint16)[:n]
                self.parts.append(FieldMessage(layer, blocks, masks, numbers, tails))
                self.seal = zlib.crc32(_node_list(tables, blocks, masks), self.seal)
            offset += size[layer]


def _node_list(tables: ExchangeTopology, blocks, masks) -> bytes:
    """Return the data both ranks must agree on: coordinates, phase and nodes of each node block."""
    block = np.searchsorted(tables.first, blocks, side="right") - 1
    rows = np.column_stack([tables.coordinates[block], tables.phase[blocks], masks.view(np.int64)])
    return np.ascontiguousarray(rows, np.int64).tobytes()


class GridExchange:
    """Exchange tables of this rank and the messages by them.

    Attributes:
        needs: What the plan requires of the tables.
        census: Directory of all blocks, their ranks and the segments of particles.
        tables: Tables of the nodes that this rank holds.
        halo: Messages of a step; None before particles are inserted.
        correction_halo: Messages of zero-length steps; None without such steps.
        bytes_sent: Bytes sent to neighbors by this rank.
    """

    def __init__(
        self, needs: TopologyRequirements, lattice: BlockLattice, ranks: SerialCommunicator,
        colliders: Any, words: int, has_timeless_steps: bool,
    ):  # fmt: skip
        """Begin without tables: they need particles.

        Args:
            needs: What the plan requires of the tables.
            lattice: Lattice of the blocks.
            ranks: Communicator.
            colliders: Colliders at the nodes.
            words: Doubles per sum.
            has_timeless_steps: Whether there are zero-length steps.
        """
        self.needs, self.lattice, self.ranks = needs, lattice, ranks
        self.colliders, self.words = colliders, words
        self.has_timeless_steps = has_timeless_steps
        self.tables: ExchangeTopology
        self.census: BlockDirectory
        self.halo: HaloExchange | None = None
        self.correction_halo: HaloExchange | None = None
        self.bytes_sent = 0

    def set_directory(self, census: BlockDirectory, features: Collection[Any]) -> bool:
        """Build tables and messages for a directory; return whether the old ones hold for it.

        They do if they are the same, also near features.

        Args:
            census: Directory of all blocks, with the segments that the groups hold.
            features: Features of the run (features/active_feature.py).
        """
        unchanged = self.halo is not None and self.census.has_segments_of(census)
        unchanged &= all(feature.is_fixed for feature in features)
        self.census = census
        if not unchanged:
            self.tables = build_topology(
                census, self.lattice, self.ranks.rank, self.needs, self.colliders, features
            )
            for feature in features:
                feature.set_topology(self.tables, census)
            self.halo = self._open(self.halo, self.needs.step_layers)
            if self.has_timeless_steps:
                self.correction_halo = self._open(self.correction_halo, self.needs.timeless_layers)
        return unchanged

    def _open(self, before: HaloExchange | None, fields: Sequence[str]) -> HaloExchange:
        """Return the messages of the fields by the present tables; the old ones are closed."""
        if before is not None:
            before.link.close()
        return HaloExchange(self.ranks, self.tables, self.words, fields)
