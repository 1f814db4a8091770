"""Load balance: the Hilbert curve through the blocks is cut into a piece of work for each rank.

The work of a block is predicted and counted in steps of one fluid particle, in integer multiples of
a fraction of one so that sums over ranks are exact. Cuts are examined only when particles are
sorted. New cuts make the largest piece as small as contiguous pieces allow and migrate as few
particles as possible; they are adopted if they save more over the next few sorts than the migration
costs. The ownership of blocks does not affect any bit of the result.

No rank knows all blocks. Each rank merges its own blocks into few runs, which begin at the useful
places for a cut: at its first block, at the present beginning of its piece, and around the places
of even cuts. All ranks know these runs and cut between them.

The pace of a rank is the processor time of its work over the predicted work, relative to all ranks:
the prediction counts particles and blocks, but not what contact, drag or a slower core cost where
they are. Each rank measures its work between two sorts and scales the predicted work of its blocks
by its pace, so that the cuts follow what was measured.
"""

from collections.abc import Callable

import numpy as np

from vgmpi.runtime.jit import kernel

from .communicator import SerialCommunicator
from .particle_group import ParticleGroup

# The unit of work is a step of one fluid particle.
BLOCK_COST = 35.0  # work of a block's nodes and patch in one phase
MIGRATION_COST = 6.0  # work of sending one particle to another rank and receiving it there
AMORTIZATION_SORTS = (
    16.0  # [sorts] period of use of new cuts: a migration avoided now is mostly needed later
)
SLACK = 1.005  # [-] ratio of the largest piece to the mean that counts as perfect
SHARES = 16  # integer units of work per step of one particle
REPARTITION_COST = 20.0  # work of each rank, per rank of the run, for computing new cuts
CANDIDATES_PER_CUT = 2  # candidate places on each side of an even cut
MIN_SECONDS = 0.02  # [s] largest processor time of a rank below which a measurement says nothing
NEWEST_SHARE = 0.5  # [-] weight of the newest measurement
MAX_PACE = 4.0  # [-] limit of the pace and of its inverse


def owners(keys: np.ndarray, cut: np.ndarray) -> np.ndarray:
    """Return the rank that owns each key, shape (n,) int64."""
    return np.searchsorted(cut, keys, side="right")


def loads(keys: np.ndarray, work: np.ndarray, cut: np.ndarray) -> np.ndarray:
    """Return the work of each rank."""
    return np.bincount(owners(keys, cut), work, minlength=len(cut) + 1)


def predicted_work(count: np.ndarray, cost: np.ndarray, pace: float = 1.0) -> np.ndarray:
    """Return the work of segments in integer units of 1 / SHARES of a step.

    Args:
        count: Particles of each segment, shape (n,).
        cost: Work per particle of each segment [steps], shape (n,).
        pace: Measured over predicted work of their rank (load_balance.RankPace).
    """
    return np.rint(SHARES * pace * (BLOCK_COST + count * cost)).astype(np.int64)


