"""Fit numbers of a scene: python -m vgmpi fit scene.toml fit.toml -o fit.

The target is a video, another run, measured or published data, or a video model.

Runs are kept below the output folder by their parameters: an interrupted fit continues, and
several processes with the same command share the runs.
"""

import argparse
import csv
import io
import math
import os
import sys
from pathlib import Path

import numpy as np

from vgmpi.io.run_lock import file_lock
from vgmpi.io.run_reader import RunError
from vgmpi.postprocess.frames.image_io import Film, VideoError, to_bytes
from vgmpi.runtime.command_line import ArgumentParser, exit_code_from_exceptions, usage_error_code
from vgmpi.runtime.config import toml_writer
from vgmpi.runtime.config.schema import TomlError
from vgmpi.runtime.config.toml_source import TomlSource
from vgmpi.runtime.user_files import replace_file
from vgmpi.scene.loader import load
from vgmpi.tools.fit.video_prior.denoising_target import DenoisingTarget
from vgmpi.tools.tradeoff.study_runs import StudyError

from .data_targets import RunTarget, TableTarget
from .evaluations import Evaluation, Evaluations
from .fit_config import FitFile
from .parameter_space import ParameterAxis
from .run_pool import RunPool
from .target_base import Target
from .video_target import VideoTarget
from .workflow import FitResult, interval, run_fit

HIGH_CORRELATION = 0.95  # [-] correlation above which two parameters are reported
GAP_WIDTH = 2  # [pixels] gap between the two images of the video
END_TOLERANCE = 1e-3  # [ranges] a value closer to an end of its range may lie beyond it
RUNS, TABLE = "runs", "fit.csv"


def target_of(file: FitFile) -> Target:
    """Return the target of a fit file.

    Raises:
        FitFileError: If the target does not suit the scene.
        vgmpi.postprocess.frames.render_config.SettingsError: If its render.toml is wrong.
        StudyError: If packages that [sds] needs are missing.
    """
    if file.settings.sds is not None:
        return DenoisingTarget(file)
    settings = file.settings.target
    if settings.video is not None:
        return VideoTarget(file)
    return RunTarget(file) if settings.run is not None else TableTarget(file)


def write_csv(
    axes: list[ParameterAxis], trials: list[Evaluation], path: Path, final: bool = True
) -> None:
    """Write every evaluation as a row of fit.csv.

    A row has the purpose, parameters [SI], losses of fitted and of held-out values, seconds,
    folder.

    Args:
        axes: Parameters.
        trials: Evaluations, in order.
        path: The file to write.
        final: If False, keep the file if another process has already written these rows.
    """
    text = io.StringIO()
    out = csv.writer(text, lineterminator="\n")
    keys = [axis.key for axis in axes]
    out.writerow(["run", "purpose", *keys, "cells", "loss", "holdout_loss", "seconds", "folder"])
    for t in trials:
        cells = dict(t.setting.knobs).get("cells", "")
        losses = ["blew up" if not t.done.completed else _cell(t.loss), _cell(t.holdout_loss)]
        values = [repr(v) for v in t.values]
        out.writerow(
            [
                t.number,
                t.purpose,
                *values,
                cells,
                *losses,
                f"{t.done.seconds:g}",
                t.done.folder.name,
            ]
        )
    data = text.getvalue().encode()
    if final or not (path.exists() and path.read_bytes().startswith(data)):
        replace_file(path, data)


def _cell(value: float) -> str:
    """Format a loss; nan becomes an empty cell."""
    return "" if np.isnan(value) else f"{value:.9g}"


def write_fitted_scene(file: FitFile, result: FitResult, path: Path) -> None:
    """Write the scene with the fitted values; its file names become relative to `path`."""
    base = file.scene
    overrides = (*base.overrides, *result.best.setting.overrides)
    data = TomlSource(base.path, overrides, base.text).data
    for entry in data.get("object", []):
        for key in ("gaussians", "mesh"):
            if key in entry and entry.get("name") in base.files:
                absolute = base.files[entry["name"]].resolve()
                entry[key] = os.path.relpath(absolute, path.parent.resolve())
                data = {"allow_outside": True, **data}
    head = [f"{base.path.name} with what was fitted", *result.best.setting.overrides]
    replace_file(path, toml_writer.text(data, head, []).encode())


def format_report(file: FitFile, result: FitResult, trials: Evaluations) -> str:
    """Return the text of report.md: fitted values, their uncertainty and correlations."""
    best, uncertainty = result.best, result.uncertainty
    out = [f"# {file.scene.title or file.scene.path.stem}: what was fitted", ""]
    out += ["| parameter | value | 95 % | of it noise | of it cells |", "|---|---|---|---|---|"]
    for k, axis in enumerate(file.axes):
        out.append(_parameter_row(file, result, k, axis))
    out += ["", f"Loss: {best.loss:.4g} ({trials.target.loss_description})."]
    if not np.isnan(best.holdout_loss):
        out.append(f"Held out: {best.holdout_loss:.4g}, of what the search did not see.")
    start = next(iter(trials.all.values()))
    out.append(f"At the start: {start.loss:.4g}. Runs: {len(trials.all)}.")
    if result.budget_exhausted:
        out.append("The runs were used up before the search had come to rest: give more.")
    out += trials.target.report_lines(best.done.folder)
    for k, axis in enumerate(file.axes):
        if not END_TOLERANCE < best.u[k] < 1 - END_TOLERANCE:
            out.append(f"{axis.key} is at the end of its range: it may lie beyond.")
    if uncertainty is None:
        return "\n".join([*out, *result.notes, ""])
    out += ["", "## How sure", ""]
    out += [
        "*noise*: of least squares with differences to both sides, for errors of the target that"
        " know nothing of each other.",
        _discretization_note(file, result),
    ]
    if len(file.axes) > 1:
        out += _correlation_section(file, result)
    return "\n".join([*out, ""])


