"""Fit numbers of a scene: python -m vgmpi fit scene.toml fit.toml -o fit.

The target is a video, another run, measured or published data, or a video model.

Runs are kept below the output folder by their parameters: an interrupted fit continues, and
several processes with the same command share the runs.
"""

import argparse
import math
import sys
from pathlib import Path

from vgmpi.io.run_lock import file_lock
from vgmpi.io.run_reader import RunError
from vgmpi.postprocess.frames.image_io import VideoError
from vgmpi.runtime.command_line import ArgumentParser, exit_code_from_exceptions, usage_error_code
from vgmpi.runtime.config.schema import TomlError
from vgmpi.runtime.user_files import replace_file
from vgmpi.scene.loader import load
from vgmpi.tools.tradeoff.study_runs import StudyError

from . import fit_report
from .evaluations import Evaluation, Evaluations
from .fit_config import FitFile
from .run_pool import RunPool
from .target_factory import target_of
from .workflow import FitResult, interval, run_fit

RUNS, TABLE = "runs", "fit.csv"


def arguments(argv: list[str] | None) -> argparse.Namespace:
    """Parse the command line."""
    p = ArgumentParser(
        prog="vgmpi fit", description=__doc__,
        formatter_class=argparse.RawTextHelpFormatter,
    )  # fmt: skip
    p.add_argument("scene", type=Path, help="scene file (TOML)")
    p.add_argument("fit", type=Path, help="fit.toml: parameters and target of the fit")
    p.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="override a key in all runs"
    )
    p.add_argument("-o", "--output", type=Path, help="folder of the fit [fit, beside the scene]")
    p.add_argument("--ranks", type=int, default=1, help="MPI ranks of each run")
    p.add_argument("--jobs", type=int, default=1, help="number of concurrent runs")
    args = p.parse_args(argv)
    for name in ("ranks", "jobs"):
        if getattr(args, name) < 1:
            p.error(f"--{name}: must be at least 1; got {getattr(args, name)}")
    args.output = args.output or args.scene.resolve().parent / "fit"
    return args


@exit_code_from_exceptions
def main(argv: list[str] | None = None) -> int:
    """Run a fit; return 0, 1 for a failed run, or 2 for a wrong file."""
    args = arguments(argv)
    try:
        scene = load(args.scene, args.set)
        file = FitFile(args.fit, scene)
        target = target_of(file)
        if target.preamble:
            print(target.preamble, flush=True)
        runs = RunPool(scene, args.output / RUNS, args.ranks, args.jobs)
        trials = Evaluations(runs, file.axes, target, file.settings.method.max_runs)
        args.output.mkdir(parents=True, exist_ok=True)

        def report_evaluation(trial: Evaluation) -> None:
            """Update fit.csv and print a line about a new evaluation."""
            fit_report.write_csv(
                file.axes, list(trials.all.values()), args.output / TABLE, final=False
            )
            values = ", ".join(f"{a.key} {v:.6g}" for a, v in zip(file.axes, trial.values))
            loss = "" if math.isnan(trial.loss) else f": loss {trial.loss:.4g}"
            outcome = loss if trial.done.completed else ": blew up"
            print(f"{trial.number:4d} {trial.purpose:13s} {values}{outcome}", flush=True)

        trials.on_evaluation = report_evaluation
        _write(file, run_fit(file, trials), trials, args.output)
    except TomlError as error:
        print("\n".join(error.lines), file=sys.stderr)
        return 2
    except (StudyError, RunError, VideoError) as error:
        print(f"vgmpi: {error}", file=sys.stderr)
        return 1
    except OSError as error:
        print(f"{error.filename or args.output}: {error.strerror or error}", file=sys.stderr)
        return usage_error_code(error)
    return 0


def _write(file: FitFile, result: FitResult, trials: Evaluations, folder: Path) -> None:
    """Write the files of the result and print a summary."""
    fit_report.write_fitted_scene(file, result, folder / "fitted.toml")
    fit_report.write_csv(file.axes, list(trials.all.values()), folder / TABLE)
    replace_file(folder / "report.md", fit_report.format_report(file, result, trials).encode())
    try:
        fit_report.plot(file, result, trials, folder / "loss.png")
    except ImportError:
        print("no plot: pip install 'vgmpi[validate]'", file=sys.stderr)
    if trials.target.pictures is not None:
        with file_lock(
            folder / "beside.lock"
        ) as handle:  # one of several processes makes the video
            if handle is not None:
                fit_report.write_comparison(
                    trials.target, result.best.done.folder, folder / "beside.mp4"
                )
    for k, axis in enumerate(file.axes):
        ends = interval(result, file, k)
        interval_text = (
            "how sure is not known" if ends is None else f"{ends[0]:.6g} .. {ends[1]:.6g}"
        )
        print(f"{axis.key} = {result.best.values[k]:.6g} ({interval_text})")
    seconds = sum(t.done.seconds for t in trials.all.values())
    print(f"{len(trials.all)} runs, {seconds / 60:.1f} minutes; {folder / 'report.md'}")


if __name__ == "__main__":
    sys.exit(main())
