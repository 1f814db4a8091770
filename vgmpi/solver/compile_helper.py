"""Process that compiles a share of the kernels of a run, for compile_kernels.py.

It reads the plan of the run from stdin and ends with the run. What it has compiled is on disk.
"""

import contextlib
import logging
import pickle
import signal
import subprocess
import sys
from collections.abc import Iterator

from vgmpi.planning.plan import Plan
from vgmpi.runtime.death_signal import die_with_parent
from vgmpi.runtime.process_limits import physical_cores

MOST = 3  # processes beside the run: a few kernels take most of the time
PROGRAM = sys.executable, "-m", "vgmpi.solver.compile_helper"


def count_helpers(ranks: int) -> int:
    """Return how many processes may compile beside a run.

    Args:
        ranks: Ranks of the run; several share the kernels among themselves.
    """
    return min(physical_cores() - 1, MOST) if ranks == 1 else 0


@contextlib.contextmanager
def helpers_of(plan: Plan, count: int) -> Iterator[None]:
    """Let processes compile while the block runs.

    Args:
        plan: The plan.
        count: Number of processes; where one fails, the run compiles its share itself.
    """
    helpers: list[subprocess.Popen] = []
    try:
        for k in range(1, count + 1):
            with contextlib.suppress(OSError):  # no process or memory is left
                helpers.append(_started([*PROGRAM, str(k), str(count + 1)], pickle.dumps(plan)))
        yield
    finally:
        for helper in helpers:
            helper.kill()
            helper.wait()


def _started(words: list[str], data: bytes) -> subprocess.Popen:
    """Return a process that has been given data on stdin, which a pipe holds at once."""
    helper = subprocess.Popen(
        words, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        preexec_fn=die_with_parent(signal.SIGKILL),
    )  # fmt: skip
    assert helper.stdin is not None
    with helper.stdin as pipe, contextlib.suppress(BrokenPipeError):
        pipe.write(data)
    return helper


def main() -> None:
    """Compile the share that the command line names, of the plan on stdin."""
    from .compile_kernels import compile_share

    logging.disable()
    share, shares = map(int, sys.argv[1:])
    compile_share(pickle.load(sys.stdin.buffer), share, shares, False)


if __name__ == "__main__":
    main()
