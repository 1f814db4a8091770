"""This program beside another checkout of it, such as the last release: processor time of a step on
one core, in turns.
"""

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from vgmpi.tools.bench.benchmark_case import BenchError, Case, lay_out
from vgmpi.tools.bench.interleaved_rounds import Contestant, Worker

# runs in the other checkout
LAY_OUT = """
import sys
from pathlib import Path
from vgmpi.tools.bench.benchmark_case import Case, lay_out
lay_out(Case(sys.argv[1], int(sys.argv[2])), ["single"], Path(sys.argv[3]))
"""
UNCONTRACTED = Path("uncontracted")
ROUND = 4.0  # [s] of both programs' turns


def lines(
    tree: Path, laws: list[str], particles: list[float], rounds: int, say: Callable
) -> Iterator[str]:
    """What is found, as text; tree: a folder, or UNCONTRACTED: this program without contraction.
    Raises BenchError where `tree` cannot."""
    more: tuple[tuple[str, str], ...] = ()
    if tree == UNCONTRACTED:
        tree, more = Path(__file__).parents[2], (("VGMPI_CONTRACTION", "off"),)
    for law in laws:
        for n in map(int, particles):
            yield line(law, n, measure(law, n, tree.resolve(), rounds, say, more))


def measure(law: str, particles: int, tree: Path, rounds: int, say, more=()) -> np.ndarray:
    """Nanoseconds per particle and step of this program and of that of `tree`, the least of a
    round, and the median ratio of neighbours in time: (rounds, 3). more: of its environment.

    Both prepare the scene themselves, since gaussians.h5 knows the program it is of. Raises
    BenchError where `tree` cannot.
    """
    case = Case(law, particles)
    with tempfile.TemporaryDirectory(prefix="vgmpi-bench-") as name:
        ours, theirs = Path(name) / "ours", Path(name) / "theirs"
        ours.mkdir()
        theirs.mkdir()
        say(f"{law}, {particles:,} particles: preparing")
        lay_out(case, ["single"], ours)
        prepared = subprocess.run(
            [sys.executable, "-c", LAY_OUT, law, str(particles), str(theirs)],
            cwd=tree, env={**os.environ, "PYTHONPATH": str(tree)}, capture_output=True, text=True,
        )  # fmt: skip
        if prepared.returncode:
            raise BenchError(f"{tree}: {(prepared.stderr.splitlines() or ['failed'])[-1]}")
        workers = []
        try:
            workers.append(Worker(Contestant("own"), case, ours))
            workers.append(Worker(Contestant("own", tree=str(tree), more=more), case, theirs))
            return _turns(workers, particles, rounds, say)
        finally:
            for worker in workers:
                worker.close()


def _turns(workers: list[Worker], particles: int, rounds: int, say) -> np.ndarray:
    """Whole cycles from sort to sort in turns, many to a round, since machines change their pace
    within seconds; who begins changes from turn to turn."""
    wall = sum(worker.ask("round", units=1)["wall"] for worker in workers)
    turns = 2 * max(2, round(0.5 * ROUND / wall))
    found = np.zeros((rounds, 3))
    for k in range(rounds):
        ns = np.zeros((turns, 2))
        for turn in range(turns):
            for which in (0, 1) if turn % 2 == 0 else (1, 0):
                answer = workers[which].ask("round", units=1)
                ns[turn, which] = 1e9 * answer["seconds"] / answer["steps"] / particles
        found[k] = *ns.min(0), np.median(ns[:, 0] / ns[:, 1])
        say(f"round {k + 1} of {rounds}: {found[k, 0]:.1f} and {found[k, 1]:.1f} ns")
    return found


def line(law: str, particles: int, found: np.ndarray) -> str:
    """The result as a line."""
    (here, there), ratios = found[:, :2].min(0), found[:, 2]
    return (
        f"{law}, {particles:,} particles: {here:.1f} and {there:.1f} ns per particle and step"
        f" (least), ratio {np.median(ratios):.3f} ({ratios.min():.3f} .. {ratios.max():.3f})"
    )
