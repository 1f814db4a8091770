"""What a test costs: compiling, processes started, processor time, that of processes included.

tests/conftest.py writes them beside the duration into the file of `pytest --junitxml`;
`python -m tests.benchmarks test-times FILE` adds them up by file.
"""

import os
import subprocess
import sys
import time
from collections.abc import Callable


class CostCounter:
    """Counter of the seconds that numba compiled in this process, and of processes started.

    Args:
        clock: What tells the seconds.
    """

    def __init__(self, clock: Callable[[], float] = time.perf_counter):
        self.clock = clock
        self.compile_seconds = 0.0
        self.processes = 0
        self._is_listening = False

    def listen(self) -> None:
        """Count from now on: processes at once, compiling as soon as numba is imported."""
        if "numba" not in sys.modules or self._is_listening:
            return
        from numba.core import event

        counter, starts = self, []

        class Listener(event.Listener):
            """Listener that adds up the outermost compilations, each with what it calls."""

            def on_start(self, _):
                """Note the start."""
                starts.append(counter.clock())

            def on_end(self, _):
                """Add the time if this was the outermost."""
                begun = starts.pop()
                counter.compile_seconds += 0.0 if starts else counter.clock() - begun

        self._is_listening = True
        event.register("numba:compile", Listener())

    def __call__(self) -> tuple[float, int]:
        """Return the seconds and the number so far."""
        self.listen()
        return self.compile_seconds, self.processes


COSTS = CostCounter(time.process_time)


def processor_seconds() -> float:
    """Return the processor time of this process and of all processes that ended below it [s]."""
    spent = os.times()
    return spent.user + spent.system + spent.children_user + spent.children_system


class _CountedPopen(subprocess.Popen):
    """Popen that counts."""

    def __init__(self, *arguments, **keywords):
        COSTS.processes += 1
        super().__init__(*arguments, **keywords)


def count_processes() -> None:
    """Count every process that is started from now on."""
    subprocess.Popen = _CountedPopen  # type: ignore[misc]
