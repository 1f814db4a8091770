"""Size and times of the page that plays a run, of a run's files or of made-up motion.

    python -m tests.benchmarks moving-page                     300,000 Gaussians, 250 frames
    python -m tests.benchmarks moving-page --folder out           a run of your own
    python -m tests.benchmarks moving-page --accuracy 1e-4     another accuracy [cells]

The made-up motion is harder than most runs: two thirds are a liquid of 8 particles per cell in an
unsteady flow with eddies of 8 to 40 cells, of up to 0.7 cells per frame, in which every particle
also trembles; one third are ten bodies that turn and vibrate.
"""

import functools
import io
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tests.support.headless_browser import FLAGS, find_chromium
from vgmpi.gaussians import spherical_harmonics as harmonics
from vgmpi.gaussians.camera import look_at
from vgmpi.gaussians.cloud import rotation_matrices
from vgmpi.gaussians.formats import motion_stream as layout
from vgmpi.gaussians.formats.motion_stream import (
    GroupState,
    MotionGroup,
    MotionWriter,
    RestGaussians,
)
from vgmpi.gaussians.formats.residual_coding import morton_order
from vgmpi.io.run_reader import RunReader
from vgmpi.postprocess.export.run_motion import RunMotion
from vgmpi.postprocess.frames import render_config
from vgmpi.postprocess.frames.appearance import Appearance
from vgmpi.postprocess.frames.frame_renderer import visible_extent
from vgmpi.postprocess.raster import rasterize
from vgmpi.postprocess.web import web_page

TREMBLE = 0.01  # [cells] of a particle's own change of velocity per frame
BODIES = 10
VIEW = {
    "camera": {"eye": [20, -90, 60], "target": [20, 20, 12], "up": [0, 0, 1], "fov": 36},
    "background": [1, 1, 1], "alpha_min": 1 / 255, "lowpass": 0.3, "antialias": False, "fps": 25,
}  # fmt: skip


class Sizes(NamedTuple):
    """What was measured on this machine."""

    count: int
    frames: int
    page: int  # [bytes]
    rest: int  # [bytes]
    stream: int  # [bytes] of all frames
    encode: float  # [s] per frame
    error: float  # [cells] largest of a position in the last frame


def flow(x: np.ndarray, t: int, modes: np.ndarray) -> np.ndarray:
    """Velocity [cells per frame] of a flow without divergence at points (n, 3)."""
    out = np.zeros_like(x)
    for k, (wave, amplitude, phase, rate) in enumerate(modes):
        a, b, c = np.roll([0, 1, 2], k)
        out[:, a] += amplitude * np.sin(wave * x[:, b] + phase + rate * t)
        out[:, b] += amplitude * np.cos(wave * x[:, c] + phase - rate * t)
    return out


def made_up(count: int, frames: int, seed: int = 0) -> tuple[list, RestGaussians, Iterator]:
    """Groups, rest Gaussians and states of frames; lengths in cells."""
    rng = np.random.default_rng(seed)
    liquid, body = count - count // 3, count // 3 // BODIES
    side = (liquid / 8 / 0.5) ** (1 / 3)
    x = rng.uniform(0, 1, (liquid, 3)) * [side, side, side / 2]
    x = x[morton_order(x, 0.25)]
    bodies = [rng.normal(0, 2.5, (body, 3)) for _ in range(BODIES)]
    bodies = [points[morton_order(points, 0.25)] for points in bodies]
    groups = [MotionGroup("liquid", liquid, layout.FREE, layout.SIZE)]
    groups += [
        MotionGroup(f"body {k}", body, layout.FREE, layout.DEFORMATION) for k in range(BODIES)
    ]
    n = liquid + BODIES * body
    root = np.zeros((n, 6))
    root[:, (0, 3, 5)] = rng.uniform(0.1, 0.3, (n, 3))
    root[:liquid, 0] = root[:liquid, 3] = root[:liquid, 5] = 0.31
    sh = np.zeros((n, 4, 3))
    sh[:, 0] = rng.normal(0, 0.5, (n, 3))
    sh[liquid:, 1:] = rng.normal(0, 0.1, (n - liquid, 3, 3))
    rest = RestGaussians(np.concatenate([x, *bodies]), root, rng.uniform(0.2, 1, n), sh)
    return groups, rest, _states(rng, x, bodies, frames)


