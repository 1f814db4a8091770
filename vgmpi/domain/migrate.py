"""Sorting: every particle to the block it lies in, every block to the rank that owns it, one order
whatever the ranks.
"""

from typing import NamedTuple

import numpy as np

from . import sorting
from .balance import BLOCK, owners, recut
from .ranks import Alone
from .state import LANES, Group


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
    blocks, at = np.unique(key, return_inverse=True)
    work = BLOCK + count * costs[group]
    total = np.bincount(at, work, minlength=len(blocks))
    held = np.bincount(at, count, minlength=len(blocks))
    cut = recut(blocks, total, held, ranks.size, cut, steps)
    return Census(key, code, group, count, owners(key, cut), work), cut


def sort(
    groups: list[Group], ranks: Alone, cut: np.ndarray | None, steps: int
) -> tuple[Census, np.ndarray, int]:
    """Re-sort all particles and send each to its block's owner. steps: since the last sort. Returns
    the Census, the cuts in force and how many particles left this rank.
    """
    rows, found = [], []
    for g, group in enumerate(groups):
        code, cell = _rebin(group)
        codes, number = _count(group, code)
        found.append((code, cell, codes))
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


def _rebin(group: Group):
    code = np.empty(group.f.shape[1], np.int64)
    cell = np.empty(group.f.shape[1], np.int64)
    sorting.rebin(
        group.start, group.count, group.block, group.xi, group.bits, group.lattice.shape, code, cell
    )
    return code, cell


def _count(group: Group, code: np.ndarray):
    """Block codes present on this rank, ascending, and their particles."""
    seen = np.empty(len(group) + 1, np.int64)
    n = sorting.distinct(group.start, group.count, code, seen)
    codes = np.unique(seen[:n])
    place = np.empty(len(code), np.int64)
    sorting.locate(group.start, group.count, code, codes, np.arange(len(codes)), place)
    return codes, np.bincount(place[group.index()], minlength=len(codes))


def _settle(group: Group, ranks: Alone, codes, owner, code, cell, known) -> int:
    """Exchange the particles that changed rank and order the rest; codes: (n,) of this group's
    blocks, in key order. Returns how many left.
    """
    gone: np.ndarray | list = []
    mine = np.where(owner == ranks.rank, np.cumsum(owner == ranks.rank) - 1, -1)
    by_code = np.argsort(codes)
    place = np.empty(len(code), np.int64)
    sorting.locate(group.start, group.count, code, codes[by_code], mine[by_code], place)
    start, count = group.start, group.count
    if ranks.size > 1:
        gone = np.empty(len(group), np.int64)
        gone = gone[: sorting.leaving(start, count, place, gone)]
        to = owner[by_code][np.searchsorted(codes[by_code], code[gone])]
        code, cell, came = _swap(group, ranks, gone, to, code, cell)
        start, count = np.append(start, group.used), np.append(count, came)
        place = np.pad(place, (0, len(code) - len(place)))
        sorting.locate(start[-1:], count[-1:], code, codes[by_code], mine[by_code], place)
    blocks = codes[owner == ranks.rank]
    number = np.zeros((len(blocks), 64), np.int64)
    sorting.tally(start, count, place, cell, number)
    size = number.sum(1)
    new_start = np.empty(len(blocks), np.int64)
    source = np.empty(int(size.sum()) + LANES * len(blocks), np.int64)
    end = sorting.arrange(start, count, place, cell, group.ids, number, LANES, new_start, source)
    group.permute(new_start, size, source, end)
    group.segments(blocks, new_start, size)
    return len(gone)


def _swap(group: Group, ranks: Alone, gone, to, code, cell):
    """Send the particles at `gone` to ranks `to`; append what arrives. Returns code, cell and how
    many came.
    """
    order = np.argsort(to, kind="stable")
    gone, to = gone[order], to[order]
    rows = (group.xi[:, gone].T, group.f[:, gone].T, group.ids[gone], code[gone], cell[gone])
    packed = np.concatenate([_as_bytes(part) for part in rows], 1)
    got = ranks.exchange(np.split(packed, np.searchsorted(to, np.arange(1, ranks.size))))
    got = np.concatenate(got)
    n, at = len(got), 0
    group.reserve(group.used + n)
    more = group.f.shape[1] - len(code)
    code, cell = np.pad(code, (0, more)), np.pad(cell, (0, more))
    new = slice(group.used, group.used + n)
    for target, width in (
        (group.xi, 3),
        (group.f, group.channels),
        (group.ids, 1),
        (code, 1),
        (cell, 1),
    ):
        size = width * target.dtype.itemsize
        values = np.ascontiguousarray(got[:, at : at + size]).view(target.dtype).reshape(n, width)
        target[..., new] = values.T if target.ndim == 2 else values[:, 0]
        at += size
    return code, cell, n


def _as_bytes(rows: np.ndarray) -> np.ndarray:
    """Rows (n, ...) as (n, bytes per row)."""
    width = int(np.prod(rows.shape[1:], dtype=np.int64)) * rows.dtype.itemsize
    return np.ascontiguousarray(rows).view(np.uint8).reshape(len(rows), width)
