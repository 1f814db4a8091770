"""`python -m vgmpi ...`, sorted every few steps, at each of which the curve is cut elsewhere.

mpirun -n N python -m tests.parallel.rebalance_job SCENE [FLAGS]

Says at the end how often each rank sorted and how many particles it sent away.
"""

import sys

import numpy as np

from vgmpi.commands import cli
from vgmpi.kernels.transfer import g2p
from vgmpi.parallel import load_balance, migration

REACH = 2.05  # cells from a block's middle, where its particles begin to lie in others at 2
SEEN = {"rank": 0, "sorts": 0, "sent": 0}


def to_and_fro(keys, work, count, ranks, cut, steps):
    """In place of load_balance.rebalance: the first ranks hold little, then much, then little."""
    power = 2.0 if SEEN["sorts"] % 2 else 0.5
    share = (np.arange(1, ranks) / ranks) ** power
    return keys[0] + ((keys[-1] - keys[0]) * share).astype(np.int64)


def watched(groups, ranks, *arguments):
    """migration.sort_particles, counted."""
    found = SORT(groups, ranks, *arguments)
    SEEN["rank"] = ranks.rank
    SEEN["sorts"] += 1
    SEEN["sent"] += found[2]
    return found


SORT = migration.sort_particles

if __name__ == "__main__":
    g2p.MAX_STRAY_CELLS = REACH
    load_balance.rebalance, load_balance.should_rebalance = to_and_fro, lambda load, steps: True
    migration.sort_particles = watched
    code = cli.main(sys.argv[1:])
    print("rank {rank} sorted {sorts} times and sent {sent} particles".format(**SEEN), flush=True)
    sys.exit(code)
