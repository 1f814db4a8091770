"""Cooperating threads on the GPU, the counterpart of kernels/simd/cooperative.py.

A team is TEAM threads: 16 threads, half of a warp, that represent a SIMD vector, or a whole block.
It synchronizes only its own threads.
"""

from numba import cuda

from .translation_types import SIMULATED

# Constants that the kernel translator replaces (translation.py).
TEAM = TEAMS = 16
REAL = None
# Half warps of a block. The simulator only has barriers for whole blocks.
HALVES = [1 if SIMULATED else 2]


def number():
    """Return the index of the team of this thread."""
    return cuda.blockIdx.x * TEAMS + cuda.threadIdx.x // TEAM


def rank():
    """Return the index of this thread in its team."""
    return cuda.threadIdx.x % TEAM


def each(count):
    """Return the numbers below `count` that this thread processes."""
    return range(cuda.threadIdx.x % TEAM, count, TEAM)


def count_up(sums, index, increment):
    """Add a number to sums[index] atomically."""
    cuda.atomic.add(sums, index, increment)


def _whole_block():
    """Wait for the other threads of the team."""
    cuda.syncthreads()


def _half_a_warp():
    """Wait for the other threads of the team, not for the other half of the warp."""
    if TEAM == 16:
        cuda.syncwarp(0xFFFF << (cuda.threadIdx.x & 16))
    else:
        cuda.syncthreads()


# The simulator has no warps: its team is a block.
meet = _whole_block if SIMULATED else _half_a_warp
