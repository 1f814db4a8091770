"""Pace of a rank: the processor time of its work over the predicted work, relative to all ranks.

The predicted work counts particles and blocks, but not what contact, drag or a slower core cost
where they are. Each rank measures its work between two sorts and scales the predicted work of its
blocks by its pace, so that the cuts follow what was measured. No bit depends on the cuts.
"""

from collections.abc import Callable

import numpy as np

from . import load_balance
from .communicator import SerialCommunicator
from .particle_group import ParticleGroup

MIN_SECONDS = 0.02  # [s] largest processor time of a rank below which a measurement says nothing
NEWEST_SHARE = 0.5  # [-] weight of the newest measurement
MAX_PACE = 4.0  # [-] limit of the pace and of its inverse


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
            float(load_balance.predicted_work(group.count, np.array(group.plan.cost)).sum())
            for group in groups
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
