"""`vgmpi bench board`: error against seconds of this program and its rivals on the same cases.

Settings of the rivals are those of their own examples, and the best ones that were found: smaller
cells, smaller or larger steps, more stiffness.
"""

import argparse
import json
import os
import subprocess
import sys
import time
import venv
from pathlib import Path
from typing import Any

from vgmpi.runtime.user_files import replace_file

from ..benchmark_case import BenchError, WorkerError
from ..subcommands import print_progress
from .board_cases import CASES
from .board_results import (
    comparable_error,
    format_csv,
    format_tables,
    mark_front,
    on_one_core,
    read_results,
    run_key,
    seconds_per_second,
)

# packages of the rivals' environment
RIVAL_PACKAGES = ("newton==1.8.0", "warp-lang==1.19.0", "torch", "genesis-world==1.4.5")

STEP_120, STEP_240, STEP_480 = "dt=0.00833333333", "dt=0.00416666667", "dt=0.00208333333"
SOFT, LONG_STEPS = "material.water.max_compression=0.04", "time.cfl=1.0"
STIFF_STEP = "step_per_cell=0.004"  # [s/m] of 5e7 Pa: a wave crosses 0.9 of a cell
APIC = "accuracy.transfer=apic"
IMPLICIT = "accuracy.pressure=implicit"
TWO_CORES = "threads=2"  # Warp has one thread on a processor, whatever it is told
S2 = "collider_basis=S2"  # Newton's default; its example of a dam break has pic
WIDE_ROOM = "domain.size=[1.25,0.5,0.5]"  # of the beam: whole cells of a twelfth of a meter
DAM_CELLS_48 = 0.146 * 4 / 48  # [m]

