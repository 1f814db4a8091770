"""The one exchange of a step: what ranks summed at the nodes that patches of both reach.

            rank 0 | rank 1
      ... [ b ][ c ] [ d ][ e ] ...       c's patch reaches into d's nodes, d's into c's:
                ======                    each sends the other its own sums at the nodes they share,
                                          and adds what comes. The order of sums is no part of them.

Segments at the border are transferred first, so that messages travel while the others are. Each
message begins with a header: the step and a number that stands for the list of nodes, so that
ranks that disagree stop instead of adding the wrong thing. The engine packs and adds.
"""

import zlib
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from .ranks import Alone
from .topology import Shared, Topology

_HEADER = 2  # numbers at the front of a message


class HaloError(RuntimeError):
    """A message did not carry what this rank expected."""


class Part(NamedTuple):
    """What a message carries of one layer, as an engine packs and adds it."""

    layer: str
    blocks: np.ndarray  # (n,) node blocks
    masks: np.ndarray  # (n,) uint64 which of their nodes
    numbers: np.ndarray  # (3 n,) uint64, part of the message, for n words of nodes
    tails: np.ndarray  # (n,) uint16, see kernels/sums.py


class Halo:
    """Buffers and lists of nodes, made anew when the tables are."""

    def __init__(self, ranks: Alone, tables: Topology, words: int, layers: Sequence[str] = ()):
        """words: doubles per sum; layers: that travel, all by default."""
        self.rank = ranks.rank
        self.sends: list[_Message] = []
        self.receives: list[_Message] = []
        for rank, every in tables.shared.items():
            shared = {layer: every[layer] for layer in layers or every if layer in every}
            for messages, kind in ((self.sends, "send"), (self.receives, "receive")):
                message = _Message(rank, shared, kind, tables, words)
                if message.parts:
                    messages.append(message)
        self.bytes_sent = sum(m.buffer.nbytes for m in self.sends)  # per step
        self.link = ranks.link(
            [(m.rank, m.buffer) for m in self.sends], [(m.rank, m.buffer) for m in self.receives]
        )

    def start(self, step: int, pack) -> None:
        """Begin to send what `pack(part)` puts into the numbers of each part. Collective among
        neighbours, with `finish`."""
        for m in self.sends:
            m.head[:] = step, m.seal
            for part in m.parts:
                pack(part)
        self.link.start()

    def finish(self, step: int, add) -> None:
        """Have `add(part)` take up what `link.wait` has seen arrive."""
        for m in self.receives:
            if m.head[0] != step or m.head[1] != m.seal:
                raise HaloError(
                    f"rank {self.rank}: message from rank {m.rank} is of step {m.head[0]},"
                    f" not {step}, or of another list of nodes"
                )
            for part in m.parts:
                add(part)


class _Message:
    """One neighbour's buffer: header, then the sums of the nodes, layer by layer."""

    def __init__(self, rank: int, shared: dict[str, Shared], kind: str, tables: Topology, words):
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
        self.parts, at, self.seal = [], _HEADER, 0
        for layer, (blocks, masks) in lists.items():
            if len(blocks):
                n = count[layer]
                numbers = self.buffer[at : at + 3 * n]
                tails = self.buffer[at + 3 * n : at + size[layer]].view(np.uint16)[:n]
                self.parts.append(Part(layer, blocks, masks, numbers, tails))
                self.seal = zlib.crc32(_listed(tables, blocks, masks), self.seal)
            at += size[layer]


def _listed(tables: Topology, blocks, masks) -> bytes:
    """What both ranks must agree on: coordinates, phase and nodes of each node block."""
    block = np.searchsorted(tables.first, blocks, side="right") - 1
    rows = np.column_stack([tables.at[block], tables.phase[blocks], masks.view(np.int64)])
    return np.ascontiguousarray(rows, np.int64).tobytes()
