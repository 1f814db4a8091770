"""Accuracy and cost of a scene: runs with other cells and other parameters.

Each run is compared with the finest run or with a given curve. The study writes a table, a plot, a
recommendation, and a scene within a budget.
"""

import argparse
import re
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import TypeAdapter, ValidationError

from vgmpi.planning.cost.tradeoff_results import FOLDER, TABLE
from vgmpi.runtime.command_line import ArgumentParser
from vgmpi.runtime.config import toml_writer
from vgmpi.runtime.config.schema import Quantity, SceneError
from vgmpi.runtime.config.toml_source import TomlSource
from vgmpi.runtime.user_files import replace_file
from vgmpi.scene.loader import load
from vgmpi.scene.scene import Scene

from . import error_measures, parameter_sweep, tradeoff_report
from .cost_error_model import CostError, CostErrorModel
from .parameter_sweep import Setting
from .study_runs import Study, StudyError

MAX_TRIES = 5  # a choice is run and revised at most this often
DEFAULT = ("cell", "precision", "transfer", "stiffness")
RUN = f"run that scene; if it misses the goal, choose again, up to {MAX_TRIES} times"
MEASURES = {
    "places": error_measures.mass_displacement,
    "energy": error_measures.energy,
    "probes": error_measures.probe,
}
LABELS = {
    "places": "share of the mass that is elsewhere",
    "energy": "kinetic energy, rms over its range",
    "probes": "probes, rms over their range, the worst",
    "curve": "off the curve, rms over its range",
}


def _parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = ArgumentParser(
        prog="vgmpi tradeoff", description=__doc__,
        formatter_class=argparse.RawTextHelpFormatter,
    )  # fmt: skip
    parser.add_argument("scene", type=Path, help="scene file (TOML)")
    parser.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="override a key in all runs"
    )
    parser.add_argument(
        "-o", "--output", type=Path, help="folder of the study [tradeoff, beside the scene]"
    )
    parser.add_argument(
        "--vary",
        help=f"settings to vary, any of {', '.join(parameter_sweep.PARAMETERS)}"
        f" [{','.join(DEFAULT)}]",
    )
    parser.add_argument(
        "--quick",
        action="store_true",
        help="only the scene, one run with larger and one with smaller cells",
    )
    parser.add_argument("--ranks", type=int, default=1, help="MPI ranks of each run")
    parser.add_argument("--measure", choices=list(MEASURES), default="places", help=_measures())
    parser.add_argument(
        "--curve",
        type=Path,
        metavar="CSV",
        help="reference curve, times [s] and values, instead of the finest run",
    )
    parser.add_argument(
        "--column", metavar="FILE:KEY", help="column compared with the curve: probe_NAME.csv:value"
    )
    parser.add_argument(
        "--budget",
        metavar="TIME",
        help="write the most accurate scene within this time, such as '5 min'",
    )
    parser.add_argument(
        "--error",
        metavar="SHARE",
        help="write the cheapest scene within this error, such as '2 %%'",
    )
    parser.add_argument(
        "--part", metavar="K/N", help="make only every Nth run, starting with the Kth; no table"
    )
    parser.add_argument("--run", action="store_true", help=RUN)
    return parser


def parse_arguments(argv: list[str]) -> argparse.Namespace:
    """Parse the command line."""
    parser = _parser()
    args = parser.parse_args(argv)
    if args.quick and args.vary is not None:
        parser.error("--quick varies the cells alone: give --quick or --vary")
    vary = ",".join(DEFAULT) if args.vary is None else args.vary
    args.vary = tuple(word.strip() for word in vary.split(",") if word.strip())
    unknown = [word for word in args.vary if word not in parameter_sweep.PARAMETERS]
    if unknown:
        parser.error(
            f"--vary: unknown: {', '.join(unknown)}; known: {', '.join(parameter_sweep.PARAMETERS)}"
        )
    if args.part is not None:
        part = re.fullmatch(r"(\d{1,6})/(\d{1,6})", args.part)
        args.part = part and (int(part[1]), int(part[2]))
        if not args.part or not 1 <= args.part[0] <= args.part[1]:
            parser.error("--part: K/N, with K from 1 to N, such as 2/8")
    if args.run and args.budget is None and args.error is None:
        parser.error("--run is for --budget and --error")
    if bool(args.curve) != bool(args.column):
        parser.error("--curve and --column go together")
    for name, unit in (("budget", "s"), ("error", "1")):
        text = getattr(args, name)
        if text is not None:
            setattr(args, name, _amount(parser, name, text, unit))
    args.output = args.output or args.scene.resolve().parent / FOLDER
    return args


