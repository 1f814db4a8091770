"""numba's CUDA simulator with the threads of a block in turns, from barrier to barrier, in a chosen
order: what two threads do to one number between two barriers then shows in every run, or in one of
some orders; and barriers that not all threads come to are found.

Importing this switches the simulator on; it must be imported before numba.
"""

import os
import sys
from types import CodeType, SimpleNamespace

os.environ["NUMBA_ENABLE_CUDASIM"] = "1"

import numpy as np  # noqa: E402
from greenlet import greenlet  # noqa: E402
from numba.cuda.simulator import kernel, kernelapi  # noqa: E402

SEED: list[int | None] = [None]  # of the order of the threads; None: as they are numbered
DEPTH = 8  # calls by which a barrier is told from others
TEAM = [1024]  # threads that a barrier holds: 16 for half warps, of which a block may have several


class Divergence(AssertionError):
    """Threads of a block wait at different barriers."""


class _Thread:
    """A thread of a card: what the simulator asks of one."""

    def __init__(self, work, grid_point, block_point, block_dim):
        self.blockIdx, self.threadIdx = kernel.Dim3(*grid_point), kernel.Dim3(*block_point)
        x, y, z = block_point
        self.thread_id = x + block_dim[0] * (y + block_dim[1] * z)
        self.stack: list[tuple[CodeType, int]] = []
        self.line = greenlet(work)

    def syncthreads(self):
        frame, at = sys._getframe(2), []
        while frame is not None and len(at) < DEPTH:
            at.append((frame.f_code, frame.f_lasti))
            frame = frame.f_back
        self.stack = at
        self.line.parent.switch()

    def lines(self) -> str:
        """Functions and lines at which it waits, from the innermost; slow."""
        found = []
        for code, last in self.stack:
            (line,) = (line for start, end, line in code.co_lines() if start <= last < end)
            found.append(f"{code.co_name}:{line}")
        return " < ".join(found)


_now: list[_Thread | None] = [None]


class _Block(kernel.BlockManager):
    def run(self, grid_point, *args):
        threads = []
        for block_point in np.ndindex(*self._block_dim):
            threads.append(
                _Thread(lambda: self._f(*args), grid_point, block_point, self._block_dim)
            )
        if SEED[0] is not None:
            np.random.default_rng([SEED[0], *grid_point]).shuffle(threads)
        teams: dict[int, list[_Thread]] = {}
        for one in threads:
            teams.setdefault(one.thread_id // TEAM[0], []).append(one)
        while teams:
            teams = {k: left for k, team in teams.items() if (left := _to_the_next_barrier(team))}


def _to_the_next_barrier(team):
    """Run the threads of a team that have not ended; returns those that wait."""
    for one in team:
        _now[0] = one
        one.line.switch()
    live = [one for one in team if not one.line.dead]
    ended = len(team) - len(live)
    if live and (ended or any(one.stack != live[0].stack for one in live)):
        places = sorted({one.lines() for one in live})
        raise Divergence(f"threads wait at {places}, {ended} have ended")
    return live


def _shared(self, shape, dtype, alignment=None):
    """As the simulator's own, which reads the text of all callers to know the line it is on."""
    caller = sys._getframe(1)
    key = caller.f_code.co_filename, caller.f_lineno
    if key not in self._allocations:
        self._allocations[key] = np.empty(shape, dtype)
    return self._allocations[key]


def _plain(array):
    """As numpy's own: the simulator wraps each access to what a kernel is called with."""
    return array._ary


kernel.BlockManager, kernelapi.FakeCUDAShared.array = _Block, _shared
kernel.FakeWithinKernelCUDAArray = _plain
kernelapi.threading = SimpleNamespace(current_thread=lambda: _now[0])
