"""Export of a run as one moving file: vgmpi export OUT --format web -o page.html.

Format usd makes an OpenUSD file: vgmpi export OUT --format usd -o scene.usdc.
"""

import argparse
import functools
import logging
import tempfile
from pathlib import Path

import numpy as np
from tqdm import tqdm

from vgmpi.gaussians.formats.motion_stream import MotionWriter
from vgmpi.io.run_reader import RunError, RunReader

from ..frames import image_io, render_config
from ..frames.appearance import Appearance
from ..frames.camera_paths import CameraPath
from ..frames.collider_meshes import collider_meshes
from ..frames.frame_renderer import visible_extent
from ..raster.shadow_lighting import Light
from ..web import web_page
from . import usd_stage
from .run_motion import RunMotion

log = logging.getLogger("vgmpi")

WEB, USD = "web", "usd"
KINDS = (WEB, USD)
SUFFIXES = {WEB: (".html", ".htm"), USD: usd_stage.SUFFIXES}
ACCURACY = 0.02  # [cells] default of --accuracy
FPS = 25.0  # default of --fps
ACCURACIES = (1e-5, 1.0)  # [cells] allowed


def output_path(args: argparse.Namespace) -> Path:
    """Return the file that an export of one moving file writes. Raises RunError."""
    suffixes = SUFFIXES[args.format]
    path = Path(args.output or Path(args.out) / f"run{suffixes[0]}")
    if path.suffix.lower() not in suffixes:
        raise RunError(f"-o: {path}: allowed: a name that ends in {', '.join(suffixes)}")
    return path


def check_flags(args: argparse.Namespace) -> None:
    """Raise RunError if a flag has no meaning with the format, or a value is not allowed."""
    for flag in ("accuracy", "fps"):
        if getattr(args, flag) is not None and args.format != WEB:
            raise RunError(f"--{flag}: allowed with --format {WEB}")
    if args.format in KINDS and args.up not in (None, "z"):
        raise RunError(f"--up: {args.up}: a moving file has z up")
    low, high = ACCURACIES
    if args.accuracy is not None and not low <= args.accuracy <= high:
        raise RunError(f"--accuracy: {args.accuracy}: allowed: {low} to {high} cells")
    if args.fps is not None and not 0.1 <= args.fps <= 240:
        raise RunError(f"--fps: {args.fps}: allowed: 0.1 to 240")


def export_moving(args: argparse.Namespace, numbers: list[int], run: RunReader, path: Path) -> None:
    """Write a run as one file.

    Args:
        args: Arguments of the command line.
        numbers: Frames.
        run: Files of the run.
        path: Result of `output_path`.

    Raises:
        RunError: If a frame is wrong, or a package is missing.
        SettingsError: If the settings are wrong.
    """
    export = export_page if args.format == WEB else export_usd
    export(args, numbers, run, path)


def export_page(args: argparse.Namespace, numbers: list[int], run: RunReader, path: Path) -> None:
    """Write the page of a run's frames.

    Args:
        args, numbers, run, path: See `export_moving`.
    """
    chosen = render_config.load(args.settings)
    look = Appearance(run, chosen.look)
    motion = RunMotion(look, numbers[len(numbers) // 2], not args.no_scenery)
    accuracy = args.accuracy or ACCURACY
    groups = web_page.groups_as_drawn(motion.groups, chosen)
    writer = MotionWriter(groups, motion.rest_gaussians, cell=look.cell_size(), accuracy=accuracy)
    for index in tqdm(numbers, unit="frame", disable=True if args.quiet else None):
        frame = look.frame(index)
        writer.add_frame(float(run.times[index]), motion.states(frame), motion.poses(frame))
    folder = render_config.base_folder(args.settings)
    box = functools.cache(lambda: visible_extent(run))
    view = web_page.view_settings(look, chosen, folder, box, args.fps or FPS)
    title = str(run.scene.get("title") or run.folder.name)
    image_io.write(path, web_page.assemble_page(writer.to_bytes(view), title))
    size = path.stat().st_size / 1e6
    message = "%d frames of %d Gaussians, %.1f MB"
    log.info(message, len(numbers), len(motion.rest_gaussians.x), size)


def export_usd(args: argparse.Namespace, numbers: list[int], run: RunReader, path: Path) -> None:
    """Write the OpenUSD file of a run's frames.

    Args:
        args, numbers, run, path: See `export_moving`.
    """
    usd = usd_stage.load_usd()
    chosen = render_config.load(args.settings)
    folder = render_config.base_folder(args.settings)
    box = functools.cache(lambda: visible_extent(run))
    views = [CameraPath(entry, chosen.picture, box, folder) for entry in chosen.views()]
    look = Appearance(run, chosen.look)
    motion = RunMotion(look, numbers[len(numbers) // 2], not args.no_scenery)
    if antialiased := [group.name for group in motion.groups if group.compensated_lowpass]:
        log.warning(
            "OpenUSD holds no render model: a viewer draws what was trained antialiased as classic,"
            " and small Gaussians too opaque: %s", ", ".join(antialiased),
        )  # fmt: skip
    times = run.times[numbers]
    rate = 1 / float(np.median(np.diff(times))) if len(times) > 1 else 24.0
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=path.parent, prefix=".usd") as temporary:
        layer = Path(temporary) / f"{path.stem}{'.usdc' if path.suffix == '.usdz' else path.suffix}"
        stage = usd_stage.UsdStage(
            layer, motion.groups, motion.rest_gaussians, frames=len(numbers), rate=rate
        )
        stage.add_light((chosen.light.light() if chosen.light else Light()).direction)
        colliders, without = collider_meshes(run.objects, run.scene)
        if without:
            log.warning(
                "colliders without a mesh, shown by Gaussians alone: %s", ", ".join(without)
            )
        meshes = [stage.add_mesh(m.name, m.points, m.faces, m.color) for m in colliders]
        for k, index in enumerate(tqdm(numbers, unit="frame", disable=args.quiet or None)):
            frame = look.frame(index)
            part = k / max(len(numbers) - 1, 1)
            cameras = {view.name: view.camera_at(part, float(times[k])) for view in views}
            stage.add_frame(motion.states(frame), motion.poses(frame), cameras)
            for mesh, collider in zip(meshes, colliders):
                if collider.pose >= 0:
                    stage.set_mesh_pose(mesh, frame["poses"][collider.pose])
        stage.save()
        del stage
        if path.suffix.lower() == ".usdz":
            package = layer.with_suffix(".usdz")
            usd.UsdUtils.CreateNewUsdzPackage(str(layer), str(package))
            layer = package
        layer.replace(path)
    message = "%d frames of %d Gaussians, %.1f MB"
    log.info(message, len(numbers), len(motion.rest_gaussians.x), path.stat().st_size / 1e6)
