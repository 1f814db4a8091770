"""Sorting: every particle to the block it lies in, every block to the rank that owns it, one order
whatever the ranks.
"""

from typing import NamedTuple

import numpy as np

from . import sorting
from .balance import BLOCK, by_block, owners, recut
from .ranks import Alone
from .state import LANES, Group

_NEAR = (-1, 0, 1)


class Census(NamedTuple):
    """All segments of all ranks, ascending by (key, group): the same on every rank."""

    key: np.ndarray  # (n,) place of the block on the Hilbert curve
    code: np.ndarray  # (n,) the block
    group: np.ndarray  # (n,)
    count: np.ndarray  # (n,) particles
    owner: np.ndarray  # (n,) rank
    work: np.ndarray  # (n,) predicted, see balance.py


def census(
    rows: np.ndarray, ranks: Alone, costs: np.ndarray, cut: np.ndarray | None, steps: int
) -> tuple[Census, np.ndarray]:
    """Merge the ranks' rows (n, 4) of key, code, group, count; cut the curve anew where that is
    worth it.

    costs: (groups,) work per particle; steps: since the last sort. Returns the Census and the cuts
    in force.
    """
    rows = ranks.all_rows(rows)
    rows = rows[np.lexsort((rows[:, 2], rows[:, 0]))]
    new = np.ones(len(rows), bool)
    new[1:] = (rows[1:, 0] != rows[:-1, 0]) | (rows[1:, 2] != rows[:-1, 2])
    first = np.flatnonzero(new)
    count = np.add.reduceat(rows[:, 3], first) if len(rows) else rows[:, 3]
    key, code, group = rows[first, 0], rows[first, 1], rows[first, 2]
    work = BLOCK + count * costs[group]
    cut = recut(*by_block(key, work, count), ranks.size, cut, steps)
    return Census(key, code, group, count, owners(key, cut), work), cut


def sort(
    groups: list[Group], ranks: Alone, cut: np.ndarray | None, steps: int
) -> tuple[Census, np.ndarray, int]:
    """Re-sort all particles and send each to its block's owner. steps: since the last sort. Returns
    the Census, the cuts in force and how many particles left this rank.
    """
    rows, found = [], []
    for g, group in enumerate(groups):
        tags, code, number = _tag(group)
        found.append((tags, code))
        codes, at = np.unique(code[number > 0], return_inverse=True)
        number = np.bincount(at, number[number > 0], len(codes)).astype(np.int64)
        key = group.lattice.key(group.lattice.block(codes))
        rows.append(np.stack([key, codes, np.full_like(key, g), number], 1))
    costs = np.array([group.plan.cost for group in groups])
    table, cut = census(np.concatenate(rows), ranks, costs, cut, steps)
    left = 0
    for g, group in enumerate(groups):
        here = table.group == g
        left += _settle(group, ranks, table.code[here], table.owner[here], *found[g])
    return table, cut, left


def arrive(group: Group, block: np.ndarray, xi: np.ndarray, f: np.ndarray, ids: np.ndarray) -> None:
    """Give a group its first particles on this rank, in any order: block (n, 3), xi (3, n), f
    (channels, n), ids (n,).
    """
    code = group.lattice.code(block)
    order = np.argsort(code, kind="stable")
    group.reserve(len(ids))
    n = len(ids)
    group.xi[:, :n], group.f[:, :n], group.ids[:n] = xi[:, order], f[:, order], ids[order]
    codes, start, count = np.unique(code[order], return_index=True, return_counts=True)
    group.segments(codes, start, count)
    group.used = n


