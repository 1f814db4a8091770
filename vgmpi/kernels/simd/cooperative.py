"""Thread cooperation: work that is divided among the threads of a team.

On the CPU one thread does all of it; on the GPU each thread does a part
(solver/engines/cuda/thread_block.py). A kernel over nodes says `for node in each(64)` where the
work at a node does not depend on the others, and `sync_threads()` where the following code reads
what other threads of the team wrote.
"""

from vgmpi.runtime.jit import always_inline

from .vector16 import pointer


@always_inline
def strided_range(count):
    """Return the numbers below `count` that this thread processes."""
    return range(count)


@always_inline
def sync_threads():
    """Wait for all threads of the team."""


@always_inline
def flat_pointer(array):
    """Return the pointer to an array of any shape (vector16.pointer); GPU arrays are flat."""
    return pointer(array.reshape(array.size))


@always_inline
def atomic_add_int(sums, index, increment):
    """Add a number to sums[index], also if other threads do so at the same time."""
    sums[index] += increment
