"""Sorting: every particle to the block it lies in, every block to the rank that owns it, one order
whatever the ranks.
"""

from typing import NamedTuple

import numpy as np

from . import balance, sorting
from .blocks import Lattice
from .census import Census, census
from .ranks import Alone
from .state import Group

_NEAR = (-1, 0, 1)


class Aim(NamedTuple):
    """Blocks in which the particles of a group lie now, before they are sorted."""

    key: np.ndarray  # (n,)
    code: np.ndarray  # (n,) the same blocks, ascending
    particles: np.ndarray  # (n,) how many of them
    block: np.ndarray  # (segments, 27) which of the n each of the blocks around a segment is, or n

    def rows(self, group: int) -> np.ndarray:
        """As `census` takes them, (n, 4)."""
        return np.stack([self.key, self.code, np.full_like(self.key, group), self.particles], 1)


def sort(
    groups: list[Group], ranks: Alone, cut: np.ndarray | None, steps: int
) -> tuple[Census, np.ndarray, int]:
    """Re-sort all particles and send each to its block's owner. steps: since the last sort. Returns
    the Census, the cuts in force and how many particles left this rank.
    """
    aims = [_tag(group) for group in groups]
    rows = [aim.rows(g) for g, (_, aim) in enumerate(aims)]
    costs = np.array([group.plan.cost for group in groups])
    table, cut = census(np.concatenate(rows), groups[0].lattice, ranks, costs, cut, steps)
    own, left = table.owner == ranks.rank, 0
    for g, (group, aim) in enumerate(zip(groups, aims, strict=True)):
        left += _settle(group, ranks, table.code[own & (table.group == g)], cut, *aim)
    return table, cut, left


def arrive(group: Group, block: np.ndarray, xi: np.ndarray, f: np.ndarray, ids: np.ndarray) -> None:
    """Give a group more particles on this rank, in any order: block (n, 3), xi (3, n), f
    (channels, n), ids (n,). They stand behind the others, in segments of their own, until the next
    sort.
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


def _tag(group: Group) -> tuple[np.ndarray, Aim]:
    """Where each particle of a group goes: tags (see sorting.tag), and the blocks."""
    tags, number = group.tag()
    return tags, aimed(group.lattice, group.code, number)


def aimed(lattice: Lattice, code: np.ndarray, number: np.ndarray) -> Aim:
    """The blocks that particles go to. code: (segments,) of the blocks they were in; number:
    (segments, 27) particles by block around it.
    """
    some = number > 0
    target, at = np.unique((code[:, None] + steps(lattice))[some], return_inverse=True)
    count = np.bincount(at, number[some], len(target)).astype(np.int64)
    block = np.full(number.shape, len(target))
    block[some] = at
    return Aim(lattice.key(lattice.block(target)), target, count, block)


def steps(lattice: Lattice) -> np.ndarray:
    """Codes of the 27 blocks around a block, less its own."""
    _, ny, nz = lattice.shape
    return np.array([(i * ny + j) * nz + k for i in _NEAR for j in _NEAR for k in _NEAR])


def _settle(group: Group, ranks: Alone, codes, cut, tags: np.ndarray, aim: Aim) -> int:
    """Exchange the particles that changed rank and order the rest; codes: (n,) of this rank's
    blocks of the group, in key order; tags, aim: from `_tag`. Returns how many left.
    """
    owner = balance.owners(aim.key, cut)
    mine = owner == ranks.rank
    by_code = np.argsort(codes)
    place = np.full(len(aim.code) + 1, -1)
    place[:-1][mine] = by_code[np.searchsorted(codes[by_code], aim.code[mine])]
    place = place[aim.block]
    came, left = 0, 0
    if ranks.size > 1:
        left = int(aim.particles[~mine].sum())
        gone, block, cell = group.leaving(tags, place, aim.block, left)
    number = group.aim(tags, place, len(codes))
    if ranks.size > 1:
        found = _swap(group, ranks, gone, owner[block], aim.code[block], cell)
        tags, came = _receive(group, tags, found, codes, by_code, number), len(found)
    group.arrange(tags, number, came, codes)
    return left


def _receive(group: Group, tags, came, codes, by_code, number) -> np.ndarray:
    """Tags with the targets of the rows (n, 2) of code and cell that came; `number` counts them.

    codes: of this rank's blocks; by_code: their order by code.
    """
    if len(came) == 0:
        return tags
    at = np.searchsorted(codes[by_code], came[:, 0])
    if len(codes) == 0 or (codes[by_code[np.minimum(at, len(codes) - 1)]] != came[:, 0]).any():
        raise RuntimeError("particles came for a block of another rank")
    to = by_code[at] * sorting.CELLS + came[:, 1]
    number += np.bincount(to, minlength=len(number))
    return group.tagged(tags, to)


def _swap(group: Group, ranks: Alone, gone, to, code, cell) -> np.ndarray:
    """Send the particles at `gone` to ranks `to`; what arrives stands behind the others. Returns
    code and cell (n, 2) of what came.
    """
    whole = group.xi.dtype  # all travels as whole numbers of the particles' own size
    where = np.stack([group.ids_at(gone), code, cell], 1).view(whole)
    packed = np.empty((len(gone), 3 + group.channels + where.shape[1]), whole)
    group.pick_up(gone, packed)
    packed[:, 3 + group.channels :] = where
    got = ranks.deliver(packed, to)
    where = np.ascontiguousarray(got[:, 3 + group.channels :]).view(np.int64)
    group.put_down(got, where[:, 0])
    return where[:, 1:]
