"""Selection of the GPU of a rank, and the memory check of a scene."""

import functools
import time
from collections.abc import Callable

import numpy as np
from numba import cuda

from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.planning.plan import Plan
from vgmpi.runtime.process_limits import format_bytes

from . import device_memory
from .kernel_launch import LAST
from .translation_types import SIMULATED

RANK = [0]  # rank of this process
# Exceptions of the GPU driver; the simulator has none.
FAILURES: tuple[type[Exception], ...] = ()
if not SIMULATED:
    FAILURES = (cuda.cudadrv.driver.CudaAPIError, cuda.cudadrv.driver.LinkerError)


def with_device_context(method: Callable) -> Callable:
    """Wrap a method of an engine so that a failure of the GPU names rank, kernel and step.

    The raised error ends all ranks (parallel/communicator.py).
    """

    @functools.wraps(method)
    def _call(self, *arguments, **keywords):
        try:
            return method(self, *arguments, **keywords)
        except FAILURES as error:
            raise RuntimeError(
                f"the card of rank {RANK[0]} failed in step {self.step_number}, at kernel "
                f"{LAST[0]} or one"
                f" before it: {error}"
            ) from error

    return _call


def select_device(place: int, rank: int = 0) -> str:
    """Select the GPU for a rank; ranks of a machine get its GPUs in turn.

    Args:
        place: Index of the rank on this machine.
        rank: Rank of this process.

    Returns:
        Error message of one line, or "".
    """
    RANK[0] = rank
    if SIMULATED:
        return ""
    try:
        count = len(cuda.gpus)
        if count:
            cuda.select_device(place % count)
    except cuda.cudadrv.error.CudaSupportError as error:
        reason = " ".join(str(error).replace(":", " ").split())
        return f"engine cuda finds no card: {reason or 'no driver'}"
    return "" if count else "engine cuda finds no card"


def free() -> int | None:
    """Return the free bytes on this rank's GPU, None where there is no GPU."""
    if SIMULATED:
        return None
    try:
        return int(cuda.current_context().get_memory_info().free)
    except cuda.cudadrv.error.CudaSupportError:
        return None


def memory_report(plan: Plan, ranks: int) -> str:
    """Return a line of --plan with the memory of all arrays that `Plan.bytes` counts."""
    free_bytes = free()
    availability = (
        "no card is here to ask" if free_bytes is None else f"{format_bytes(free_bytes)} are free"
    )
    needs = format_bytes(plan.bytes() / ranks)
    return f"card         {needs} on the card of each rank; {availability}"


def memory_error(plan: Plan, ranks: SerialCommunicator) -> str:
    """Return an error line on all ranks if the share of one rank does not fit, else "".

    Collective: all ranks must call this.
    """
    free_bytes = free()
    min_free = -ranks.max(np.array([-np.inf if free_bytes is None else -float(free_bytes)]))[0]
    needs = plan.bytes() / ranks.size
    if needs <= 0.95 * min_free:
        return ""
    return (
        f"needs about {format_bytes(needs)} on the card of each rank, of which one has"
        f" {format_bytes(min_free)} free"
    )


def finished_at() -> float:
    """Return the time [s] at which all launched kernels have ended."""
    if not SIMULATED:
        cuda.synchronize()
    return time.perf_counter()


def copy_bandwidth(size: int) -> float:
    """Return the bytes per second that a copy of `size` bytes within the GPU reads and writes."""
    source, target = (
        device_memory.to_card(np.zeros(size, np.uint8)),
        device_memory.to_card(np.zeros(size, np.uint8)),
    )
    shortest = np.inf
    for _ in range(10):
        start = finished_at()
        target.copy_to_device(source)
        shortest = min(shortest, finished_at() - start)
    return 2 * size / shortest
