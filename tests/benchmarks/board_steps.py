"""Steps and errors of the board's own runs with the default time step, and with a shorter one.

Runs whose options give the time step, and those with an implicit pressure or two threads, are left
out.
"""

import sys
from typing import Any

from vgmpi.tools.bench.benchmark_case import BenchError
from vgmpi.tools.bench.board.board_cases import CASES
from vgmpi.tools.bench.board.board_command import make_run
from vgmpi.tools.bench.board.board_settings import IMPLICIT, RUNS, TWO_CORES


def runs_with_default_step(case: str) -> list[tuple[str, ...]]:
    """Return the options of the runs of this program that do not give the time step."""
    return [
        options
        for solver, *options in RUNS[case]
        if solver == "vgmpi"
        and not {IMPLICIT, TWO_CORES} & set(options)
        and not any(option.startswith("time.cfl") for option in options)
    ]


def successful_run(case: str, options: tuple[str, ...]) -> dict[str, Any]:
    """Return what a run of this program gave.

    Raises:
        BenchError: If it failed.
    """
    result = make_run(sys.executable, case, ("vgmpi", *options))
    if "failure" in result:
        raise BenchError(f"{case} {' '.join(options)}: {result['failure']}")
    return result


def run(cases: list[str], courant: float) -> None:
    """Print the table.

    Args:
        cases: Cases of the board.
        courant: Courant number of the shorter step [-].
    """
    print(f"| case | options | steps | with cfl = {courant:g} | ratio | error | with {courant:g} |")
    print("|---|---|---|---|---|---|---|")
    for case in cases or list(CASES):
        for options in runs_with_default_step(case):
            now = successful_run(case, options)
            before = successful_run(case, (*options, f"time.cfl={courant:g}"))
            errors = [f"{r['error']:.4f}" if r.get("error") else "" for r in (now, before)]
            ratio = now["steps"] / before["steps"]
            print(
                f"| {case} | {' '.join(options)} | {now['steps']:,} | {before['steps']:,}"
                f" | {ratio:.2f} | {errors[0]} | {errors[1]} |",
                flush=True,
            )
