"""What each thread of a rank does, and where threads that meet at a node add."""

import numpy as np

from ..domain.topology import Topology


class Shares:
    """Rows per thread: all, those at the border to other ranks, and the others."""

    def __init__(self, weights: np.ndarray, border: np.ndarray, threads: int):
        row = np.arange(len(weights))
        self.all = _shares(row, weights, threads)
        self.border = _shares(row[border], weights[border], threads)
        self.inner = _shares(row[~border], weights[~border], threads)

    def of(self, border: bool) -> list[np.ndarray]:
        return self.border if border else self.inner


def _shares(rows: np.ndarray, weights: np.ndarray, threads: int) -> list[np.ndarray]:
    """Consecutive rows of about equal weight, one array per thread."""
    ends = np.cumsum(weights)
    total = ends[-1] if len(ends) else 0
    cut = np.searchsorted(ends, total * np.arange(1, threads) / threads)
    return np.split(rows, cut)


def copies(
    tables: Topology, rows: list[np.ndarray], shares: list[Shares], threads: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows of sums of their own for threads that add to one node block at the same time.

    rows: of each group, its segments in the tables. Returns where each segment adds, (segments,
    27); and of each node block where its copies begin, (node blocks + 1,), in the list of all,
    whose rows follow the node blocks'. The first thread needs none.
    """
    count = len(tables.phase)
    into, first = tables.table.copy(), np.zeros(count + 1, np.int64)
    if threads == 1 or not count:
        return into, first, np.zeros(0, np.int64)
    used = np.zeros((2, threads, count), bool)  # while the border, or the others, are transferred
    done = []
    for here, share in zip(rows, shares, strict=True):
        for stage, split in enumerate((share.border, share.inner)):
            for k, mine in enumerate(split):
                used[stage, k][tables.table[here[mine]].ravel()] = True
                done.append((stage, k, here[mine]))
    many = used.sum(1) > 1  # (2, node blocks)
    needs = (used & many[:, None]).any(0)  # (threads, node blocks)
    needs[0] = False
    first[1:] = np.cumsum(needs.sum(0))
    block, thread = np.nonzero(needs.T)
    row = np.full((threads, count), -1)
    row[thread, block] = count + np.arange(len(block))
    for stage, k, mine in done:
        if k > 0:
            here = tables.table[mine]
            into[mine] = np.where(many[stage][here], row[k][here], here)
    return into, first, count + np.arange(len(block))
