"""Report of a study: table, CSV file, plot and sentences."""

import csv
import io
from pathlib import Path

from vgmpi.planning.cost.tradeoff_results import COLUMNS, fingerprint
from vgmpi.runtime.user_files import replace_file
from vgmpi.scene.scene import Scene

from .cost_error_model import CostError, pareto_front
from .parameter_sweep import BASELINE, Setting

LABEL_OFFSET = (4, 3)  # [points] offset of a run's name from its marker


def _without_reference(results: list[CostError], finest: Setting) -> list[CostError]:
    """Drop the finest run and the runs that differ from it by precision alone.

    Their differences from it are rounding and no error.
    """

    def grid(setting: Setting) -> set:
        """Return the knobs of a setting without its precision."""
        return {(knob, value) for knob, value in setting.knobs if knob != "precision"}

    if all(m.error > 0 for m in results if m.setting == finest):
        return results  # a curve is the reference
    return [
        m for m in results if grid(m.setting) != grid(finest) or m.setting == BASELINE != finest
    ]


def table(results: list[CostError], finest: Setting, label: str) -> list[str]:
    """Return a table line for each run, from cheap to expensive; label: name of the error."""
    front = pareto_front(_without_reference(results, finest))
    lines = [f"error: {label}", "", "| setting | processor time | error | |", "|---|---|---|---|"]
    for m in sorted(results, key=lambda m: m.cpu):
        description = ", ".join(f"{knob} {value}" for knob, value in m.setting.knobs) or "the scene"
        error = "held to" if m.setting == finest and m.error == 0 else f"{100 * m.error:.3g} %"
        lines.append(
            f"| {description} | {m.cpu:.1f} s | {error} | {'best' if m in front else ''} |"
        )
    return lines


def rows(scene: Scene, results: list[CostError], path: Path) -> None:
    """Write the results as CSV, with the overrides for --set."""
    text = io.StringIO(newline="")
    out = csv.writer(text)
    out.writerow(COLUMNS)
    for m in results:
        out.writerow(
            [m.setting.name, m.cells, f"{m.cpu:.4g}", f"{m.error:.6g}",
             " ".join(m.setting.overrides), fingerprint(scene)]
        )  # fmt: skip
    replace_file(path, text.getvalue())


def plot(results: list[CostError], finest: Setting, path: Path, label: str) -> None:
    """Plot the error over the processor time.

    Args:
        results: All runs.
        finest: Setting of the reference.
        path: File of the picture.
        label: Name of the error.

    Raises:
        ImportError: matplotlib is missing.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot, ticker

    figure, axes = pyplot.subplots(figsize=(6, 4), dpi=120)
    inexact = [m for m in results if m.error > 0]
    plotted = [m for m in _without_reference(results, finest) if m in inexact] or inexact
    front = pareto_front(plotted)
    axes.loglog([m.cpu for m in front], [100 * m.error for m in front], "-", color="0.7")
    for m in plotted:
        series = m.setting.of_grid
        axes.loglog(m.cpu, 100 * m.error, "o" if series else "s", color="C0" if series else "C1")
        name = " ".join(f"{k} {v}" for k, v in m.setting.knobs) or "the scene"
        position = (m.cpu, 100 * m.error)
        axes.annotate(name, position, LABEL_OFFSET, textcoords="offset points", fontsize=7)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(ticker.LogLocator(subs=(1, 2, 5)))
        axis.set_major_formatter(ticker.FormatStrFormatter("%g"))
        axis.set_minor_formatter(ticker.NullFormatter())
    axes.set_xlabel("processor time [s]")
    axes.set_ylabel(f"error [%]: {label}", fontsize=8)
    figure.tight_layout()
    figure.savefig(path, bbox_inches="tight")  # names may reach beyond the axes
    pyplot.close(figure)


def words(results: list[CostError], finest: Setting) -> list[str]:
    """Return sentences about the most useful results."""
    by_setting = {m.setting: m for m in results}
    own, out = by_setting[BASELINE], [""]
    if finest != BASELINE:
        times = by_setting[finest].cpu / own.cpu
        deviation = f"is {100 * own.error:.2g} % off"
        out.append(f"The scene as it stands costs 1/{times:.1f} of the finest run and {deviation}.")
    for m in results:
        if m.setting in (BASELINE, finest) or m.cpu >= own.cpu:
            continue
        name = ", ".join(f"{k} {v}" for k, v in m.setting.knobs)
        change = f"{100 * m.error:.2g} % off instead of {100 * own.error:.2g} %"
        out.append(f"With {name} it costs {m.cpu / own.cpu:.2f} of that and is {change}.")
    return out