RUNS: dict[str, tuple[tuple[str, ...], ...]] = {
    "dam_break": (
        ("vgmpi", "accuracy.level=draft", LONG_STEPS),
        ("vgmpi", "accuracy.level=draft"),
        ("vgmpi", f"domain.cell={DAM_CELLS_48}", SOFT),
        ("vgmpi", f"domain.cell={DAM_CELLS_48}"),
        ("vgmpi",),
        ("vgmpi", "accuracy.level=draft", IMPLICIT),
        ("vgmpi", f"domain.cell={DAM_CELLS_48}", IMPLICIT),
        ("vgmpi", IMPLICIT),
        ("vgmpi", IMPLICIT, TWO_CORES),
        ("vgmpi", TWO_CORES),
        ("newton", "cell=0.01825", STEP_120),
        ("newton", "cell=0.01825", STEP_120, S2),
        ("newton", f"cell={DAM_CELLS_48}", STEP_240),
        ("newton", f"cell={DAM_CELLS_48}", STEP_240, S2),
        ("newton", f"cell={DAM_CELLS_48}", STEP_480),
        ("genesis", "cell=0.01825"),
        ("genesis", "cell=0.01825", "step_per_cell=0.04"),
        ("genesis", f"cell={DAM_CELLS_48}", "E=2.25e6"),
        ("genesis", "cell=0.009125"),
        ("genesis", "cell=0.01825", TWO_CORES),
        ("genesis", f"cell={DAM_CELLS_48}", "E=2.25e6", TWO_CORES),
    ),
    "level": (
        ("vgmpi", SOFT, "time.cfl=0.6"),  # 1.0 is unstable
        ("vgmpi", SOFT),
        ("vgmpi", "domain.cell=0.016"),
        ("vgmpi",),
        ("vgmpi", "domain.cell=0.013333333333333334"),
        ("vgmpi", IMPLICIT),
        ("vgmpi", "domain.cell=0.013333333333333334", IMPLICIT),
        ("newton", "cell=0.04", STEP_120),
        ("newton", "cell=0.04", STEP_120, S2),
        ("newton", "cell=0.04", "dt=0.00238095238"),
        ("newton", "cell=0.04", "dt=0.00238095238", S2),
        ("newton", "cell=0.02", STEP_120),
        ("genesis", "cell=0.02", "particle_size=0.64", "sampler=pbs"),
        ("genesis", "cell=0.02"),
        ("genesis", "cell=0.013333333333333334"),
    ),
    "sand": (
        ("vgmpi", "domain.cell=0.02"),
        ("vgmpi", "domain.cell=0.013333333333333334"),
        ("vgmpi",),
        ("newton", "cell=0.02", "dt=0.0166666667"),
        ("newton", "cell=0.013333333333333334", "dt=0.0166666667"),
        ("newton", "cell=0.013333333333333334", STEP_240),
        ("genesis", "cell=0.02", "E=5e5"),
        ("genesis", "cell=0.02"),
        ("genesis", "cell=0.013333333333333334"),
    ),
    "bar": (
        ("vgmpi", "domain.cell=0.1"),
        ("vgmpi",),
        ("vgmpi", "domain.cell=0.025"),
        ("newton", "cell=0.1", STEP_240, "end=0.6"),
        ("newton", "cell=0.05", STEP_240, "end=0.6"),
        ("newton", "cell=0.1", "dt=0.001", "end=0.6"),
        ("genesis", "cell=0.1"),
        ("genesis", "cell=0.05"),
        ("genesis", "cell=0.033333333333333333"),
    ),
    "cantilever": (
        ("vgmpi", "domain.cell=0.08333333333333333", WIDE_ROOM, LONG_STEPS, APIC),
        ("vgmpi", "domain.cell=0.0625", LONG_STEPS, APIC),
        ("vgmpi", "domain.cell=0.0625", LONG_STEPS),
        ("vgmpi", "domain.cell=0.0625"),
        ("vgmpi", "domain.cell=0.041666666666666664"),
        ("vgmpi",),
        ("vgmpi", "domain.cell=0.020833333333333333"),
        ("newton", "cell=0.0625", "dt=0.01", "end=0.45"),
        ("newton", "cell=0.0625", "dt=0.0025", "end=0.45"),
        ("newton", "cell=0.0625", "dt=0.0025", "end=0.45", "per_axis=3"),
        ("genesis", "cell=0.0625", STIFF_STEP),
        ("genesis", "cell=0.041666666666666664", STIFF_STEP),
        ("genesis", "cell=0.03125", STIFF_STEP),
        ("genesis", "cell=0.020833333333333333", STIFF_STEP),
    ),
    "vortices": (
        ("vgmpi", IMPLICIT),
        ("vgmpi",),
        ("vgmpi", "domain.cell=0.005"),
        ("vgmpi", "domain.cell=0.0041666666666666666", IMPLICIT),
        ("vgmpi", "domain.cell=0.0041666666666666666"),
        ("newton", "cell=0.00625", "dt=0.025"),
        ("newton", "cell=0.00625", STEP_120),
        ("newton", "cell=0.0041666666666666666", STEP_120),
        ("genesis", "cell=0.00625", "step_per_cell=0.2"),
        ("genesis", "cell=0.00625", "step_per_cell=0.4"),
        ("genesis", "cell=0.0041666666666666666", "step_per_cell=0.4"),
        ("genesis", "cell=0.003125", "step_per_cell=0.4"),
    ),
    "jet": (
        ("vgmpi", "domain.cell=0.05", IMPLICIT),
        ("vgmpi", "domain.cell=0.025", IMPLICIT),
        ("vgmpi", "domain.cell=0.025"),
        ("vgmpi", IMPLICIT),
        ("vgmpi", SOFT),
        ("vgmpi",),
        ("vgmpi", "domain.cell=0.00625", IMPLICIT),
        ("vgmpi", "domain.cell=0.00625"),
        ("newton", "cell=0.025", STEP_120),
        ("newton", "cell=0.0125", STEP_120),
        ("newton", "cell=0.0125", STEP_120, S2),
        ("newton", "cell=0.0125", STEP_240),
        ("newton", "cell=0.00625", STEP_120),
        ("genesis", "cell=0.025"),
        ("genesis", "cell=0.0125"),
        ("genesis", "cell=0.00625"),
    ),
    "block": (
        ("vgmpi", "domain.cell=0.015", SOFT, LONG_STEPS),
        ("vgmpi", "domain.cell=0.015", SOFT),
        ("vgmpi", "domain.cell=0.015"),
        ("vgmpi",),
        ("vgmpi", "object.block.rigid=false"),
        ("newton", "cell=0.015", STEP_120),
        ("newton", "cell=0.015", STEP_120, S2),
        ("newton", "cell=0.015", STEP_240),
        ("newton", "cell=0.01", STEP_120),
        ("genesis", "cell=0.02"),
        ("genesis", "cell=0.015"),
        ("genesis", "cell=0.01"),
    ),
    "rest": (
        ("vgmpi", LONG_STEPS),
        ("vgmpi",),
        ("vgmpi", IMPLICIT),
        ("newton", "cell=0.016", STEP_120),
        ("newton", "cell=0.016", STEP_120, S2),
        ("newton", "cell=0.01", STEP_120, "per_axis=2"),
        ("genesis", "cell=0.01"),
    ),
    "splash": (
        ("vgmpi", SOFT, LONG_STEPS),
        ("vgmpi", SOFT),
        ("vgmpi",),
        ("vgmpi", IMPLICIT),
        ("vgmpi", TWO_CORES),
        ("vgmpi", IMPLICIT, TWO_CORES),
        ("newton", "cell=0.016", "dt=0.0166666667"),
        ("newton", "cell=0.016", "dt=0.0166666667", S2),
        ("newton", "cell=0.016", STEP_120),
        ("newton", "cell=0.01", STEP_120, "per_axis=2"),
        ("genesis", "cell=0.01", "end=0.1"),
        ("genesis", "cell=0.01", "end=0.1", TWO_CORES),
    ),
}


