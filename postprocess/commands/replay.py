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

from vgmpi.io.run_reader import RunError, RunReader
from vgmpi.runtime.command_line import ArgumentParser, exit_code_from_exceptions, usage_error_code

from ..frames import image_io
from ..frames.appearance import Appearance
from ..frames.camera_paths import CameraPath
from ..frames.frame_gaussians import moving
from ..frames.frame_renderer import domain_box, visible_extent
from ..frames.render_config import CameraSettings, PictureSettings, SettingsError
from ..live.gaussian_selection import GaussianSelection
from ..live.viewer_scene import show_domain, viewer_camera

log = logging.getLogger("vgmpi")


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
    camera = view.camera_at(0.0, 0.0)
    logging.getLogger("websockets").setLevel(logging.ERROR)
    server = viser.ViserServer(host="127.0.0.1", port=_free_port(), verbose=False)
    try:
        scene = server.scene
        scene.set_up_direction("+z")
        viewer_camera(camera, box, chosen.cell).set_as(server.initial_camera)
        show_domain(scene, domain_box(run), chosen.cell)
        serializer = server.get_scene_serializer()
        has_moving_objects = bool(moving(run.objects))
        for k, index in enumerate(numbers):
            scenery_splats, moving_splats = chosen.splats_at(index, camera.eye)
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


def _free_port() -> int:
    """Return a free port."""
    with socket.socket() as sock:
        sock.bind(("127.0.0.1", 0))
        return sock.getsockname()[1]


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    p = ArgumentParser(prog="vgmpi replay", description=__doc__)
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
        return usage_error_code(error)
    size = output.stat().st_size / 1e6
    summary = f"{chosen.count} of {chosen.all} Gaussians"
    log.info("%s, %d frames, %.1f MB", summary, len(numbers), size)
    print(output)
    return 0
