"""Particle group in GPU memory."""

import numpy as np

from vgmpi.kernels.kernel_arguments import Particles
from vgmpi.parallel.particle_group import SIMD_WIDTH, ParticleGroup
from vgmpi.parallel.sort_kernels import CELLS_PER_BLOCK

from . import device_sort
from .device_memory import (
    ChannelMemory,
    card_room,
    clear,
    flattened,
    new,
    read,
    to_card,
    to_card_together,
    write,
)
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
        self._memory: dict[str, ChannelMemory] = {}
        self._scratch: dict = {}  # arrays of a sort, by name
        self._sorted: tuple = ()  # segments, and their tables in GPU memory
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
        host, memory = self._host[name], self._memory.get(name)
        if memory is None or memory.array.shape != host.shape:
            self._memory[name] = ChannelMemory(host.shape, host.dtype)
            self._set_particles()
        write(self._memory[name].array, host)
        self._newest[name] = "both"

    def _set_particles(self) -> None:
        """Set the particle arrays that kernels take, by `flat`."""
        if len(self._memory) == len(ROWS):
            arrays = Particles(*(self._memory[name].array for name in ROWS))
            self._particles = {False: arrays, True: Particles(*map(flattened, arrays))}

    def _get(self, name: str) -> np.ndarray:
        if self._newest[name] == "card":
            read(self._memory[name].array, self._host[name])
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
        if (
            not self._sorted
            or self._sorted[0] is not self.start
            or self._sorted[1] is not self.count
        ):
            self._sorted = self.start, self.count, *to_card_together([self.start, self.count])
        self.launcher.launch(len(self.start), SORT, kernel, *self._sorted[2:], *arguments)

    def _room(self, name: str, size: int, kind):
        """Return an array of a sort with room for `size` numbers, which the next sort reuses."""
        self._scratch[name] = card_room(
            self._scratch.get(name, np.zeros(0)), max(size, 1), (), kind
        )
        return self._scratch[name]

    def _each_item(self, count: int, kernel, *arguments) -> None:
        """Launch a kernel with a thread per item."""
        self.launcher.launch(-(-count // self.launcher.threads), SORT, kernel, *arguments)

    def tag(self):
        """Move particles to the blocks of their base nodes; return their tags and the counts."""
        tags = self._room("tags", self.capacity, np.int32)
        number = new((len(self.start), 27), np.int64)
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

    def assign_targets(self, tags, place: np.ndarray, segments: int):
        """Convert tags to targets and return the number of particles per target, on the GPU.

        Args:
            tags: Tags of `tag` (in/out).
            place: Target segment by segment and neighbor, -1 for another rank.
            segments: Number of target segments.
        """
        number = self._room("number", CELLS_PER_BLOCK * segments, np.int64)
        clear(number)
        self._each_segment(device_sort.aim, tags, to_card(place), number)
        return number

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

    def extend_targets(self, tags, targets: np.ndarray, number):
        """Return the tags extended by the targets of received particles, and count these.

        Args:
            tags: Targets of `assign_targets`.
            targets: Targets of the received particles, shape (n,).
            number: Number of particles per target (in/out).
        """
        if self.used + len(targets) > tags.size:
            old = tags
            tags = self._scratch["tags"] = new(self.capacity, np.int32)
            tags[: old.size].copy_to_device(old)
        self._each_item(
            len(targets), device_sort.append_targets, to_card(targets), self.used, tags, number
        )
        return tags

    def counting_sort(self, tags, number, received: int, codes: np.ndarray) -> None:
        """Sort the particles into new segments.

        Args:
            tags: Target of each particle, -1 if it leaves.
            number: Number of particles per target cell, on the GPU.
            received: Number of received particles.
            codes: Codes of the new segments.
        """
        segments, cells = len(codes), CELLS_PER_BLOCK * len(codes)
        size = self._sizes(number, segments)
        length = -(-size // SIMD_WIDTH) * SIMD_WIDTH
        start = np.cumsum(length) - length
        end = int(length.sum())
        if received:
            self.start = np.append(self.start, self.used)
            self.count = np.append(self.count, received)
        tables = to_card_together([start, size, start + length])
        begin = self._room("begin", cells, np.int64)
        source = self._room("source", end, np.uint32)
        self.launcher.launch(segments, SORT, device_sort.place_cells, tables[0], number, begin)
        self._each_segment(device_sort.put, tags, begin, source)
        self._each_item(cells, device_sort.order, cells, begin, number, self.on_card().ids, source)
        self._permute(tables, source, end)
        self.segments(codes, start, size)
        self._sorted = start, size, *tables[:2]

    def _sizes(self, number, segments: int) -> np.ndarray:
        """Return the number of particles of each new segment, shape (segments,)."""
        sizes = new(max(segments, 1), np.int64)
        self.launcher.launch(segments, SORT, device_sort.add_cells, number, sizes)
        return sizes.copy_to_host()[:segments]

    def _permute(self, tables: list, source, end: int) -> None:
        """Copy the particles into new segments, channel after channel."""
        self.reserve(end)
        for name, fill in (("xi", 0), ("f", 0), ("ids", -1)):
            self.on_card((name,))
            memory = self._memory[name]
            value = memory.array.dtype.type(fill)
            for old, place in memory.moves():
                self.launcher.launch(
                    tables[0].size, SORT, device_sort.carry, *tables, source, old, place,
                    memory.all,
                    value,
                )  # fmt: skip
            memory.is_shifted = not memory.is_shifted
        self._set_particles()
        self.used = end