def _parameter_row(file: FitFile, result: FitResult, k: int, axis: ParameterAxis) -> str:
    """Return the table row of parameter k."""
    value, uncertainty, ends = result.best.values[k], result.uncertainty, interval(result, file, k)
    if uncertainty is None or ends is None:
        return f"| {axis.key} | {value:.6g} | not known | | |"
    parts = []
    for halfwidth in (uncertainty.noise_halfwidth[k], uncertainty.discretization_halfwidth[k]):
        low, high = axis.interval(result.best.u[k], float(halfwidth))
        parts.append(f"{(high - low) / 2:.2g}")
    if uncertainty.reference_cell_count is None:
        parts[1] = "not known"
    return f"| {axis.key} | {value:.6g} | {ends[0]:.6g} .. {ends[1]:.6g} | {' | '.join(parts)} |"


def _discretization_note(file: FitFile, result: FitResult) -> str:
    """Return the sentence about the discretization uncertainty."""
    assert result.uncertainty is not None
    cells, other = max(file.scene.domain.cells), result.uncertainty.reference_cell_count
    if other is None:
        return "*cells*: not known, as no run in other cells was made."
    return (
        f"*cells*: from one run with {other} cells along the longest edge instead of {cells}: how"
        " far the parameters would have to move to make up for it, taken to fall with the cells'"
        " size, and thrice that (Roache's index of two grids). What the target has and the scene"
        " has not is in neither."
    )


def _correlation_section(file: FitFile, result: FitResult) -> list[str]:
    """Return the section with correlations and singular values."""
    uncertainty, axes = result.uncertainty, file.axes
    assert uncertainty is not None
    out = ["", "## What goes together", ""]
    out += [f"| correlation | {' | '.join(a.key for a in axes)} |", f"|{'---|' * (len(axes) + 1)}"]
    for k, axis in enumerate(axes):
        out.append(f"| {axis.key} | {' | '.join(f'{c:.3f}' for c in uncertainty.correlation[k])} |")
    singular = ", ".join(f"{s:.3g}" for s in uncertainty.singular_values)
    out += ["", f"Singular values of the differences, each parameter's of length 1: {singular}."]
    for k in range(len(axes)):
        for j in range(k):
            if abs(uncertainty.correlation[k, j]) > HIGH_CORRELATION:
                names = f"{axes[j].key} and {axes[k].key}"
                out.append(f"{names} are hardly told apart: a wrong one hides a wrong other.")
    return out


def plot(file: FitFile, result: FitResult, trials: Evaluations, path: Path) -> None:
    """Plot the loss of every run over each parameter.

    Args:
        file: The fit file.
        result: Result of the fit.
        trials: All evaluations.
        path: The image to write.

    Raises:
        ImportError: If matplotlib is missing.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    runs = [t for t in trials.all.values() if t.done.completed and len(t.setting.knobs) == len(t.u)]
    count = len(file.axes)
    figure, all_axes = pyplot.subplots(
        1, count, figsize=(4 * count, 3.2), dpi=120, squeeze=False, sharey=True
    )
    for k, (axis, axes) in enumerate(zip(file.axes, all_axes[0])):
        for purpose in dict.fromkeys(t.purpose for t in runs):
            evaluations = [t for t in runs if t.purpose == purpose]
            axes.plot(
                [t.values[k] for t in evaluations],
                [t.loss for t in evaluations],
                ".",
                label=purpose,
            )
        axes.plot(result.best.values[k], result.best.loss, "*", color="k", markersize=10)
        ends = interval(result, file, k)
        if ends is not None:
            axes.axvspan(*ends, color="0.9")
        axes.set_xscale(axis.scale)
        axes.set_yscale("log")
        axes.set_xlabel(axis.key, fontsize=8)
    all_axes[0][0].set_ylabel("loss")
    all_axes[0][0].legend(fontsize=7)
    figure.tight_layout()
    picture = io.BytesIO()
    figure.savefig(picture, format="png")
    replace_file(path, picture.getvalue())
    pyplot.close(figure)


def write_comparison(target: Target, folder: Path, path: Path) -> None:
    """Write a video with the target on the left and the run in `folder` on the right.

    Raises RunError, VideoError, vgmpi.postprocess.frames.render_config.SettingsError.
    """
    assert target.pictures is not None
    left, right = target.images(), target.pictures.render_run(folder, target.frames)
    count, height, width = right.shape[:3]
    size = (2 * width + GAP_WIDTH, height)
    video_settings = target.pictures.chosen.video
    with Film(path, *size, video_settings.fps, video_settings.quality) as out:
        for target_image, run_image in zip(left, right):
            picture = np.zeros((height, size[0], 3))
            picture[:, :width], picture[:, width + GAP_WIDTH :] = target_image, run_image
            out.add(to_bytes(picture))


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
            write_csv(file.axes, list(trials.all.values()), args.output / TABLE, final=False)
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
    write_fitted_scene(file, result, folder / "fitted.toml")
    write_csv(file.axes, list(trials.all.values()), folder / TABLE)
    replace_file(folder / "report.md", format_report(file, result, trials).encode())
    try:
        plot(file, result, trials, folder / "loss.png")
    except ImportError:
        print("no plot: pip install 'vgmpi[validate]'", file=sys.stderr)
    if trials.target.pictures is not None:
        with file_lock(
            folder / "beside.lock"
        ) as handle:  # one of several processes makes the video
            if handle is not None:
                write_comparison(trials.target, result.best.done.folder, folder / "beside.mp4")
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
