"""numba's CUDA simulator with one thread at work at a time, in a chosen order: what two threads do
to one number between two barriers then shows in every run, or in one of some orders.

Importing this switches the simulator on; it must be imported before numba.
"""

import os
import sys
import threading

os.environ["NUMBA_ENABLE_CUDASIM"] = "1"

import numpy as np  # noqa: E402
from numba.cuda.simulator import kernel, kernelapi  # noqa: E402

SEED: list[int | None] = [None]  # of the order of the threads; None: as they are numbered


class Divergence(AssertionError):
    """Threads of a block wait at different barriers."""


class _Thread(kernel.BlockThread):
    """A thread that runs when it is told to, until it waits or ends."""

    def __init__(self, *arguments):
        super().__init__(*arguments)
        self.go, self.stopped = threading.Semaphore(0), threading.Semaphore(0)
        self.ended, self.at = False, ()

    def run(self):
        self.go.acquire()
        super().run()
        self.ended = True
        self.stopped.release()

    def syncthreads(self):
        frame, self.at = sys._getframe(2), []
        while frame is not None and frame.f_code.co_name != "target" and len(self.at) < 12:
            self.at.append((frame.f_code.co_name, frame.f_lineno))
            frame = frame.f_back
        self.at = tuple(self.at)
        self.stopped.release()
        self.go.acquire()
        if self.abort:
            raise RuntimeError("another thread failed")

    def step(self):
        """Run to the next barrier."""
        self.go.release()
        self.stopped.acquire()


class _Block(kernel.BlockManager):
    def run(self, grid_point, *args):
        threads = []
        for block_point in np.ndindex(*self._block_dim):
            one = _Thread(lambda: self._f(*args), self, grid_point, block_point, self._debug)
            one.start()
            threads.append(one)
        live = list(threads)
        if SEED[0] is not None:
            np.random.default_rng([SEED[0], *grid_point]).shuffle(live)
        while live:
            for one in live:
                one.step()
                if one.exception:
                    _abort(threads)
                    raise one.exception[0].with_traceback(one.exception[1])
            ended = [one for one in live if one.ended]
            live = [one for one in live if not one.ended]
            places = {one.at for one in live}
            if len(places) > 1 or (live and ended):
                _abort(threads)
                raise Divergence(f"threads wait at {sorted(places)}, {len(ended)} have ended")


def _abort(threads) -> None:
    for one in threads:
        one.abort = True
        if not one.ended:
            one.go.release()


_lock, _array = threading.Lock(), kernelapi.FakeCUDAShared.array


def _one_at_a_time(self, *arguments, **options):
    with _lock:
        return _array(self, *arguments, **options)


kernel.BlockManager = _Block
