"""`python -m vgmpi ...` with a fault built in.

mpirun -n N python -m tests.parallel.broken_job FAULT SCENE [FLAGS]
"""

import os
import sys
import time

import numpy as np

from vgmpi.commands import cli
from vgmpi.parallel.block_lattice import BLOCK_CENTER
from vgmpi.runtime.command_line import exit_code_from_exceptions
from vgmpi.solver.simulation import Simulation

STEP = 5


def raise_on_rank_1():
    """An exception on one rank."""
    real = Simulation.advance

    def advance(self, *arguments):
        if self.ranks.rank == 1 and self.step == STEP:
            raise ValueError("a fault on purpose")
        return real(self, *arguments)

    Simulation.advance = advance


def step_too_large():
    """From step 80 on, twenty times what is stable."""
    real = Simulation.bound
    Simulation.bound = lambda self: real(self) * (20.0 if self.step >= 80 else 1.0)


def leave_the_domain():
    """Particle 7, next to the west wall, is put beyond it."""
    real = Simulation.advance

    def advance(self, *arguments):
        for group in self.groups:
            at = group.index()
            here = at[group.ids[at] == 7]
            if self.step == STEP and len(here):
                block = np.repeat(group.block, group.count, axis=0)[group.ids[at] == 7]
                assert block[0, 0] == 0
                group.xi[0, here] = int(
                    (-0.7 - BLOCK_CENTER) * 2.0**group.bits
                )  # 0.7 cells outside
        return real(self, *arguments)

    Simulation.advance = advance


def linger():
    """A job of SLURM that takes a second for each step after the first checkpoint, unless it
    was queued again: time for what happens to it.
    """
    real = Simulation.advance

    def advance(self, *arguments):
        if self.step >= 40 and os.environ.get("SLURM_RESTART_COUNT", "0") == "0":
            time.sleep(1)
        return real(self, *arguments)

    Simulation.advance = advance


if __name__ == "__main__":
    globals()[sys.argv[1]]()
    sys.exit(exit_code_from_exceptions(cli.main)(sys.argv[2:]))
