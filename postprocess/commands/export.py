"""Export for other programs: vgmpi export OUT --frames 0:50:5 -o DIR --format ply

Format web makes one page that plays the run: vgmpi export OUT --format web -o page.html; format usd
one OpenUSD file with time samples (.usdc, .usda, .usdz; needs pip install "vgmpi[usd]"). A file of
the other formats holds the Gaussians of a frame as the renderer draws them: shapes, opacities and
colors, in meters and in the axes of the domain, for any viewer. With --surface it holds the surface
of a body as triangles with the colors of its Gaussians. Exit code 2 is for errors that the user can
correct.
"""

import argparse
import logging
import re
import sys
from pathlib import Path

import numpy as np
from tqdm import tqdm

from vgmpi.gaussians.capture_conventions import to_ply_frame, with_render_model
from vgmpi.gaussians.cloud import GaussianCloud, principal_axes
from vgmpi.gaussians.formats import gltf, registry, sog, spz
from vgmpi.io import mesh_files
from vgmpi.io.run_reader import RunError, RunReader
from vgmpi.runtime.command_line import (
    ArgumentParser,
    exit_code_from_exceptions,
    report_file_error,
    usage_error_code,
)

from ..export import export_moving, surface_export
from ..export.particle_surface import SMOOTHING_STEPS
from ..frames import image_io, render_config
from ..frames.appearance import Appearance
from ..frames.export_model import file_render_model

POINT_FORMAT = "vtp"
log = logging.getLogger("vgmpi")
GAUSSIAN_FORMATS = [suffix.removeprefix(".") for suffix in registry.WRITTEN]
WITHOUT_MODEL = (".splat", registry.GLTF)  # formats that do not say how opacities are meant
Y_UP = ("glb", "obj")  # formats that programs read with y up
# rotations of the domain's z axis to the up axis of the file
UP = {
    "z": np.eye(3),
    "y": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
    "-y": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]),
}


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
            raise RunError(f"{flag}: is not for --format {POINT_FORMAT} without --surface")
    folder.mkdir(parents=True, exist_ok=True)
    files: dict[str, float] = {}
    for index in tqdm(numbers, unit="frame", disable=True if args.quiet else None):
        frame = run.frame(index)
        path = folder / f"frame_{index:05d}.{POINT_FORMAT}"
        fields = {name: a for name, a in frame.items() if name not in ("positions", "poses")}
        mesh_files.write_vtp(path, frame["positions"], None, fields)
        files[path.name] = float(run.times[index])
        mesh_files.write_pvd(folder / "points.pvd", files)
    log.info("%d files of %d particles", len(numbers), len(frame["positions"]))


def cloud(look: Appearance, frame: dict[str, np.ndarray], scenery: bool = True) -> GaussianCloud:
    """Return the Gaussians of a frame as they are drawn [m], for any view; scenery first.

    frame: result of look.frame. Raises RunError.
    """
    parts = look.parts(frame)
    if not scenery and look.scenery is not None:
        parts = parts[1:]
    colors = [part.coefficients() for part in parts]
    terms = max(sh.shape[1] for sh in colors)
    colors = [np.pad(sh, ((0, 0), (0, terms - sh.shape[1]), (0, 0))) for sh in colors]
    quat, scale = principal_axes(np.concatenate([part.cov for part in parts]))
    return GaussianCloud(
        np.concatenate([part.x for part in parts]),
        quat,
        scale,
        np.concatenate([part.opacity for part in parts]),
        np.concatenate(colors),
    )


def selected_frames(text: str | None, count: int) -> list[int]:
    """Parse "25", "-1" or "first:last:every" (last excluded) as frame numbers.

    The syntax is that of list indices in Python. Raises RunError.
    """
    if text is None:
        return list(range(count))
    if not re.fullmatch(r"-?\d{1,9}|(-?\d{1,9})?:(-?\d{1,9})?(:\d{0,9})?", text):
        raise RunError(f"--frames: {text}: allowed: a number, or first:last:every as 0:50:5")
    numbers = [int(part) if part else None for part in text.split(":")]
    if len(numbers) == 1:
        numbers = [int(text), int(text) + 1 or None]
    elif numbers[2:] == [0]:
        raise RunError(f"--frames: {text}: allowed: every 1st or more")
    selected = list(range(count))[slice(*numbers)]
    if not selected:
        raise RunError(f"--frames: {text}: the run has the frames 0..{count - 1}")
    return selected