def _tag(group: Group) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where each particle goes: tags (see sorting.tag), and for the 27 blocks around each segment
    their codes and how many go there, (segments, 27)."""
    tags = np.empty(group.f.shape[1], np.int32)
    number = np.zeros((len(group.start), 27), np.int64)
    sorting.tag(group.start, group.count, group.xi, group.bits, tags, number)
    _, ny, nz = group.lattice.shape
    step = np.array([(i * ny + j) * nz + k for i in _NEAR for j in _NEAR for k in _NEAR])
    return tags, group.code[:, None] + step, number


def _settle(group: Group, ranks: Alone, codes, owner, tags, code) -> int:
    """Exchange the particles that changed rank and order the rest; codes: (n,) of this group's
    blocks, in key order; tags, code: from `_tag`. Returns how many left.
    """
    mine = owner == ranks.rank
    by_code = np.argsort(codes)
    rank_of = np.searchsorted(codes[by_code], code)
    rank_of = by_code[np.minimum(rank_of, len(codes) - 1)] if len(codes) else rank_of
    numbered = np.where(mine, np.cumsum(mine) - 1, -1)
    place = numbered[rank_of] if len(codes) else rank_of
    number = np.zeros(sorting.CELLS * int(mine.sum()), np.int64)
    start, count, left = group.start, group.count, 0
    before = tags.copy() if (place < 0).any() else tags
    sorting.aim(start, count, tags, place, number)
    if ranks.size > 1:
        gone, to = np.empty(len(group), np.int64), np.empty(len(group), np.int64)
        left = sorting.leaving(start, count, tags, before, gone, to)
        block = rank_of.ravel()[to[:left]]
        cell = before[gone[:left]] & (sorting.CELLS - 1)
        came = _swap(group, ranks, gone[:left], owner[block], codes[block], cell)
        tags = _receive(group, tags, came, codes[by_code], numbered[by_code], number)
        start, count = np.append(start, group.used), np.append(count, len(came))
    new_start = np.empty(int(mine.sum()), np.int64)
    size = number.reshape(-1, sorting.CELLS).sum(1)
    source = np.empty(int(size.sum()) + LANES * len(size), np.uint32)
    end = sorting.arrange(start, count, tags, group.ids, number, LANES, new_start, source)
    group.permute(new_start, size, source, end)
    group.segments(codes[mine], new_start, size)
    return left


def _receive(group: Group, tags, came, codes, numbered, number) -> np.ndarray:
    """Tags with the targets of the rows (n, 2) of code and cell that came; `number` counts them."""
    tags = np.pad(tags, (0, max(0, group.f.shape[1] - len(tags))))
    to = numbered[np.searchsorted(codes, came[:, 0])] * sorting.CELLS + came[:, 1]
    tags[group.used : group.used + len(came)] = to
    np.add.at(number, to, 1)
    return tags


def _swap(group: Group, ranks: Alone, gone, to, code, cell) -> np.ndarray:
    """Send the particles at `gone` to ranks `to`; what arrives stands behind the others. Returns
    code and cell (n, 2) of what came.
    """
    order = np.argsort(to, kind="stable")
    gone, to = gone[order], to[order]
    where = np.stack([code, cell], 1).astype(np.int64)[order]
    rows = (group.xi[:, gone].T, group.f[:, gone].T, group.ids[gone], where)
    packed = np.concatenate([_as_bytes(part) for part in rows], 1)
    got = ranks.exchange(np.split(packed, np.searchsorted(to, np.arange(1, ranks.size))))
    got = np.concatenate(got)
    n, at = len(got), 0
    group.reserve(group.used + n)
    new = slice(group.used, group.used + n)
    for target, width in ((group.xi, 3), (group.f, group.channels), (group.ids, 1)):
        size = width * target.dtype.itemsize
        values = np.ascontiguousarray(got[:, at : at + size]).view(target.dtype).reshape(n, width)
        target[..., new] = values.T if target.ndim == 2 else values[:, 0]
        at += size
    return np.ascontiguousarray(got[:, at:]).view(np.int64).reshape(n, 2)


def _as_bytes(rows: np.ndarray) -> np.ndarray:
    """Rows (n, ...) as (n, bytes per row)."""
    width = int(np.prod(rows.shape[1:], dtype=np.int64)) * rows.dtype.itemsize
    return np.ascontiguousarray(rows).view(np.uint8).reshape(len(rows), width)
