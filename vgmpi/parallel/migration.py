"""Particle sort and migration: every particle moves to its block, every block to its owner.

The order of particles does not depend on the number of ranks.
"""

from typing import NamedTuple

import numpy as np

from . import load_balance, sort_kernels
from .block_lattice import BlockLattice
from .block_ownership import BlockDirectory, build_block_directory
from .communicator import SerialCommunicator
from .particle_group import ParticleGroup

_NEAR = (-1, 0, 1)


class MigrationTargets(NamedTuple):
    """Target blocks of the particles of a group, before they are sorted."""

    key: np.ndarray  # (n,) Hilbert key of each target block
    code: np.ndarray  # (n,) code of each target block, ascending
    particles: np.ndarray  # (n,) number of particles of each
    block: np.ndarray  # (segments, 27) row of each block around a segment, n if not a target

    def rows(self, group: int) -> np.ndarray:
        """Return the rows that `build_block_directory` takes, shape (n, 4)."""
        return np.stack([self.key, self.code, np.full_like(self.key, group), self.particles], 1)


def sort_particles(
    groups: list[ParticleGroup], ranks: SerialCommunicator, cut: np.ndarray | None, steps: int,
    pace: float = 1.0,
) -> tuple[BlockDirectory, np.ndarray, int]:  # fmt: skip
    """Sort all particles and send each to the owner of its block. Collective.

    Args:
        groups: Particle groups of this rank.
        ranks: Communicator.
        cut: Present cuts; None at the start.
        steps: Steps since the last sort.
        pace: Measured over predicted work of this rank (load_balance.RankPace).

    Returns:
        The Census, the cuts from now on, and the number of particles that left this rank.
    """
    aims = [_tag(group) for group in groups]
    rows = [aim.rows(g) for g, (_, aim) in enumerate(aims)]
    costs = np.array([group.plan.cost for group in groups])
    table, cut = build_block_directory(
        np.concatenate(rows), groups[0].lattice, ranks, costs, cut, steps, pace
    )
    own, left = table.owner == ranks.rank, 0
    for g, (group, aim) in enumerate(zip(groups, aims, strict=True)):
        left += _reorder(group, ranks, table.code[own & (table.group == g)], cut, *aim)
    return table, cut, left


def append_particles(
    group: ParticleGroup, block: np.ndarray, xi: np.ndarray, f: np.ndarray, ids: np.ndarray
) -> None:
    """Append particles to a group on this rank, in any order.

    They follow the others, in segments of their own, until the next sort.

    Args:
        group: The group (in/out).
        block: Blocks, shape (n, 3).
        xi: Fixed-point positions, shape (3, n).
        f: Channels, shape (channels, n).
        ids: Particle ids, shape (n,).
    """
    code = group.lattice.code(block)
    order = np.argsort(code, kind="stable")
    first, end = group.used, group.used + len(ids)
    group.reserve(end)
    group.xi[:, first:end], group.f[:, first:end] = xi[:, order], f[:, order]
    group.ids[first:end] = ids[order]
    codes, start, count = np.unique(code[order], return_index=True, return_counts=True)
    group.segments(
        np.append(group.code, codes), np.append(group.start, first + start),
        np.append(group.count, count),
    )  # fmt: skip
    group.used = end


def _tag(group: ParticleGroup) -> tuple[np.ndarray, MigrationTargets]:
    """Return the tags of a group's particles, see sort_kernels.assign_tags, and targets."""
    tags, number = group.tag()
    return tags, migration_targets(group.lattice, group.code, number)


def migration_targets(
    lattice: BlockLattice, code: np.ndarray, number: np.ndarray
) -> MigrationTargets:
    """Return the target blocks of particles.

    Args:
        lattice: Lattice of the blocks.
        code: Code of the block of each segment, shape (segments,).
        number: Particles by block around it, shape (segments, 27).
    """
    some = number > 0
    target, row = np.unique(
        (code[:, None] + neighbor_code_offsets(lattice))[some], return_inverse=True
    )
    count = np.bincount(row, number[some], len(target)).astype(np.int64)
    block = np.full(number.shape, len(target))
    block[some] = row
    return MigrationTargets(lattice.key(lattice.block(target)), target, count, block)


def neighbor_code_offsets(lattice: BlockLattice) -> np.ndarray:
    """Return the differences of code between a block and the 27 blocks around it."""
    _, ny, nz = lattice.shape
    return np.array([(i * ny + j) * nz + k for i in _NEAR for j in _NEAR for k in _NEAR])


def _reorder(
    group: ParticleGroup,
    ranks: SerialCommunicator,
    codes,
    cut,
    tags: np.ndarray,
    aim: MigrationTargets,
) -> int:
    """Exchange the particles that change rank and reorder the others; return how many left.

    `codes` (n,) are this rank's blocks of the group in key order; `tags` and `aim` come from
    `_tag`.
    """
    owner = load_balance.owners(aim.key, cut)
    mine = owner == ranks.rank
    by_code = np.argsort(codes)
    place = np.full(len(aim.code) + 1, -1)
    place[:-1][mine] = by_code[np.searchsorted(codes[by_code], aim.code[mine])]
    place = place[aim.block]
    came_count, left = 0, 0
    if ranks.size > 1:
        left = int(aim.particles[~mine].sum())
        leaving, block, cell = group.collect_leaving(tags, place, aim.block, left)
    number = group.assign_targets(tags, place, len(codes))
    if ranks.size > 1:
        received = _exchange(group, ranks, leaving, owner[block], aim.code[block], cell)
        tags, came_count = _receive(group, tags, received, codes, by_code, number), len(received)
    group.counting_sort(tags, number, came_count, codes)
    return left


def _receive(group: ParticleGroup, tags, received, codes, by_code, number) -> np.ndarray:
    """Extend the tags by the targets of the received rows (n, 2) of code and cell.

    `number` counts them (in/out); `codes` are this rank's blocks and `by_code` is their order by
    code.
    """
    if len(received) == 0:
        return tags
    index = np.searchsorted(codes[by_code], received[:, 0])
    if (
        len(codes) == 0
        or (codes[by_code[np.minimum(index, len(codes) - 1)]] != received[:, 0]).any()
    ):
        raise RuntimeError("particles came for a block of another rank")
    target = by_code[index] * sort_kernels.CELLS_PER_BLOCK + received[:, 1]
    return group.extend_targets(tags, target, number)


def _exchange(
    group: ParticleGroup, ranks: SerialCommunicator, leaving, to, code, cell
) -> np.ndarray:
    """Send the particles at `leaving` to ranks `to`; the received ones follow the others.

    Returns code and cell (n, 2) of the received particles.
    """
    integer = group.xi.dtype  # all values travel as integers of the particles' own size
    where = np.stack([group.ids_at(leaving), code, cell], 1).view(integer)
    packed = np.empty((len(leaving), 3 + group.channels + where.shape[1]), integer)
    group.pack_particles(leaving, packed)
    packed[:, 3 + group.channels :] = where
    received = ranks.sparse_exchange(packed, to)
    where = np.ascontiguousarray(received[:, 3 + group.channels :]).view(np.int64)
    group.unpack_particles(received, where[:, 0])
    return where[:, 1:]
