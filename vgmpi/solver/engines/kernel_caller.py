"""Calls of compiled kernels on threads, without the dispatch of their types at every call."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from vgmpi.runtime.compiled_kernels import precompiled_entry


class KernelCaller:
    """Threads of one rank and the compiled code of the calls that they make."""

    def __init__(self, threads: int):
        self.threads = threads
        self.pool = ThreadPoolExecutor(threads) if threads > 1 else None
        self.entries: dict[tuple, Callable] = {}  # compiled code for the current arrays

    def call_if_rows(self, key: tuple, kernel, rows: np.ndarray, *arguments) -> None:
        """Call kernel(rows, *arguments) if there are rows.

        Args:
            key: Tells calls of one kernel apart whose arguments have other types.
        """
        if len(rows):
            self.run(key, kernel, rows, *arguments)

    def run(self, key: tuple, kernel, *arguments) -> None:
        """Call kernel(*arguments); calls with one key have equal types until the next sort."""
        compiled = self.entries.get((kernel, key))
        if compiled is None:
            compiled = self.entries[kernel, key] = precompiled_entry(kernel, *arguments)
        compiled(*arguments)

    def call(self, kernel, rows: np.ndarray, *arguments) -> None:
        """Call kernel(rows, *arguments) if there are rows; its calls have equal types."""
        self.call_if_rows((), kernel, rows, *arguments)

    def each(self, work, *arguments) -> None:
        """Call work(thread, *arguments) on every thread."""
        if self.pool is None:
            work(0, *arguments)
            return
        futures = [self.pool.submit(work, k, *arguments) for k in range(self.threads)]
        for future in futures:
            future.result()
