"""Statements of the paper, measured in our runs: python -m tests.benchmarks.paper statements

Reads the runs that `python runs/gallery.py --small --variants` writes to runs/*/out/small, or with
--full the runs of full size. Lengths are reported in cm.
"""

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from vgmpi.io.run_reader import RunError, RunReader

RUNS = Path(__file__).resolve().parents[3] / "runs"


class RunFrames:
    """Frames of a run, with particles selected by the name of a body."""

    def __init__(self, folder: Path):
        self.run = RunReader(folder)
        self.names = [str(o["name"]) for o in self.run.objects]
        self.object = np.asarray(self.run.gaussians.object)
        self.volume = np.asarray(self.run.gaussians.vol0)
        self.cell = float(self.run.scene["domain"]["cell"])

    def positions(self, name: str, frame: int = -1) -> np.ndarray:
        """Return the positions [m] (n, 3) of a body's particles."""
        fields = self.run.frame(len(self.run) + frame if frame < 0 else frame)
        is_member = self.object[fields["id"]] == self.names.index(name)
        return np.asarray(fields["positions"], dtype=np.float64)[is_member]


def concentration_variance(run_frames: RunFrames) -> tuple[float, float]:
    """Return the relative concentration variance and the height difference of two liquids.

    The variance of the heavy liquid's concentration over cells of two grid spacings is relative to
    that of separated liquids; the difference is that of the mean heights, light minus heavy [m].
    """
    light, heavy = run_frames.positions("light"), run_frames.positions("heavy")
    edge = 2 * run_frames.cell
    cells_of_particles = np.floor(np.concatenate([light, heavy]) / edge).astype(int)
    _, cell = np.unique(cells_of_particles, axis=0, return_inverse=True)
    cell = cell.ravel()
    count = np.bincount(cell)
    share = np.bincount(cell[len(light) :], minlength=len(count)) / count
    mean = np.average(share, weights=count)
    variance = np.average((share - mean) ** 2, weights=count)
    return variance / (mean * (1 - mean)), light[:, 2].mean() - heavy[:, 2].mean()


def surface_heights(x: np.ndarray, points: np.ndarray, within: float) -> np.ndarray:
    """Return the height [m] of the highest particle near each of points (m, 2), or nan."""
    heights = np.full(len(points), np.nan)
    for k, place in enumerate(points):
        is_near = np.abs(x[:, :2] - place).max(axis=1) < within
        if is_near.any():
            heights[k] = x[is_near, 2].max()
    return heights


def mixing(runs: Path) -> Iterator[tuple[str, str]]:
    """Yield the statements about two liquids."""
    for label, value in (("sharp", "0"), ("", "2e-4"), ("fast", "2e-3")):
        variance, higher = concentration_variance(RunFrames(runs / "two_liquids" / label))
        yield (
            f"two liquids, diffusion {value} m2/s: variance of concentration; light above heavy",
            f"{variance:.2f} of that apart; {100 * higher:.1f} cm",
        )


def flood(runs: Path) -> Iterator[tuple[str, str]]:
    """Yield the statements about a castle in a wave."""
    for label, value in (("fine", "1e-3"), ("", "1e-2"), ("gravel", ".1"), ("cobbles", "1")):
        run_frames = RunFrames(runs / "castle_flood" / label)
        begin, end = run_frames.positions("castle", 0), run_frames.positions("castle")
        beyond = (end[:, 0] > begin[:, 0].max() + run_frames.cell).mean()
        carried, _, sunk = 100 * (end.mean(axis=0) - begin.mean(axis=0)) * (1, 1, -1)
        yield (
            f"castle in a wave, permeability {value} m/s: sand carried along; beyond it; sunk",
            f"{carried:.1f} cm; {beyond:.0%}; {sunk:.2f} cm",
        )


def floats(runs: Path) -> Iterator[tuple[str, str]]:
    """Yield the statements about floating bodies."""
    run_frames = RunFrames(runs / "water_on_snow")
    level = np.percentile(run_frames.positions("water")[:, 2], 90)
    snow = run_frames.positions("wall")
    yield (
        "snow of .4 in water: above the level that 90 % of the water lies below",
        (f"{(snow[:, 2] > level).mean():.0%} of the snow"),
    )
    run_frames = RunFrames(runs / "sandbox")
    for name, density_ratio in (("cork", "0.13"), ("wood", "0.94"), ("iron", "3.8")):
        rise = run_frames.positions(name)[:, 2].mean() - run_frames.positions(name, 0)[:, 2].mean()
        yield (
            f"body of {density_ratio} of the sand's density, tilted: rises by",
            f"{100 * rise:+.1f} cm",
        )


