"""The card of a rank: which it is, and whether a scene fits into its memory."""

import functools
import time
from collections.abc import Callable

import numpy as np
from numba import cuda

from ...domain.ranks import Alone
from ...planning.plan import Plan
from ...room import gib
from . import memory
from .launch import LAST
from .words import SIMULATED

RANK = [0]  # that this process is
# what a card's driver raises; the simulator has none
FAILURES: tuple[type[Exception], ...] = ()
if not SIMULATED:
    FAILURES = (cuda.cudadrv.driver.CudaAPIError, cuda.cudadrv.driver.LinkerError)


def named(method: Callable) -> Callable:
    """A method of an engine, a failure of whose card names rank, kernel and step; all ranks end by
    what is raised (domain/ranks.py)."""

    @functools.wraps(method)
    def go(self, *arguments, **words):
        try:
            return method(self, *arguments, **words)
        except FAILURES as error:
            raise RuntimeError(
                f"the card of rank {RANK[0]} failed in step {self.at}, at kernel {LAST[0]} or one"
                f" before it: {error}"
            ) from error

    return go


def choose(place: int, rank: int = 0) -> str:
    """Take the card of the `place`-th rank of this machine: they are dealt out in turn. Returns
    what is wrong, in one line, or ""."""
    RANK[0] = rank
    if SIMULATED:
        return ""
    try:
        count = len(cuda.gpus)
        if count:
            cuda.select_device(place % count)
    except cuda.cudadrv.error.CudaSupportError as error:
        said = " ".join(str(error).replace(":", " ").split())
        return f"engine cuda finds no card: {said or 'no driver'}"
    return "" if count else "engine cuda finds no card"


def free() -> int | None:
    """Bytes that are free on this rank's card; None where there is no card to ask."""
    if SIMULATED:
        return None
    try:
        return int(cuda.current_context().get_memory_info().free)
    except cuda.cudadrv.error.CudaSupportError:
        return None


def told(plan: Plan, ranks: int) -> str:
    """A line of --plan: what the arrays take that Plan.bytes counts, all of which a card holds."""
    have = free()
    there = "no card is here to ask" if have is None else f"{gib(have)} are free"
    return f"card         {gib(plan.bytes() / ranks)} on the card of each rank; {there}"


def too_large(plan: Plan, ranks: Alone) -> str:
    """One line, on all ranks, if the share of one of them does not fit, else "". Collective."""
    have = free()
    least = -ranks.max(np.array([-np.inf if have is None else -float(have)]))[0]
    needs = plan.bytes() / ranks.size
    if needs <= 0.95 * least:
        return ""
    return f"needs about {gib(needs)} on the card of each rank, of which one has {gib(least)} free"


def finished_at() -> float:
    """The time [s] at which all that was launched has ended, for clocks."""
    if not SIMULATED:
        cuda.synchronize()
    return time.perf_counter()


def copies(size: int) -> float:
    """Bytes per second that a copy of `size` bytes within the card reads and writes."""
    one, other = memory.to_card(np.zeros(size, np.uint8)), memory.to_card(np.zeros(size, np.uint8))
    best = np.inf
    for _ in range(10):
        began = finished_at()
        other.copy_to_device(one)
        best = min(best, finished_at() - began)
    return 2 * size / best
