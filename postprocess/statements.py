"""python -m postprocess.study statements: what the paper says of its scenes, measured in ours.

Reads the runs that `python runs/gallery.py --small --variants` leaves in runs/*/out/small, or with
--full those of full size. Lengths are told in cm.
"""

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from vgmpi.output.read import RunError, RunFiles

RUNS = Path(__file__).resolve().parents[1] / "runs"


class Seen:
    """A run at its frames: particles of a body by its name."""

    def __init__(self, folder: Path):
        self.run = RunFiles(folder)
        self.names = [str(o["name"]) for o in self.run.objects]
        self.object = np.asarray(self.run.gaussians.object)
        self.volume = np.asarray(self.run.gaussians.vol0)
        self.cell = float(self.run.scene["domain"]["cell"])

    def of(self, name: str, frame: int = -1) -> np.ndarray:
        """Places [m] (n, 3) of a body's particles."""
        fields = self.run.frame(len(self.run) + frame if frame < 0 else frame)
        mine = self.object[fields["id"]] == self.names.index(name)
        return np.asarray(fields["x"], dtype=np.float64)[mine]


def segregation(seen: Seen) -> tuple[float, float]:
    """Variance of the concentration of the heavy liquid over cells of two spacings of the grid,
    over that of liquids apart; and how much higher the light one's middle lies [m]."""
    light, heavy = seen.of("light"), seen.of("heavy")
    edge = 2 * seen.cell
    both = np.floor(np.concatenate([light, heavy]) / edge).astype(int)
    _, at = np.unique(both, axis=0, return_inverse=True)
    at = at.ravel()
    count = np.bincount(at)
    share = np.bincount(at[len(light) :], minlength=len(count)) / count
    mean = np.average(share, weights=count)
    variance = np.average((share - mean) ** 2, weights=count)
    return variance / (mean * (1 - mean)), light[:, 2].mean() - heavy[:, 2].mean()


def surface(x: np.ndarray, at: np.ndarray, within: float) -> np.ndarray:
    """Heights [m] of the highest of particles x (n, 3) near each of points (m, 2), nan for none."""
    out = np.full(len(at), np.nan)
    for k, place in enumerate(at):
        near = np.abs(x[:, :2] - place).max(axis=1) < within
        if near.any():
            out[k] = x[near, 2].max()
    return out


def mixing(runs: Path) -> Iterator[tuple[str, str]]:
    for label, said in (("sharp", "0"), ("", "2e-4"), ("fast", "2e-3")):
        apart, higher = segregation(Seen(runs / "two_liquids" / label))
        yield (
            f"two liquids, diffusion {said} m2/s: variance of concentration; light above heavy",
            f"{apart:.2f} of that apart; {100 * higher:.1f} cm",
        )


def flood(runs: Path) -> Iterator[tuple[str, str]]:
    for label, said in (("fine", "1e-3"), ("", "1e-2"), ("gravel", ".1"), ("cobbles", "1")):
        seen = Seen(runs / "castle_flood" / label)
        begin, end = seen.of("castle", 0), seen.of("castle")
        beyond = (end[:, 0] > begin[:, 0].max() + seen.cell).mean()
        carried, _, sunk = 100 * (end.mean(axis=0) - begin.mean(axis=0)) * (1, 1, -1)
        yield (
            f"castle in a wave, permeability {said} m/s: sand carried along; beyond it; sunk",
            f"{carried:.1f} cm; {beyond:.0%}; {sunk:.2f} cm",
        )


def floats(runs: Path) -> Iterator[tuple[str, str]]:
    seen = Seen(runs / "water_on_snow")
    level = np.percentile(seen.of("water")[:, 2], 90)
    snow = seen.of("wall")
    yield (
        "snow of .4 in water: above the level that 90 % of the water lies below",
        (f"{(snow[:, 2] > level).mean():.0%} of the snow"),
    )
    seen = Seen(runs / "sandbox")
    for name, said in (("cork", "0.13"), ("wood", "0.94"), ("iron", "3.8")):
        rise = seen.of(name)[:, 2].mean() - seen.of(name, 0)[:, 2].mean()
        yield f"body of {said} of the sand's density, tilted: rises by", f"{100 * rise:+.1f} cm"


