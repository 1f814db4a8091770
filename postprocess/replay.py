"""python -m postprocess.replay OUT -o replay.html: a run to turn and zoom in a browser.

One page with a timeline that holds all it needs and opens from disk. It shows a part of the
Gaussians (--particles), the same ones in every frame, each as much larger as the others are missed.
Needs viser: pip install "vgmpi[replay]". Exit code 2 for what the user can mend, with one line.
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

from postprocess import video
from postprocess.look import Look, seen
from postprocess.painter import domain_box, reach
from postprocess.parts import moving
from postprocess.settings import CameraSettings, PictureSettings, SettingsError
from postprocess.viewpoints import Viewpoint
from vgmpi.ends import guarded
from vgmpi.output.read import RunError, RunFiles

log = logging.getLogger("vgmpi")

LARGER = 4.0  # of a Gaussian's size at most, however few are shown
SOLIDS = 0.75  # of the places, for bodies and scenery
PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))  # places of cov (n, 6) in a matrix


class Chosen:
    """The Gaussians that are shown: at most `count` of the run's, the same at every frame.

    Bodies and scenery go before liquids, which are many and alike: they get SOLIDS of the places if
    they need them. Within both, large Gaussians are kept rather than small ones, by chance in
    proportion to their area. growth: by which the covariances of each grow, so that what is left
    covers the area of all.
    """

    def __init__(self, look: Look, count: int, seed: int = 0):
        self.look = look
        scenery = look.scenery.cov0 if look.scenery is not None else np.zeros((0, 6))
        riders = look.passive.cov0 if look.passive is not None else np.zeros((0, 6))
        ends = [len(scenery), len(scenery) + len(look.object)]
        # the sum of the squares of its axes: of a disc, its area but for a factor
        area = np.concatenate([c[:, (0, 3, 5)].sum(1) for c in (scenery, look.cov0, riders)])
        liquid = np.zeros(len(area), dtype=bool)
        liquid[ends[0] : ends[1]] = look.fluid
        self.all, places = len(area), min(count, len(area))
        solids = len(area) - int(liquid.sum())
        few = min(solids, max(round(SOLIDS * places), places - int(liquid.sum())))
        # the `few` first of an exponential race have a chance in proportion to their weight
        race = np.random.default_rng(seed).exponential(size=len(area)) / np.maximum(area, 1e-300)
        shown, growth = np.zeros(len(area), dtype=bool), np.ones(len(area))
        for those, most in ((~liquid, few), (liquid, places - few)):
            at = np.flatnonzero(those)
            kept = at[np.argsort(race[at])[:most]]
            shown[kept] = True
            if len(kept):
                growth[kept] = min(area[at].sum() / area[kept].sum(), LARGER**2)
        self.count = int(shown.sum())
        self.still, self.moving, self.riding = np.split(shown, ends)
        self.growth = np.split(growth, ends)

    def at(self, index: int, eye: np.ndarray) -> tuple[dict, dict]:
        """What viser draws of frame `index`, of the scenery and of all that moves."""
        frame = self.look.frame(index)
        parts = self.look.parts(frame)
        still = np.flatnonzero(self.still)
        first = len(parts) - 1 - (self.look.passive is not None)  # the scenery stands before it
        there = np.asarray(frame["id"])
        shown, growth = [self.moving[there]], [self.growth[1][there]]
        if self.look.passive is not None:  # those whose carriers are all there
            shown.append(self.riding[parts[-1].rows])
            growth.append(self.growth[2][parts[-1].rows])
        behind = seen(parts[:1], eye) if first else seen(parts, eye)
        rows = np.flatnonzero(np.concatenate(shown))
        return self._drawn(behind, still, self.growth[0][still]), self._drawn(
            seen(parts[first:], eye), rows, np.concatenate(growth)[rows]
        )

    def _drawn(self, splats: Any, rows: np.ndarray, growth: np.ndarray) -> dict[str, np.ndarray]:
        cov = np.empty((len(rows), 3, 3), dtype=np.float32)
        for k, (i, j) in enumerate(PAIRS):
            cov[:, i, j] = cov[:, j, i] = growth * splats.cov[rows, k]
        return {
            "centers": splats.x[rows].astype(np.float32),
            "covariances": cov,
            "rgbs": np.clip(splats.color[rows], 0, 1).astype(np.float32),
            "opacities": splats.opacity[rows, None].astype(np.float32),
        }


def page(run: RunFiles, numbers: list[int], count: int, seconds: float) -> tuple[str, Chosen]:
    """The HTML text, and what it shows. seconds: that a frame stays. Raises RunError."""
    try:
        import viser
    except ImportError:
        said = 'a replay needs the package viser: pip install "vgmpi[replay]"'
        raise RunError(said) from None
    chosen = Chosen(Look(run), count)
    box = reach(run)
    view = Viewpoint(CameraSettings(), PictureSettings(width=1200), lambda: box, Path("."))
    eye = view.at(0.0, 0.0).eye
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
        moves = bool(moving(run.objects))
        for k, index in enumerate(numbers):
            still, loose = chosen.at(index, eye)
            if (k == 0 or moves) and len(still["centers"]):
                scene.add_gaussian_splats("/scenery", **still)
            scene.add_gaussian_splats("/particles", **loose)
            serializer.insert_sleep(seconds)
        html = serializer.as_html()
    finally:
        server.stop()
    return _labelled(html, f"{chosen.count:,} of {chosen.all:,} Gaussians"), chosen


def _labelled(html: str, said: str) -> str:
    """The page with a line about what it shows."""
    style = "position:fixed;left:12px;bottom:64px;z-index:10;font:13px sans-serif;color:#555"
    line = f'<div id="vgmpi" style="{style}">{said}</div>'
    at = html.rindex("</body>")
    return html[:at] + line + html[at:]


def _edges(lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """The edges of a box, (12, 2, 3)."""
    corners = np.indices((2, 2, 2)).reshape(3, -1).T
    pairs = [(a, b) for a in corners for b in corners if (b - a).sum() == 1 and (b >= a).all()]
    return (lower + np.array(pairs) * (upper - lower)).astype(np.float32)


def _free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


def parser() -> argparse.ArgumentParser:
    p = argparse.ArgumentParser(prog="python -m postprocess.replay", description=__doc__)
    p.add_argument("out", help="folder of the run")
    p.add_argument("-o", "--output", help="the page [OUT/replay.html]")
    p.add_argument("--particles", type=int, default=20000, help="Gaussians shown [20000]")
    p.add_argument("--every", type=int, default=1, help="show every so many frames [1]")
    p.add_argument("--fps", type=float, default=25.0, help="frames a second [25]")
    return p


@guarded
def main(argv: list[str] | None = None) -> int:
    args = parser().parse_args(argv)
    logging.basicConfig(level=logging.INFO, format="%(message)s", stream=sys.stderr)
    output = Path(args.output or Path(args.out) / "replay.html")
    try:
        if output.suffix != ".html":
            raise RunError(f"-o: {output}: allowed: a name that ends in .html")
        if args.particles < 1 or args.every < 1 or not 0.1 <= args.fps <= 240:
            raise RunError("allowed: --particles and --every from 1, --fps 0.1 to 240")
        run = RunFiles(args.out)
        numbers = run.present(range(0, len(run), args.every))
        with open(os.devnull, "w") as quiet, contextlib.redirect_stdout(quiet):
            html, chosen = page(run, numbers, args.particles, 1 / args.fps)
        video.write(output, html.encode())
    except SettingsError as error:
        print("\n".join(error.lines), file=sys.stderr)
        return 2
    except (RunError, video.VideoError) as error:
        print(error, file=sys.stderr)
        return 2
    size = output.stat().st_size / 1e6
    shown = f"{chosen.count} of {chosen.all} Gaussians"
    log.info("%s, %d frames, %.1f MB", shown, len(numbers), size)
    print(output)
    return 0


if __name__ == "__main__":
    sys.exit(main())
