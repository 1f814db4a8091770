"""Picture of the board: error over processor time, one panel per case."""

from pathlib import Path
from typing import Any

from .board_cases import CASES
from .board_results import comparable_error, on_one_core, seconds_per_second

COLORS = {"vgmpi": "#1f5fbf", "newton": "#d9822b", "genesis": "#4a9a53"}
MARKERS = {"vgmpi": "o", "newton": "s", "genesis": "^"}


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