def mound(runs: Path) -> Iterator[tuple[str, str]]:
    seen = Seen(runs / "castle_falls")
    sand, dents = seen.of("castle"), []
    for name in ("ball", "cube"):
        body = seen.of(name)
        middle, size = body[:, :2].mean(axis=0), np.ptp(body[:, :2], axis=0).max() / 2
        angle = np.linspace(0, 2 * np.pi, 16, endpoint=False)
        ring = middle + 1.6 * size * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        around = np.nanmean(surface(sand, ring, seen.cell))
        dents.append(f"{name} {100 * (around - body[:, 2].min()):.1f} cm")
    yield "bodies that fall into the mound: lowest point below the sand around", ", ".join(dents)
    yield "heap of sand of 32 degrees, fallen: slope of its flanks", f"{flanks(seen):.0f} degrees"
    poured = Seen(runs / "castle_falls" / "poured")
    yield "the same sand, poured slowly", f"{flanks(poured):.0f} degrees"


def flanks(seen: Seen) -> float:
    """Slope [degrees] of a heap, by the heights of rings around its middle, between .2 and .9 of
    its own."""
    sand = seen.of("castle")
    out = np.linalg.norm(sand[:, :2] - sand[:, :2].mean(axis=0), axis=1)
    ring = np.floor(out / (2 * seen.cell)).astype(int)
    z = np.array([np.percentile(sand[ring == k, 2], 99) for k in np.unique(ring)])
    r = (np.unique(ring) + 0.5) * 2 * seen.cell
    flank = (r > r[z.argmax()]) & (z > 0.2 * z.max()) & (z < 0.9 * z.max())
    return float(np.degrees(np.arctan(-np.polyfit(r[flank], z[flank], 1)[0])))


def parting(runs: Path) -> Iterator[tuple[str, str]]:
    for label, said in (
        ("", "at 5 m/s, a field for each"), ("one_field", "at 5 m/s, one field for all"),
        ("slow", "at 1 m/s, a field for each"), ("slow_one_field", "at 1 m/s, one field for all"),
    ):  # fmt: skip
        seen = Seen(runs / "snowman" / label)
        found = []
        for frame in range(len(seen.run)):
            ball = seen.of("ball", frame)
            if len(ball) < 0.5 * (seen.object == seen.names.index("ball")).sum():
                break
            middle = ball.mean(axis=0)
            radius = np.linalg.norm(ball - middle, axis=1).max()
            snow = seen.of("snowman", frame)
            close = (np.linalg.norm(snow - middle, axis=1) < radius + 2 * seen.cell).mean()
            found.append((seen.run.times[frame], middle, close))
        (before, there, _), (time, here, close) = found[-2:]
        goes = np.linalg.norm(here - there) / (time - before)
        yield (
            f"ball and snowman, {said}: the ball's place, speed, snow within two cells of it",
            f"x = {100 * here[0]:.0f} cm at {time:.2f} s, {goes:.2f} m/s, {close:.1%}",
        )


def main(argv: list[str] | None = None) -> int:
    p = argparse.ArgumentParser(prog="python -m postprocess.study statements", description=__doc__)
    p.add_argument("--full", action="store_true", help="the runs of full size")
    given = p.parse_args(argv)
    print("| what | found |\n|---|---|")
    code = 0
    for each in (mixing, flood, floats, mound, parting):
        try:
            for what, found in each(_Folders(given.full)):
                print(f"| {what} | {found} |")
        except RunError as error:  # the others may be there
            print(error, file=sys.stderr)
            code = 2
    return code


class _Folders:
    """runs/NAME/out, or its folder of small runs, by runs / NAME / label."""

    def __init__(self, full: bool):
        self.below = Path("out") if full else Path("out", "small")

    def __truediv__(self, name: str) -> Path:
        return RUNS / name / self.below
