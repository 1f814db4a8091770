"""What a study found, told: a table, CSV, a plot, sentences."""

import csv
from pathlib import Path

from ..planning.studied import COLUMNS, fingerprint
from ..scene.scene import Scene
from .choice import Measured, best
from .knobs import PLAIN, Setting

BESIDE = (4, 3)  # points from a run's mark to its name


def _apart(found: list[Measured], finest: Setting) -> list[Measured]:
    """Without the finest run and what differs from it by its precision alone: what these are off is
    no error but rounding."""

    def grid(one: Setting) -> set:
        return {(knob, value) for knob, value in one.knobs if knob != "precision"}

    if all(m.error > 0 for m in found if m.setting == finest):
        return found  # held to a curve
    return [m for m in found if grid(m.setting) != grid(finest) or m.setting == PLAIN != finest]


def table(found: list[Measured], finest: Setting, said: str) -> list[str]:
    """A line per run, from cheap to dear."""
    front = best(_apart(found, finest))
    out = [f"error: {said}", "", "| setting | processor time | error | |", "|---|---|---|---|"]
    for m in sorted(found, key=lambda m: m.cpu):
        what = ", ".join(f"{knob} {value}" for knob, value in m.setting.knobs) or "the scene"
        error = "held to" if m.setting == finest and m.error == 0 else f"{100 * m.error:.3g} %"
        out.append(f"| {what} | {m.cpu:.1f} s | {error} | {'best' if m in front else ''} |")
    return out


def rows(scene: Scene, found: list[Measured], path: Path) -> None:
    """The same as CSV, with what --set takes."""
    with open(path, "w", newline="") as file:
        out = csv.writer(file)
        out.writerow(COLUMNS)
        for m in found:
            out.writerow(
                [m.setting.name, m.cells, f"{m.cpu:.4g}", f"{m.error:.6g}",
                 " ".join(m.setting.overrides), fingerprint(scene)]
            )  # fmt: skip


def plot(found: list[Measured], finest: Setting, path: Path, said: str) -> None:
    """Error over processor time. Raises ImportError without matplotlib."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot, ticker

    figure, axes = pyplot.subplots(figsize=(6, 4), dpi=120)
    off = [m for m in found if m.error > 0]
    shown = [m for m in _apart(found, finest) if m in off] or off
    front = best(shown)
    axes.loglog([m.cpu for m in front], [100 * m.error for m in front], "-", color="0.7")
    for m in shown:
        series = m.setting.of_grid
        axes.loglog(m.cpu, 100 * m.error, "o" if series else "s", color="C0" if series else "C1")
        name = " ".join(f"{k} {v}" for k, v in m.setting.knobs) or "the scene"
        at = (m.cpu, 100 * m.error)
        axes.annotate(name, at, BESIDE, textcoords="offset points", fontsize=7)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(ticker.LogLocator(subs=(1, 2, 5)))
        axis.set_major_formatter(ticker.FormatStrFormatter("%g"))
        axis.set_minor_formatter(ticker.NullFormatter())
    axes.set_xlabel("processor time [s]")
    axes.set_ylabel(f"error [%]: {said}", fontsize=8)
    figure.tight_layout()
    figure.savefig(path, bbox_inches="tight")  # names may stand out
    pyplot.close(figure)


def words(found: list[Measured], finest: Setting) -> list[str]:
    """What a user needs to know."""
    by = {m.setting: m for m in found}
    own, out = by[PLAIN], [""]
    if finest != PLAIN:
        times = by[finest].cpu / own.cpu
        off = f"is {100 * own.error:.2g} % off"
        out.append(f"The scene as it stands costs 1/{times:.1f} of the finest run and {off}.")
    for m in found:
        if m.setting in (PLAIN, finest) or m.cpu >= own.cpu:
            continue
        name = ", ".join(f"{k} {v}" for k, v in m.setting.knobs)
        change = f"{100 * m.error:.2g} % off instead of {100 * own.error:.2g} %"
        out.append(f"With {name} it costs {m.cpu / own.cpu:.2f} of that and is {change}.")
    return out
