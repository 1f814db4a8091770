"""The one exchange of a step: boundary patches, un-summed, to the ranks whose nodes they touch.

            rank 0 | rank 1
      ... [ b ][ c ] [ d ][ e ] ...       c's patch reaches into d's nodes, d's into c's:
                 ----> c                  each sends the other the boxes of nodes they share,
              d <----                     and both add all patches in the order of their keys.

Patches at the boundary are filled first, so that messages travel while the others are filled and
summed. Each message begins with a header: the step and a number that stands for the list of
patches, so that ranks that disagree stop instead of adding the wrong thing.
"""

import zlib

import numpy as np

from ..device.jit import inline, kernel
from .ranks import Alone
from .topology import Topology

_HEADER = 4  # numbers at the front of a message
SIDE = 8  # nodes of a patch along an axis
HALF = 16  # numbers of half a row of nodes along z


class HaloError(RuntimeError):
    """A message did not carry what this rank expected."""


class Halo:
    """Buffers and box lists, made anew at each sort."""

    def __init__(self, ranks: Alone, topology: Topology, slots: list[np.ndarray], real: np.dtype):
        """slots: for each layer of patches (patches,) where each patch that travels is kept, -1
        where the layer has none of it."""
        self.rank = ranks.rank
        self.sends = [_Message(part, topology, slots, real) for part in topology.sends]
        self.receives = [_Message(part, topology, slots, real) for part in topology.receives]
        self.bytes_sent = sum(m.buffer.nbytes for m in self.sends)  # per step
        self.link = ranks.link(
            [(m.rank, m.buffer) for m in self.sends], [(m.rank, m.buffer) for m in self.receives]
        )

    def start(self, step: int, *layers: np.ndarray) -> None:
        """Begin to send the boundary boxes of each layer's patches (slots, 2048). Collective among
        neighbours, with `finish`."""
        for m in self.sends:
            m.head[:] = step, m.seal
            for part, patches in zip(m.parts, layers, strict=True):
                pack(*part, patches)
        self.link.start()

    def finish(self, step: int, *layers: np.ndarray) -> None:
        """Put the neighbours' boxes, which `link.wait` has seen arrive, into the ghost patches."""
        for m in self.receives:
            if m.head[0] != step or m.head[1] != m.seal:
                raise HaloError(
                    f"rank {self.rank}: message from rank {m.rank} is of step {m.head[0]},"
                    f" not {step}, or of another list of patches"
                )
            for part, patches in zip(m.parts, layers, strict=True):
                unpack(*part, patches)


class _Message:
    """One neighbour's buffer: header, then the boxes of its patches, layer by layer.

    parts: (buffer, slots, low, high) of each layer.
    """

    def __init__(self, part, topology: Topology, slots: list[np.ndarray], real: np.dtype):
        self.rank, patches, low, high = part
        size = np.prod(high[:, :2] - low[:, :2], axis=1) * HALF
        size = np.where(high[:, 2] - low[:, 2] == SIDE, 2 * size, size)
        wanted = [slot[patches] >= 0 for slot in slots]
        ends = _HEADER + np.cumsum([0, *(int(size[here].sum()) for here in wanted)])
        self.buffer = np.zeros(ends[-1], real)
        self.head = self.buffer[:_HEADER].view(np.int64)[:2]
        self.parts = [
            (self.buffer[ends[k] : ends[k + 1]], slots[k][patches][here], low[here], high[here])
            for k, here in enumerate(wanted)
        ]
        blocks = topology.block[patches].astype(np.int64)  # rows of the census are a rank's own
        listed = np.concatenate([blocks.ravel(), low.ravel(), high.ravel(), *wanted])
        self.seal = zlib.crc32(listed.astype(np.int64).tobytes())


@kernel
def pack(buffer, slots, low, high, patches):
    """Copy nodes low..high of each patch into the buffer. patches: (slots, 2048).

    Along z a box holds the first four nodes of a patch, the last four or all eight: copies of a
    length the compiler knows.
    """
    at = 0
    for q in range(len(slots)):
        patch = patches[slots[q]]
        k, whole = 4 * low[q, 2], high[q, 2] - low[q, 2] == SIDE
        for i in range(low[q, 0], high[q, 0]):
            for j in range(low[q, 1], high[q, 1]):
                row = (i * SIDE + j) * 2 * HALF + k
                _copy(buffer[at : at + HALF], patch[row : row + HALF])
                at += HALF
                if whole:
                    _copy(buffer[at : at + HALF], patch[row + HALF : row + 2 * HALF])
                    at += HALF


@kernel
def unpack(buffer, slots, low, high, patches):
    """Inverse of `pack`."""
    at = 0
    for q in range(len(slots)):
        patch = patches[slots[q]]
        k, whole = 4 * low[q, 2], high[q, 2] - low[q, 2] == SIDE
        for i in range(low[q, 0], high[q, 0]):
            for j in range(low[q, 1], high[q, 1]):
                row = (i * SIDE + j) * 2 * HALF + k
                _copy(patch[row : row + HALF], buffer[at : at + HALF])
                at += HALF
                if whole:
                    _copy(patch[row + HALF : row + 2 * HALF], buffer[at : at + HALF])
                    at += HALF


@inline
def _copy(to, of):
    for c in range(HALF):
        to[c] = of[c]