COLORS = {"vgmpi": "#1f5fbf", "newton": "#d9822b", "genesis": "#4a9a53"}
MARKERS = {"vgmpi": "o", "newton": "s", "genesis": "^"}
PACKAGE = Path(__file__).parents[4]  # the folder of the package vgmpi
RIVALS = ("newton", "genesis")
LIMIT_SECONDS = 1800  # of a run, with what it compiles


def draw_board(path: Path, results: list[dict[str, Any]]) -> None:
    """Write the picture of runs on one core; references cannot tell apart what is in the gray band.

    Raises:
        ImportError: If matplotlib is missing.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    results = [r for r in results if on_one_core(r)]
    names = [name for name in CASES if any(r["case"] == name and "error" in r for r in results)]
    rows_of_panels = 1 + (len(names) > 4)
    columns = max(1, -(-len(names) // rows_of_panels))
    figure, panels = pyplot.subplots(
        rows_of_panels, columns, figsize=(3.1 * columns, 3.2 * rows_of_panels), squeeze=False
    )
    for panel in panels.flat[len(names) :]:
        panel.set_axis_off()
    for name, panel in zip(names, panels.flat):
        rows = [r for r in results if r["case"] == name and "error" in r]
        for solver, color in COLORS.items():
            points = sorted(
                (seconds_per_second(r), max(r["error"], 0.2 * CASES[name].resolution))
                for r in rows
                if r["solver"] == solver
            )
            if points:
                panel.plot(*zip(*points), MARKERS[solver], color=color, label=solver, ms=6)
        panel.axhspan(0, CASES[name].resolution, color="0.93", zorder=-1)
        front = sorted((seconds_per_second(r), comparable_error(r)) for r in rows if r["on_front"])
        panel.step(*zip(*front), where="post", color="0.6", lw=1, zorder=0)
        panel.set(xscale="log", yscale="log", xlabel="processor s per simulated s")
        panel.set_title(CASES[name].title.replace(": ", ":\n"), fontsize=9)
        panel.grid(alpha=0.25)
    for panel in panels[:, 0]:
        panel.set_ylabel("error")
    figure.axes[0].legend(frameon=False, fontsize=8)
    figure.tight_layout()
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


def flags(parser: argparse.ArgumentParser) -> None:
    """Add the flags of the command."""
    say = parser.add_argument
    say("--only", nargs="+", choices=CASES, metavar="CASE", help=f"any of {', '.join(CASES)}")
    say("--solvers", nargs="+", choices=("vgmpi", *RIVALS), metavar="SOLVER", help="vgmpi, newton,"
        " genesis; default: all that are installed")  # fmt: skip
    say("--setup", action="store_true", help="install the rivals in an environment of their own"
        f" ({', '.join(RIVAL_PACKAGES)}: 7 GB)")  # fmt: skip
    say("--environment", type=Path, metavar="FOLDER", help="environment of the rivals; default:"
        " rivals in the output folder")  # fmt: skip
    say("-o", "--output", type=Path, default=Path("board"), metavar="FOLDER",
        help="folder of results and of the board as .md, .csv, .png; default: board")  # fmt: skip
    say(
        "--again",
        dest="repeats",
        action="store_true",
        help="measure runs again whose results are there",
    )


def install_rivals(environment: Path) -> None:
    """Make the environment of the rivals.

    Raises:
        WorkerError: If a package cannot be installed.
    """
    print_progress(f"installing {', '.join(RIVAL_PACKAGES)} in {environment}")
    venv.create(environment, with_pip=True)
    command = [str(environment / "bin" / "python"), "-m", "pip", "install", "-q", *RIVAL_PACKAGES]
    if subprocess.run(command).returncode:
        raise WorkerError(f"{environment}: the rivals cannot be installed: pip's lines say why")


def installed_solvers(environment: Path) -> dict[str, str]:
    """Return the interpreter of each solver that is installed, and name those that are not."""
    interpreters, python = {"vgmpi": sys.executable}, environment / "bin" / "python"
    for name in RIVALS:
        probe = [str(python), "-c", f"import importlib.util as u; u.find_spec({name!r}) or exit(1)"]
        if python.exists() and subprocess.run(probe).returncode == 0:
            interpreters[name] = str(python)
        else:
            print_progress(f"{name} is not installed in {environment}: left out (--setup)")
    return interpreters


def make_run(interpreter: str, case: str, words: tuple[str, ...]) -> dict[str, Any]:
    """Make a run in a process of its own and return its results, or the reason of its failure."""
    solver, *options = words
    command = [interpreter, "-m", "vgmpi.tools.bench.board.board_run", solver, case, *options]
    env = os.environ | {"PYTHONPATH": str(PACKAGE)}
    failure = {"case": case, "solver": solver, "options": options}
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, env=env, timeout=LIMIT_SECONDS
        )
    except subprocess.TimeoutExpired:
        return failure | {"failure": f"no end within {LIMIT_SECONDS} s"}
    try:
        return failure | json.loads(done.stdout.strip().splitlines()[-1])
    except (ValueError, IndexError):
        lines = done.stderr.strip().splitlines() or [f"exit code {done.returncode}"]
        return failure | {"failure": lines[-1]}


def run_board(args: argparse.Namespace) -> int:
    """Make the runs that are missing, and write table, CSV and picture."""
    environment = args.environment or args.output / "rivals"
    try:
        args.output.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError):
        raise BenchError(f"{args.output}: is a file, a folder is needed") from None
    if args.setup:
        install_rivals(environment)
    interpreters = installed_solvers(environment)
    solvers = [name for name in args.solvers or interpreters if name in interpreters]
    path = args.output / "results.jsonl"
    results = {run_key(result): result for result in read_results(path)}
    for case in args.only or RUNS:
        for words in RUNS[case]:
            key = (case, *words)
            if words[0] not in solvers or (key in results and not args.repeats):
                continue
            print_progress(f"{case}: {' '.join(words)}")
            start = time.monotonic()
            result = make_run(interpreters[words[0]], case, words)
            results[key] = result | {"elapsed": time.monotonic() - start}
            with open(path, "a") as file:
                file.write(json.dumps(results[key]) + "\n")
    order = [(case, *words) for case, runs in RUNS.items() for words in runs]
    marked = mark_front([results[key] for key in order if key in results])
    tables = format_tables(marked)
    replace_file(args.output / "board.md", tables + "\n")
    replace_file(args.output / "board.csv", format_csv(marked))
    print(tables)
    try:
        draw_board(args.output / "board.png", marked)
    except ImportError:
        print_progress("no picture: not installed: pip install 'vgmpi[validate]'")
    return 1 if any("failure" in result for result in marked) else 0
