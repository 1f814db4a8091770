"""Video of a run's Gaussians: vgmpi render OUT [render.toml] -o video.mp4

Reads only the files of the run. With mpirun (or srun) the ranks share the frames and rank 0 writes.
Exit code 2 is for errors that the user can correct, with one line each; 75 is for SIGTERM, which
leaves the pictures that are finished.
"""

import argparse
import atexit
import contextlib
import gc
import logging
import os
import signal
import sys
import time
from pathlib import Path
from typing import Any

from vgmpi.io.run_reader import RunError, RunReader
from vgmpi.runtime.command_line import ArgumentParser, exit_code_from_exceptions, usage_error_code
from vgmpi.runtime.compiled_kernels import announce_compiling
from vgmpi.runtime.process_limits import available_cores

from ..frames import image_io, render_config
from ..frames.finished_pictures import digest_of, find_finished, read_picture
from ..frames.frame_processes import (
    OtherRankError,
    compiled_beside,
    render_in_processes,
    render_on_ranks,
    run_on_all_ranks,
)
from ..frames.frame_progress import FrameProgress
from ..frames.frame_renderer import FrameRenderer, RenderedView
from ..frames.prepared_run import PreparedRun, open_run

log = logging.getLogger("vgmpi")

PREVIEW_SIZE = 400  # [pixels] longer side of a preview
FRAMES_PER_PROCESS = 4  # fewer frames than these do not pay for the start of a process
# Variables that launchers set for the processes they start; SLURM's is set without srun too.
LAUNCHER_VARIABLES = ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "SLURM_STEP_NUM_TASKS")

STOPPED = 75  # exit code after SIGTERM, as of a run

COMPILING = "compiling the renderer for this processor, once: a minute or two"


class StopRequest(KeyboardInterrupt):
    """SIGTERM was received."""


def frame_numbers(run: RunReader, frames: render_config.FrameSettings) -> list[int]:
    """Return the frames to draw, missing ones included. Raises RunError if there are none."""
    count = len(run)
    numbers = frames.numbers(count)
    if not numbers:
        message = f"frames {frames.first}..{frames.end(count)}"
        raise RunError(f"{message}: the run has the frames 0..{count - 1}")
    return numbers


def ranks_of_launcher() -> Any:
    """Return the ranks that share the frames, or None for a single process.

    MPI is started only for several ranks, because that takes half a second.
    """
    sizes = [os.environ.get(name, "") for name in LAUNCHER_VARIABLES]
    if max(int(size) if size.isdecimal() else 1 for size in sizes) <= 1:
        return None
    from vgmpi.parallel.communicator import init_communicator

    ranks = init_communicator()
    return ranks if ranks.size > 1 else None


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    p = ArgumentParser(prog="vgmpi render", description=__doc__)
    p.add_argument("out", help="folder of the run")
    p.add_argument("settings", nargs="?", help="render.toml: camera, picture, video, splatting")
    p.add_argument(
        "-o",
        "--output",
        help="a video (.mp4, .webm, .gif), one .png, or a folder of .png files [OUT/video.mp4]",
    )
    p.add_argument("--frame", type=int, help="frame of a .png or of --preview [the last]")
    p.add_argument(
        "--frames", metavar="DIR", help="also write every picture as a PNG to this folder"
    )
    p.add_argument("--alpha", metavar="DIR", help="write the coverage of each pixel as 16-bit PNG")
    p.add_argument("--depth", metavar="DIR", help="write the depth of each pixel [m] as .npy")
    p.add_argument(
        "--resume",
        action="store_true",
        help="use the pictures that an interrupted command left in --frames or the folder of -o",
    )
    p.add_argument(
        "--draft",
        action="store_true",
        help="a fast look: 0.4 of the width and height, coarser grids, one sample per pixel",
    )
    p.add_argument("--preview", action="store_true", help="draw one small picture, OUT/preview.png")
    p.add_argument("--jobs", type=int, help="processes that share the frames [one per core]")
    p.add_argument("-v", "--verbose", action="store_true", help="also say what was chosen and why")
    p.add_argument("-q", "--quiet", action="store_true", help="warnings and errors only")
    return p


