"""Surfaces of a run's bodies as files: the part of vgmpi export with --surface.

A mesh has the colors of the Gaussians at its vertices. A .vtp has the frame's fields too.
"""

import argparse
import logging
from pathlib import Path
from typing import NamedTuple

import numpy as np
from tqdm import tqdm

from vgmpi.gaussians.spherical_harmonics import rgb_from_dc
from vgmpi.io import mesh_files
from vgmpi.io.run_reader import RunError, RunReader
from vgmpi.runtime.message_text import did_you_mean

from ..frames.appearance import Appearance
from .particle_surface import SurfaceMesh, reconstruct_surface

log = logging.getLogger("vgmpi")

FORMATS = ("vtp", "obj")
MAX_STEPS = 500
# fields of a frame that a mesh has too, where the frame has them
VERTEX_FIELDS = ("velocity", "J", "pressure", "volume_fraction")


class SurfaceOptions(NamedTuple):
    """Choices of a surface."""

    objects: list[int]  # rows of the list `objects`
    steps: int  # smoothing steps
    rotation: np.ndarray  # (3, 3) from the axes of the domain to those of the file


def check_arguments(args: argparse.Namespace, formats: list[str]) -> None:
    """Check flags that exclude each other, and set the default of the format. Raises RunError.

    Args:
        args: Arguments of the command line (in/out).
        formats: Formats of Gaussian files.
    """
    allowed = formats if args.surface is None else FORMATS
    args.format = args.format or allowed[0]
    if args.format not in allowed:
        why = "is of meshes: name a body, --surface NAME; vtp without it is of particles"
        if args.surface is not None:
            why = f"is of Gaussians; allowed with --surface: {', '.join(FORMATS)}"
        raise RunError(f"--format: {args.format} {why}")
    if args.surface is not None and args.no_scenery:
        raise RunError("--no-scenery: a surface has no scenery")
    if not 0 <= args.smoothing <= MAX_STEPS:
        raise RunError(f"--smoothing: {args.smoothing}: allowed: 0 to {MAX_STEPS} steps")


def matching_objects(objects: list[dict], name: str) -> list[int]:
    """Return the rows of the bodies that a name stands for: a body, or all of a material.

    Args:
        objects: Objects of gaussians.h5.
        name: Name of an object or of a material.

    Raises:
        RunError: If no body has that name.
    """
    bodies = [k for k, entry in enumerate(objects) if entry.get("family")]
    for key in ("name", "material"):
        rows = [k for k in bodies if objects[k].get(key) == name]
        if rows:
            return rows
    names = {str(objects[k].get(key)): 0 for key in ("name", "material") for k in bodies}
    names.pop("None", None)
    raise RunError(
        f"--surface: {name}: no body or material has this name{did_you_mean(name, names)};"
        f" there are {', '.join(names)}"
    )


def export_surfaces(
    run: RunReader, look: Appearance, numbers: list[int], args: argparse.Namespace,
    rotation: np.ndarray, folder: Path,
) -> None:  # fmt: skip
    """Write a mesh for each frame; for .vtp also surface.pvd, after each frame.

    Args:
        run: Files of the run.
        look: Its appearance.
        numbers: Frames.
        args: Arguments of the command line.
        rotation: Rotation to the axes of the files, shape (3, 3).
        folder: Folder of the files.

    Raises:
        RunError: If pysplashsurf is missing, or a name or a frame is wrong.
    """
    options = SurfaceOptions(matching_objects(run.objects, args.surface), args.smoothing, rotation)
    size = run.scene.get("domain", {}).get("size")
    files: dict[str, float] = {}
    folder.mkdir(parents=True, exist_ok=True)
    for index in tqdm(numbers, unit="frame", disable=True if args.quiet else None):
        mesh = frame_surface(look, look.frame(index), options, size)
        path = folder / f"frame_{index:05d}.{args.format}"
        if args.format == "obj":
            mesh_files.write_obj(path, mesh.vertices, mesh.triangles, mesh.fields["RGB"])
            continue
        colors = np.rint(255 * mesh.fields["RGB"]).astype(np.uint8)
        mesh_files.write_vtp(path, mesh.vertices, mesh.triangles, {**mesh.fields, "RGB": colors})
        files[path.name] = float(run.times[index])
        mesh_files.write_pvd(folder / "surface.pvd", files)
    log.info("%d files, the last of %d triangles", len(numbers), len(mesh.triangles))


def frame_surface(
    look: Appearance, frame: dict[str, np.ndarray], options: SurfaceOptions, size: list | None
) -> SurfaceMesh:
    """Return the surface of a frame's bodies, with the field RGB in 0..1.

    Args:
        look: Appearance of the run.
        frame: Result of look.frame.
        options: Choices of the surface.
        size: Edges of the domain [m], or None without walls.
    """
    rows = np.asarray(frame["id"])
    chosen = np.flatnonzero(np.isin(look.object[rows], options.objects))
    particles = look.parts(frame)[0 if look.scenery is None else 1]
    rgb = rgb_from_dc(np.asarray(particles.color.sh)[particles.rows[chosen], 0])
    if particles.bright is not None:
        rgb = rgb * particles.bright[chosen, None]
    fields = {"RGB": np.clip(rgb, 0.0, 1.0)}
    fields |= {name: frame[name][chosen] for name in VERTEX_FIELDS if name in frame}
    spacing = float(np.cbrt(np.median(look.vol0[rows[chosen]]))) if len(chosen) else 1.0
    box = None if size is None else np.array(size, np.float64)
    mesh = reconstruct_surface(frame["positions"][chosen], spacing, fields, box, options.steps)
    turned = {k: v @ options.rotation.T for k, v in mesh.fields.items() if k == "velocity"}
    return SurfaceMesh(
        mesh.vertices @ options.rotation.T,
        mesh.triangles,
        {**mesh.fields, **turned, "RGB": np.clip(mesh.fields["RGB"], 0.0, 1.0)},
    )
