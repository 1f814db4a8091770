"""What accuracy of a scene costs: runs with other cells and other knobs, each beside the finest
run or a curve from elsewhere; a table, a plot, a recommendation, and a scene within a budget."""

import argparse
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import TypeAdapter, ValidationError

from ..convert import written
from ..planning.studied import FOLDER, TABLE
from ..scene.reader import load
from ..scene.scene import Scene
from ..source import Source
from ..tables import Quantity, SceneError
from . import errors, knobs, told
from .choice import Measured, Model
from .knobs import Setting
from .runs import Study, StudyError

TRIES = 5  # times that a choice is run, and chosen anew where it is not as expected
DEFAULT = ("cell", "precision", "transfer", "stiffness")
RUN = f"run that scene; where it is not as expected, choose anew, up to {TRIES} times"
MEASURES = {"places": errors.elsewhere, "energy": errors.energy, "probes": errors.probe}
SAID = {
    "places": "share of the mass that is elsewhere",
    "energy": "kinetic energy, rms over its range",
    "probes": "probes, rms over their range, the worst",
    "curve": "off the curve, rms over its range",
}


def arguments(argv: list[str]) -> argparse.Namespace:
    p = argparse.ArgumentParser(
        prog="python -m vgmpi.study tradeoff", description=__doc__,
        formatter_class=argparse.RawTextHelpFormatter,
    )  # fmt: skip
    p.add_argument("scene", type=Path)
    p.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="in all runs, as in vgmpi"
    )
    p.add_argument("-o", "--output", type=Path, help="folder of the study [SCENE's/tradeoff]")
    p.add_argument("--vary", default=",".join(DEFAULT), help=f"of {','.join(knobs.KNOBS)}")
    p.add_argument("--ranks", type=int, default=1, help="of each run")
    p.add_argument("--measure", choices=list(MEASURES), default="places", help=_measures())
    p.add_argument(
        "--curve", type=Path, metavar="CSV", help="times [s] and values, in place of the finest run"
    )
    p.add_argument("--column", metavar="FILE:KEY", help="what is held to it: probe_NAME.csv:value")
    p.add_argument(
        "--budget",
        metavar="TIME",
        help="write the best scene that takes no longer, such as '5 min'",
    )
    p.add_argument(
        "--error",
        metavar="SHARE",
        help="write the cheapest scene that is off by no more, such as '2 %%'",
    )
    p.add_argument("--part", metavar="K/N", help="only every Nth run, from the Kth on; no table")
    p.add_argument("--run", action="store_true", help=RUN)
    given = p.parse_args(argv)
    given.vary = tuple(word.strip() for word in given.vary.split(",") if word.strip())
    unknown = [word for word in given.vary if word not in knobs.KNOBS]
    if unknown:
        p.error(f"--vary: unknown: {', '.join(unknown)}; known: {', '.join(knobs.KNOBS)}")
    if given.part is not None:
        part = re.fullmatch(r"(\d{1,6})/(\d{1,6})", given.part)
        given.part = part and (int(part[1]), int(part[2]))
        if not given.part or not 1 <= given.part[0] <= given.part[1]:
            p.error("--part: K/N, with K from 1 to N, such as 2/8")
    if given.run and given.budget is None and given.error is None:
        p.error("--run is for --budget and --error")
    if bool(given.curve) != bool(given.column):
        p.error("--curve and --column go together")
    for name, unit in (("budget", "s"), ("error", "1")):
        text = getattr(given, name)
        if text is not None:
            setattr(given, name, _amount(p, name, text, unit))
    given.output = given.output or given.scene.resolve().parent / FOLDER
    return given


def _measures() -> str:
    return "\n".join(f"{name}: {SAID[name]}" for name in MEASURES) + "  [places]"


def _amount(p: argparse.ArgumentParser, name: str, text: str, unit: str) -> float:
    try:
        return TypeAdapter(Annotated[float, Quantity(unit, gt=0)]).validate_python(text)
    except ValidationError as error:
        p.error(f"--{name}: {error.errors()[0]['msg']}")