def output_path(args: argparse.Namespace) -> Path:
    """Return the path of the result. Raises VideoError for an unknown suffix."""
    path = Path(args.output or Path(args.out) / ("preview.png" if args.preview else "video.mp4"))
    allowed = (".png",) if args.preview else (*image_io.FORMATS, ".png", "")
    if path.suffix not in allowed:
        message = ".png" if args.preview else ".mp4, .webm, .gif or .png, or a folder"
        raise image_io.VideoError(f"-o: {path}: allowed: a name that ends in {message}")
    return path


def main(argv: list[str] | None = None) -> int:
    """Run the command and return its exit code."""
    args = parser().parse_args(argv)
    ranks = ranks_of_launcher()
    is_first = ranks is None or ranks.rank == 0
    level = logging.WARNING if args.quiet else logging.DEBUG if args.verbose else logging.INFO
    level = level if is_first else logging.ERROR
    logging.basicConfig(level=level, format="%(message)s", stream=sys.stderr)
    logging.getLogger("vgmpi").setLevel(level)
    announce_compiling(logging.getLogger("vgmpi"), COMPILING)
    try:
        if ranks is None:
            return _draw(*_prepare(args), args, None)
        painter, output, folder = run_on_all_ranks(ranks, lambda: _prepare(args, ranks.local_size))
        return _draw(painter, output, folder, args, ranks)
    except OtherRankError:
        return 2
    except (render_config.SettingsError, RunError, image_io.VideoError) as error:
        lines = render_config.error_lines(error, args.settings)
        print("\n".join(lines), file=sys.stderr)
        return usage_error_code(error)
    except KeyboardInterrupt as stop:
        print(_stop_message(args), file=sys.stderr)
        return STOPPED if isinstance(stop, StopRequest) else 130


def pictures_folder(args: argparse.Namespace) -> Path | None:
    """Return the folder that holds each picture as soon as it is drawn, or None."""
    if args.frames:
        return Path(args.frames)
    is_folder = args.output and not Path(args.output).suffix
    return Path(args.output) if is_folder else None


def _stop_message(args: argparse.Namespace) -> str:
    """Return one line on what is left after an interrupt."""
    folder = pictures_folder(args)
    if folder is None:
        return "stopped: no video was written (--frames DIR keeps the pictures that are drawn)"
    return f"stopped: the pictures that are drawn are in {folder}; --resume goes on after them"


def _prepare(args: argparse.Namespace, local_count: int = 1) -> tuple[FrameRenderer, Path, Path]:
    """Return the renderer, the output and the folder of render.toml.

    local_count: number of processes on this machine. Raises errors of one line.
    """
    _check_arguments(args)
    output = output_path(args)
    chosen = render_config.load(args.settings)
    if chosen.background == "none" and output.suffix in image_io.FORMATS:
        if output.suffix not in image_io.TRANSPARENT:
            message = f"{output.suffix} has no transparency: allowed: .webm, .png, a folder"
            raise render_config.SettingsError([f"picture.background: 'none': {message}"])
    settings_folder = render_config.base_folder(args.settings)
    run = open_run(args.out, prepared=args.preview)
    if isinstance(run, PreparedRun):
        log.info("%s: no frames yet: the prepared particles are drawn", args.out)
    painter = FrameRenderer(
        run,
        chosen,
        settings_folder,
        alpha=args.alpha is not None,
        depth=args.depth is not None,
        longest=PREVIEW_SIZE if args.preview else None,
        draft=args.draft,
    )
    if output.suffix != ".png":
        painter.afford(max(local_count, min(args.jobs or 1, len(painter.run))))
    return painter, output, settings_folder


