"""Particles of one group on one rank, in the arrays that the plan requires."""

import numpy as np

from vgmpi.planning.phases_and_groups import GroupPlan
from vgmpi.runtime.aligned_arrays import aligned_zeros

from . import sort_kernels
from .block_lattice import BITS, INTEGER, BlockLattice
from .sort_kernels import gather_rows

SIMD_WIDTH = 16  # segments begin at multiples of this, so that no SIMD vector spans two


class ParticleGroup:
    """Particles of one group on this rank, in segments of one block each.

    Segment s consists of the particles start[s] to start[s] + count[s] - 1 of the block code[s].
    Segments are in the order of their keys, particles within one in the order of (cell, id) at the
    last sort. This order is part of the state.

    Attributes:
        xi: Fixed-point positions, shape (3, cap).
        f: Channels, see kernels/particle_records.py, shape (channels, cap).
        ids: Global particle ids, -1 for padding, shape (cap,).
    """

    def __init__(self, plan: GroupPlan, lattice: BlockLattice, real: np.dtype):
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
        """Set the particles of each block.

        Args:
            code: Codes of the blocks, shape (segments,).
            start: First particle of each segment, shape (segments,).
            count: Particles of each segment, shape (segments,).
        """
        self.code, self.start, self.count = code, start, count
        self.block = self.lattice.block(code)

    def __len__(self) -> int:
        """Return the number of particles."""
        return int(self.count.sum())

    def reserve(self, places: int) -> None:
        """Allocate memory for `places` particles, padding included.

        The capacity grows by a quarter so that sorts seldom allocate.
        """
        have = self.f.shape[1]
        if places <= have:
            return
        cap = (places + places // 4 + SIMD_WIDTH - 1) // SIMD_WIDTH * SIMD_WIDTH
        for name in ("xi", "f", "ids"):
            old = getattr(self, name)
            new = aligned_zeros((*old.shape[:-1], cap), old.dtype)
            new[..., :have] = old
            setattr(self, name, new)
        self.ids[have:] = -1
        self.spare = np.empty(cap, np.int64)  # scratch memory for one channel during a sort

    # ---- a sort (migration.py) ------------------------------------------------------------------

    def tag(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the tags of all particles (sort_kernels.assign_tags) and their numbers by block.

        The numbers are for the blocks around each segment, shape (segments, 27).
        """
        tags = np.empty(self.f.shape[1], np.int32)
        number = np.zeros((len(self.start), 27), np.int64)
        sort_kernels.assign_tags(self.start, self.count, self.xi, self.bits, tags, number)
        return tags, number

    def collect_leaving(
        self, tags, place, block, left: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return indices, targets and cells of the `left` particles that leave this rank.

        Args:
            tags: Tags of `tag`.
            place: New segment for each block around a segment, or -1, shape (segments, 27).
            block: Target value of each block around a segment, shape (segments, 27).
            left: Number of leaving particles.
        """
        indices, to, cell = (np.empty(left, np.int64) for _ in range(3))
        sort_kernels.collect_leaving(self.start, self.count, tags, place, block, indices, to, cell)
        return indices, to, cell

    def assign_targets(self, tags, place: np.ndarray, segments: int) -> np.ndarray:
        """Replace tags by targets (sort_kernels.assign_targets); return the counts of the targets.

        Args:
            tags: Tags of `tag`, then targets (in/out).
            place: New segment for each block around a segment, or -1, shape (segments, 27).
            segments: Number of new segments.

        Returns:
            Shape (64 * segments,).
        """
        number = np.zeros(sort_kernels.CELLS_PER_BLOCK * segments, np.int64)
        sort_kernels.assign_targets(self.start, self.count, tags, place, number)
        return number

    def ids_at(self, index: np.ndarray) -> np.ndarray:
        """Return the ids of the particles with these indices (n,)."""
        return self.ids[index]

    def pack_particles(self, indices: np.ndarray, packed: np.ndarray) -> None:
        """Pack particles (n,) into rows of a message, shape (n, 3 + channels and more) (out)."""
        sort_kernels.pack_particles(indices, self.xi, packed, 0)
        sort_kernels.pack_particles(indices, self.f.view(self.xi.dtype), packed, 3)

    def unpack_particles(self, packed: np.ndarray, ids: np.ndarray) -> None:
        """Unpack received particles behind the others."""
        first = self.used
        self.reserve(first + len(packed))
        sort_kernels.unpack_particles(packed, 0, self.xi, first)
        sort_kernels.unpack_particles(packed, 3, self.f.view(self.xi.dtype), first)
        self.ids[first : first + len(packed)] = ids

    def extend_targets(self, tags, targets: np.ndarray, number: np.ndarray):
        """Return the tags, extended by the targets of received particles, and count these.

        Args:
            tags: Targets of `assign_targets`.
            targets: Targets of the received particles, shape (n,).
            number: Particles of each target (in/out), shape (64 segments,).
        """
        number += np.bincount(targets, minlength=len(number))
        if self.f.shape[1] > len(tags):
            tags = np.pad(tags, (0, self.f.shape[1] - len(tags)))
        tags[self.used : self.used + len(targets)] = targets
        return tags

    def counting_sort(self, tags, number: np.ndarray, received: int, codes: np.ndarray) -> None:
        """Move all particles, including received ones, into the segments of blocks `codes`.

        Args:
            tags: Targets of `assign_targets`, extended by those of received particles.
            number: Particles of each target, shape (64 segments,); overwritten.
            received: Number of received particles.
            codes: Codes of the new blocks, in key order.
        """
        start, count = np.append(self.start, self.used), np.append(self.count, received)
        new_start = np.empty(len(codes), np.int64)
        size = number.reshape(-1, sort_kernels.CELLS_PER_BLOCK).sum(1)
        source = np.empty(int(size.sum()) + SIMD_WIDTH * len(size), np.uint32)
        end = sort_kernels.counting_sort(
            start, count, tags, self.ids, number, SIMD_WIDTH, new_start, source
        )
        self.permute(new_start, size, source, end)
        self.segments(codes, new_start, size)

    def permute(self, start: np.ndarray, count: np.ndarray, source: np.ndarray, end: int) -> None:
        """Move the particles into new segments: index `new` receives the particle source[new].

        Args:
            start: First particle of each new segment.
            count: Particles of each new segment.
            source: Old index of each new one.
            end: End of the last segment.
        """
        self.reserve(end)
        for rows, fill in ((self.xi, 0), (self.f, 0), (self.ids[None], -1)):
            spare = self.spare.view(rows.dtype)[:end]
            for row in rows:
                gather_rows(start, count, source, row, spare, row.dtype.type(fill))
                row[:end] = spare
        self.used = end

    def index(self) -> np.ndarray:
        """Return the indices of this rank's particles, segment after segment."""
        return self.places(slice(None))

    def places(self, segments: np.ndarray | slice) -> np.ndarray:
        """Return the indices of the particles of some segments."""
        start, count = self.start[segments], self.count[segments]
        return np.arange(count.sum()) + np.repeat(start - np.cumsum(count) + count, count)

    def get(self, name: str, index: np.ndarray) -> np.ndarray:
        """Return a channel (planning/particle_channels.py) of particles (n,), shape (n, width)."""
        return self.f[self.plan.channels[name].rows, index].T

    def put(self, name: str, index: np.ndarray, values: np.ndarray) -> None:
        """Set a channel of particles; the inverse of `get`.

        Args:
            name: Name of the channel.
            index: Indices of the particles, shape (n,).
            values: Values, shape (n, width).
        """
        self.f[self.plan.channels[name].rows, index] = values.T

    def law_state(self, index: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return the law's state of particles (n,), as its functions take it."""
        return tuple(row for name in self.plan.carries for row in self.get(name, index).T)

    def positions(self) -> np.ndarray:
        """Return all positions in the order of `index`, shape (n, 3) [m]."""
        index = self.index()
        return self.lattice.position(
            np.repeat(self.block, self.count, axis=0), self.xi[:, index], self.real
        )

    def segment_of(self, index: np.ndarray) -> np.ndarray:
        """Return the segments of particles (n,)."""
        return np.searchsorted(self.start, index, side="right") - 1

    def positions_at(self, index: np.ndarray) -> np.ndarray:
        """Return the positions of particles (n,), shape (n, 3) [m]."""
        return self.lattice.position(
            self.block[self.segment_of(index)], self.xi[:, index], self.real
        )
