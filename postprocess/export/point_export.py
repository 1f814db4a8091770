"""Particles of frames as .vtp files, for programs that do not read VTKHDF: part of vgmpi export."""

import argparse
import logging
from pathlib import Path

from tqdm import tqdm

from vgmpi.io import mesh_files
from vgmpi.io.run_reader import RunError, RunReader

log = logging.getLogger("vgmpi")

FORMAT = "vtp"


def export_points(
    run: RunReader, numbers: list[int], args: argparse.Namespace, folder: Path
) -> None:
    """Write the particles of each frame with all of its fields, and points.pvd after each frame.

    Args:
        run: Files of the run.
        numbers: Frames.
        args: Arguments of the command line.
        folder: Folder of the files.

    Raises:
        RunError: If a flag is not for points, or a frame is not readable.
    """
    for flag, present in (("--up", args.up is not None), ("--no-scenery", args.no_scenery)):
        if present:
            raise RunError(f"{flag}: is not for --format {FORMAT} without --surface")
    folder.mkdir(parents=True, exist_ok=True)
    files: dict[str, float] = {}
    for index in tqdm(numbers, unit="frame", disable=True if args.quiet else None):
        frame = run.frame(index)
        path = folder / f"frame_{index:05d}.{FORMAT}"
        fields = {name: a for name, a in frame.items() if name not in ("positions", "poses")}
        mesh_files.write_vtp(path, frame["positions"], None, fields)
        files[path.name] = float(run.times[index])
        mesh_files.write_pvd(folder / "points.pvd", files)
    log.info("%d files of %d particles", len(numbers), len(frame["positions"]))
