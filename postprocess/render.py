"""python -m postprocess.render OUT [render.toml] -o video.mp4: a video of a run's Gaussians.

Reads only the files of the run. Started by mpirun (or srun), the ranks share the frames and rank 0
writes. Exit code 2 for what the user can mend, with one line each.
"""

import argparse
import atexit
import contextlib
import gc
import logging
import os
import sys
import time
from pathlib import Path
from typing import Any

from postprocess import settings, video
from postprocess.painter import Drawn, OtherRankError, Painter, agree, by_processes, by_ranks
from vgmpi.ends import guarded
from vgmpi.output.read import RunError, RunFiles

log = logging.getLogger("vgmpi")

PREVIEW = 400  # pixels of its longer side
# what launchers tell the processes they start; SLURM's is there in a job without srun, too
LAUNCHED = ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "SLURM_STEP_NUM_TASKS")


def frame_numbers(run: RunFiles, asked: settings.FrameSettings) -> list[int]:
    """The frames to draw, also of those that are missing. Raises RunError if there are none."""
    count = len(run)
    numbers = asked.numbers(count)
    if not numbers:
        said = f"frames {asked.first}..{asked.end(count)}"
        raise RunError(f"{said}: the run has the frames 0..{count - 1}")
    return numbers


def ranks_of_launcher() -> Any:
    """The ranks among which a launcher wants the frames shared; None where it started one process.

    MPI is started only then: it takes half a second.
    """
    told = [os.environ.get(name, "") for name in LAUNCHED]
    if max(int(size) if size.isdecimal() else 1 for size in told) <= 1:
        return None
    from vgmpi.domain.ranks import world

    ranks = world()
    return ranks if ranks.size > 1 else None


def parser() -> argparse.ArgumentParser:
    p = argparse.ArgumentParser(prog="python -m postprocess.render", description=__doc__)
    p.add_argument("out", help="folder of the run")
    p.add_argument("settings", nargs="?", help="render.toml: camera, picture, video, splatting")
    p.add_argument(
        "-o",
        "--output",
        help="a film (.mp4, .webm, .gif), a .png of one frame, or a folder of .png [OUT/video.mp4]",
    )
    p.add_argument("--frame", type=int, help="the frame of a .png or --preview [the last]")
    p.add_argument("--frames", metavar="DIR", help="keep every picture as a PNG in this folder")
    p.add_argument("--alpha", metavar="DIR", help="what the Gaussians cover, as 16-bit PNG")
    p.add_argument("--depth", metavar="DIR", help="depth of the frames [m], as .npy")
    p.add_argument("--preview", action="store_true", help="one small picture, OUT/preview.png")
    p.add_argument("--jobs", type=int, default=1, help="processes that share the frames [1]")
    p.add_argument("-q", "--quiet", action="store_true", help="warnings and errors only")
    return p


def output_path(args: argparse.Namespace) -> Path:
    """Where the result goes. Raises VideoError for a name of no known kind."""
    path = Path(args.output or Path(args.out) / ("preview.png" if args.preview else "video.mp4"))
    allowed = (".png",) if args.preview else (*video.FORMATS, ".png", "")
    if path.suffix not in allowed:
        said = ".png" if args.preview else ".mp4, .webm, .gif or .png, or a folder"
        raise video.VideoError(f"-o: {path}: allowed: a name that ends in {said}")
    return path


def main(argv: list[str] | None = None) -> int:
    args = parser().parse_args(argv)
    ranks = ranks_of_launcher()
    first = ranks is None or ranks.rank == 0
    level = logging.ERROR if not first else logging.WARNING if args.quiet else logging.INFO
    logging.basicConfig(level=level, format="%(message)s", stream=sys.stderr)
    logging.getLogger("vgmpi").setLevel(level)
    try:
        if ranks is None:
            return _draw(*_prepare(args), args, None)
        return _draw(*agree(ranks, lambda: _prepare(args, ranks.here)), args, ranks)
    except OtherRankError:
        return 2
    except settings.SettingsError as error:
        print("\n".join(error.lines), file=sys.stderr)
    except (RunError, video.VideoError) as error:
        print(error, file=sys.stderr)
    except KeyboardInterrupt:
        print("stopped: no video was written", file=sys.stderr)
        return 130
    return 2