def _states(rng, x: np.ndarray, bodies: list, frames: int) -> Iterator:
    """States of the frames."""
    lengths = np.geomspace(8, 40, 6)
    modes = np.array([(2 * np.pi / s, 0.02 * s**0.5, rng.uniform(0, 6), 0.05) for s in lengths])
    own = np.zeros_like(x)
    for t in range(frames):
        own = 0.9 * own + TREMBLE * rng.normal(size=x.shape)
        x = x + flow(x, t, modes) + own
        states = [GroupState(np.ones(len(x), bool), x, 1 + 0.002 * rng.normal(size=len(x)))]
        for k, points in enumerate(bodies):
            angle = 0.04 * t + k
            quat = np.array(
                [np.cos(angle / 2), 0.6 * np.sin(angle / 2), 0, 0.8 * np.sin(angle / 2)]
            )
            stretch = 1 + 0.05 * np.sin(0.5 * t + k) * np.cos(0.6 * points[:, :1])
            triangles = np.concatenate([stretch, 0 * points[:, :2], 1 / stretch], axis=1)
            triangles = np.column_stack([triangles, 0 * stretch, np.ones(len(points))])
            moved = (points * [1, 1, 1]) @ rotation_matrices(quat[None])[0].T
            moved = moved + [6.0 * (k % 5), 8.0 * (k // 5), 30 + 0.01 * t * t]
            present = np.ones(len(points), bool)
            states.append(
                GroupState(present, moved, None, np.tile(quat, (len(points), 1)), triangles)
            )
        yield float(t), states, []


def similarity(folder: Path, path: Path) -> float:
    """PSNR [dB] of the last frame of a page beside the run's, by the renderer, 512 pixels wide."""
    run, reader = RunReader(folder), web_page.read_page(path)
    look = Appearance(run, render_config.load(None).look)
    view, index = reader.header["view"], run.available_frames(range(len(run)))[len(reader) - 1]
    camera = look_at(*(view["camera"][k] for k in ("eye", "target", "up", "fov")), 512, 384)
    frame, sh = reader.frame(len(reader) - 1), reader.rest.sh.copy()
    sh[:, 0] = harmonics.dc_from_rgb(frame.rgb)
    directions = np.einsum("nij,ni->nj", frame.rotation, frame.x - camera.eye)
    color = np.maximum(harmonics.evaluate(sh, directions), 0)
    opacity = reader.rest.opacity * frame.present
    decoded = rasterize.ProjectableGaussians(frame.x, frame.cov, opacity, color)
    drawn = look.splats(look.frame(index), camera.eye)
    a, b = (
        np.clip(rasterize.render(splats, camera, alpha_min=view["alpha_min"])[0], 0, 1)
        for splats in (decoded, drawn)
    )
    return float(10 * np.log10(1 / np.mean((a - b) ** 2)))


def of_run(folder: Path, frames: int) -> tuple[list, RestGaussians, Iterator, float, dict]:
    """The same of the files of a run, and its cell and view."""
    run = RunReader(folder)
    settings = render_config.load(None)
    look = Appearance(run, settings.look)
    motion = RunMotion(look, min(len(run), frames) // 2)
    box = functools.cache(lambda: visible_extent(run))
    view = web_page.view_settings(look, settings, Path("."), box, 25.0)

    def states() -> Iterator:
        for index in run.available_frames(range(len(run)))[:frames]:
            frame = look.frame(index)
            yield float(run.times[index]), motion.states(frame), motion.poses(frame)

    return motion.groups, motion.rest, states(), float(run.scene["domain"]["cell"]), view


def measure(
    path: Path, run: Path | None, count: int, frames: int, accuracy: float, say=lambda text: None
) -> Sizes:
    """Write the page at `path` and return its sizes."""
    cell, view = 1.0, VIEW
    if run is None:
        groups, rest, states = made_up(count, frames)
    else:
        groups, rest, states, cell, view = of_run(run, frames)
    writer = MotionWriter(groups, rest, cell=cell, accuracy=accuracy)
    seconds, last = 0.0, []
    for number, (t, last, poses) in enumerate(states):
        start = time.perf_counter()
        writer.add_frame(t, last, poses)
        seconds += time.perf_counter() - start
        say(f"frame {number}")
    path.write_bytes(web_page.assemble_page(writer.to_bytes(view), "benchmark"))
    reader = web_page.read_page(path)
    decoded = reader.bins(len(reader) - 1)
    error = max(
        np.abs(reader.positions(bins[:, :3])[present] - state.x).max(initial=0.0) / cell
        for (present, bins), state in zip(decoded, last, strict=True)
    )
    stream = sum(entry["bytes"] for entry in writer.frames)
    rest_bytes = reader.header["rest"]["bytes"]
    encode = seconds / len(reader)
    return Sizes(
        len(rest.x), len(reader), path.stat().st_size, rest_bytes, stream, encode, float(error)
    )


TIMES = """async () => {
  const median = (list) => list.sort((a, b) => a - b)[list.length >> 1];
  const { motion, renderer, camera } = vgmpi;
  vgmpi.play(false);
  const seeks = [], steps = [], sorts = [], last = motion.frames.length - 1;
  for (let k = 0; k <= last; k++) {
    if (k < last && !motion.frames[k + 1].key) continue;
    motion.last = -1;
    const start = performance.now();
    await motion.seek(k);
    seeks.push(performance.now() - start);
  }
  await motion.seek(0);
  for (let k = 1; k <= Math.min(last, 40); k++) {
    const start = performance.now();
    await motion.seek(k);
    steps.push(performance.now() - start);
  }
  const { turn, shift } = camera.matrices();
  for (let k = 0; k < 9; k++) {
    const start = performance.now();
    renderer.sort(turn, shift);
    sorts.push(performance.now() - start);
  }
  const worst = Math.max(...seeks);
  return { worst, seek: median(seeks), step: median(steps), sort: median(sorts) };
}"""


def browser_times(path: Path) -> str:
    """Times of a page in Chromium as one line, or why there are none."""
    program = find_chromium()
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        return "browser: playwright is not installed"
    if program is None:
        return "browser: no chromium here"
    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=program, args=FLAGS)
        page = browser.new_page(viewport={"width": 512, "height": 512})
        page.set_default_timeout(600_000)
        start = time.perf_counter()
        page.goto(path.resolve().as_uri())
        page.evaluate("() => vgmpi.ready")
        opened = time.perf_counter() - start
        t = page.evaluate(TIMES)
        browser.close()
    return (
        f"browser: opened in {opened:.1f} s; the frame before a key frame in {t['seek']:.0f} ms "
        f"(worst {t['worst']:.0f}), the next frame in {t['step']:.0f} ms, sorted in "
        f"{t['sort']:.0f} ms"
    )


def text(sizes: Sizes) -> str:
    """The sizes as lines."""
    per = sizes.stream / sizes.count / sizes.frames
    out = io.StringIO()
    print(f"{sizes.count:,} Gaussians, {sizes.frames} frames: {sizes.page / 1e6:.1f} MB", file=out)
    print(
        f"at rest {sizes.rest / 1e6:.1f} MB, then {per:.3f} bytes per Gaussian and frame", file=out
    )
    print(
        f"largest error {sizes.error:.2g} cells; coded in {sizes.encode:.2f} s per frame", file=out
    )
    return out.getvalue().rstrip()


def run_benchmark(args, say=lambda text: None) -> str:
    """Measure as the flags of the command say; return lines."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(args.output or Path(folder) / "page.html")
        sizes = measure(path, args.folder, int(args.gaussians), args.frames, args.accuracy, say)
        lines = [text(sizes)]
        if args.folder:
            lines.append(f"last frame beside the run's: {similarity(args.folder, path):.1f} dB")
        return "\n".join([*lines, browser_times(path)])
