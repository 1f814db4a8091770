"""Particles in a card's memory."""

import numpy as np

from ...domain.sorting import CELLS
from ...domain.state import LANES, Group
from ...kernels.tables import Particles
from . import sorting
from .launch import Launcher
from .memory import flattened, new, to_card
from .sorting import SORT

ROWS = ("xi", "f", "ids")


class CardGroup(Group):
    """Particles that are where they were changed last: in the card's memory or the host's.

    Whoever reads or writes xi, f or ids gets the host's arrays, and the card takes them from there
    when it needs them again; steps and sorts read and write the card's alone.
    """

    launcher: Launcher  # of kernels that have a team per segment; the engine's

    def __init__(self, plan, lattice, real):
        self._host: dict[str, np.ndarray] = {}
        self._card: dict = {}
        self._newest: dict[str, str] = {}
        super().__init__(plan, lattice, real)

    def on_card(self, writes: tuple[str, ...] = (), flat: bool = True) -> Particles:
        """The card's arrays. writes: those that are about to be changed there; flat: one channel
        behind the other."""
        for name in ROWS:
            if self._newest[name] == "host":
                self._card[name] = to_card(self._host[name])
                self._newest[name] = "both"
        for name in writes:
            self._newest[name] = "card"
        found = [self._card[name] for name in ROWS]
        return Particles(*(flattened(one) for one in found) if flat else found)

    def _get(self, name: str) -> np.ndarray:
        if self._newest[name] == "card":
            self._card[name].copy_to_host(self._host[name])
        self._newest[name] = "host"
        return self._host[name]

    def _set(self, name: str, array: np.ndarray) -> None:
        self._host[name], self._newest[name] = array, "host"

    xi = property(lambda self: self._get("xi"), lambda self, array: self._set("xi", array))
    f = property(lambda self: self._get("f"), lambda self, array: self._set("f", array))
    ids = property(lambda self: self._get("ids"), lambda self, array: self._set("ids", array))

    @property
    def places_there_are(self) -> int:
        return self._host["ids"].size

    def reserve(self, places: int) -> None:
        """Make room for particles; what the card has comes along by way of the host."""
        if places > self.places_there_are:
            super().reserve(places)

    # ---- a sort ------------------------------------------------------------------------------

    def _each_segment(self, kernel, *arguments) -> None:
        """A kernel with a team per segment."""
        self.launcher.launch(
            len(self.start), SORT, kernel, *map(to_card, (self.start, self.count)), *arguments
        )

    def _each(self, count: int, kernel, *arguments) -> None:
        """A kernel with a thread per thing."""
        self.launcher.launch(-(-count // self.launcher.threads), SORT, kernel, *arguments)

    def tag(self):
        tags = new(max(self.places_there_are, 1), np.int32)
        number = to_card(np.zeros((len(self.start), 27), np.int64))
        particles = self.on_card(writes=("xi",))
        self._each_segment(sorting.tag, particles.xi, self.places_there_are, tags, number)
        return tags, number.copy_to_host()

    def leaving(self, tags, place, block, left: int):
        gone, found = to_card(np.zeros(left, np.int64)), to_card(np.zeros(1, np.int64))
        self._each_segment(sorting.leaving, tags, to_card(place), gone, found)
        at = np.sort(gone.copy_to_host())
        mine = tags.copy_to_host()[at]
        return at, block[self.segment_of(at), mine >> 6], (mine & (CELLS - 1)).astype(np.int64)

    def segment_of(self, at: np.ndarray) -> np.ndarray:
        """Segments (n,) of the particles at `at` (n,)."""
        by_start = np.argsort(self.start, kind="stable")
        return by_start[np.searchsorted(self.start[by_start], at, side="right") - 1]

    def aim(self, tags, place: np.ndarray, segments: int) -> np.ndarray:
        number = to_card(np.zeros(CELLS * segments, np.int64))
        self._each_segment(sorting.aim, tags, to_card(place), number)
        return number.copy_to_host()

    def ids_at(self, at: np.ndarray) -> np.ndarray:
        found = np.zeros((len(at), 1), np.int64)
        self._picked(at, found, ("ids", 1, 0))
        return found[:, 0]

    def pick_up(self, gone: np.ndarray, packed: np.ndarray) -> None:
        self._picked(gone, packed, ("xi", 3, 0), ("f", self.channels, 3))

    def _picked(self, gone: np.ndarray, packed: np.ndarray, *parts) -> None:
        """Channels (name, how many, column) of particles into rows."""
        rows, at = to_card(packed), to_card(gone)
        for name, count, first in parts:
            self._each(
                len(gone) * count, sorting.pick_up, at, self._whole(name), count,
                self.places_there_are, rows, first,
            )  # fmt: skip
        if len(gone):
            rows.copy_to_host(packed)

    def _whole(self, name: str, writes: bool = False):
        """An array of the card's as whole numbers of its size."""
        found = getattr(self.on_card((name,) if writes else ()), name)
        return found if name == "ids" else found.view(self._host["xi"].dtype)

    def put_down(self, packed: np.ndarray, ids: np.ndarray) -> None:
        first, count = self.used, len(packed)
        self.reserve(first + count)
        for name, rows, channels, column in (
            ("xi", packed, 3, 0), ("f", packed, self.channels, 3), ("ids", ids[:, None], 1, 0),
        ):  # fmt: skip
            self._each(
                count * channels, sorting.put_down, to_card(rows), column, channels,
                self._whole(name, writes=True), self.places_there_are, first,
            )  # fmt: skip

    def tagged(self, tags, to: np.ndarray):
        more = to_card(np.zeros(max(self.places_there_are, 1), np.int32))
        found = tags.copy_to_host()
        all_tags = np.zeros(more.size, np.int32)
        all_tags[: len(found)] = found
        all_tags[self.used : self.used + len(to)] = to
        more.copy_to_device(all_tags)
        return more

    def arrange(self, tags, number: np.ndarray, came: int, codes: np.ndarray) -> None:
        size = number.reshape(-1, CELLS).sum(1)
        length = -(-size // LANES) * LANES
        start = np.cumsum(length) - length
        begin = np.cumsum(number) - number
        begin += np.repeat(start - begin[::CELLS], CELLS) if len(start) else 0
        end = int(length.sum())
        self.start, self.count = np.append(self.start, self.used), np.append(self.count, came)
        source = new(max(end, 1), np.uint32)
        first, taken = to_card(begin), to_card(np.zeros(len(begin), np.int64))
        self._each_segment(sorting.put, tags, first, taken, source)
        self._each(len(begin), sorting.order, first, taken, self.on_card().ids, source)
        self._permuted(start, size, start + length, source, end)
        self.segments(codes, start, size)

    def _permuted(self, start, count, ends, source, end: int) -> None:
        """Bring the particles into new segments, channel after channel."""
        self.reserve(end)
        tables = [to_card(one) for one in (start, count, ends)]
        for name, fill in (("xi", 0), ("f", 0), ("ids", -1)):
            rows = getattr(self.on_card((name,)), name)
            kind = rows.dtype.type
            spare = new(max(end, 1), kind)
            for first in range(0, rows.size, self.places_there_are or 1):
                self.launcher.launch(
                    len(start), SORT, sorting.carry, *tables, source, first, rows, spare, kind(fill)
                )
                self._each(end, sorting.put_back, spare, first, rows, end)
        self.used = end
