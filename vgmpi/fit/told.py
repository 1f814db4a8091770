"""What a fit found, told: fit.csv, fitted.toml, report.md, a plot of the loss."""

import csv
import io
import os
from pathlib import Path

import numpy as np

from ..convert import written
from ..source import Source
from .axes import Axis
from .find import Found, interval
from .settings import FitFile
from .shared import replaced
from .trials import Trial, Trials

HARDLY = 0.95  # correlation from which two are hardly told apart
AT_END = 1e-3  # of a range: what is found so near to its end may lie beyond


def rows(axes: list[Axis], trials: list[Trial], path: Path, whole: bool = True) -> None:
    """Every run: what for, its parameters [SI], how far it is off what is fitted and what is held
    out, seconds, its folder. Not whole: left alone where another process has told as much."""
    text = io.StringIO()
    out = csv.writer(text, lineterminator="\n")
    keys = [axis.key for axis in axes]
    out.writerow(["run", "what", *keys, "cells", "loss", "held_out", "seconds", "folder"])
    for t in trials:
        cells = dict(t.setting.knobs).get("cells", "")
        off = ["blew up" if not t.done.whole else _cell(t.loss), _cell(t.held)]
        values = [repr(v) for v in t.values]
        out.writerow(
            [t.number, t.what, *values, cells, *off, f"{t.done.seconds:g}", t.done.folder.name]
        )
    data = text.getvalue().encode()
    if whole or not (path.exists() and path.read_bytes().startswith(data)):
        replaced(path, data)


def _cell(value: float) -> str:
    return "" if np.isnan(value) else f"{value:.9g}"


def scene(file: FitFile, found: Found, path: Path) -> None:
    """The scene with what was found. Its files are named from where it lies now."""
    base = file.scene
    overrides = (*base.overrides, *found.best.setting.overrides)
    data = Source(base.path, overrides, base.text).data
    for thing in data.get("object", []):
        for key in ("gaussians", "mesh"):
            if key in thing and thing.get("name") in base.files:
                there = base.files[thing["name"]].resolve()
                thing[key] = os.path.relpath(there, path.parent.resolve())
                data = {"allow_outside": True, **data}
    head = [f"{base.path.name} with what was fitted", *found.best.setting.overrides]
    replaced(path, written.text(data, head, []).encode())


def report(file: FitFile, found: Found, trials: Trials) -> str:
    """report.md: what was found, how sure that is, what cannot be told apart."""
    best, known = found.best, found.known
    out = [f"# {file.scene.title or file.scene.path.stem}: what was fitted", ""]
    out += ["| parameter | value | 95 % | of it noise | of it cells |", "|---|---|---|---|---|"]
    for k, axis in enumerate(file.axes):
        out.append(_row(file, found, k, axis))
    out += ["", f"Loss: {best.loss:.4g} ({trials.target.said})."]
    if not np.isnan(best.held):
        out.append(f"Held out: {best.held:.4g}, of what the search did not see.")
    first = next(iter(trials.all.values()))
    out.append(f"At the start: {first.loss:.4g}. Runs: {len(trials.all)}.")
    if found.spent:
        out.append("The runs were used up before the search had come to rest: give more.")
    out += trials.target.notes(best.done.folder)
    for k, axis in enumerate(file.axes):
        if not AT_END < best.u[k] < 1 - AT_END:
            out.append(f"{axis.key} is at the end of its range: it may lie beyond.")
    if known is None:
        return "\n".join([*out, *found.unsure, ""])
    out += ["", "## How sure", ""]
    out += [
        "*noise*: of least squares with differences to both sides, for errors of the target that"
        " know nothing of each other.",
        _cells_said(file, found),
    ]
    if len(file.axes) > 1:
        out += _together(file, found)
    return "\n".join([*out, ""])


def _row(file: FitFile, found: Found, k: int, axis: Axis) -> str:
    value, known, ends = found.best.values[k], found.known, interval(found, file, k)
    if known is None or ends is None:
        return f"| {axis.key} | {value:.6g} | not known | | |"
    parts = []
    for off in (known.noise[k], known.cells[k]):
        low, high = axis.around(found.best.u[k], float(off))
        parts.append(f"{(high - low) / 2:.2g}")
    if known.beside is None:
        parts[1] = "not known"
    return f"| {axis.key} | {value:.6g} | {ends[0]:.6g} .. {ends[1]:.6g} | {' | '.join(parts)} |"


def _cells_said(file: FitFile, found: Found) -> str:
    assert found.known is not None
    own, beside = max(file.scene.domain.cells), found.known.beside
    if beside is None:
        return "*cells*: not known, as no run in other cells was made."
    return (
        f"*cells*: from one run with {beside} cells along the longest edge instead of {own}: how"
        " far the parameters would have to move to make up for it, taken to fall with the cells'"
        " size, and thrice that (Roache's index of two grids). What the target has and the scene"
        " has not is in neither."
    )


def _together(file: FitFile, found: Found) -> list[str]:
    """What is hard to tell apart."""
    known, axes = found.known, file.axes
    assert known is not None
    out = ["", "## What goes together", ""]
    out += [f"| correlation | {' | '.join(a.key for a in axes)} |", f"|{'---|' * (len(axes) + 1)}"]
    for k, axis in enumerate(axes):
        out.append(f"| {axis.key} | {' | '.join(f'{c:.3f}' for c in known.correlation[k])} |")
    singular = ", ".join(f"{s:.3g}" for s in known.singular)
    out += ["", f"Singular values of the differences, each parameter's of length 1: {singular}."]
    for k in range(len(axes)):
        for j in range(k):
            if abs(known.correlation[k, j]) > HARDLY:
                names = f"{axes[j].key} and {axes[k].key}"
                out.append(f"{names} are hardly told apart: a wrong one hides a wrong other.")
    return out


def plot(file: FitFile, found: Found, trials: Trials, path: Path) -> None:
    """The loss of every run over each parameter. Raises ImportError without matplotlib."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    runs = [t for t in trials.all.values() if t.done.whole and len(t.setting.knobs) == len(t.u)]
    count = len(file.axes)
    figure, all_axes = pyplot.subplots(
        1, count, figsize=(4 * count, 3.2), dpi=120, squeeze=False, sharey=True
    )
    for k, (axis, axes) in enumerate(zip(file.axes, all_axes[0])):
        for what in dict.fromkeys(t.what for t in runs):
            some = [t for t in runs if t.what == what]
            axes.plot([t.values[k] for t in some], [t.loss for t in some], ".", label=what)
        axes.plot(found.best.values[k], found.best.loss, "*", color="k", markersize=10)
        ends = interval(found, file, k)
        if ends is not None:
            axes.axvspan(*ends, color="0.9")
        axes.set_xscale("log" if axis.logarithmic else "linear")
        axes.set_yscale("log")
        axes.set_xlabel(axis.key, fontsize=8)
    all_axes[0][0].set_ylabel("loss")
    all_axes[0][0].legend(fontsize=7)
    figure.tight_layout()
    picture = io.BytesIO()
    figure.savefig(picture, format="png")
    replaced(path, picture.getvalue())
    pyplot.close(figure)
