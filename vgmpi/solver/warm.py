"""Compile every kernel a plan needs on rank 0 first; the other ranks then find them in numba's
cache.
"""

import numpy as np

from ..domain import halo
from ..domain.ranks import Alone
from ..plan import Plan
from .step import Simulation
from .watch import ledger


def warm(plan: Plan, ranks: Alone) -> None:
    """Run a particle per object through one step, a sort and the ledger. Collective."""
    if ranks.rank == 0:
        middle = 0.5 * np.array(plan.cells) * plan.dx
        things = np.array([k for k, g in enumerate(plan.group_of) if g >= 0 and plan.count[k]])
        alone = Simulation(plan, Alone())
        n = len(things)
        ids = np.array(plan.first_id)[things]
        alone.put(np.tile(middle, (n, 1)), np.zeros((n, 3)), np.full(n, plan.dx**3), ids, things)
        alone.advance(1e-6 * alone.bound())
        ledger(alone)
        none = np.zeros(0, np.int64)
        corner = np.zeros((0, 3), np.int64)
        for copy in (halo.pack, halo.unpack):
            copy(np.zeros(0, plan.real), none, corner, corner, alone.engine.flat_patches)
    ranks.barrier()
