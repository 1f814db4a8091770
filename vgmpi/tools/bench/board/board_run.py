"""One run of one solver on a case of the board, timed; it prints a line of JSON.

    python -m vgmpi.tools.bench.board.board_run SOLVER CASE [KEY=VALUE ...]

Options are those of the solver, and `threads` and `end` [s]. It runs in the environment of the
solver. Processor and wall time are those of the loop over steps, after a first run has compiled
everything; nothing is written to a disk. A run that took little time is made twice, and the smaller
time counts; the digests of both tell whether their bits agree.
"""

import hashlib
import importlib
import json
import os
import sys
import time
from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from vgmpi.tools.bench.board.board_cases import CASES, BoardCase, BoardState

SOLVERS = {
    "vgmpi": "vgmpi.tools.bench.board.vgmpi_board_solver",
    "newton": "vgmpi.tools.bench.board.newton_board_solver",
    "genesis": "vgmpi.tools.bench.board.genesis_board_solver",
}
THREADS = ("OMP_NUM_THREADS", "QD_NUM_THREADS", "TI_NUM_THREADS")
REPEAT_SECONDS = 25.0  # processor time up to which a run is made twice


class BoardSolver(Protocol):
    """A solver with a case set up in it.

    Attributes:
        cell: Edge of a cell [m].
        volume: Volumes of the particles, shape (n,) [m3].
        versions: Versions of the programs.
    """

    cell: float
    volume: np.ndarray
    versions: dict[str, str]

    def restart(self) -> None:
        """Begin the run again."""

    def advance(self, t: float) -> int:
        """Simulate up to a time [s] and return the number of steps."""

    def state(self) -> tuple[np.ndarray, np.ndarray]:
        """Return positions from the tank's corner and velocities, (n, 3) each [m], [m/s]."""


def parse_options(words: list[str]) -> dict[str, Any]:
    """Return KEY=VALUE words as a dictionary; values are JSON where they can be."""
    options = {}
    for word in words:
        key, _, text = word.partition("=")
        try:
            options[key] = json.loads(text)
        except ValueError:
            options[key] = text
    return options


def timed_run(solver: BoardSolver, case: BoardCase) -> dict[str, Any]:
    """Make a run and return its times, steps, digest and what its measure found."""
    solver.restart()
    first = BoardState(0.0, *solver.state())
    measure = case.measure(solver.volume, first.x, solver.cell)
    measure.record(first)
    cpu = wall = 0.0
    steps, now = 0, first
    for k in range(1, round(case.end / case.interval) + 1):
        start = time.process_time(), time.perf_counter()
        steps += solver.advance(k * case.interval)
        cpu, wall = cpu + time.process_time() - start[0], wall + time.perf_counter() - start[1]
        now = BoardState(k * case.interval, *solver.state())
        if not np.isfinite(now.x).all():
            return {"failure": f"positions are not finite at {now.t:.3g} s"}
        measure.record(now)
    digest = hashlib.sha256(np.ascontiguousarray(now.x).tobytes()).hexdigest()[:12]
    return {"cpu": cpu, "wall": wall, "steps": steps, "digest": digest} | measure.result()


def measure_case(name: str, case_name: str, options: dict[str, Any]) -> dict[str, Any]:
    """Return the results of a solver on a case."""
    case = CASES[case_name]
    if "end" in options:
        options = dict(options)
        case = replace(case, end=float(options.pop("end")))
    solver: BoardSolver = importlib.import_module(SOLVERS[name]).Solver(case_name, options)
    solver.restart()
    solver.advance(case.interval)  # compiles
    runs = [timed_run(solver, case)]
    if runs[0].get("cpu", np.inf) < REPEAT_SECONDS:
        runs.append(timed_run(solver, case))
    result = min(runs, key=lambda run: run.get("cpu", np.inf))
    particles = int(np.count_nonzero(solver.volume))
    result |= {
        "solver": name, "case": case_name, "versions": solver.versions, "cell": solver.cell,
        "particles": particles, "simulated": case.end,
        "same_bits": len({run.get("digest") for run in runs}) == 1 if len(runs) > 1 else None,
    }  # fmt: skip
    return result


def main(words: list[str]) -> None:
    """Print the results as a line of JSON, the last one on stdout."""
    options = parse_options(words[2:])
    for name in THREADS:
        os.environ[name] = str(options.get("threads", 1))
    result = measure_case(words[0], words[1], options) | {"options": words[2:]}
    print(json.dumps(result), flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