def _measures() -> str:
    """Return the help text of --measure."""
    return ";\n".join(f"{name}: {LABELS[name]}" for name in MEASURES) + " [places]"


def _amount(parser: argparse.ArgumentParser, name: str, text: str, unit: str) -> float:
    """Parse a positive quantity, or exit with a message about its flag."""
    try:
        return TypeAdapter(Annotated[float, Quantity(unit, gt=0)]).validate_python(text)
    except ValidationError as error:
        parser.error(f"--{name}: {error.errors()[0]['msg']}")


def main(argv: list[str]) -> int:
    """Run the study and return its exit code."""
    args = parse_arguments(argv)
    try:
        scene = load(args.scene, args.set)
        study = Study(scene, args.output, args.ranks)
        if args.quick:
            settings, finest = parameter_sweep.quick_sweep(scene)
        else:
            settings, finest = parameter_sweep.sweep(scene, args.vary)
        args.output.mkdir(parents=True, exist_ok=True)
        if args.part:
            study.all(settings[args.part[0] - 1 :: args.part[1]], set())
            return 0
        interim = InterimTable(study, args, finest, len(settings))
        cpu_times = study.all(settings, {parameter_sweep.BASELINE, finest}, interim.lines)
        error_of = error_function(study, args, finest)
        results = measure(scene, cpu_times, error_of)
    except SceneError as error:
        print("\n".join(error.lines), file=sys.stderr)
        return 2
    except (StudyError, error_measures.RunError) as error:
        print(f"vgmpi: {error}", file=sys.stderr)
        return 1
    name = "curve" if args.curve else args.measure
    print("\n".join(tradeoff_report.table(results, finest, LABELS[name])))
    tradeoff_report.rows(scene, results, args.output / TABLE)
    try:
        tradeoff_report.plot(results, finest, args.output / "tradeoff.png", LABELS[name])
    except ImportError:
        print("no plot: pip install 'vgmpi[validate]'", file=sys.stderr)
    print("\n".join(tradeoff_report.words(results, finest)))
    return _write_choice(study, args, results, error_of)


def error_function(
    study: Study, args: argparse.Namespace, finest: Setting
) -> Callable[[Setting], float]:
    """Return a function that measures a run against the curve or the finest run."""
    if args.curve:
        times, values = np.loadtxt(args.curve, delimiter=",", usecols=(0, 1), comments="#").T
        return lambda setting: error_measures.curve(
            study.outcome(setting), args.column, times, values
        )
    reference, distance = study.outcome(finest), MEASURES[args.measure]
    return lambda setting: 0.0 if setting == finest else distance(study.outcome(setting), reference)


def measure(
    scene: Scene, cpu_times: dict[Setting, float], error_of: Callable[[Setting], float]
) -> list[CostError]:
    """Return cost and error of runs.

    Args:
        scene: The scene.
        cpu_times: Processor time [s] of each run.
        error_of: Function that measures the error of a setting.
    """
    return [
        CostError(setting, cpu, error_of(setting), _cell_count(scene, setting))
        for setting, cpu in cpu_times.items()
    ]


def _cell_count(scene: Scene, setting: Setting) -> int:
    """Return the cells along the longest edge in a run."""
    return int(dict(setting.knobs).get("cells", max(scene.domain.cells)))