def _prepare(args: argparse.Namespace, here: int = 1) -> tuple[Painter, Path, Path]:
    """The painter, the output and the folder of render.toml. Raises errors of one line.

    here: processes of this machine that draw.
    """
    output = output_path(args)
    chosen = settings.load(args.settings)
    if chosen.background == "none" and output.suffix in video.FORMATS:
        if output.suffix not in video.TRANSPARENT:
            said = f"{output.suffix} has no transparency: allowed: .webm, .png, a folder"
            raise settings.SettingsError([f"picture.background: 'none': {said}"])
    beside = Path(args.settings).parent if args.settings else Path(".")
    painter = Painter(
        RunFiles(args.out),
        chosen,
        beside,
        alpha=args.alpha is not None,
        depth=args.depth is not None,
        longest=PREVIEW if args.preview else None,
    )
    if output.suffix != ".png":
        painter.afford(max(here, min(args.jobs, len(painter.run))))
    return painter, output, beside


def _draw(painter: Painter, output: Path, beside: Path, args: Any, ranks: Any) -> int:
    if output.suffix == ".png":
        return _one_picture(painter, output, args) if ranks is None or ranks.rank == 0 else 0
    return _video(painter, output, beside, args, ranks)


def of_view(path: Path, painter: Painter, number: int) -> Path:
    """The path of one camera's files: itself if there is only one camera."""
    if len(painter.views) == 1:
        return path
    name = painter.views[number].name
    return path.with_name(f"{path.stem}_{name}{path.suffix}") if path.suffix else path / name


def _one_picture(painter: Painter, output: Path, args: argparse.Namespace) -> int:
    count = len(painter.run)
    index = count - 1 if args.frame is None else args.frame
    if not 0 <= index < count:
        raise RunError(f"--frame: {index}: the run has the frames 0..{count - 1}")
    for number, drawn in enumerate(painter.views_of(index, index / max(count - 1, 1))):
        path = of_view(output, painter, number)
        video.write_png(path, drawn.picture)
        _keep(drawn, index, number, painter, args)
        print(path)
    return 0


def _keep(drawn: Drawn, index: int, number: int, painter: Painter, args: Any) -> None:
    """Write what is asked for besides the video."""
    name = f"frame_{index:05d}"
    if args.frames:
        folder = of_view(Path(args.frames), painter, number)
        video.write_png(folder / f"{name}.png", drawn.picture)
    if args.alpha:
        video.write_png(of_view(Path(args.alpha), painter, number) / f"{name}.png", drawn.alpha)
    if args.depth:
        video.write_array(of_view(Path(args.depth), painter, number) / f"{name}.npy", drawn.depth)


def _video(painter: Painter, output: Path, beside: Path, args: Any, ranks: Any) -> int:
    from tqdm import tqdm

    begin = time.perf_counter()
    asked = frame_numbers(painter.run, painter.chosen.frames)
    numbers = painter.run.present(asked)
    # the camera goes on behind a frame that is missing as if it were there
    parts = {index: k / max(len(asked) - 1, 1) for k, index in enumerate(asked)}
    tasks = [(index, parts[index]) for index in numbers]
    if ranks is None:
        drawn = by_processes(painter, beside, tasks, args.jobs)
    else:
        drawn = by_ranks(painter, ranks, tasks)
        if ranks.rank:
            for _ in drawn:
                pass
            return 0
    paths = [of_view(output, painter, number) for number in range(len(painter.views))]
    with contextlib.ExitStack() as stack:
        stack.enter_context(contextlib.closing(drawn))  # other processes end with this one
        films = [
            stack.enter_context(_sink(painter, k, path, numbers)) for k, path in enumerate(paths)
        ]
        bar = tqdm(drawn, total=len(numbers), unit="frame", disable=True if args.quiet else None)
        for index, views in zip(numbers, bar):
            for number, (film, one) in enumerate(zip(films, views)):
                film.add(one.picture)
                _keep(one, index, number, painter, args)
    each = (time.perf_counter() - begin) / len(numbers)
    sizes = ", ".join(f"{view.width} x {view.height}" for view in painter.views)
    log.info("%d frames of %s, %.2f s each", len(numbers), sizes, each)
    print(*paths, sep="\n")
    return 0


def _sink(painter: Painter, number: int, path: Path, frames: list[int]) -> Any:
    """What takes the pictures of one camera, in order."""
    view, film = painter.views[number], painter.chosen.video
    if not path.suffix:
        return video.Sequence(path, frames)
    size = (view.width, view.height)
    return video.Film(path, *size, film.fps, film.quality, clear=painter.clear)


@guarded
def command() -> int:
    """main() in a process of its own: `vgmpi-render`."""
    # what the packages brought stays to the end: not to look through it again, then above all,
    # saves a quarter of a second
    gc.freeze()
    atexit.register(gc.freeze)
    return main()


if __name__ == "__main__":
    sys.exit(command())
