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
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from .communicator import SerialCommunicator
from .exchange_topology import ExchangeTopology, SharedNodes

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
