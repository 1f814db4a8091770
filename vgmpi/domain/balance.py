"""Who owns what: the Hilbert curve through the blocks, cut into one piece per rank by predicted
work.

Work is counted in steps of one fluid particle, in whole shares of one so that sums over ranks are
exact. Cuts are looked at when particles are sorted anyway: new ones make the largest piece as small
as contiguous pieces allow, move as little as possible, and are taken when what they save over the
next few sorts is more than the moving costs. Who owns a block decides no bit of the result.

No rank knows all blocks. Each merges its own into few runs, which begin where a cut would be worth
having: at its first block, where its piece begins now, and around the places of even cuts. All know
these runs, and cut between them.
"""

import numpy as np

from ..device.jit import kernel

BLOCK = 35.0  # work of a block's nodes and patch in one phase
MOVED = 6.0  # work of sending one particle to another rank and taking it in
LASTS = 16.0  # sorts that new cuts are worth having: not to move now mostly means to move later
SLACK = 1.005  # largest piece over the mean that is as good as perfect
SHARES = 16  # whole numbers of work are in this part of a step of one particle
LOOK = 20.0  # work, per rank there is, that looking for new cuts costs each rank
BESIDE = 2  # places where one may cut, on each side of an even cut


def owners(keys: np.ndarray, cut: np.ndarray) -> np.ndarray:
    """Rank that owns each key: (n,) int64."""
    return np.searchsorted(cut, keys, side="right")


def loads(keys: np.ndarray, work: np.ndarray, cut: np.ndarray) -> np.ndarray:
    """Work of each rank."""
    return np.bincount(owners(keys, cut), work, minlength=len(cut) + 1)


def predicted(count: np.ndarray, cost: np.ndarray) -> np.ndarray:
    """Work of segments of `count` particles, `cost` each: whole numbers of SHARES of a step."""
    return np.rint(SHARES * (BLOCK + count * cost)).astype(np.int64)


def by_block(
    key: np.ndarray, work: np.ndarray, count: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Segments, ascending by key, to blocks: keys, work and particles of each."""
    first = np.flatnonzero(np.diff(key, prepend=-1))
    if not len(key):  # reduceat takes no empty rows
        return key, work, count
    return key[first], np.add.reduceat(work, first), np.add.reduceat(count, first)


def offers(
    keys: np.ndarray, work: np.ndarray, count: np.ndarray, before: int, total: int, ranks: int
) -> np.ndarray:
    """A rank's blocks merged into runs that begin where one may cut: (runs, 3) of key, work, count.

    keys, work, count: (n,) of its blocks, ascending; before, total: work of the ranks below it and
    of all.
    """
    if len(keys) == 0:
        return np.zeros((0, 3), np.int64)
    ends = before + np.cumsum(work) - work
    first, last = -(-before * ranks // total), (before + int(work.sum())) * ranks // total
    even = np.searchsorted(ends, total * np.arange(first, last + 1) // ranks)
    at = even[:, None] + np.arange(-BESIDE, BESIDE)
    at = np.unique(np.append(0, at[(at >= 0) & (at < len(keys))]))
    return np.stack([keys[at], np.add.reduceat(work, at), np.add.reduceat(count, at)], 1)


def worth(load: np.ndarray, steps: int) -> bool:
    """Whether to look for new cuts at all. load: (ranks,) work; steps: since the last sort."""
    over = load.max() - load.mean()
    if load.max() <= SLACK * load.mean():
        return False
    return over / SHARES * steps * LASTS > LOOK * len(load)


def imbalance(load: np.ndarray) -> float:
    """Largest over mean; 1 where there is nothing."""
    return float(load.max() / load.mean()) if load.sum() > 0 else 1.0


def recut(
    keys: np.ndarray, work: np.ndarray, count: np.ndarray, ranks: int, cut: np.ndarray | None,
    steps: int,
) -> np.ndarray:  # fmt: skip
    """First key of ranks 1.. from now on: the cuts in force, or new ones where they pay.

    keys: (n,) of blocks or runs of them, ascending; work, count: (n,) each one's work and
    particles; cut: None at the start; steps: taken since the last sort.
    """
    new = cuts(keys, work, ranks, cut)
    if cut is None or ranks == 1 or not len(keys):
        return new
    before, after = owners(keys, cut), owners(keys, new)
    moved = count * (before != after)
    passed = np.bincount(before, moved, ranks) + np.bincount(after, moved, ranks)
    saved = np.bincount(before, work, ranks).max() - np.bincount(after, work, ranks).max()
    return new if saved / SHARES * steps * LASTS > MOVED * passed.max() else cut


def cuts(keys: np.ndarray, work: np.ndarray, ranks: int, old: np.ndarray | None) -> np.ndarray:
    """First key of ranks 1.., (ranks - 1,) int64, non-decreasing, so that the largest piece is as
    small as it can be (or within SLACK of the mean), and each cut as near to the old one as that
    allows.

    keys: (n,) ascending; a rank owns the keys from its cut up to the next rank's. More ranks than
    keys leave some idle.
    """
    if len(keys) == 0:
        return np.zeros(ranks - 1, np.int64)
    ends = np.concatenate([[0.0], np.cumsum(work, dtype=np.float64)])
    most = bottleneck(ends, ranks, SLACK * ends[-1] / ranks)
    earliest = np.empty(ranks + 1, np.int64)
    backward(ends, most, earliest)
    if old is None:  # spread evenly within what is allowed
        wish = np.searchsorted(ends, ends[-1] * np.arange(1, ranks) / ranks)
    else:
        wish = np.searchsorted(keys, old)
    at = np.empty(ranks - 1, np.int64)
    forward(ends, most, earliest, wish, at)
    return np.append(keys, keys[-1] + 1)[at]


@kernel
def bottleneck(ends, ranks, good):
    """Smallest largest piece, to rounding, of `ranks` pieces; not sought below `good`.

    ends: (n + 1,) sums of the work before each block.
    """
    low, high = good, good
    while not _fits(ends, ranks, high):
        low, high = high, 2.0 * high
    while high - low > 1e-6 * high:
        middle = 0.5 * (low + high)
        if _fits(ends, ranks, middle):
            high = middle
        else:
            low = middle
    return high * (1.0 + 1e-9)  # room for rounding on the way back


@kernel
def _fits(ends, ranks, most):
    """Whether `ranks` pieces of at most `most` hold all."""
    at, n = 0, len(ends) - 1
    for _ in range(ranks):
        end = ends[at] + most
        while at < n and ends[at + 1] <= end:
            at += 1
    return at == n


@kernel
def backward(ends, most, earliest):
    """earliest[r]: first place where rank r may begin so that the ranks from r on hold the rest."""
    n, ranks = len(ends) - 1, len(earliest) - 1
    earliest[ranks] = n
    for r in range(ranks - 1, -1, -1):
        earliest[r] = np.searchsorted(ends, ends[earliest[r + 1]] - most, side="left")


@kernel
def forward(ends, most, earliest, wish, at):
    """Cuts nearest to `wish` among those that keep every piece within `most`."""
    before = 0
    for r in range(len(at)):
        latest = np.searchsorted(ends, ends[before] + most, side="right") - 1
        before = min(max(wish[r], earliest[r + 1], before), latest)
        at[r] = before
