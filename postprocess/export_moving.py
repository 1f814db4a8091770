"""Export of a run as one moving file: vgmpi export OUT --format web -o page.html."""

import argparse
import functools
import logging
from pathlib import Path

from tqdm import tqdm

from vgmpi.gaussians.formats.motion_writer import MotionWriter
from vgmpi.io.run_reader import RunError, RunReader
from vgmpi.rendering import image_io, render_config, web_page
from vgmpi.rendering.appearance import Appearance
from vgmpi.rendering.frame_renderer import visible_extent
from vgmpi.rendering.run_motion import RunMotion

log = logging.getLogger("vgmpi")

WEB = "web"
ACCURACY = 0.01  # [cells] default of --accuracy
ACCURACIES = (1e-5, 1.0)  # [cells] allowed


def output_path(args: argparse.Namespace) -> Path:
    """Return the file that an export of one moving file writes. Raises RunError."""
    path = Path(args.output or Path(args.out) / "run.html")
    if path.suffix.lower() not in (".html", ".htm"):
        raise RunError(f"-o: {path}: allowed: a name that ends in .html")
    return path


def export_page(args: argparse.Namespace, numbers: list[int], run: RunReader) -> None:
    """Write the page of a run's frames `numbers`. Raises RunError and SettingsError."""
    low, high = ACCURACIES
    if not low <= args.accuracy <= high:
        raise RunError(f"--accuracy: {args.accuracy}: allowed: {low} to {high} cells")
    if not 0.1 <= args.fps <= 240:
        raise RunError(f"--fps: {args.fps}: allowed: 0.1 to 240")
    path = output_path(args)
    chosen = render_config.load(args.settings)
    look = Appearance(run, chosen.look)
    motion = RunMotion(look, numbers[len(numbers) // 2], not args.no_scenery)
    cell = float(run.scene.get("domain", {}).get("cell", look.spacing))
    writer = MotionWriter(motion.groups, motion.rest, cell=cell, accuracy=args.accuracy)
    for index in tqdm(numbers, unit="frame", disable=True if args.quiet else None):
        frame = look.frame(index)
        writer.add_frame(float(run.times[index]), motion.states(frame), motion.poses(frame))
    folder = Path(args.settings).parent if args.settings else Path(".")
    box = functools.cache(lambda: visible_extent(run))
    view = web_page.view_settings(look, chosen, folder, box, args.fps)
    title = str(run.scene.get("title") or run.folder.name)
    image_io.write(path, web_page.assemble_page(writer.to_bytes(view), title))
    size = path.stat().st_size / 1e6
    message = "%d frames of %d Gaussians, %.1f MB"
    log.info(message, len(numbers), len(motion.rest.x), size)
