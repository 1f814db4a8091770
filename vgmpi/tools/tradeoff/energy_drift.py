"""Energy drift of each transfer scheme: how much of a scene's motion remains after many steps.

There is one run for each scheme, as long as the scene says and with its time step. The remaining
energy is 1 + (E - E0) / K with the total energy E (kinetic, elastic, potential), its initial value
E0 and the largest kinetic energy K. A scheme that conserves energy stays at 1; 0 or less means
rest.
"""

import argparse
import csv
import io
import sys
from pathlib import Path

import numpy as np

from vgmpi.io import csv_log, file_layout
from vgmpi.io.run_reader import RunError
from vgmpi.planning.cost.tradeoff_results import FOLDER
from vgmpi.runtime.command_line import ArgumentParser
from vgmpi.runtime.config.schema import SceneError
from vgmpi.runtime.user_files import replace_file
from vgmpi.scene.loader import load

from .parameter_sweep import BASELINE, Setting
from .study_runs import Study, StudyError

TRANSFERS = ("apic-corrected", "apic", "aflip", "flip", "pic")
MARKS = (1000, 10_000, 100_000)  # steps at which the table reports the remaining energy
COLUMNS = ("scene", "transfer", "step", "time", "left")


def remaining_energy(folder: Path) -> np.ndarray:
    """Return rows of (step, time [s], remaining energy) of a run's ledger, one for each frame."""
    rows = csv_log.read_rows(folder / file_layout.LEDGER)
    frames = np.array([(row["step"], row["time"]) for row in rows], float)
    frames, index = np.unique(frames, axis=0, return_inverse=True)
    kinetic, other = (
        np.bincount(index.ravel(), weights=[sum(row[k] for k in keys) for row in rows])
        for keys in (("kinetic_energy",), ("elastic_energy", "potential_energy"))
    )
    total = kinetic + other
    return np.column_stack([frames, 1 + (total - total[0]) / max(kinetic.max(), 1e-300)])


def table(results: dict[str, np.ndarray]) -> list[str]:
    """Return a table line for each transfer: remaining energy at the marks, and its maximum."""
    last = max(int(rows[-1, 0]) for rows in results.values())
    marks = [m for m in MARKS if m <= last] or [last]
    head = ["transfer", *(f"{m:,} steps" for m in marks), "most"]
    lines = [f"| {' | '.join(head)} |", f"|{'---|' * len(head)}"]
    for name, rows in results.items():
        cells = [f"{rows[np.searchsorted(rows[:, 0], m), 2]:.4f}" for m in marks]
        lines.append(f"| {' | '.join([name, *cells, f'{rows[:, 2].max():.4f}'])} |")
    return lines


def plot(results: dict[str, np.ndarray], path: Path, title: str) -> None:
    """Plot the remaining energy over the steps.

    Raises:
        ImportError: matplotlib is missing.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(6, 3.4), dpi=120)
    for name, rows in results.items():
        axes.semilogx(rows[1:, 0], rows[1:, 2], label=name)
    axes.set_xlabel("steps")
    axes.set_ylabel("left of the motion's energy")
    axes.set_ylim(-0.05, max(1.1, 1.05 * max(rows[:, 2].max() for rows in results.values())))
    axes.set_title(title, fontsize=9)
    axes.legend(fontsize=8)
    figure.tight_layout()
    figure.savefig(path)
    pyplot.close(figure)


def runs(study: Study) -> dict[str, np.ndarray]:
    """Return the remaining energy with each transfer that the scene can be run with.

    Raises:
        StudyError: The scene does not run as it stands.
    """
    own_transfer = study.scene.accuracy.transfer
    others = [
        Setting((("transfer", kind),), (f"accuracy.transfer={kind}",))
        for kind in TRANSFERS
        if kind != own_transfer
    ]
    cpu_times = study.all([BASELINE, *others], {BASELINE})
    names = {
        BASELINE: own_transfer,
        **{setting: dict(setting.knobs)["transfer"] for setting in others},
    }
    results = {names[setting]: remaining_energy(study.place(setting)) for setting in cpu_times}
    return {kind: results[kind] for kind in TRANSFERS if kind in results}


def main(argv: list[str]) -> int:
    """Run the study and return its exit code."""
    parser = ArgumentParser(
        prog="vgmpi energy", description=__doc__,
        formatter_class=argparse.RawTextHelpFormatter,
    )  # fmt: skip
    parser.add_argument("scene", type=Path, help="scene file (TOML)")
    parser.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="override a key in all runs"
    )
    parser.add_argument(
        "-o", "--output", type=Path, help="folder of the runs [tradeoff/STEM, beside the scene]"
    )
    parser.add_argument("--ranks", type=int, default=1, help="MPI ranks of each run")
    args = parser.parse_args(argv)
    folder = args.output or args.scene.resolve().parent / FOLDER / args.scene.stem
    try:
        scene = load(args.scene, args.set)
        folder.mkdir(parents=True, exist_ok=True)
        results = runs(Study(scene, folder, args.ranks))
    except SceneError as error:
        print("\n".join(error.lines), file=sys.stderr)
        return 2
    except (StudyError, RunError) as error:
        print(f"vgmpi: {error}", file=sys.stderr)
        return 1
    print("\n".join(table(results)))
    text = io.StringIO(newline="")
    out = csv.writer(text)
    out.writerow(COLUMNS)
    for kind, rows in results.items():
        out.writerows((scene.path.stem, kind, int(s), f"{t:.6g}", f"{e:.6g}") for s, t, e in rows)
    replace_file(folder / "energy.csv", text.getvalue())
    try:
        plot(results, folder / "energy.png", scene.title)
    except ImportError:
        print("no plot: pip install 'vgmpi[validate]'", file=sys.stderr)
    return 0