def mound(runs: Path) -> Iterator[tuple[str, str]]:
    """Yield the statements about bodies and heaps of sand."""
    run_frames = RunFrames(runs / "castle_falls")
    sand, dents = run_frames.positions("castle"), []
    for name in ("ball", "cube"):
        body = run_frames.positions(name)
        middle, size = body[:, :2].mean(axis=0), np.ptp(body[:, :2], axis=0).max() / 2
        angle = np.linspace(0, 2 * np.pi, 16, endpoint=False)
        ring = middle + 1.6 * size * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        sand_height = np.nanmean(surface_heights(sand, ring, run_frames.cell))
        dents.append(f"{name} {100 * (sand_height - body[:, 2].min()):.1f} cm")
    yield "bodies that fall into the mound: lowest point below the sand around", ", ".join(dents)
    yield (
        "heap of sand of 32 degrees, fallen: slope of its flanks",
        f"{heap_slope(run_frames):.0f} degrees",
    )
    poured = RunFrames(runs / "castle_falls" / "poured")
    yield "the same sand, poured slowly", f"{heap_slope(poured):.0f} degrees"


def heap_slope(run_frames: RunFrames) -> float:
    """Return the slope [degrees] of a heap.

    It is fitted to the heights of rings around its center, between 0.2 and 0.9 of its own height.
    """
    sand = run_frames.positions("castle")
    distance = np.linalg.norm(sand[:, :2] - sand[:, :2].mean(axis=0), axis=1)
    ring = np.floor(distance / (2 * run_frames.cell)).astype(int)
    z = np.array([np.percentile(sand[ring == k, 2], 99) for k in np.unique(ring)])
    r = (np.unique(ring) + 0.5) * 2 * run_frames.cell
    flank = (r > r[z.argmax()]) & (z > 0.2 * z.max()) & (z < 0.9 * z.max())
    return float(np.degrees(np.arctan(-np.polyfit(r[flank], z[flank], 1)[0])))


def parting(runs: Path) -> Iterator[tuple[str, str]]:
    """Yield the statements about a ball and a snowman."""
    for label, case in (
        ("", "at 5 m/s, a field for each"), ("one_field", "at 5 m/s, one field for all"),
        ("slow", "at 1 m/s, a field for each"), ("slow_one_field", "at 1 m/s, one field for all"),
    ):  # fmt: skip
        run_frames = RunFrames(runs / "snowman" / label)
        states = []
        for frame in range(len(run_frames.run)):
            ball = run_frames.positions("ball", frame)
            if len(ball) < 0.5 * (run_frames.object == run_frames.names.index("ball")).sum():
                break
            middle = ball.mean(axis=0)
            radius = np.linalg.norm(ball - middle, axis=1).max()
            snow = run_frames.positions("snowman", frame)
            close = (np.linalg.norm(snow - middle, axis=1) < radius + 2 * run_frames.cell).mean()
            states.append((run_frames.run.times[frame], middle, close))
        (before, previous, _), (time, current, close) = states[-2:]
        speed = np.linalg.norm(current - previous) / (time - before)
        yield (
            f"ball and snowman, {case}: the ball's place, speed, snow within two cells of it",
            f"x = {100 * current[0]:.0f} cm at {time:.2f} s, {speed:.2f} m/s, {close:.1%}",
        )


def main(argv: list[str] | None = None) -> int:
    """Run the command and return its exit code."""
    p = argparse.ArgumentParser(
        prog="python -m tests.benchmarks.paper statements", description=__doc__
    )
    p.add_argument("--full", action="store_true", help="the runs of full size")
    args = p.parse_args(argv)
    print("| what | found |\n|---|---|")
    code = 0
    for statement in (mixing, flood, floats, mound, parting):
        try:
            for what, value in statement(_Folders(args.full)):
                print(f"| {what} | {value} |")
        except RunError as error:  # other runs may exist
            print(error, file=sys.stderr)
            code = 2
    return code


class _Folders:
    """Folders of runs: runs/NAME/out, or its folder of small runs, by `/`."""

    def __init__(self, full: bool):
        self.below = Path("out") if full else Path("out", "small")

    def __truediv__(self, name: str) -> Path:
        return RUNS / name / self.below