@dataclass
class InterimTable:
    """Table of the runs so far, whose errors are relative to the finest of them."""

    study: Study
    args: argparse.Namespace  # command line
    finest: Setting  # of all runs
    count: int  # of all runs
    reference: Setting | None = None  # that `errors` are relative to
    errors: dict[Setting, float] = field(default_factory=dict)  # [-] of the runs so far

    def lines(self, cpu_times: dict[Setting, float]) -> list[str]:
        """Return the lines of the table, given the processor times [s] so far."""
        scene, knobs = self.study.scene, set(self.finest.knobs)
        reference = max(
            cpu_times, key=lambda s: (_cell_count(scene, s), len(knobs.intersection(s.knobs)))
        )
        if reference != self.reference and not self.args.curve:
            self.reference, self.errors = reference, {}
        if missing := cpu_times.keys() - self.errors.keys():
            error_of = error_function(self.study, self.args, reference)
            self.errors |= {setting: error_of(setting) for setting in missing}
        results = measure(scene, cpu_times, self.errors.__getitem__)
        name = "curve" if self.args.curve else self.args.measure
        head = f"so far, {len(cpu_times)} of {self.count} runs"
        if not self.args.curve and reference != self.finest:
            head += f", compared with the finest of them ({reference.name})"
        return ["", head, *tradeoff_report.table(results, reference, LABELS[name]), ""]


def _write_choice(
    study: Study,
    args: argparse.Namespace,
    results: list[CostError],
    error_of: Callable[[Setting], float],
) -> int:
    """Write the scene that meets the budget, and return the exit code.

    Args:
        study: The study.
        args: Command line.
        results: All runs.
        error_of: Function that measures the error of a setting.
    """
    if args.budget is None and args.error is None:
        return 0
    aims = [] if args.error is None else [f"{100 * args.error:g} %"]
    aims += [] if args.budget is None else [f"{args.budget:g} s"]
    limits, tries = " and ".join(aims), MAX_TRIES if args.run else 0
    try:
        choice, results = choose(study, results, error_of, (args.error, args.budget), tries)
    except (StudyError, error_measures.RunError) as error:
        print(f"vgmpi: {error}", file=sys.stderr)
        return 1
    if choice is None:
        print(f"no setting stays within {limits}", file=sys.stderr)
        return 2
    path = args.scene.with_name(f"{args.scene.stem}_chosen.toml")
    basis = "as was found" if choice in results else "as expected"
    write(study.scene, choice, f"{limits}: {_label(choice)}, {basis}", path)
    print(
        f"{path}: {_label(choice)}, {basis}: {' '.join(choice.setting.overrides) or 'as it stands'}"
    )
    return 0


def choose(
    study: Study,
    results: list[CostError],
    error_of: Callable[[Setting], float],
    aim: tuple[float | None, float | None],
    tries: int,
) -> tuple[CostError | None, list[CostError]]:
    """Return the best setting within an error and a cost, and all runs so far.

    A choice is run, and revised if it is not as predicted, up to `tries` times; then only settings
    that were run are considered.

    Args:
        study: The study.
        results: All runs.
        error_of: Function that measures the error of a setting.
        aim: Upper limits of error and cost [s], each or None.
        tries: Upper limit of the additional runs.

    Raises:
        StudyError: A run fails.
        RunError: The results of a run are unreadable.
    """
    grids = [m.cells for m in results]  # the model only interpolates
    counts = list(range(min(grids), max(grids) + 1, parameter_sweep.cell_unit(study.scene)))
    for _ in range(tries):
        choice = CostErrorModel(study.scene, results, counts).within(*aim)
        if choice is None or choice.setting in {m.setting for m in results}:
            return choice, results
        cpu = study.run(choice.setting)
        result = CostError(choice.setting, cpu, error_of(choice.setting), choice.cells)
        print(
            f"{choice.setting.name}: expected {_label(choice)}; it took {_label(result)}",
            flush=True,
        )
        results = [*results, result]
    return CostErrorModel(study.scene, results, counts).within(*aim, run=tries > 0), results


def _label(result: CostError) -> str:
    """Return cost and error as text."""
    return f"{result.cpu:.3g} s of processor time, {100 * result.error:.2g} % off"


def write(scene: Scene, choice: CostError, what: str, path: Path) -> None:
    """Write the scene with the chosen overrides.

    Args:
        scene: The scene.
        choice: The chosen setting.
        what: Description of the limits and of the choice.
        path: File of the new scene.
    """
    overrides = (*scene.overrides, *choice.setting.overrides)
    head = [f"{scene.path.name} within {what}", *overrides]
    replace_file(path, toml_writer.text(TomlSource(scene.path, overrides).data, head, []))
