"""Threads that share work: what lanes/team.py says, on a card.

A team is TEAM threads: 16, half of a warp, that stand for a vector of the processor's, or a whole
block. It waits for itself alone.
"""

from numba import cuda

from .words import SIMULATED

# what a program of the card knows as constants (program.py)
TEAM = TEAMS = 16
REAL = None
# half warps of a block. The simulator has barriers for whole blocks alone
HALVES = [1 if SIMULATED else 2]


def number():
    """Which team this thread is of."""
    return cuda.blockIdx.x * TEAMS + cuda.threadIdx.x // TEAM


def rank():
    """Which thread of its team this is."""
    return cuda.threadIdx.x % TEAM


def each(count):
    """The numbers below `count` that this thread does."""
    return range(cuda.threadIdx.x % TEAM, count, TEAM)


def count_up(sums, at, whole):
    """sums[at] += whole, whoever else does so."""
    cuda.atomic.add(sums, at, whole)


def _whole_block():
    """Wait for the others of the team."""
    cuda.syncthreads()


def _half_a_warp():
    """Wait for the others of the team, not for the other half of the warp."""
    if TEAM == 16:
        cuda.syncwarp(0xFFFF << (cuda.threadIdx.x & 16))
    else:
        cuda.syncthreads()


# the simulator knows no warps: there a team is a block
meet = _whole_block if SIMULATED else _half_a_warp
