"""What the compiled engine keeps to tell what colliders and walls give: sums of each thread, which
nodes this rank counts, and the masses beyond walls."""

import numpy as np

from ..domain.topology import Topology, counted
from ..kernels import given, touch
from ..planning.plan import Plan


class Givers:
    """Sums of what is rigid gives, rows of kernels.given.NUMBERS. See engines/base.py (`feel`)."""

    def __init__(self, plan: Plan, rows: int, quanta: np.ndarray, rank: int, threads: int):
        self.plan, self.rank = plan, rank
        n = len(plan.phases)
        self.of_thread = [given.given(rows, quanta, n, plan.dx) for _ in range(threads)]

    def adopt(self, tables: Topology) -> None:
        """Choose the nodes that this rank counts."""
        counts = counted(tables, self.rank)
        self.of_thread = [one._replace(counts=counts) for one in self.of_thread]

    def rooms(self, rooms: list[touch.Room]) -> list[touch.Room]:
        """The threads' scratch for contact, with their sums."""
        both = zip(rooms, self.of_thread, strict=True)
        return [room._replace(given=own) for room, own in both]

    def ghosts(self, block: np.ndarray, mirror: np.ndarray) -> given.Ghosts:
        """Room for the masses beyond walls of a group's segments. block: (n, 3); mirror: (n, 3, 2)
        codes of walls.py."""
        met = mirror.any((1, 2))
        slot = np.where(met, np.cumsum(met) - 1, -1)
        mass = np.zeros((int(met.sum()), given.WALLS, given.PLANE))
        low = np.ascontiguousarray(4 * block - 2)
        return given.Ghosts(self.of_thread[0], slot, low, mass, 1.0, 0.0, 1)

    def of(self, ghosts: given.Ghosts, thread: int, layer: str, dt: float) -> given.Ghosts | None:
        """The same for a thread's transfer of a layer in a step of dt [s], or of no time."""
        keeps, own = self.plan.keeps, self.of_thread[thread]
        if layer == "impulses":
            return ghosts._replace(given=own, weighs=0)
        if layer != "momentum":
            return None
        if not dt:  # what the mirror changes is given back
            return ghosts._replace(given=own, share=-float(self.plan.restores))
        kept = 0.0 if keeps is None else keeps.over(dt)
        return ghosts._replace(given=own, share=1.0 - kept, kept=kept)

    def taken(self) -> np.ndarray:
        """The sums of all threads, which begin anew: (rows, 7) int64."""
        total = np.sum([one.sums for one in self.of_thread], 0)
        for one in self.of_thread:
            one.sums[:] = 0
        return total