def by_block(
    key: np.ndarray, work: np.ndarray, count: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Merge segments, ascending by key, into blocks; return key, work and particles of each."""
    first = np.flatnonzero(np.diff(key, prepend=-1))
    if not len(key):  # reduceat does not accept empty arrays
        return key, work, count
    return key[first], np.add.reduceat(work, first), np.add.reduceat(count, first)


def candidate_cuts(
    keys: np.ndarray, work: np.ndarray, count: np.ndarray, before: int, total: int, ranks: int
) -> np.ndarray:
    """Merge a rank's blocks into runs that begin at the candidate places for cuts.

    Args:
        keys: Keys of its blocks, ascending, shape (n,).
        work: Work of each block, shape (n,).
        count: Particles of each block, shape (n,).
        before: Work of the ranks below this one.
        total: Work of all ranks.
        ranks: Number of ranks.

    Returns:
        Key, work and particles of each run, shape (runs, 3).
    """
    if len(keys) == 0:
        return np.zeros((0, 3), np.int64)
    ends = before + np.cumsum(work) - work
    first, last = -(-before * ranks // total), (before + int(work.sum())) * ranks // total
    even = np.searchsorted(ends, total * np.arange(first, last + 1) // ranks)
    start = even[:, None] + np.arange(-CANDIDATES_PER_CUT, CANDIDATES_PER_CUT)
    start = np.unique(np.append(0, start[(start >= 0) & (start < len(keys))]))
    return np.stack([keys[start], np.add.reduceat(work, start), np.add.reduceat(count, start)], 1)


def should_rebalance(load: np.ndarray, steps: int) -> bool:
    """Return True if new cuts should be computed.

    Args:
        load: Work of each rank, shape (ranks,).
        steps: Steps since the last sort.
    """
    over = load.max() - load.mean()
    if load.max() <= SLACK * load.mean():
        return False
    return over / SHARES * steps * AMORTIZATION_SORTS > REPARTITION_COST * len(load)


def imbalance(load: np.ndarray) -> float:
    """Return the ratio of the largest load to the mean; 1 without load."""
    return float(load.max() / load.mean()) if load.sum() > 0 else 1.0


def rebalance(
    keys: np.ndarray, work: np.ndarray, count: np.ndarray, ranks: int, cut: np.ndarray | None,
    steps: int,
) -> np.ndarray:  # fmt: skip
    """Return the first key of ranks 1 and up: the present cuts, or new ones if they pay.

    Args:
        keys: Keys of blocks or runs of blocks, ascending, shape (n,).
        work: Work of each, shape (n,).
        count: Particles of each, shape (n,).
        ranks: Number of ranks.
        cut: Present cuts; None at the start.
        steps: Steps since the last sort.
    """
    new = partition(keys, work, ranks, cut)
    if cut is None or ranks == 1 or not len(keys):
        return new
    before, after = owners(keys, cut), owners(keys, new)
    moved = count * (before != after)
    passed = np.bincount(before, moved, ranks) + np.bincount(after, moved, ranks)
    saved = np.bincount(before, work, ranks).max() - np.bincount(after, work, ranks).max()
    return (
        new if saved / SHARES * steps * AMORTIZATION_SORTS > MIGRATION_COST * passed.max() else cut
    )


def partition(keys: np.ndarray, work: np.ndarray, ranks: int, old: np.ndarray | None) -> np.ndarray:
    """Return cuts that minimize the largest piece, each as near to the old one as possible.

    A rank owns the keys from its cut up to the next rank's. A largest piece within SLACK of the
    mean is small enough. With more ranks than keys, some ranks are idle.

    Args:
        keys: Keys, ascending, shape (n,).
        work: Work of each, shape (n,).
        ranks: Number of ranks.
        old: Present cuts; None at the start.

    Returns:
        First key of ranks 1 and up, shape (ranks - 1,) int64, non-decreasing.
    """
    if len(keys) == 0:
        return np.zeros(ranks - 1, np.int64)
    ends = np.concatenate([[0.0], np.cumsum(work, dtype=np.float64)])
    max_work = bottleneck(ends, ranks, SLACK * ends[-1] / ranks)
    earliest = np.empty(ranks + 1, np.int64)
    earliest_cuts(ends, max_work, earliest)
    if old is None:  # spread evenly within the admissible range
        wish = np.searchsorted(ends, ends[-1] * np.arange(1, ranks) / ranks)
    else:
        wish = np.searchsorted(keys, old)
    first_block = np.empty(ranks - 1, np.int64)
    nearest_cuts(ends, max_work, earliest, wish, first_block)
    return np.append(keys, keys[-1] + 1)[first_block]


@kernel
def bottleneck(ends, ranks, good):
    """Return the smallest possible largest piece of `ranks` pieces, up to rounding.

    Args:
        ends: Work before each block, and in total, shape (n + 1,).
        ranks: Number of pieces.
        good: Size below which no smaller one is searched.
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
    return high * (1.0 + 1e-9)  # margin for rounding in `earliest_cuts`


@kernel
def _fits(ends, ranks, max_work):
    """Return True if `ranks` pieces of at most `max_work` hold all blocks."""
    block, n = 0, len(ends) - 1
    for _ in range(ranks):
        end = ends[block] + max_work
        while block < n and ends[block + 1] <= end:
            block += 1
    return block == n


@kernel
def earliest_cuts(ends, max_work, earliest):
    """Compute the earliest first block of each rank so that the ranks from it on hold all the rest.

    Args:
        ends: Work before each block, and in total, shape (n + 1,).
        max_work: Largest admissible work of a piece.
        earliest: First blocks (out), shape (ranks + 1,).
    """
    n, ranks = len(ends) - 1, len(earliest) - 1
    earliest[ranks] = n
    for r in range(ranks - 1, -1, -1):
        earliest[r] = np.searchsorted(ends, ends[earliest[r + 1]] - max_work, side="left")


@kernel
def nearest_cuts(ends, max_work, earliest, wish, first_block):
    """Choose the cuts nearest to `wish` that keep every piece within `max_work`.

    Args:
        ends: Work before each block, and in total, shape (n + 1,).
        max_work: Largest admissible work of a piece.
        earliest: Earliest first block of each rank, shape (ranks + 1,).
        wish: Desired first blocks of ranks 1 and up, shape (ranks - 1,).
        first_block: Chosen first blocks (out), shape (ranks - 1,).
    """
    before = 0
    for r in range(len(first_block)):
        latest = np.searchsorted(ends, ends[before] + max_work, side="right") - 1
        before = min(max(wish[r], earliest[r + 1], before), latest)
        first_block[r] = before


class RankPace:
    """Pace of this rank.

    Attributes:
        busy: Returns the processor time of the rank's work so far [s]; None where it is not
            measured. It must be None on all ranks or on none.
        value: Measured over predicted work, relative to all ranks.
    """

    def __init__(self, ranks: SerialCommunicator):
        """Begin with the predicted work."""
        self.ranks = ranks
        self.busy: Callable[[], float] | None = None
        self.value = 1.0
        self._seconds = 0.0  # `busy` at the last sort

    def measure_work(self, groups: list[ParticleGroup], steps: int) -> float:
        """Measure the work since the last sort, and return the pace. Collective.

        Args:
            groups: Particle groups of this rank, as they were during these steps.
            steps: Steps since the last sort.
        """
        if self.busy is None or self.ranks.size == 1:
            return self.value
        now = self.busy()
        work = steps * sum(
            float(predicted_work(group.count, np.array(group.plan.cost)).sum()) for group in groups
        )
        rows = self.ranks.each(np.array([now - self._seconds, work]))
        self._seconds = now
        seconds, all_work = rows.sum(0)
        if rows[:, 0].max() < MIN_SECONDS or all_work == 0.0:
            return self.value
        newest = 1.0
        if work > 0.0:
            own = rows[self.ranks.rank]
            newest = min(max(own[0] * all_work / (own[1] * seconds), 1.0 / MAX_PACE), MAX_PACE)
        self.value += NEWEST_SHARE * (newest - self.value)
        return self.value
