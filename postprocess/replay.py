"""HTML replay of a run: vgmpi replay OUT -o replay.html

The page has a timeline, is self-contained and opens from disk. It shows a subset of the Gaussians
(--particles), the same one in every frame, enlarged to replace the others. It needs viser:
pip install "vgmpi[replay]". Exit code 2 is for errors that the user can correct, with one line.
"""

import argparse
import contextlib
import logging
import os
import socket
import sys
from pathlib import Path
from typing import Any

import numpy as np

from vgmpi.io.run_reader import RunError, RunReader
from vgmpi.rendering import image_io
from vgmpi.rendering.appearance import Appearance, view_dependent_splats
from vgmpi.rendering.camera_paths import CameraPath
from vgmpi.rendering.frame_gaussians import moving
from vgmpi.rendering.frame_renderer import domain_box, visible_extent
from vgmpi.rendering.render_config import CameraSettings, PictureSettings, SettingsError
from vgmpi.runtime.exit_handler import exit_code_from_exceptions

log = logging.getLogger("vgmpi")

MAX_GROWTH = 4.0  # [-] largest factor on the size of a Gaussian
SOLID_SHARE = 0.75  # [-] share of the shown Gaussians reserved for bodies and scenery
MATRIX_INDICES = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))  # matrix indices of cov (n, 6)


class GaussianSelection:
    """Subset of at most `count` Gaussians that is shown in every frame.

    Bodies and scenery come before liquids, whose Gaussians are many and similar: they get
    SOLID_SHARE of the subset if they need it. Within both, Gaussians are sampled with probability
    proportional to their area. growth: factor on the covariances, so that the subset covers the
    area of all.
    """

    def __init__(self, look: Appearance, count: int, seed: int = 0):
        self.look = look
        scenery = look.scenery.cov0 if look.scenery is not None else np.zeros((0, 6))
        riders = look.passive.cov0 if look.passive is not None else np.zeros((0, 6))
        ends = [len(scenery), len(scenery) + len(look.object)]
        # sum of the squared axes, for a disc proportional to its area
        area = np.concatenate([c[:, (0, 3, 5)].sum(1) for c in (scenery, look.cov0, riders)])
        liquid = np.zeros(len(area), dtype=bool)
        liquid[ends[0] : ends[1]] = look.fluid
        self.all, total_count = len(area), min(count, len(area))
        solids = len(area) - int(liquid.sum())
        solid_count = min(
            solids, max(round(SOLID_SHARE * total_count), total_count - int(liquid.sum()))
        )
        # the first of an exponential race are a sample with probability proportional to weight
        race = np.random.default_rng(seed).exponential(size=len(area)) / np.maximum(area, 1e-300)
        is_shown, growth = np.zeros(len(area), dtype=bool), np.ones(len(area))
        for is_class, max_count in ((~liquid, solid_count), (liquid, total_count - solid_count)):
            candidates = np.flatnonzero(is_class)
            selected = candidates[np.argsort(race[candidates])[:max_count]]
            is_shown[selected] = True
            if len(selected):
                growth[selected] = min(area[candidates].sum() / area[selected].sum(), MAX_GROWTH**2)
        self.count = int(is_shown.sum())
        self.still, self.moving, self.riding = np.split(is_shown, ends)
        self.growth = np.split(growth, ends)

    def splats_at(self, index: int, eye: np.ndarray) -> tuple[dict, dict]:
        """Return viser's arrays of frame `index`: of the scenery, and of all other Gaussians."""
        frame = self.look.frame(index)
        parts = self.look.parts(frame)
        still = np.flatnonzero(self.still)
        # scenery comes before the particles
        first = len(parts) - 1 - (self.look.passive is not None)
        ids = np.asarray(frame["id"])
        is_shown, growth = [self.moving[ids]], [self.growth[1][ids]]
        if self.look.passive is not None:  # the part holds Gaussians whose carriers are all present
            is_shown.append(self.riding[parts[-1].rows])
            growth.append(self.growth[2][parts[-1].rows])
        scenery_splats = (
            view_dependent_splats(parts[:1], eye) if first else view_dependent_splats(parts, eye)
        )
        rows = np.flatnonzero(np.concatenate(is_shown))
        return self._splat_arrays(scenery_splats, still, self.growth[0][still]), self._splat_arrays(
            view_dependent_splats(parts[first:], eye), rows, np.concatenate(growth)[rows]
        )

    def _splat_arrays(
        self, splats: Any, rows: np.ndarray, growth: np.ndarray
    ) -> dict[str, np.ndarray]:
        """Return viser's arrays of some Gaussians."""
        cov = np.empty((len(rows), 3, 3), dtype=np.float32)
        for k, (i, j) in enumerate(MATRIX_INDICES):
            cov[:, i, j] = cov[:, j, i] = growth * splats.cov[rows, k]
        return {
            "centers": splats.x[rows].astype(np.float32),
            "covariances": cov,
            "rgbs": np.clip(splats.color[rows], 0, 1).astype(np.float32),
            "opacities": splats.opacity[rows, None].astype(np.float32),
        }


