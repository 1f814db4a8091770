"""What is left of a scene's motion after many steps, with each transfer: one run each, as long as
the scene says, with its time step.

Left: 1 + (E - E0) / K, of the whole energy E (kinetic, elastic, of height) and of that at the start
E0, and of the largest kinetic energy K. Whoever keeps energy has 1 for ever; 0 or less is rest.
"""

import argparse
import csv
import sys
from pathlib import Path

import numpy as np

from ..output import layout, ledger
from ..output.read import RunError
from ..planning.studied import FOLDER
from ..scene.reader import load
from ..tables import SceneError
from .knobs import PLAIN, Setting
from .runs import Study, StudyError

TRANSFERS = ("restored", "apic", "aflip", "flip", "pic")
MARKS = (1000, 10_000, 100_000)  # steps of which is told
COLUMNS = ("scene", "transfer", "step", "time", "left")


def left(folder: Path) -> np.ndarray:
    """Rows of (step, time [s], what is left) of a run's ledger, one for each frame."""
    rows = ledger.read(folder / layout.LEDGER)
    when = np.array([(row["step"], row["time"]) for row in rows], float)
    when, at = np.unique(when, axis=0, return_inverse=True)
    kinetic, other = (
        np.bincount(at.ravel(), weights=[sum(row[k] for k in keys) for row in rows])
        for keys in (("kinetic",), ("elastic", "potential"))
    )
    whole = kinetic + other
    return np.column_stack([when, 1 + (whole - whole[0]) / max(kinetic.max(), 1e-300)])


def table(found: dict[str, np.ndarray]) -> list[str]:
    """A line for each transfer: what is left at the marks, and the most there ever was."""
    last = max(int(rows[-1, 0]) for rows in found.values())
    marks = [m for m in MARKS if m <= last] or [last]
    head = ["transfer", *(f"{m:,} steps" for m in marks), "most"]
    out = [f"| {' | '.join(head)} |", f"|{'---|' * len(head)}"]
    for name, rows in found.items():
        cells = [f"{rows[np.searchsorted(rows[:, 0], m), 2]:.4f}" for m in marks]
        out.append(f"| {' | '.join([name, *cells, f'{rows[:, 2].max():.4f}'])} |")
    return out


def plot(found: dict[str, np.ndarray], path: Path, title: str) -> None:
    """What is left over the steps. Raises ImportError without matplotlib."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(6, 3.4), dpi=120)
    for name, rows in found.items():
        axes.semilogx(rows[1:, 0], rows[1:, 2], label=name)
    axes.set_xlabel("steps")
    axes.set_ylabel("left of the motion's energy")
    axes.set_ylim(-0.05, max(1.1, 1.05 * max(rows[:, 2].max() for rows in found.values())))
    axes.set_title(title, fontsize=9)
    axes.legend(fontsize=8)
    figure.tight_layout()
    figure.savefig(path)
    pyplot.close(figure)


def runs(study: Study) -> dict[str, np.ndarray]:
    """What is left with each transfer that the scene can be run with. Raises StudyError."""
    own = study.scene.accuracy.transfer
    others = [
        Setting((("transfer", kind),), (f"accuracy.transfer={kind}",))
        for kind in TRANSFERS
        if kind != own
    ]
    took = study.all([PLAIN, *others], {PLAIN})
    names = {PLAIN: own, **{one: dict(one.knobs)["transfer"] for one in others}}
    found = {names[one]: left(study.place(one)) for one in took}
    return {kind: found[kind] for kind in TRANSFERS if kind in found}


def main(argv: list[str]) -> int:
    p = argparse.ArgumentParser(
        prog="python -m vgmpi.study energy", description=__doc__,
        formatter_class=argparse.RawTextHelpFormatter,
    )  # fmt: skip
    p.add_argument("scene", type=Path)
    p.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="as in vgmpi")
    p.add_argument("-o", "--output", type=Path, help="folder of the runs [SCENE's/tradeoff/STEM]")
    p.add_argument("--ranks", type=int, default=1, help="of each run")
    given = p.parse_args(argv)
    folder = given.output or given.scene.resolve().parent / FOLDER / given.scene.stem
    try:
        scene = load(given.scene, given.set)
        found = runs(Study(scene, folder, given.ranks))
    except SceneError as error:
        print("\n".join(error.lines), file=sys.stderr)
        return 2
    except (StudyError, RunError) as error:
        print(f"vgmpi: {error}", file=sys.stderr)
        return 1
    print("\n".join(table(found)))
    with open(folder / "energy.csv", "w", newline="") as file:
        out = csv.writer(file)
        out.writerow(COLUMNS)
        for kind, rows in found.items():
            out.writerows(
                (scene.path.stem, kind, int(s), f"{t:.6g}", f"{e:.6g}") for s, t, e in rows
            )
    try:
        plot(found, folder / "energy.png", scene.title)
    except ImportError:
        print("no plot: pip install 'vgmpi[validate]'", file=sys.stderr)
    return 0
