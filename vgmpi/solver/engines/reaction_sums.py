"""Reaction sums of the compiled engine: impulses of colliders and walls on bodies.

Keeps the sums of each thread, the nodes that this rank counts, and the masses beyond walls.
"""

import numpy as np

from vgmpi.kernels import reaction_impulses
from vgmpi.kernels.grid.contact_impulses import ContactWorkspace
from vgmpi.parallel.exchange_topology import ExchangeTopology, counting_owner
from vgmpi.planning.plan import Plan


class ReactionAccumulators:
    """Reaction sums of each thread, rows of `NUMBERS`; see `EngineServices.enable_reactions`."""

    def __init__(self, plan: Plan, rows: int, quanta: np.ndarray, rank: int, threads: int):
        self.plan, self.rank = plan, rank
        n = len(plan.phases)
        self.by_thread = [
            reaction_impulses.reaction_sums(rows, quanta, n, plan.dx) for _ in range(threads)
        ]

    def set_topology(self, tables: ExchangeTopology) -> None:
        """Select the nodes that this rank counts."""
        counts = counting_owner(tables, self.rank)
        self.by_thread = [accumulator._replace(counts=counts) for accumulator in self.by_thread]

    def attach_to_workspaces(self, workspaces: list[ContactWorkspace]) -> list[ContactWorkspace]:
        """Return the contact workspaces of the threads, each with the thread's reaction sums."""
        pairs = zip(workspaces, self.by_thread, strict=True)
        return [workspace._replace(reactions=accumulator) for workspace, accumulator in pairs]

    def ghosts(self, block: np.ndarray, mirror: np.ndarray) -> reaction_impulses.GhostNodes:
        """Allocate storage for the masses beyond walls of a group's segments.

        Args:
            block: Block coordinates of the segments, shape (n, 3).
            mirror: Wall codes of kernels/wall_boundary.py, shape (n, 3, 2).
        """
        meets_wall = mirror.any((1, 2))
        slot = np.where(meets_wall, np.cumsum(meets_wall) - 1, -1)
        mass = np.zeros((int(meets_wall.sum()), reaction_impulses.WALLS, reaction_impulses.PLANE))
        low = np.ascontiguousarray(4 * block - 2)
        return reaction_impulses.GhostNodes(self.by_thread[0], slot, low, mass, 1.0, 0.0, 1)

    def ghosts_of_transfer(
        self, ghosts: reaction_impulses.GhostNodes, thread: int, layer: str, dt: float
    ) -> reaction_impulses.GhostNodes | None:
        """Return the ghost-node record for one thread's transfer of a nodal field.

        Args:
            ghosts: Record of the group's segments, from `ghosts`.
            thread: Index of the thread.
            layer: Name of the nodal field.
            dt: Length of the step [s], 0 for a step of no time.

        Returns:
            Record for the thread, or None where the field has no reactions.
        """
        accumulator = self.by_thread[thread]
        if layer == "impulses":
            return ghosts._replace(reactions=accumulator, holds_mass=0)
        if layer != "momentum":
            return None
        if not dt:  # the change by the mirror is restored
            return ghosts._replace(
                reactions=accumulator, share=-float(self.plan.correction_interval)
            )
        retained = self.plan.retained_share(dt)
        return ghosts._replace(reactions=accumulator, share=1.0 - retained, change_share=retained)

    def take(self) -> np.ndarray:
        """Return the sums of all threads, shape (rows, 7) int64, and reset them to zero."""
        total = np.sum([accumulator.sums for accumulator in self.by_thread], 0)
        for accumulator in self.by_thread:
            accumulator.sums[:] = 0
        return total