def losses(gaussians: GaussianCloud, suffix: str) -> list[str]:
    """Return a line for each property of the Gaussians that a file format cannot hold."""
    lines = []
    shiny_count = np.count_nonzero((gaussians.sh[:, 1:] != 0).any(axis=(1, 2)))
    if suffix == ".splat" and shiny_count:
        lines.append(
            f"a .splat keeps no view-dependent color: {shiny_count:,} Gaussians lose theirs"
        )
    if suffix == registry.SOG and shiny_count >= sog.PALETTE:
        text = f"a .sog holds {sog.PALETTE:,} view-dependent colors"
        lines.append(f"{text}: {shiny_count:,} Gaussians share them")
    max_value = {".spz": 1, registry.COMPRESSED: 4}.get(suffix, np.inf)
    if beyond_count := np.count_nonzero(np.abs(gaussians.sh[:, 1:]) > max_value):
        lines.append(
            f"a {suffix} holds coefficients of -{max_value}..{max_value}: {beyond_count:,} are cut"
        )
    faint = np.count_nonzero((gaussians.opacity > 0) & (gaussians.opacity < 0.5 / 255))
    if suffix not in (".ply", registry.GLTF) and faint:
        text = (
            f"opacities are 255ths in a {suffix}: {faint:,} of {len(gaussians):,} Gaussians vanish"
        )
        lines.append(f"{text}; a .ply keeps them")
    if gaussians.is_antialiased and suffix in WITHOUT_MODEL:
        text = f"a {suffix} holds no render model: viewers draw Gaussians of antialiased training"
        lines.append(f"{text} as classic, and small ones too opaque")
    return lines


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    p = ArgumentParser(prog="vgmpi export", description=__doc__)
    p.add_argument("out", help="folder of the run")
    p.add_argument("settings", nargs="?", help="render.toml, of which the table [look] is used")
    p.add_argument("--frames", help="a number, or first:last:every as in Python [all]")
    p.add_argument(
        "-o",
        "--output",
        help="folder of the files, or the one file [OUT/gaussians, OUT/points, OUT/surface]",
    )
    p.add_argument(
        "--format",
        choices=[*GAUSSIAN_FORMATS, *surface_export.FORMATS, *export_moving.KINDS],
        help="file format; vtp holds particles, or meshes with --surface, obj meshes"
        " [ply; vtp with --surface]",
    )
    p.add_argument(
        "--surface",
        metavar="NAME",
        help="surface of a body, or of all bodies of a material, as triangles (extra mesh)",
    )
    p.add_argument(
        "--smoothing",
        type=int,
        default=SMOOTHING_STEPS,
        metavar="STEPS",
        help="smoothing steps of a surface, 0: none",
    )
    up = "axis that points up in the file; --up=-y for captures [z; y in .glb and .obj]"
    p.add_argument("--up", choices=UP, help=up)
    version = f"version of .spz files [{spz.DEFAULT_VERSION}, which most viewers read]"
    p.add_argument("--spz-version", type=int, choices=spz.WRITTEN_VERSIONS, help=version)
    p.add_argument("--no-scenery", action="store_true", help="leave out scenery")
    accuracy = f"largest error of a position in a page, in cells [{export_moving.ACCURACY}]"
    p.add_argument("--accuracy", type=float, help=accuracy)
    p.add_argument("--fps", type=float, help=f"frames per second of a page [{export_moving.FPS:g}]")
    p.add_argument("-q", "--quiet", action="store_true", help="warnings and errors only")
    return p


@exit_code_from_exceptions
def main(argv: list[str] | None = None) -> int:
    """Run the command and return its exit code."""
    args = parser().parse_args(argv)
    level = logging.WARNING if args.quiet else logging.INFO
    logging.basicConfig(level=level, format="%(message)s", stream=sys.stderr)
    kind = "points" if args.format == POINT_FORMAT else "gaussians"
    folder = Path(args.output or Path(args.out) / ("surface" if args.surface else kind))
    try:
        if args.format in export_moving.KINDS:
            folder = export_moving.output_path(args)
        _export(args, folder)
    except render_config.SettingsError as error:
        print("\n".join(error.lines), file=sys.stderr)
    except (RunError, image_io.VideoError, registry.GaussianFileError) as error:
        print(error, file=sys.stderr)
        return usage_error_code(error)
    except OSError as error:
        return report_file_error(error, folder)
    except KeyboardInterrupt:
        print("stopped: the files written so far are complete", file=sys.stderr)
        return 130
    else:
        print(folder)
        return 0
    return 2


def _export(args: argparse.Namespace, folder: Path) -> None:
    """Write the files."""
    formats = [*GAUSSIAN_FORMATS, *export_moving.KINDS, POINT_FORMAT]
    surface_export.check_arguments(args, formats)
    export_moving.check_flags(args)
    if args.spz_version is not None and args.format != "spz":
        raise RunError("--spz-version: allowed with --format spz")
    run = RunReader(args.out)
    numbers = run.available_frames(selected_frames(args.frames, len(run)))
    if args.format in export_moving.KINDS:
        export_moving.export_moving(args, numbers, run, folder)
        return
    if args.format == POINT_FORMAT and args.surface is None:
        export_points(run, numbers, args, folder)
        return
    look = Appearance(run, render_config.load(args.settings).look)
    up = args.up or ("y" if args.format in Y_UP else "z")
    if args.surface is not None:
        surface_export.export_surfaces(run, look, numbers, args, UP[up], folder)
        return
    folder.mkdir(parents=True, exist_ok=True)
    suffix, version = f".{args.format}", args.spz_version or spz.DEFAULT_VERSION
    reported: set[str] = set()
    model, differing = file_render_model(run, not args.no_scenery)
    if differing and suffix not in WITHOUT_MODEL:
        log.warning("%s", differing)
    for index in tqdm(numbers, unit="frame", disable=True if args.quiet else None):
        gaussians = with_render_model(cloud(look, look.frame(index), not args.no_scenery), model)
        if up != "z":
            gaussians = gaussians.transformed(UP[up])
        if suffix == registry.GLTF:
            gaussians = to_ply_frame(gaussians, gltf.FRAME)  # --up names an axis of the file
        for line in losses(gaussians, suffix):
            kind = line.split(":")[0]
            if kind not in reported:  # each kind is reported once
                log.warning("frame %d: %s", index, line)
                reported.add(kind)
        registry.write(folder / f"frame_{index:05d}{suffix}", gaussians, version)
    log.info("%d files of %d Gaussians", len(numbers), len(gaussians))
