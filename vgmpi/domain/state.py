"""The particles of one rank, in the arrays the plan asks for."""

import numpy as np

from ..device.memory import aligned
from ..planning.groups import GroupPlan
from . import sorting
from .blocks import BITS, INTEGER, Lattice
from .sorting import gather_rows

LANES = 16  # segments begin at multiples of this, so that vectors never straddle two


class Group:
    """Particles of one group on this rank, in segments of one block each.

    xi: (3, cap) fixed-point positions; f: (channels, cap) see kernels/records.py; ids: (cap,)
    global particle id, -1 in unused places. Segment s is the particles start[s] .. start[s] +
    count[s] of block code[s]; segments lie in the order of their keys, particles within one by
    (cell, id) as of the last sort. That order is part of the state.
    """

    def __init__(self, plan: GroupPlan, lattice: Lattice, real: np.dtype):
        self.plan = plan
        self.lattice = lattice
        self.real = np.dtype(real)
        self.bits = BITS[self.real]
        self.channels = plan.channels.count
        self.segments(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0, np.int64))
        self.xi = np.zeros((3, 0), INTEGER[self.real])
        self.f = np.zeros((self.channels, 0), self.real)
        self.ids = np.zeros(0, np.int64)
        self.spare = np.zeros(0, np.int64)
        self.used = 0

    def segments(self, code: np.ndarray, start: np.ndarray, count: np.ndarray) -> None:
        """Set which particles lie in which block."""
        self.code, self.start, self.count = code, start, count
        self.block = self.lattice.block(code)

    def __len__(self) -> int:
        return int(self.count.sum())

    def reserve(self, places: int) -> None:
        """Make room for `places` particles, padding included; grows by a quarter so that sorts
        seldom allocate.
        """
        have = self.f.shape[1]
        if places <= have:
            return
        cap = (places + places // 4 + LANES - 1) // LANES * LANES
        for name in ("xi", "f", "ids"):
            old = getattr(self, name)
            new = aligned((*old.shape[:-1], cap), old.dtype)
            new[..., :have] = old
            setattr(self, name, new)
        self.ids[have:] = -1
        self.spare = np.empty(cap, np.int64)  # one channel while it is sorted

    # ---- a sort (migrate.py) ------------------------------------------------------------------

    def tag(self) -> tuple[np.ndarray, np.ndarray]:
        """Where each particle goes: tags (see sorting.tag), and particles by block around each
        segment's, (segments, 27)."""
        tags = np.empty(self.f.shape[1], np.int32)
        number = np.zeros((len(self.start), 27), np.int64)
        sorting.tag(self.start, self.count, self.xi, self.bits, tags, number)
        return tags, number

    def leaving(self, tags, place, block, left: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The `left` particles that leave this rank: their places, where they go and their cells,
        see sorting.leaving."""
        gone, to, cell = (np.empty(left, np.int64) for _ in range(3))
        sorting.leaving(self.start, self.count, tags, place, block, gone, to, cell)
        return gone, to, cell

    def aim(self, tags, place: np.ndarray, segments: int) -> np.ndarray:
        """Tags to targets, see sorting.aim; returns how many particles there are of each:
        (64 segments,)."""
        number = np.zeros(sorting.CELLS * segments, np.int64)
        sorting.aim(self.start, self.count, tags, place, number)
        return number

    def ids_at(self, at: np.ndarray) -> np.ndarray:
        """Ids of the particles at `at` (n,)."""
        return self.ids[at]

    def pick_up(self, gone: np.ndarray, packed: np.ndarray) -> None:
        """Particles at `gone` into rows of packed, (n, 3 + channels and more)."""
        sorting.pick_up(gone, self.xi, packed, 0)
        sorting.pick_up(gone, self.f.view(self.xi.dtype), packed, 3)

    def put_down(self, packed: np.ndarray, ids: np.ndarray) -> None:
        """Particles that came stand behind the others."""
        first = self.used
        self.reserve(first + len(packed))
        sorting.put_down(packed, 0, self.xi, first)
        sorting.put_down(packed, 3, self.f.view(self.xi.dtype), first)
        self.ids[first : first + len(packed)] = ids

    def tagged(self, tags, to: np.ndarray):
        """Tags with the targets of those that came."""
        if self.f.shape[1] > len(tags):
            tags = np.pad(tags, (0, self.f.shape[1] - len(tags)))
        tags[self.used : self.used + len(to)] = to
        return tags

    def arrange(self, tags, number: np.ndarray, came: int, codes: np.ndarray) -> None:
        """Bring the particles, and those that came, into the segments of blocks `codes`."""
        start, count = np.append(self.start, self.used), np.append(self.count, came)
        new_start = np.empty(len(codes), np.int64)
        size = number.reshape(-1, sorting.CELLS).sum(1)
        source = np.empty(int(size.sum()) + LANES * len(size), np.uint32)
        end = sorting.arrange(start, count, tags, self.ids, number, LANES, new_start, source)
        self.permute(new_start, size, source, end)
        self.segments(codes, new_start, size)

    def permute(self, start: np.ndarray, count: np.ndarray, source: np.ndarray, end: int) -> None:
        """Bring the particles into new segments: the one at `new` is the one that was at
        source[new].
        """
        self.reserve(end)
        for rows, fill in ((self.xi, 0), (self.f, 0), (self.ids[None], -1)):
            spare = self.spare.view(rows.dtype)[:end]
            for row in rows:
                gather_rows(start, count, source, row, spare, row.dtype.type(fill))
                row[:end] = spare
        self.used = end

    def index(self) -> np.ndarray:
        """Places of this rank's particles, segment after segment."""
        return self.places(slice(None))

    def places(self, segments: np.ndarray | slice) -> np.ndarray:
        """Those of the particles of some segments."""
        start, count = self.start[segments], self.count[segments]
        return np.arange(count.sum()) + np.repeat(start - np.cumsum(count) + count, count)

    def get(self, name: str, at: np.ndarray) -> np.ndarray:
        """A channel (planning/channels.py) of the particles at `at` (n,): (n, width)."""
        return self.f[self.plan.channels[name].rows, at].T

    def put(self, name: str, at: np.ndarray, values: np.ndarray) -> None:
        """Inverse of `get`."""
        self.f[self.plan.channels[name].rows, at] = values.T

    def law_state(self, at: np.ndarray) -> tuple[np.ndarray, ...]:
        """What the law carries of the particles at `at` (n,), as its functions take it."""
        return tuple(row for name in self.plan.carries for row in self.get(name, at).T)

    def positions(self) -> np.ndarray:
        """Positions (n, 3) [m] in the order of `index`."""
        at = self.index()
        return self.lattice.position(
            np.repeat(self.block, self.count, axis=0), self.xi[:, at], self.real
        )

    def segment_of(self, at: np.ndarray) -> np.ndarray:
        """Segments (n,) of the particles at `at` (n,)."""
        return np.searchsorted(self.start, at, side="right") - 1

    def positions_at(self, at: np.ndarray) -> np.ndarray:
        """Positions (n, 3) [m] of the particles at `at` (n,)."""
        return self.lattice.position(self.block[self.segment_of(at)], self.xi[:, at], self.real)
