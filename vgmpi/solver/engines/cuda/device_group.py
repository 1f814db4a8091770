"""Particle group in GPU memory."""

import numpy as np

from vgmpi.kernels.kernel_arguments import Particles
from vgmpi.parallel.particle_group import SIMD_WIDTH, ParticleGroup
from vgmpi.parallel.sort_kernels import CELLS_PER_BLOCK

from . import device_sort
from .device_memory import flattened, new, read, to_card, write
from .device_sort import SORT
from .kernel_launch import Launcher

ROWS = ("xi", "f", "ids")


class CardGroup(ParticleGroup):
    """Particle group whose arrays live where they were changed last, on the GPU or the host.

    Access to xi, f or ids returns the host's arrays, and the GPU copies them again when it needs
    them. Steps and sorts read and write only the arrays of the GPU.
    """

    launcher: Launcher  # the engine's launcher of kernels with a team per segment

    def __init__(self, plan, lattice, real):
        self._host: dict[str, np.ndarray] = {}
        self._card: dict = {}
        self._newest: dict[str, str] = {}
        self._particles: dict[bool, Particles] = {}
        super().__init__(plan, lattice, real)

    def on_card(self, writes: tuple[str, ...] = (), flat: bool = True) -> Particles:
        """Return the particle arrays of the GPU.

        Args:
            writes: Names of the arrays that the caller is about to change there.
            flat: Whether to return one-dimensional arrays, channel after channel.
        """
        for name in ROWS:
            if self._newest[name] == "host":
                self._copy_to_card(name)
        for name in writes:
            self._newest[name] = "card"
        return self._particles[flat]

    def _copy_to_card(self, name: str) -> None:
        """Copy an array of the host to the GPU, into its memory there if it has the size."""
        host, card = self._host[name], self._card.get(name)
        if card is not None and card.shape == host.shape:
            write(card, host)
        else:
            self._set_card(name, to_card(host))
        self._newest[name] = "both"

    def _set_card(self, name: str, array) -> None:
        """Set an array of the GPU, and the particle arrays that kernels take, by `flat`."""
        self._card[name] = array
        if len(self._card) == len(ROWS):
            arrays = Particles(*(self._card[name] for name in ROWS))
            self._particles = {False: arrays, True: Particles(*map(flattened, arrays))}

    def _get(self, name: str) -> np.ndarray:
        if self._newest[name] == "card":
            read(self._card[name], self._host[name])
        self._newest[name] = "host"
        return self._host[name]

    def _set(self, name: str, array: np.ndarray) -> None:
        self._host[name], self._newest[name] = array, "host"

    xi = property(lambda self: self._get("xi"), lambda self, array: self._set("xi", array))
    f = property(lambda self: self._get("f"), lambda self, array: self._set("f", array))
    ids = property(lambda self: self._get("ids"), lambda self, array: self._set("ids", array))

    @property
    def capacity(self) -> int:
        """Number of particles for which memory is allocated."""
        return self._host["ids"].size

    def reserve(self, places: int) -> None:
        """Allocate memory for particles; the GPU's values are copied by way of the host."""
        if places > self.capacity:
            super().reserve(places)

    # ---- a sort ------------------------------------------------------------------------------

    def _each_segment(self, kernel, *arguments) -> None:
        """Launch a kernel with a team per segment."""
        self.launcher.launch(
            len(self.start), SORT, kernel, *map(to_card, (self.start, self.count)), *arguments
        )

    def _each_item(self, count: int, kernel, *arguments) -> None:
        """Launch a kernel with a thread per item."""
        self.launcher.launch(-(-count // self.launcher.threads), SORT, kernel, *arguments)

    def tag(self):
        """Move particles to the blocks of their base nodes; return their tags and the counts."""
        tags = new(max(self.capacity, 1), np.int32)
        number = to_card(np.zeros((len(self.start), 27), np.int64))
        particles = self.on_card(writes=("xi",))
        self._each_segment(device_sort.tag, particles.xi, self.capacity, tags, number)
        return tags, number.copy_to_host()

    def collect_leaving(self, tags, place, block, left: int):
        """Return indices, blocks and cells of the particles that leave this rank.

        Args:
            tags: Tags of `tag`.
            place: Target segment by segment and neighbor, -1 for another rank.
            block: Block of each segment and neighbor.
            left: Number of leaving particles.
        """
        leaving, count = to_card(np.zeros(left, np.int64)), to_card(np.zeros(1, np.int64))
        self._each_segment(device_sort.leaving, tags, to_card(place), leaving, count)
        index = np.sort(leaving.copy_to_host())
        tag = tags.copy_to_host()[index]
        return (
            index,
            block[self.segment_of(index), tag >> 6],
            (tag & (CELLS_PER_BLOCK - 1)).astype(np.int64),
        )

    def segment_of(self, index: np.ndarray) -> np.ndarray:
        """Return the segments (n,) of the particles with the indices (n,)."""
        by_start = np.argsort(self.start, kind="stable")
        return by_start[np.searchsorted(self.start[by_start], index, side="right") - 1]

    def assign_targets(self, tags, place: np.ndarray, segments: int) -> np.ndarray:
        """Convert tags to targets and return the number of particles per target.

        Args:
            tags: Tags of `tag` (in/out).
            place: Target segment by segment and neighbor, -1 for another rank.
            segments: Number of target segments.
        """
        number = to_card(np.zeros(CELLS_PER_BLOCK * segments, np.int64))
        self._each_segment(device_sort.aim, tags, to_card(place), number)
        return number.copy_to_host()

    def ids_at(self, index: np.ndarray) -> np.ndarray:
        """Return the ids of particles."""
        rows = np.zeros((len(index), 1), np.int64)
        self._gather_channels(index, rows, ("ids", 1, 0))
        return rows[:, 0]

    def pack_particles(self, indices: np.ndarray, packed: np.ndarray) -> None:
        """Copy positions and channels of leaving particles into rows of a message."""
        self._gather_channels(indices, packed, ("xi", 3, 0), ("f", self.channels, 3))

    def _gather_channels(self, index: np.ndarray, packed: np.ndarray, *channels) -> None:
        """Copy channels (name, count, column) of particles into rows."""
        rows, card_index = to_card(packed), to_card(index)
        for name, count, column in channels:
            self._each_item(
                len(index) * count, device_sort.pick_up, card_index, self._integer_array(name),
                count,
                self.capacity, rows, column,
            )  # fmt: skip
        if len(index):
            rows.copy_to_host(packed)

    def _integer_array(self, name: str, writes: bool = False):
        """Return an array of the GPU viewed as integers of its size."""
        array = getattr(self.on_card((name,) if writes else ()), name)
        return array if name == "ids" else array.view(self._host["xi"].dtype)

    def unpack_particles(self, packed: np.ndarray, ids: np.ndarray) -> None:
        """Append received particles, given as rows of a message and ids."""
        first, count = self.used, len(packed)
        self.reserve(first + count)
        for name, rows, channels, column in (
            ("xi", packed, 3, 0), ("f", packed, self.channels, 3), ("ids", ids[:, None], 1, 0),
        ):  # fmt: skip
            self._each_item(
                count * channels, device_sort.put_down, to_card(rows), column, channels,
                self._integer_array(name, writes=True), self.capacity, first,
            )  # fmt: skip

    def extend_targets(self, tags, targets: np.ndarray):
        """Return the tags extended by the targets of received particles."""
        extended = to_card(np.zeros(max(self.capacity, 1), np.int32))
        host_tags = tags.copy_to_host()
        all_tags = np.zeros(extended.size, np.int32)
        all_tags[: len(host_tags)] = host_tags
        all_tags[self.used : self.used + len(targets)] = targets
        extended.copy_to_device(all_tags)
        return extended

    def counting_sort(self, tags, number: np.ndarray, received: int, codes: np.ndarray) -> None:
        """Sort the particles into new segments.

        Args:
            tags: Target of each particle, -1 if it leaves.
            number: Number of particles per target cell.
            received: Number of received particles.
            codes: Codes of the new segments.
        """
        size = number.reshape(-1, CELLS_PER_BLOCK).sum(1)
        length = -(-size // SIMD_WIDTH) * SIMD_WIDTH
        start = np.cumsum(length) - length
        begin = np.cumsum(number) - number
        begin += np.repeat(start - begin[::CELLS_PER_BLOCK], CELLS_PER_BLOCK) if len(start) else 0
        end = int(length.sum())
        self.start, self.count = np.append(self.start, self.used), np.append(self.count, received)
        source = new(max(end, 1), np.uint32)
        first, taken = to_card(begin), to_card(np.zeros(len(begin), np.int64))
        self._each_segment(device_sort.put, tags, first, taken, source)
        self._each_item(len(begin), device_sort.order, first, taken, self.on_card().ids, source)
        self._permute(start, size, start + length, source, end)
        self.segments(codes, start, size)

    def _permute(self, start, count, ends, source, end: int) -> None:
        """Copy the particles into new segments, channel after channel."""
        self.reserve(end)
        tables = [to_card(table) for table in (start, count, ends)]
        for name, fill in (("xi", 0), ("f", 0), ("ids", -1)):
            rows = getattr(self.on_card((name,)), name)
            kind = rows.dtype.type
            spare = new(max(end, 1), kind)
            for first in range(0, rows.size, self.capacity or 1):
                self.launcher.launch(
                    len(start),
                    SORT,
                    device_sort.carry,
                    *tables,
                    source,
                    first,
                    rows,
                    spare,
                    kind(fill),
                )
                self._each_item(end, device_sort.put_back, spare, first, rows, end)
        self.used = end