def page(
    run: RunReader, numbers: list[int], count: int, seconds: float
) -> tuple[str, GaussianSelection]:
    """Return the HTML text and the shown subset.

    Args:
        run: Files of the run.
        numbers: Frames.
        count: Largest number of Gaussians.
        seconds: Duration of a frame [s].

    Raises:
        RunError: If viser is missing or a frame cannot be read.
    """
    try:
        import viser
    except ImportError:
        message = 'a replay needs the package viser: pip install "vgmpi[replay]"'
        raise RunError(message) from None
    chosen = GaussianSelection(Appearance(run), count)
    box = visible_extent(run)
    view = CameraPath(CameraSettings(), PictureSettings(width=1200), lambda: box, Path("."))
    eye = view.camera_at(0.0, 0.0).eye
    logging.getLogger("websockets").setLevel(logging.ERROR)
    server = viser.ViserServer(host="127.0.0.1", port=_free_port(), verbose=False)
    try:
        scene = server.scene
        scene.set_up_direction("+z")
        server.initial_camera.position = tuple(eye)
        server.initial_camera.fov = np.radians(CameraSettings().fov)
        server.initial_camera.look_at = tuple(0.5 * (box[0] + box[1]))
        edges = _edges(*domain_box(run))
        scene.add_line_segments(
            "/domain", edges, colors=(150, 150, 150), thickness=1.0, thickness_units="screen"
        )
        serializer = server.get_scene_serializer()
        has_moving_objects = bool(moving(run.objects))
        for k, index in enumerate(numbers):
            scenery_splats, moving_splats = chosen.splats_at(index, eye)
            if (k == 0 or has_moving_objects) and len(scenery_splats["centers"]):
                scene.add_gaussian_splats("/scenery", **scenery_splats)
            scene.add_gaussian_splats("/particles", **moving_splats)
            serializer.insert_sleep(seconds)
        html = serializer.as_html()
    finally:
        server.stop()
    return _labelled(html, f"{chosen.count:,} of {chosen.all:,} Gaussians"), chosen


def _labelled(html: str, label: str) -> str:
    """Return the page with a line about its content."""
    style = "position:fixed;left:12px;bottom:64px;z-index:10;font:13px sans-serif;color:#555"
    line = f'<div id="vgmpi" style="{style}">{label}</div>'
    position = html.rindex("</body>")
    return html[:position] + line + html[position:]


def _edges(lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Return the edges of a box, (12, 2, 3)."""
    corners = np.indices((2, 2, 2)).reshape(3, -1).T
    pairs = [(a, b) for a in corners for b in corners if (b - a).sum() == 1 and (b >= a).all()]
    return (lower + np.array(pairs) * (upper - lower)).astype(np.float32)


def _free_port() -> int:
    """Return a free port."""
    with socket.socket() as sock:
        sock.bind(("127.0.0.1", 0))
        return sock.getsockname()[1]


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    p = argparse.ArgumentParser(prog="vgmpi replay", description=__doc__)
    p.add_argument("out", help="folder of the run")
    p.add_argument("-o", "--output", help="output page [OUT/replay.html]")
    p.add_argument(
        "--particles", type=int, default=20000, help="maximum number of Gaussians [20000]"
    )
    p.add_argument("--every", type=int, default=1, help="show every Nth frame [1]")
    p.add_argument("--fps", type=float, default=25.0, help="frames per second [25]")
    return p


@exit_code_from_exceptions
def main(argv: list[str] | None = None) -> int:
    """Run the command and return its exit code."""
    args = parser().parse_args(argv)
    logging.basicConfig(level=logging.INFO, format="%(message)s", stream=sys.stderr)
    output = Path(args.output or Path(args.out) / "replay.html")
    try:
        if output.suffix != ".html":
            raise RunError(f"-o: {output}: allowed: a name that ends in .html")
        if args.particles < 1 or args.every < 1 or not 0.1 <= args.fps <= 240:
            raise RunError("allowed: --particles and --every from 1, --fps 0.1 to 240")
        run = RunReader(args.out)
        numbers = run.available_frames(range(0, len(run), args.every))
        with open(os.devnull, "w") as quiet, contextlib.redirect_stdout(quiet):
            html, chosen = page(run, numbers, args.particles, 1 / args.fps)
        image_io.write(output, html.encode())
    except SettingsError as error:
        print("\n".join(error.lines), file=sys.stderr)
        return 2
    except (RunError, image_io.VideoError) as error:
        print(error, file=sys.stderr)
        return 2
    size = output.stat().st_size / 1e6
    summary = f"{chosen.count} of {chosen.all} Gaussians"
    log.info("%s, %d frames, %.1f MB", summary, len(numbers), size)
    print(output)
    return 0


if __name__ == "__main__":
    sys.exit(main())
