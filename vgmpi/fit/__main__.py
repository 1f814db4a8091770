"""python -m vgmpi.fit scene.toml fit.toml -o fit: numbers of a scene, found from a video, from
frames of another run, from what was measured or published, or by a video model's taste.

Runs are kept below the output folder by their parameters: a fit that was stopped goes on, and
the same command several times at once shares the runs."""

import argparse
import math
import sys
from pathlib import Path

from postprocess.video import VideoError

from ..ends import guarded
from ..output.owner import claimed
from ..output.read import RunError
from ..scene.reader import load
from ..study.runs import StudyError
from ..tables import TomlError
from . import beside, told
from .find import Found, find, interval
from .runs import Runs
from .settings import FitFile
from .shared import replaced
from .targets import target_of
from .trials import Trial, Trials

RUNS, TABLE = "runs", "fit.csv"


def arguments(argv: list[str] | None) -> argparse.Namespace:
    p = argparse.ArgumentParser(
        prog="python -m vgmpi.fit", description=__doc__,
        formatter_class=argparse.RawTextHelpFormatter,
    )  # fmt: skip
    p.add_argument("scene", type=Path)
    p.add_argument("fit", type=Path, help="what is looked for, and held to what (docs/fitting.md)")
    p.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="in all runs, as in vgmpi"
    )
    p.add_argument("-o", "--output", type=Path, help="folder of the fit [SCENE's/fit]")
    p.add_argument("--ranks", type=int, default=1, help="of each run")
    p.add_argument("--jobs", type=int, default=1, help="runs side by side")
    given = p.parse_args(argv)
    for name in ("ranks", "jobs"):
        if getattr(given, name) < 1:
            p.error(f"--{name}: must be at least 1; got {getattr(given, name)}")
    given.output = given.output or given.scene.resolve().parent / "fit"
    return given


@guarded
def main(argv: list[str] | None = None) -> int:
    given = arguments(argv)
    try:
        scene = load(given.scene, given.set)
        file = FitFile(given.fit, scene)
        target = target_of(file)
        if target.before:
            print(target.before, flush=True)
        runs = Runs(scene, given.output / RUNS, given.ranks, given.jobs)
        trials = Trials(runs, file.axes, target, file.settings.method.runs)
        given.output.mkdir(parents=True, exist_ok=True)

        def heard(trial: Trial) -> None:
            told.rows(file.axes, list(trials.all.values()), given.output / TABLE, whole=False)
            values = ", ".join(f"{a.key} {v:.6g}" for a, v in zip(file.axes, trial.values))
            loss = "" if math.isnan(trial.loss) else f": loss {trial.loss:.4g}"
            off = loss if trial.done.whole else ": blew up"
            print(f"{trial.number:4d} {trial.what:13s} {values}{off}", flush=True)

        trials.heard = heard
        _write(file, find(file, trials), trials, given.output)
    except TomlError as error:
        print("\n".join(error.lines), file=sys.stderr)
        return 2
    except (StudyError, RunError, VideoError) as error:
        print(f"vgmpi: {error}", file=sys.stderr)
        return 1
    return 0


def _write(file: FitFile, found: Found, trials: Trials, folder: Path) -> None:
    told.scene(file, found, folder / "fitted.toml")
    told.rows(file.axes, list(trials.all.values()), folder / TABLE)
    replaced(folder / "report.md", told.report(file, found, trials).encode())
    try:
        told.plot(file, found, trials, folder / "loss.png")
    except ImportError:
        print("no plot: pip install 'vgmpi[validate]'", file=sys.stderr)
    if trials.target.pictures is not None:
        with claimed(folder / "beside.lock") as mine:  # one of several processes draws it
            if mine is not None:
                beside.write(trials.target, found.best.done.folder, folder / "beside.mp4")
    for k, axis in enumerate(file.axes):
        ends = interval(found, file, k)
        sure = "how sure is not known" if ends is None else f"{ends[0]:.6g} .. {ends[1]:.6g}"
        print(f"{axis.key} = {found.best.values[k]:.6g} ({sure})")
    seconds = sum(t.done.seconds for t in trials.all.values())
    print(f"{len(trials.all)} runs, {seconds / 60:.1f} minutes; {folder / 'report.md'}")


if __name__ == "__main__":
    sys.exit(main())
