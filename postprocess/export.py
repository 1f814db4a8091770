"""python -m postprocess.export OUT --frames 0:50:5 -o DIR --format ply: Gaussian files of frames.

A file holds what the renderer draws: shapes, opacities and colours of that moment, in metres and
in the domain's axes, for any viewer of Gaussians. Exit code 2 for what the user can mend.
"""

import argparse
import logging
import re
import sys
from pathlib import Path

import numpy as np
from tqdm import tqdm

from postprocess import settings
from postprocess.look import Look
from vgmpi.ends import guarded
from vgmpi.gaussians import files
from vgmpi.gaussians.cloud import Cloud, principal
from vgmpi.output.read import RunError, RunFiles

log = logging.getLogger("vgmpi")

# what brings the domain's z to the axis that points up in the file
UP = {
    "z": np.eye(3),
    "y": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
    "-y": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]),
}


def cloud(look: Look, frame: dict[str, np.ndarray], scenery: bool = True) -> Cloud:
    """The Gaussians of a frame as they are drawn [m], for any eye; scenery first.

    frame: of look.frame. Raises RunError.
    """
    parts = look.parts(frame)
    if not scenery and look.scenery is not None:
        parts = parts[1:]
    colors = [part.coefficients() for part in parts]
    terms = max(sh.shape[1] for sh in colors)
    colors = [np.pad(sh, ((0, 0), (0, terms - sh.shape[1]), (0, 0))) for sh in colors]
    quat, scale = principal(np.concatenate([part.cov for part in parts]))
    return Cloud(
        np.concatenate([part.x for part in parts]),
        quat,
        scale,
        np.concatenate([part.opacity for part in parts]),
        np.concatenate(colors),
    )


def chosen(text: str | None, count: int) -> list[int]:
    """Frame numbers out of "25", "-1" or "first:last:every" (last not included), as for a list in
    Python. Raises RunError."""
    if text is None:
        return list(range(count))
    if not re.fullmatch(r"-?\d{1,9}|(-?\d{1,9})?:(-?\d{1,9})?(:\d{0,9})?", text):
        raise RunError(f"--frames: {text}: allowed: a number, or first:last:every as 0:50:5")
    numbers = [int(part) if part else None for part in text.split(":")]
    if len(numbers) == 1:
        numbers = [numbers[0], numbers[0] + 1 or None]
    elif numbers[2:] == [0]:
        raise RunError(f"--frames: {text}: allowed: every 1st or more")
    found = list(range(count))[slice(*numbers)]
    if not found:
        raise RunError(f"--frames: {text}: the run has the frames 0..{count - 1}")
    return found


def losses(made: Cloud, suffix: str) -> list[str]:
    """What a file of this kind does not keep of a cloud, a line each."""
    found = []
    shiny = np.count_nonzero((made.sh[:, 1:] != 0).any(axis=(1, 2)))
    if suffix == ".splat" and shiny:
        found.append(f"a .splat keeps no view-dependent colour: {shiny:,} Gaussians lose theirs")
    most = {".spz": 1, files.COMPRESSED: 4}.get(suffix, np.inf)
    if beyond := np.count_nonzero(np.abs(made.sh[:, 1:]) > most):
        found.append(f"a {suffix} holds coefficients of -{most}..{most}: {beyond:,} are cut")
    faint = np.count_nonzero((made.opacity > 0) & (made.opacity < 0.5 / 255))
    if suffix not in (".ply", files.GLTF) and faint:
        said = f"opacities are 255ths in a {suffix}: {faint:,} of {len(made):,} Gaussians vanish"
        found.append(f"{said}; a .ply keeps them")
    return found


def parser() -> argparse.ArgumentParser:
    p = argparse.ArgumentParser(prog="python -m postprocess.export", description=__doc__)
    p.add_argument("out", help="folder of the run")
    p.add_argument("settings", nargs="?", help="render.toml: its table [look]")
    p.add_argument("--frames", help="a number, or first:last:every as in Python [all]")
    p.add_argument("-o", "--output", help="folder of the files [OUT/gaussians]")
    kinds = [suffix.removeprefix(".") for suffix in (*files.KINDS, files.COMPRESSED, files.GLTF)]
    p.add_argument("--format", choices=kinds, default=kinds[0], help="kind of the files [ply]")
    up = "up in the file; captures: --up=-y [z; of a .glb y]"
    p.add_argument("--up", choices=UP, help=up)
    p.add_argument("--no-scenery", action="store_true", help="only what moves")
    p.add_argument("-q", "--quiet", action="store_true", help="warnings and errors only")
    return p


@guarded
def main(argv: list[str] | None = None) -> int:
    args = parser().parse_args(argv)
    level = logging.WARNING if args.quiet else logging.INFO
    logging.basicConfig(level=level, format="%(message)s", stream=sys.stderr)
    folder = Path(args.output or Path(args.out) / "gaussians")
    try:
        _export(args, folder)
    except settings.SettingsError as error:
        print("\n".join(error.lines), file=sys.stderr)
    except (RunError, files.GaussianFileError) as error:
        print(error, file=sys.stderr)
    except OSError as error:
        print(f"{error.filename or folder}: {error.strerror or error}", file=sys.stderr)
    except KeyboardInterrupt:
        print("stopped: the files written so far are complete", file=sys.stderr)
        return 130
    else:
        print(folder)
        return 0
    return 2


def _export(args: argparse.Namespace, folder: Path) -> None:
    run = RunFiles(args.out)
    numbers = run.present(chosen(args.frames, len(run)))
    look = Look(run, settings.load(args.settings).look)
    folder.mkdir(parents=True, exist_ok=True)
    suffix = f".{args.format}"
    said: set[str] = set()
    for index in tqdm(numbers, unit="frame", disable=True if args.quiet else None):
        made = cloud(look, look.frame(index), not args.no_scenery)
        up = args.up or ("y" if suffix == files.GLTF else "z")
        if up != "z":
            made = made.transformed(UP[up])
        for line in losses(made, suffix):
            kind = line.split(":")[0]
            if kind not in said:  # once for all frames
                log.warning("frame %d: %s", index, line)
                said.add(kind)
        files.write(folder / f"frame_{index:05d}{suffix}", made)
    log.info("%d files of %d Gaussians", len(numbers), len(made))


if __name__ == "__main__":
    sys.exit(main())
