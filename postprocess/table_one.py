"""python -m postprocess.study pruning: the paper's Table I, with and without pruning.

Both scenes are run by `mpirun -n 2 python -m vgmpi`: with prune_scale = 1, which keeps every
kernel; as they stand (every object with `prune = "paper"` thinned); and thinned with
`passive = true`, by which the dropped kernels ride along and are drawn. All are drawn by the same
12 fixed cameras around the domain.

Simulation: wall time from the first frame after the start to the last one, by the times their
files were written, over the number of frames between; start-up and compilation come before.
Rendering: processor time of one core per picture, from the arrays of a frame to pixels, median.
Kernels: those that are simulated.
PSNR: against the run without pruning, over all cameras; inside: where the pruned bodies, drawn
alone and not pruned, cover more than half. By chance: as many kernels of each body's surface and
inside, chosen at random and drawn wider, at frame 0; the best of three.
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import time
import tomllib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from postprocess import likeness, video
from postprocess.look import Look
from vgmpi.output.read import RunError, RunFiles

RUNS = Path(__file__).resolve().parents[1] / "runs"
FRAME = 0.04  # [s] of the paper's configurations
CHANCES = 3  # seeds
WAYS = {"without": "prune_scale=1", "with": "", "passive": "passive=true"}  # changes of bodies


@dataclass(frozen=True)
class Known:
    """A scene: its name in the paper, the flags of make_assets.py, and the paper's numbers
    without and with pruning: kernels, seconds of simulation and rendering on an A100; PSNR [dB]."""

    title: str
    assets: str
    kernels: tuple[int, int]
    simulation: tuple[float, float]
    rendering: tuple[float, float]
    psnr: float


KNOWN = {
    "balls_duck": Known(
        "balls & duck in fluid", "--things duck ball --gaussians 90000 --width 0.85",
        (368_000, 191_000), (25.48, 8.78), (0.26, 0.13), 45.79,
    ),
    "faucet_ducks": Known(
        "faucet & ducks", "--gaussians 90000 --width 0.85",
        (367_000, 71_000), (15.18, 4.84), (0.26, 0.07), 47.26,
    ),
}  # fmt: skip


class StudyError(RuntimeError):
    """Why a study cannot go on, in one line."""


@dataclass(frozen=True)
class Made:
    """A run of a scene. seconds: wall time per frame. counts: of each thinned body, particles on
    its surface and inside."""

    run: RunFiles
    seconds: float
    counts: dict[str, tuple[int, int]]


@dataclass(frozen=True)
class Row:
    """A scene run in one of WAYS. kernels: simulated. simulation, colours: seconds per frame;
    rendering: per picture. first, last: PSNR [dB] of these frames, each inside and of whole
    pictures; chance: of the first, inside, by chance. None where there is none."""

    name: str
    how: str
    kernels: int
    simulation: float
    rendering: float
    colours: float
    first: tuple[float, float] | None = None
    last: tuple[float, float] | None = None
    chance: float | None = None


def study(name: str, folder: Path, args: argparse.Namespace) -> list[Row]:
    """Run and draw a scene in all ways. Raises StudyError, RunError."""
    path = RUNS / name / "scene.toml"
    things = tomllib.loads(path.read_text(encoding="utf-8"))["object"]
    pruned = [thing["name"] for thing in things if thing.get("prune", "off") != "off"]
    _assets(name)
    made = []
    for how, change in WAYS.items():
        changes = [f'object."{thing}".{change}' for thing in pruned if change]
        made.append(simulated(path, folder / name / how, [*args.set, *changes], args))
    full, thin = made[:2]
    looks = [Look(one.run) for one in made]
    views = likeness.cameras(full.run, args.pixels)
    alpha_min = min(look.alpha_min(None) for look in looks)
    first, last = (
        [likeness.portraits(look, index, views, alpha_min) for look in looks]
        for index in (0, len(full.run) - 1)
    )
    at_first = _inside(full, pruned, 0, first[0], views, alpha_min)
    at_last = _inside(full, pruned, -1, last[0], views, alpha_min)
    parts = _parts(full, thin, pruned)
    chance = max(
        likeness.psnr(
            first[0].pictures,
            likeness.by_chance(first[0].splats, parts, views, alpha_min, seed),
            at_first,
        )
        for seed in range(CHANCES)
    )
    _picture(folder / f"{name}.png", [one.pictures[1] for one in last[:2]])
    rows = []
    for one, how, begun, ended in zip(made, WAYS, first, last):
        measured = (len(one.run.gaussians.object), one.seconds, ended.seconds, ended.colours)
        alike = ()
        if one is not full:
            alike = (_alike(first[0], begun, at_first), _alike(last[0], ended, at_last))
        rows.append(Row(name, how, *measured, *alike, chance=chance if one is thin else None))
    return rows


def _alike(wanted, got, inside: list[np.ndarray]) -> tuple[float, float]:
    """PSNR [dB] of portraits inside and of whole pictures."""
    return (
        likeness.psnr(wanted.pictures, got.pictures, inside),
        likeness.psnr(wanted.pictures, got.pictures),
    )


def simulated(path: Path, folder: Path, overrides: list[str], args: argparse.Namespace) -> Made:
    """Run a scene in a process of its own. Raises StudyError."""
    end = FRAME * args.frames
    sets = [f"time.end={end!r}", f"time.frames={args.frames + 1}", "output.checkpoint=0"]
    command = [sys.executable, "-m", "vgmpi", path, "-o", folder]
    for item in (*sets, *overrides):
        command += ["--set", item]
    if args.ranks > 1 and shutil.which("mpirun"):
        command = ["mpirun", "-n", args.ranks, *command]
    root = {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"}
    env = {**os.environ, **(root if os.geteuid() == 0 else {})}
    words = [str(word) for word in command]
    print(" ".join(words), file=sys.stderr)
    shutil.rmtree(folder, ignore_errors=True)
    done = subprocess.run(words, env=env, capture_output=True, text=True, cwd=RUNS.parent)
    if done.returncode:
        raise StudyError(f"{path}: the run ended with {done.returncode}:\n{done.stderr[-2000:]}")
    run = RunFiles(folder)
    written = [run.path(k).stat().st_mtime_ns for k in range(1, len(run))]
    seconds = (written[-1] - written[0]) * 1e-9 / (len(written) - 1)
    told = re.findall(r"'([^']+)': (\d+) particles on its surface, (\d+) inside", done.stderr)
    return Made(run, seconds, {name: (int(skin), int(inner)) for name, skin, inner in told})


def _assets(name: str) -> None:
    """Make the Gaussians of a scene: the same bytes every time."""
    script = RUNS / "assets" / "make_assets.py"
    words = [sys.executable, str(script), str(RUNS / name / "assets"), *KNOWN[name].assets.split()]
    done = subprocess.run(words, capture_output=True, text=True)
    if done.returncode:
        raise StudyError(f"{script}: ended with {done.returncode}:\n{done.stderr[-2000:]}")


def _inside(made: Made, names: list[str], index: int, shown, views, alpha_min) -> list[np.ndarray]:
    """Pixels of each picture that the bodies `names` cover."""
    run = made.run
    numbers = [k for k, entry in enumerate(run.objects) if entry["name"] in names]
    of = np.isin(run.gaussians.object[run.frame(index)["id"]], numbers)
    scenery = len(shown.splats[0].x) - len(of)  # drawn first
    rows = np.concatenate([np.zeros(scenery, dtype=bool), of])
    return likeness.masks(shown.splats, rows, views, alpha_min)


def _parts(full: Made, thin: Made, names: list[str]) -> list[tuple[np.ndarray, int]]:
    """Rows of frame 0 of the full run and how many stay: surface and inside of every body."""
    ids = full.run.frame(0)["id"]
    rest = full.run.gaussians
    scenery = 0 if rest.scenery is None else len(rest.scenery.x0)
    row = np.empty(len(ids), dtype=np.int64)
    row[ids] = scenery + np.arange(len(ids))
    parts = []
    for name in names:
        number = next(k for k, e in enumerate(full.run.objects) if e["name"] == name)
        own = np.flatnonzero(rest.object == number)  # the surface comes first
        skin = full.counts[name][0]
        left = thin.counts[name]
        parts += [(row[own[:skin]], left[0]), (row[own[skin:]], left[1])]
    return parts


def _picture(path: Path, pair: list[np.ndarray]) -> None:
    """Both pictures side by side, and ten times their difference."""
    a, b = pair
    difference = 1 - np.clip(10 * np.abs(a.astype(np.float64) - b), 0, 1)
    video.write_png(path, video.to_bytes(np.concatenate([a, b, difference], axis=1)))


def table(rows: list[Row], args: argparse.Namespace) -> str:
    """The whole table as Markdown."""
    lines = [
        f"# Table I: with and without pruning\n\n{args.ranks} ranks, {args.frames} frames of"
        f" {FRAME:g} s, pictures of {args.pixels} x {args.pixels} pixels, 12 cameras.\n",
        "| scene | pruning | kernels | paper | simulation s/frame | paper, A100 | at most half |"
        " rendering s/picture | paper, A100 | colours s/frame |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        known, k = KNOWN[row.name], row.how != "without"
        theirs = ["-"] * 4
        if row.how != "passive":
            seconds = (f"{both[k]:.2f}" for both in (known.simulation, known.rendering))
            half = "yes" if row.simulation <= known.simulation[k] / 2 else "no"
            theirs = [f"{known.kernels[k] // 1000}k", *seconds, half]
        lines.append(
            f"| {known.title} | {row.how} | {row.kernels:,} | {theirs[0]} |"
            f" {row.simulation:.2f} | {theirs[1]} | {theirs[3]} |"
            f" {row.rendering:.3f} | {theirs[2]} | {row.colours:.2f} |"
        )
    lines += [
        "\n| scene | pruning | first frame, inside | by chance, inside | first frame, whole |"
        " last frame, inside | last frame, whole | paper, whole |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        if row.how == "without":
            continue
        thin = row.how == "with"
        cells = [row.first[0], row.chance, row.first[1], *row.last]
        cells.append(KNOWN[row.name].psnr if thin else None)
        said = " | ".join("-" if cell is None else f"{cell:.2f} dB" for cell in cells)
        lines.append(f"| {KNOWN[row.name].title} | {row.how} | {said} |")
    return "\n".join(lines) + "\n"


def parser() -> argparse.ArgumentParser:
    p = argparse.ArgumentParser(
        prog="python -m postprocess.study pruning",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    p.add_argument("-o", "--output", type=Path, default=Path("study"), help="folder [study]")
    p.add_argument("--scenes", nargs="+", choices=KNOWN, default=list(KNOWN))
    p.add_argument("--frames", type=int, default=2, help="after the start, from 2 [2]")
    p.add_argument("--ranks", type=int, default=2, help="of MPI, where there is mpirun [2]")
    p.add_argument("--pixels", type=int, default=800, help="edge of the pictures [800]")
    p.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="of the scenes")
    return p


def main(argv: list[str] | None = None) -> int:
    args = parser().parse_args(argv)
    if args.frames < 2 or args.ranks < 1 or not 16 <= args.pixels <= 8192:
        print("allowed: --frames from 2, --ranks from 1, --pixels 16 to 8192", file=sys.stderr)
        return 2
    begin = time.monotonic()
    try:
        rows = [row for name in args.scenes for row in study(name, args.output, args)]
        text = table(rows, args)
        video.write(args.output / "table_one.md", text.encode())
    except (StudyError, RunError, video.VideoError) as error:
        print(error, file=sys.stderr)
        return 2
    print(text)
    pictures = ", ".join(str(args.output / f"{name}.png") for name in args.scenes)
    print(f"{args.output / 'table_one.md'}, {pictures}: {time.monotonic() - begin:.0f} s")
    return 0
