"""python -m postprocess.study pruning: the paper's Table I, with and without pruning.

Both scenes are run twice by `mpirun -n 2 python -m vgmpi`, as they stand (every object with
`prune = "paper"` thinned) and with prune_scale = 1, which keeps every kernel. Both are drawn by
the same 12 fixed cameras around the domain.

Simulation: wall time from the first frame after the start to the last one, by the times their
files were written, over the number of frames between; start-up and compilation come before.
Rendering: processor time of one core per picture, from the arrays of a frame to pixels, median.
PSNR: pruned against not pruned, over all cameras; inside: where the pruned bodies, drawn alone and
not pruned, cover more than half. By chance: as many kernels of each body's surface and inside,
chosen at random and drawn as large, at frame 0; the best of three.
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
from vgmpi.output.read import Run, RunError

RUNS = Path(__file__).resolve().parents[1] / "runs"
FRAME = 0.04  # [s] of the paper's configurations
CHANCES = 3  # seeds


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

    run: Run
    seconds: float
    counts: dict[str, tuple[int, int]]


@dataclass(frozen=True)
class Row:
    """What was found of a scene; pairs are without and with pruning. psnr: at the first and the
    last frame, each inside and of whole pictures; chance: the former inside, by chance [dB]."""

    name: str
    kernels: tuple[int, int]
    simulation: tuple[float, float]
    rendering: tuple[float, float]
    colours: tuple[float, float]
    first: tuple[float, float]
    last: tuple[float, float]
    chance: float


def study(name: str, folder: Path, args: argparse.Namespace) -> Row:
    """Run and draw a scene both ways. Raises StudyError, RunError."""
    path = RUNS / name / "scene.toml"
    things = tomllib.loads(path.read_text(encoding="utf-8"))["object"]
    pruned = [thing["name"] for thing in things if thing.get("prune", "off") != "off"]
    _assets(name)
    whole = [f'object."{thing}".prune_scale=1' for thing in pruned]
    full = simulated(path, folder / name / "whole", [*args.set, *whole], args)
    thin = simulated(path, folder / name / "pruned", args.set, args)
    looks = [Look(made.run) for made in (full, thin)]
    views = likeness.cameras(full.run, args.pixels)
    alpha_min = min(look.alpha_min(None) for look in looks)
    found = []
    for index in (0, len(full.run) - 1):
        found.append([likeness.portraits(look, index, views, alpha_min) for look in looks])
    inside = [_inside(full, pruned, index, a, views, alpha_min) for index, (a, _) in
              zip((0, -1), found)]  # fmt: skip
    psnr = [
        (
            likeness.decibels(a.pictures, b.pictures, mask),
            likeness.decibels(a.pictures, b.pictures),
        )
        for (a, b), mask in zip(found, inside)
    ]
    parts = _parts(full, thin, pruned)
    still = found[0][0]
    chance = max(
        likeness.decibels(
            still.pictures,
            likeness.by_chance(still.splats, parts, views, alpha_min, seed),
            inside[0],
        )
        for seed in range(CHANCES)
    )
    _picture(folder / f"{name}.png", [one.pictures[1] for one in found[-1]])
    last = found[-1]
    return Row(
        name,
        tuple(len(made.run.gaussians.object) for made in (full, thin)),
        (full.seconds, thin.seconds),
        tuple(one.seconds for one in last),
        tuple(one.colours for one in last),
        psnr[0],
        psnr[1],
        chance,
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
    run = Run(folder)
    written = [frame.stat().st_mtime_ns for frame in run.frames[1:]]
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
        known = KNOWN[row.name]
        for k, how in enumerate(("without", "with")):
            half = "yes" if row.simulation[k] <= known.simulation[k] / 2 else "no"
            lines.append(
                f"| {known.title} | {how} | {row.kernels[k]:,} | {known.kernels[k] // 1000}k |"
                f" {row.simulation[k]:.2f} | {known.simulation[k]:.2f} | {half} |"
                f" {row.rendering[k]:.3f} | {known.rendering[k]:.2f} | {row.colours[k]:.2f} |"
            )
    lines += [
        "\n| scene | first frame, inside | by chance, inside | first frame, whole |"
        " last frame, inside | last frame, whole | paper, whole |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        lines.append(
            f"| {KNOWN[row.name].title} | {row.first[0]:.2f} dB | {row.chance:.2f} dB |"
            f" {row.first[1]:.2f} dB | {row.last[0]:.2f} dB | {row.last[1]:.2f} dB |"
            f" {KNOWN[row.name].psnr:.2f} dB |"
        )
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
        rows = [study(name, args.output, args) for name in args.scenes]
        text = table(rows, args)
        video.write(args.output / "table_one.md", text.encode())
    except (StudyError, RunError, video.VideoError) as error:
        print(error, file=sys.stderr)
        return 2
    print(text)
    pictures = ", ".join(str(args.output / f"{name}.png") for name in args.scenes)
    print(f"{args.output / 'table_one.md'}, {pictures}: {time.monotonic() - begin:.0f} s")
    return 0
