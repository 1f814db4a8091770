"""Numbers of scenes found again from an honest reference: a run in cells half as large, of another
seed, in the other precision, with noise on what its probe tells, or on its pictures, which a camera
took that is off by a pixel.

python -m tests.benchmarks.recovery [NAME ...] [--repeats 10] prints what each fit finds.
"""

import argparse
import csv
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.support.fit_scenes import write_fit
from tests.support.recovery_scenes import CASES, Case
from vgmpi import api
from vgmpi.postprocess.frames.image_io import to_bytes, write_png
from vgmpi.tools.fit.__main__ import target_of
from vgmpi.tools.fit.evaluations import Evaluations
from vgmpi.tools.fit.fit_config import FitFile
from vgmpi.tools.fit.run_pool import RunPool
from vgmpi.tools.fit.target_base import Pictures
from vgmpi.tools.fit.workflow import interval, run_fit

NOISE = 0.05  # of a column's range, of white
WIDTH, HEIGHT = 128, 96  # pixels

VIEW = """
[camera]
kind = "fixed"
eye = {eye}
target = {target}
fov = {fov}
[picture]
width = {width}
height = {height}
background = "#808080"
[look]
preset = "paper"
"""

FIT = """
[[parameter]]
key = "{key}"
range = [{low!r}, {high!r}]
initial = {initial!r}
[target]
{target}
[method]
discretization_check = "{grid}"
"""


def honest(case: Case, folder: Path) -> dict[str, np.ndarray]:
    """What is told of a run in cells half as large, of another seed, in the other precision: times
    [s] and columns of its probe, or "pictures" (frames, height, width, 3) from a camera that is off
    by a pixel."""
    scene = api.load(folder / "scene.toml", (), case.scene)
    changes = {"domain.cell": scene.domain.cell / 2, "accuracy.precision": "double", "seed": 2}
    fine = api.load(folder / "scene.toml", changes, case.scene)
    run = api.run(fine, folder / "reference" if case.camera else None, overwrite=True)
    assert run.code == 0
    if not case.camera:
        rows = run.probes["it"]
        return {c: np.array([r[c] for r in rows]) for c in ("time", *case.columns)}
    eye, target, fov = case.camera
    (folder / "off.toml").write_text(view(eye, aside(eye, target, fov), fov))
    pictures = Pictures(folder / "off.toml")
    return {"pictures": pictures.render_run(folder / "reference", list(range(scene.time.frames)))}


def aside(eye, target, fov: float) -> list[float]:
    """What the camera looks at when it is turned by a pixel."""
    way = np.subtract(target, eye)
    right = np.cross(way, [0, 0, 1])
    right /= np.linalg.norm(right)
    up = np.cross(right, way / np.linalg.norm(way))
    pixel = 2 * np.tan(np.radians(fov / 2)) * np.linalg.norm(way) / HEIGHT
    return (target + pixel * (0.8 * right + 0.6 * up)).tolist()


def view(eye, target, fov: float) -> str:
    """A render.toml."""
    return VIEW.format(eye=list(eye), target=list(target), fov=fov, width=WIDTH, height=HEIGHT)


def noisy(told: dict[str, np.ndarray], columns, folder: Path, seed: int) -> None:
    """The same with noise, of NOISE of each column's range or of white, as files."""
    chance = np.random.default_rng(seed)
    if "pictures" in told:
        noise = NOISE * chance.normal(size=told["pictures"].shape)
        for k, picture in enumerate(told["pictures"] + noise):
            write_png(folder / "film" / f"{k:03d}.png", to_bytes(picture))
        return
    out = dict(told)
    for c in columns:
        width = np.nanmax(told[c]) - np.nanmin(told[c])
        out[c] = told[c] + NOISE * width * chance.normal(size=len(told[c]))
    with open(folder / "noisy.csv", "w", newline="") as f:
        csv.writer(f).writerows([list(out), *zip(*out.values())])


@dataclass(frozen=True)
class Result:
    """What a fit found, its interval of 95 %, and how many runs it took."""

    value: float
    interval: tuple[float, float]
    runs: int
    seconds: float

    def covers(self, true: float) -> bool:
        return self.interval[0] <= true <= self.interval[1]


def recover(case: Case, folder: Path, told: dict[str, np.ndarray], seed: int) -> Result:
    """A fit to the reference with that noise."""
    if case.camera:
        target = 'video = "film"\nrender = "render.toml"\nmax_camera_shift = 3'
        (folder / "render.toml").write_text(view(*case.camera))
    else:
        columns = ", ".join(f'"{c}"' for c in case.columns)
        target = f'table = "noisy.csv"\nprobe = "it"\ncolumns = [{columns}]'
    low, high = case.range
    text = FIT.format(
        key=case.key, low=low, high=high, initial=case.initial, target=target, grid=case.grid
    )
    scene, fit = write_fit(folder, case.scene, text)
    noisy(told, case.columns, folder, seed)
    file = FitFile(fit, api.load(scene))
    began = time.perf_counter()
    runs = RunPool(file.scene, folder / "runs")
    trials = Evaluations(runs, file.axes, target_of(file), file.settings.method.max_runs)
    found = run_fit(file, trials)
    took = time.perf_counter() - began
    ends = interval(found, file, 0) or (np.nan, np.nan)
    return Result(found.best.values[0], ends, len(trials.all), took)


def main() -> int:
    p = argparse.ArgumentParser(description=__doc__)
    p.add_argument("names", nargs="*", choices=[*CASES, []])
    p.add_argument("--repeats", type=int, default=1)
    given = p.parse_args()
    for name in given.names or CASES:
        case = CASES[name]
        with tempfile.TemporaryDirectory() as place:
            told, inside, off = honest(case, Path(place)), 0, []
            for seed in range(given.repeats):
                one = recover(case, Path(place), told, seed)
                inside, off = inside + one.covers(case.true), [*off, one.value / case.true - 1]
                ends = " .. ".join(f"{x:.5g}" for x in one.interval)
                said = f"{one.value:.5g} ({100 * off[-1]:+.2f} %), {ends}, {one.runs} runs"
                print(f"{name}: {said}, {one.seconds:.0f} s", flush=True)
            worst = 100 * max(map(abs, off))
            print(f"{name}: worst {worst:.2f} %, {inside} of {len(off)} cover {case.true:g}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
