"""What accuracy of a scene costs: runs with other cells and other knobs, each beside the finest
run or a curve from elsewhere; a table, a plot, a recommendation, and a scene within a budget."""

import argparse
import sys
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import TypeAdapter, ValidationError

from ..convert import written
from ..scene.reader import load
from ..scene.scene import Scene
from ..source import Source
from ..tables import Quantity, SceneError
from . import errors, knobs, told
from .choice import SLACK, Measured, Model
from .errors import Outcome
from .knobs import Setting
from .runs import Study, StudyError

DEFAULT = ("cell", "precision", "transfer", "stiffness")
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
    given = p.parse_args(argv)
    given.vary = tuple(word.strip() for word in given.vary.split(",") if word.strip())
    unknown = [word for word in given.vary if word not in knobs.KNOBS]
    if unknown:
        p.error(f"--vary: unknown: {', '.join(unknown)}; known: {', '.join(knobs.KNOBS)}")
    if bool(given.curve) != bool(given.column):
        p.error("--curve and --column go together")
    for name, unit in (("budget", "s"), ("error", "1")):
        text = getattr(given, name)
        if text is not None:
            setattr(given, name, _amount(p, name, text, unit))
    given.output = given.output or given.scene.resolve().parent / "tradeoff"
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
        scene = load(given.scene)
        study = Study(scene, given.output, given.ranks)
        settings, finest = knobs.sweep(scene, given.vary)
        took = study.all(settings)
        found = measured(study, given, took, finest)
    except SceneError as error:
        print("\n".join(error.lines), file=sys.stderr)
        return 2
    except (StudyError, errors.RunError) as error:
        print(f"vgmpi: {error}", file=sys.stderr)
        return 1
    name = "curve" if given.curve else given.measure
    print("\n".join(told.table(found, finest, SAID[name])))
    told.rows(found, given.output / "tradeoff.csv")
    try:
        told.plot(found, given.output / "tradeoff.png", SAID[name])
    except ImportError:
        print("no plot: pip install 'vgmpi[validate]'", file=sys.stderr)
    print("\n".join(told.words(found, finest)))
    return _chosen(scene, given, found)


def measured(
    study: Study, given: argparse.Namespace, took: dict[Setting, float], finest: Setting
) -> list[Measured]:
    """Each run with its error."""
    if given.curve:
        times, values = np.loadtxt(given.curve, delimiter=",", usecols=(0, 1), comments="#").T

        def off(one: Outcome) -> float:
            return errors.curve(one, given.column, times, values)
    else:
        reference = study.outcome(finest)

        def off(one: Outcome) -> float:
            return MEASURES[given.measure](one, reference)

    found = []
    own = max(study.scene.domain.cells)
    for setting, cpu in took.items():
        count = int(dict(setting.knobs).get("cells", own))
        error = 0.0 if setting == finest and not given.curve else off(study.outcome(setting))
        found.append(Measured(setting, cpu, error, count))
    return found


def _chosen(scene: Scene, given: argparse.Namespace, found: list[Measured]) -> int:
    if given.budget is None and given.error is None:
        return 0
    grids = [m.cells for m in found]  # nothing is said of others than those in between
    counts = range(min(grids), max(grids) + 1, knobs.unit_of(scene))
    model = Model(scene, found, list(counts))
    if given.error is not None:
        choice, what = model.within_error(given.error), f"{100 * given.error:g} %"
        if choice and given.budget is not None and choice.cpu > SLACK * given.budget:
            print(f"{what} takes {choice.cpu:.0f} s, more than the budget", file=sys.stderr)
            return 2
    else:
        choice, what = model.within_budget(given.budget), f"{given.budget:g} s"
    if choice is None:
        print(f"no setting stays within {what}", file=sys.stderr)
        return 2
    path = given.scene.with_name(f"{given.scene.stem}_chosen.toml")
    write(given.scene, choice, what, path)
    expected = f"{choice.cpu:.0f} s of processor time, {100 * choice.error:.2g} % off"
    print(
        f"{path}: {expected}, as expected: {' '.join(choice.setting.overrides) or 'as it stands'}"
    )
    return 0


def write(scene: Path, choice: Measured, what: str, path: Path) -> None:
    """The scene with what was chosen."""
    said = f"{choice.cpu:.0f} s of processor time and {100 * choice.error:.2g} % expected"
    head = [f"{scene.name} within {what}: {said}", *choice.setting.overrides]
    path.write_text(written.text(Source(scene, choice.setting.overrides).data, head, []))