def _check_arguments(args: argparse.Namespace) -> None:
    """Raise VideoError if the run and its render.toml are swapped, or if the latter is missing."""
    if args.settings is None:
        if Path(args.out).is_file():
            message = f"{args.out}: is a file; give the folder of a run first"
            raise image_io.VideoError(f"{message}: vgmpi render OUT {args.out}")
        return
    if Path(args.settings).is_dir():
        message = f"{args.settings}: is a folder; the folder of the run comes first"
        raise image_io.VideoError(f"{message}: vgmpi render {args.settings} {args.out}")
    if not Path(args.settings).exists():
        settings = render_config.find_settings(Path(args.out))
        hint = f"; there is {settings}" if settings else "; without it, the defaults are used"
        raise image_io.VideoError(f"{args.settings}: no such file{hint}")


def process_count(painter: FrameRenderer, frame_count: int) -> int:
    """Return how many processes share the frames unless `--jobs` tells.

    One per core, each with enough frames to outweigh its start, and as many as memory holds.
    """
    count = max(1, min(available_cores(), frame_count // FRAMES_PER_PROCESS))
    while count > 1:
        try:
            painter.afford(count)
            break
        except render_config.SettingsError:
            count -= 1
    return count


def _draw(
    painter: FrameRenderer, output: Path, settings_folder: Path, args: Any, ranks: Any
) -> int:
    """Write the picture or the video."""
    if output.suffix == ".png":
        if ranks is not None and ranks.rank:
            return 0
        with compiled_beside(painter, settings_folder):
            return _one_picture(painter, output, args)
    return _video(painter, output, settings_folder, args, ranks)


def view_path(path: Path, painter: FrameRenderer, number: int) -> Path:
    """Return the path of one camera's files; it is `path` if there is only one camera."""
    if len(painter.views) == 1:
        return path
    name = painter.views[number].name
    return path.with_name(f"{path.stem}_{name}{path.suffix}") if path.suffix else path / name


def _one_picture(painter: FrameRenderer, output: Path, args: argparse.Namespace) -> int:
    """Write one frame as PNG."""
    count = len(painter.run)
    index = count - 1 if args.frame is None else args.frame
    if not 0 <= index < count:
        raise RunError(f"--frame: {index}: the run has the frames 0..{count - 1}")
    for number, view in enumerate(painter.views_of(index, index / max(count - 1, 1))):
        path = view_path(output, painter, number)
        image_io.write_png(path, view.picture)
        _write_extras(view, index, number, painter, args)
        print(path)
    return 0


def _write_extras(
    view: RenderedView, index: int, number: int, painter: FrameRenderer, args: Any
) -> None:
    """Write the images, coverages and depths that are requested besides the video."""
    name = f"frame_{index:05d}"
    if args.frames:
        folder = view_path(Path(args.frames), painter, number)
        image_io.write_png(folder / f"{name}.png", view.picture, digest_of(painter))
    if args.alpha:
        assert view.alpha is not None
        image_io.write_png(view_path(Path(args.alpha), painter, number) / f"{name}.png", view.alpha)
    if args.depth:
        assert view.depth is not None
        image_io.write_array(
            view_path(Path(args.depth), painter, number) / f"{name}.npy", view.depth
        )


def _video(
    painter: FrameRenderer, output: Path, settings_folder: Path, args: Any, ranks: Any
) -> int:
    """Write the video."""
    begin = time.perf_counter()
    frames = frame_numbers(painter.run, painter.chosen.frames)
    numbers = painter.run.available_frames(frames)
    ready = _finished_frames(painter, numbers, args, ranks) if args.resume else set()
    # the camera path includes missing frames
    parts = {index: k / max(len(frames) - 1, 1) for k, index in enumerate(frames)}
    tasks = [(index, parts[index]) for index in numbers if index not in ready]
    if ranks is None:
        jobs = process_count(painter, len(tasks)) if args.jobs is None else args.jobs
        rendered = render_in_processes(painter, settings_folder, tasks, jobs)
    else:
        rendered = render_on_ranks(painter, ranks, tasks)
        if ranks.rank:
            for _ in rendered:
                pass
            return 0
    paths = [view_path(output, painter, number) for number in range(len(painter.views))]
    with contextlib.ExitStack() as stack:
        stack.enter_context(contextlib.closing(rendered))  # worker processes end with this one
        in_place = not output.suffix and not args.frames
        added = [index for index in numbers if not (in_place and index in ready)]
        writers = [
            stack.enter_context(_open_writer(painter, k, path, added))
            for k, path in enumerate(paths)
        ]
        progress = stack.enter_context(FrameProgress(len(numbers), args.quiet, len(ready)))
        for index in added:
            if index in ready:
                for number, writer in enumerate(writers):
                    writer.add(read_picture(_files_of(index, number, painter, args)[0]))
                continue
            for number, (writer, view) in enumerate(zip(writers, next(rendered))):
                writer.add(view.picture)
                _write_extras(view, index, number, painter, args)
            progress.add()
    _report(painter, len(numbers), len(tasks), time.perf_counter() - begin)
    print(*paths, sep="\n")
    return 0


def _report(painter: FrameRenderer, count: int, drawn: int, seconds: float) -> None:
    """Log the number of frames, their size and their time [s]."""
    sizes = ", ".join(f"{view.width} x {view.height}" for view in painter.views)
    ready = f", {count - drawn} of them drawn before" if drawn < count else ""
    pace = f", {seconds / drawn:.2f} s each" if drawn else ""
    log.info("%d frames of %s%s%s", count, sizes, ready, pace)


def _files_of(index: int, number: int, painter: FrameRenderer, args: Any) -> list[Path]:
    """Return the files of a frame from one camera: its picture, its coverage and its depth."""
    places = (
        (pictures_folder(args), ".png"),
        (args.alpha and Path(args.alpha), ".png"),
        (args.depth and Path(args.depth), ".npy"),
    )
    return [
        view_path(place, painter, number) / f"frame_{index:05d}{suffix}"
        for place, suffix in places
        if place
    ]


def _finished_frames(painter: FrameRenderer, numbers: list[int], args: Any, ranks: Any) -> set[int]:
    """Return the frames that --resume does not draw again. Collective. Raises VideoError."""
    if pictures_folder(args) is None:
        raise image_io.VideoError("--resume: allowed: with --frames DIR, or -o and a folder")
    finished: set[int] = set()
    if ranks is None or ranks.rank == 0:
        views = range(len(painter.views))
        files = {i: [_files_of(i, number, painter, args) for number in views] for i in numbers}
        finished = find_finished(painter, numbers, files)
    return finished if ranks is None else set(ranks.bcast(sorted(finished)))


def _open_writer(painter: FrameRenderer, number: int, path: Path, frames: list[int]) -> Any:
    """Return the writer of the images of one camera."""
    view, video_settings = painter.views[number], painter.chosen.video
    if not path.suffix:
        return image_io.Sequence(path, frames, digest_of(painter))
    size = (view.width, view.height)
    return image_io.Film(
        path, *size, video_settings.fps, video_settings.quality, clear=painter.clear
    )


def _request_stop(number: int, frame: object) -> None:
    """Stop at SIGTERM: what is half written is removed on the way out."""
    raise StopRequest


@exit_code_from_exceptions
def command(argv: list[str] | None = None) -> int:
    """Run main() in a process of its own: `vgmpi render`."""
    # The objects of imported packages live to the end. Their exclusion from garbage collection,
    # above all at exit, saves a quarter of a second.
    gc.freeze()
    atexit.register(gc.freeze)
    signal.signal(signal.SIGTERM, _request_stop)
    return main(argv)
