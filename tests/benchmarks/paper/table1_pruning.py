"""Table I of the paper, with and without pruning: python -m tests.benchmarks.paper pruning

Both scenes are run by `mpirun -n 2 python -m vgmpi`: with prune_scale = 1, which keeps every
kernel; as they are (every object with `prune = "versagauss"` pruned); and pruned with
`passive_gaussians = true`, by which the removed kernels are carried along and drawn. All are drawn
by the same 12 fixed cameras around the domain.

Simulation: wall time from the first frame after the start to the last one, by the modification
times of their files, over the number of frames between; start-up and compilation are excluded.
Rendering: processor time of one core per image, from the arrays of a frame to pixels, median.
Kernels: number of simulated kernels.
PSNR: against the run without pruning, over all cameras; inside: where the pruned bodies, drawn
alone from the run without pruning, cover more than half. By chance: as many kernels of each body's
surface and inside, chosen at random and drawn wider, at frame 0; the best of three.
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

from tests.benchmarks.paper import portrait_metrics
from vgmpi.io.run_reader import RunError, RunReader
from vgmpi.postprocess.frames import image_io
from vgmpi.postprocess.frames.appearance import Appearance

RUNS = Path(__file__).resolve().parents[3] / "runs"
FRAME_INTERVAL = 0.04  # [s] frame interval of the paper's scenes
RANDOM_SEEDS = 3  # number of seeds of the random subset
# changes of the pruned bodies
VARIANTS = {"without": "prune_scale=1", "with": "", "passive": "passive_gaussians=true"}


@dataclass(frozen=True)
class PaperScene:
    """A scene of the paper: its title, flags of make_assets.py, and published numbers.

    The numbers are without and with pruning: kernels, seconds of simulation and rendering on an
    A100; PSNR [dB].
    """

    title: str
    assets: str
    kernels: tuple[int, int]
    simulation: tuple[float, float]
    rendering: tuple[float, float]
    psnr: float


PAPER_SCENES = {
    "balls_duck": PaperScene(
        "balls & duck in fluid", "--things duck ball --gaussians 90000 --width 0.85",
        (368_000, 191_000), (25.48, 8.78), (0.26, 0.13), 45.79,
    ),
    "faucet_ducks": PaperScene(
        "faucet & ducks", "--gaussians 90000 --width 0.85",
        (367_000, 71_000), (15.18, 4.84), (0.26, 0.07), 47.26,
    ),
}  # fmt: skip


class StudyError(RuntimeError):
    """Error that ends a study, in one line."""


@dataclass(frozen=True)
class SceneRun:
    """A run of a scene.

    seconds: wall time per frame. counts: particles on the surface and inside of each pruned body.
    """

    run: RunReader
    seconds: float
    counts: dict[str, tuple[int, int]]


@dataclass(frozen=True)
class Row:
    """A scene run in one of VARIANTS.

    kernels: number simulated. simulation, colors: seconds per frame; rendering: per image. first,
    last: PSNR [dB] of these frames, inside and of whole images; chance: PSNR inside of a random
    subset at the first frame. None if not applicable.
    """

    name: str
    variant: str
    kernels: int
    simulation: float
    rendering: float
    colors: float
    first: tuple[float, float] | None = None
    last: tuple[float, float] | None = None
    chance: float | None = None


def study(name: str, folder: Path, args: argparse.Namespace) -> list[Row]:
    """Run and draw a scene in all variants. Raises StudyError, RunError."""
    path = RUNS / name / "scene.toml"
    objects = tomllib.loads(path.read_text(encoding="utf-8"))["object"]
    pruned = [body["name"] for body in objects if body.get("prune", "off") != "off"]
    _make_assets(name)
    runs = []
    for variant, change in VARIANTS.items():
        changes = [f'object."{body}".{change}' for body in pruned if change]
        runs.append(simulated(path, folder / name / variant, [*args.set, *changes], args))
    full, pruned_run = runs[:2]
    looks = [Appearance(scene_run.run) for scene_run in runs]
    views = portrait_metrics.cameras(full.run, args.pixels)
    alpha_min = min(look.alpha_min(None) for look in looks)
    first, last = (
        [portrait_metrics.render_portraits(look, index, views, alpha_min) for look in looks]
        for index in (0, len(full.run) - 1)
    )
    first_masks = _body_masks(full, pruned, 0, first[0], views, alpha_min)
    last_masks = _body_masks(full, pruned, -1, last[0], views, alpha_min)
    parts = _parts(full, pruned_run, pruned)
    chance = max(
        portrait_metrics.psnr(
            first[0].pictures,
            portrait_metrics.random_subset_images(first[0].splats, parts, views, alpha_min, seed),
            first_masks,
        )
        for seed in range(RANDOM_SEEDS)
    )
    _picture(folder / f"{name}.png", [scene_run.pictures[1] for scene_run in last[:2]])
    rows = []
    for scene_run, variant, at_start, at_end in zip(runs, VARIANTS, first, last):
        measured = (
            len(scene_run.run.gaussians.object),
            scene_run.seconds,
            at_end.seconds,
            at_end.colors,
        )
        psnrs = ()
        if scene_run is not full:
            psnrs = (
                _psnr_pair(first[0], at_start, first_masks),
                _psnr_pair(last[0], at_end, last_masks),
            )
        rows.append(
            Row(
                name, variant, *measured, *psnrs, chance=chance if scene_run is pruned_run else None
            )
        )
    return rows


def _psnr_pair(wanted, images, inside: list[np.ndarray]) -> tuple[float, float]:
    """Return the PSNR [dB] of portraits inside and of whole images."""
    return (
        portrait_metrics.psnr(wanted.pictures, images.pictures, inside),
        portrait_metrics.psnr(wanted.pictures, images.pictures),
    )


def simulated(path: Path, folder: Path, overrides: list[str], args: argparse.Namespace) -> SceneRun:
    """Run a scene in a process of its own.

    Args:
        path: Scene.
        folder: Output folder.
        overrides: Arguments of --set.
        args: Arguments of the command line.

    Raises:
        StudyError: If the run fails.
    """
    end = FRAME_INTERVAL * args.frames
    sets = [f"time.end={end!r}", f"time.frames={args.frames + 1}", "output.checkpoint_interval=0"]
    command = [sys.executable, "-m", "vgmpi", path, "-o", folder, "--ranks", args.ranks]
    for item in (*sets, *overrides):
        command += ["--set", item]
    if args.ranks > 1 and shutil.which("mpirun"):
        command = ["mpirun", "-n", args.ranks, *command]
    root = {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"}
    env = {**os.environ, **(root if os.geteuid() == 0 else {})}
    words = [str(word) for word in command]
    print(" ".join(words), file=sys.stderr)
    shutil.rmtree(folder, ignore_errors=True)
    process = subprocess.run(words, env=env, capture_output=True, text=True, cwd=RUNS.parent)
    if process.returncode:
        raise StudyError(
            f"{path}: the run ended with {process.returncode}:\n{process.stderr[-2000:]}"
        )
    run = RunReader(folder)
    written = [run.path(k).stat().st_mtime_ns for k in range(1, len(run))]
    seconds = (written[-1] - written[0]) * 1e-9 / (len(written) - 1)
    counts = re.findall(r"'([^']+)': (\d+) particles on its surface, (\d+) inside", process.stderr)
    return SceneRun(run, seconds, {name: (int(skin), int(inner)) for name, skin, inner in counts})


def _make_assets(name: str) -> None:
    """Make the Gaussians of a scene, reproducibly."""
    script = RUNS / "assets" / "make_assets.py"
    words = [
        sys.executable,
        str(script),
        str(RUNS / name / "assets"),
        *PAPER_SCENES[name].assets.split(),
    ]
    done = subprocess.run(words, capture_output=True, text=True)
    if done.returncode:
        raise StudyError(f"{script}: ended with {done.returncode}:\n{done.stderr[-2000:]}")


def _body_masks(
    scene_run: SceneRun, names: list[str], index: int, portraits, views, alpha_min
) -> list[np.ndarray]:
    """Return the pixels of each image that the bodies `names` cover."""
    run = scene_run.run
    numbers = [k for k, entry in enumerate(run.objects) if entry["name"] in names]
    is_body = np.isin(run.gaussians.object[run.frame(index)["id"]], numbers)
    scenery = len(portraits.splats[0].x) - len(is_body)  # scenery is drawn first
    rows = np.concatenate([np.zeros(scenery, dtype=bool), is_body])
    return portrait_metrics.masks(portraits.splats, rows, views, alpha_min)


def _parts(full: SceneRun, pruned_run: SceneRun, names: list[str]) -> list[tuple[np.ndarray, int]]:
    """Return rows of frame 0 of the full run and how many remain, surface and inside by body."""
    ids = full.run.frame(0)["id"]
    gaussians = full.run.gaussians
    scenery = 0 if gaussians.scenery is None else len(gaussians.scenery.x0)
    row = np.empty(len(ids), dtype=np.int64)
    row[ids] = scenery + np.arange(len(ids))
    parts = []
    for name in names:
        number = next(k for k, e in enumerate(full.run.objects) if e["name"] == name)
        members = np.flatnonzero(gaussians.object == number)  # the surface comes first
        skin = full.counts[name][0]
        remaining = pruned_run.counts[name]
        parts += [(row[members[:skin]], remaining[0]), (row[members[skin:]], remaining[1])]
    return parts


def _picture(path: Path, pair: list[np.ndarray]) -> None:
    """Write both images side by side, and ten times their difference."""
    a, b = pair
    difference = 1 - np.clip(10 * np.abs(a.astype(np.float64) - b), 0, 1)
    image_io.write_png(path, image_io.to_bytes(np.concatenate([a, b, difference], axis=1)))


def table(rows: list[Row], args: argparse.Namespace) -> str:
    """Return the whole table as Markdown."""
    lines = [
        f"# Table I: with and without pruning\n\n{args.ranks} ranks, {args.frames} frames of"
        f" {FRAME_INTERVAL:g} s, pictures of {args.pixels} x {args.pixels} pixels, 12 cameras.\n",
        "| scene | pruning | kernels | paper | simulation s/frame | paper, A100 | at most half |"
        " rendering s/picture | paper, A100 | colors s/frame |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        paper, k = PAPER_SCENES[row.name], row.variant != "without"
        paper_cells = ["-"] * 4
        if row.variant != "passive":
            seconds = (f"{pair[k]:.2f}" for pair in (paper.simulation, paper.rendering))
            half = "yes" if row.simulation <= paper.simulation[k] / 2 else "no"
            paper_cells = [f"{paper.kernels[k] // 1000}k", *seconds, half]
        lines.append(
            f"| {paper.title} | {row.variant} | {row.kernels:,} | {paper_cells[0]} |"
            f" {row.simulation:.2f} | {paper_cells[1]} | {paper_cells[3]} |"
            f" {row.rendering:.3f} | {paper_cells[2]} | {row.colors:.2f} |"
        )
    lines += [
        "\n| scene | pruning | first frame, inside | by chance, inside | first frame, whole |"
        " last frame, inside | last frame, whole | paper, whole |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        if row.variant == "without":
            continue
        is_pruned = row.variant == "with"
        cells = [row.first[0], row.chance, row.first[1], *row.last]
        cells.append(PAPER_SCENES[row.name].psnr if is_pruned else None)
        cells_text = " | ".join("-" if cell is None else f"{cell:.2f} dB" for cell in cells)
        lines.append(f"| {PAPER_SCENES[row.name].title} | {row.variant} | {cells_text} |")
    return "\n".join(lines) + "\n"


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    p = argparse.ArgumentParser(
        prog="python -m tests.benchmarks.paper pruning",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    p.add_argument("-o", "--output", type=Path, default=Path("study"), help="folder [study]")
    p.add_argument("--scenes", nargs="+", choices=PAPER_SCENES, default=list(PAPER_SCENES))
    p.add_argument("--frames", type=int, default=2, help="after the start, from 2 [2]")
    p.add_argument("--ranks", type=int, default=2, help="of MPI, where there is mpirun [2]")
    p.add_argument("--pixels", type=int, default=800, help="edge of the pictures [800]")
    p.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="of the scenes")
    return p


def main(argv: list[str] | None = None) -> int:
    """Run the command and return its exit code."""
    args = parser().parse_args(argv)
    if args.frames < 2 or args.ranks < 1 or not 16 <= args.pixels <= 8192:
        print("allowed: --frames from 2, --ranks from 1, --pixels 16 to 8192", file=sys.stderr)
        return 2
    begin = time.monotonic()
    try:
        rows = [row for name in args.scenes for row in study(name, args.output, args)]
        text = table(rows, args)
        image_io.write(args.output / "table_one.md", text.encode())
    except (StudyError, RunError, image_io.VideoError) as error:
        print(error, file=sys.stderr)
        return 2
    print(text)
    pictures = ", ".join(str(args.output / f"{name}.png") for name in args.scenes)
    print(f"{args.output / 'table_one.md'}, {pictures}: {time.monotonic() - begin:.0f} s")
    return 0