def main(argv: list[str]) -> int:
    given = arguments(argv)
    try:
        scene = load(given.scene, given.set)
        study = Study(scene, given.output, given.ranks)
        settings, finest = knobs.sweep(scene, given.vary)
        if given.part:
            study.all(settings[given.part[0] - 1 :: given.part[1]], set())
            return 0
        took = study.all(settings, {knobs.PLAIN, finest})
        off = off_of(study, given, finest)
        own = max(scene.domain.cells)
        found = [
            Measured(one, cpu, off(one), int(dict(one.knobs).get("cells", own)))
            for one, cpu in took.items()
        ]
    except SceneError as error:
        print("\n".join(error.lines), file=sys.stderr)
        return 2
    except (StudyError, errors.RunError) as error:
        print(f"vgmpi: {error}", file=sys.stderr)
        return 1
    name = "curve" if given.curve else given.measure
    print("\n".join(told.table(found, finest, SAID[name])))
    told.rows(scene, found, given.output / TABLE)
    try:
        told.plot(found, finest, given.output / "tradeoff.png", SAID[name])
    except ImportError:
        print("no plot: pip install 'vgmpi[validate]'", file=sys.stderr)
    print("\n".join(told.words(found, finest)))
    return _chosen(study, given, found, off)


def off_of(study: Study, given: argparse.Namespace, finest: Setting) -> Callable[[Setting], float]:
    """By how much a run is off: the curve that is given, or the finest run."""
    if given.curve:
        times, values = np.loadtxt(given.curve, delimiter=",", usecols=(0, 1), comments="#").T
        return lambda one: errors.curve(study.outcome(one), given.column, times, values)
    reference, measure = study.outcome(finest), MEASURES[given.measure]
    return lambda one: 0.0 if one == finest else measure(study.outcome(one), reference)


def _chosen(
    study: Study, given: argparse.Namespace, found: list[Measured], off: Callable[[Setting], float]
) -> int:
    """The scene that meets what is asked for, written."""
    if given.budget is None and given.error is None:
        return 0
    aims = [] if given.error is None else [f"{100 * given.error:g} %"]
    aims += [] if given.budget is None else [f"{given.budget:g} s"]
    what, tries = " and ".join(aims), TRIES if given.run else 0
    try:
        choice, found = choose(study, found, off, (given.error, given.budget), tries)
    except (StudyError, errors.RunError) as error:
        print(f"vgmpi: {error}", file=sys.stderr)
        return 1
    if choice is None:
        print(f"no setting stays within {what}", file=sys.stderr)
        return 2
    path = given.scene.with_name(f"{given.scene.stem}_chosen.toml")
    how = "as was found" if choice in found else "as expected"
    write(study.scene, choice, f"{what}: {_said(choice)}, {how}", path)
    print(f"{path}: {_said(choice)}, {how}: {' '.join(choice.setting.overrides) or 'as it stands'}")
    return 0


def choose(
    study: Study,
    found: list[Measured],
    off: Callable[[Setting], float],
    aim: tuple[float | None, float | None],
    tries: int,
) -> tuple[Measured | None, list[Measured]]:
    """What meets an error and a time [s], and all that was run by then. What is chosen is run, and
    chosen anew with what came of it, up to so many times; after that among what was run. Raises
    StudyError, RunError."""
    grids = [m.cells for m in found]  # nothing is said of others than those in between
    counts = list(range(min(grids), max(grids) + 1, knobs.unit_of(study.scene)))
    for _ in range(tries):
        choice = Model(study.scene, found, counts).within(*aim)
        if choice is None or choice.setting in {m.setting for m in found}:
            return choice, found
        cpu = study.run(choice.setting)
        one = Measured(choice.setting, cpu, off(choice.setting), choice.cells)
        print(f"{choice.setting.name}: expected {_said(choice)}; it took {_said(one)}", flush=True)
        found = [*found, one]
    return Model(study.scene, found, counts).within(*aim, run=tries > 0), found


def _said(one: Measured) -> str:
    return f"{one.cpu:.3g} s of processor time, {100 * one.error:.2g} % off"


def write(scene: Scene, choice: Measured, what: str, path: Path) -> None:
    """The scene with what was chosen."""
    overrides = (*scene.overrides, *choice.setting.overrides)
    head = [f"{scene.path.name} within {what}", *overrides]
    path.write_text(written.text(Source(scene.path, overrides).data, head, []))
