"""python -m postprocess.render OUT [render.toml] -o video.mp4: a video of a run's Gaussians.

Reads only the files of the run. Exit code 2 for what the user can mend, with one line each.
"""

import argparse
import logging
import multiprocessing
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from tqdm import tqdm

from postprocess import settings, video
from postprocess.look import Look
from vgmpi.output.read import Run, RunError
from vgmpi.splatting import splat
from vgmpi.splatting.camera import HEIGHT, Camera, look_at, orbit_eye, overview

log = logging.getLogger("vgmpi")


class Painter:
    """Draws frames of one run with one set of settings.

    chosen: settings.Settings. folder: of the render.toml, for the background picture.
    """

    def __init__(self, run: Run, chosen: settings.Settings, folder: Path):
        self.run, self.chosen = run, chosen
        self.look = Look(run, chosen.look)
        self.alpha_min = self.look.alpha_min(chosen.splatting.alpha_min)
        size = chosen.picture
        self.background = video.background(size.background, size.width, size.height, folder)
        self.box = domain_box(run)

    def camera(self, part: float) -> Camera:
        """The camera at a part 0..1 of the video."""
        asked, size = self.chosen.camera, self.chosen.picture
        angles = np.arange(0, 360, 10) if asked.turns else [asked.angle]
        auto = overview(*self.box, asked.fov, size.width / size.height, angles, asked.up)
        target, distance, _ = auto
        if asked.target is not None:
            target = np.array(asked.target)
        if asked.kind == "fixed":
            eye = np.array(asked.eye)
        else:
            distance = asked.distance or distance
            height = HEIGHT * distance if asked.height is None else asked.height
            angle = asked.angle + 360 * asked.turns * part
            eye = orbit_eye(target, distance, height, angle, asked.up)
        try:
            return look_at(eye, target, asked.up, asked.fov, size.width, size.height, asked.near)
        except ValueError as error:
            raise settings.SettingsError([f"camera: {error}"]) from None

    def draw(self, index: int, part: float = 0.0) -> np.ndarray:
        """Frame `index` as a uint8 picture (height, width, 3)."""
        camera = self.camera(part)
        splats = self.look.splats(self.look.frame(index), camera.eye)
        options = self.chosen.splatting.options()
        image, _ = splat.render(
            splats, camera, self.background, alpha_min=self.alpha_min, **options
        )
        return video.to_bytes(image)


def domain_box(run: Run) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corner of the domain [m]; of the Gaussians if the scene does not tell."""
    try:
        size = np.array(run.scene["domain"]["size"], dtype=np.float64)
        return np.zeros(3), size
    except (KeyError, TypeError, ValueError):
        x = np.asarray(run.gaussians.x0)
        return x.min(axis=0), x.max(axis=0)


def frame_numbers(run: Run, asked: settings.FrameSettings) -> list[int]:
    """The frames to draw. Raises RunError if there are none."""
    count = len(run)
    last = count - 1 if asked.last is None else min(asked.last, count - 1)
    numbers = list(range(asked.first, last + 1, asked.every))
    if not numbers:
        raise RunError(f"frames {asked.first}..{last}: the run has the frames 0..{count - 1}")
    return numbers


_painter: Painter | None = None  # of a worker process


def _start_worker(folder: str, chosen: settings.Settings, beside: Path) -> None:
    global _painter
    logging.disable(logging.WARNING)  # the first process has said it already
    _painter = Painter(Run(folder), chosen, beside)


def _work(task: tuple[int, float]) -> np.ndarray:
    return _painter.draw(*task)


def pictures(
    painter: Painter, folder: str, beside: Path, numbers: list[int], jobs: int
) -> Iterator:
    """The pictures of the frames in order, drawn by `jobs` processes."""
    tasks = [(index, k / max(len(numbers) - 1, 1)) for k, index in enumerate(numbers)]
    jobs = min(jobs, len(tasks))
    if jobs <= 1:
        yield from (painter.draw(*task) for task in tasks)
        return
    painter.look.colours.prepare(numbers[-1])
    context = multiprocessing.get_context("spawn")  # a fork would share the open files
    with context.Pool(jobs, _start_worker, (folder, painter.chosen, beside)) as pool:
        yield from pool.imap(_work, tasks)


def parser() -> argparse.ArgumentParser:
    p = argparse.ArgumentParser(prog="python -m postprocess.render", description=__doc__)
    p.add_argument("out", help="folder of the run")
    p.add_argument("settings", nargs="?", help="render.toml: camera, picture, video, splatting")
    p.add_argument("-o", "--output", help="video.mp4, or a .png of one frame [OUT/video.mp4]")
    p.add_argument("--frame", type=int, help="the frame of a .png [the last]")
    p.add_argument("--frames", metavar="DIR", help="keep every picture as a PNG in this folder")
    p.add_argument("--jobs", type=int, default=1, help="processes that share the frames [1]")
    p.add_argument("-q", "--quiet", action="store_true", help="warnings and errors only")
    return p


def main(argv: list[str] | None = None) -> int:
    args = parser().parse_args(argv)
    level = logging.WARNING if args.quiet else logging.INFO
    logging.basicConfig(level=level, format="%(message)s", stream=sys.stderr)
    output = Path(args.output or Path(args.out) / "video.mp4")
    if output.suffix not in (".mp4", ".png"):
        print(f"-o: {output}: allowed: a name that ends in .mp4 or .png", file=sys.stderr)
        return 2
    try:
        chosen = settings.load(args.settings)
        beside = Path(args.settings).parent if args.settings else Path(".")
        run = Run(args.out)
        painter = Painter(run, chosen, beside)
        if output.suffix == ".png":
            return _one_picture(painter, output, args)
        return _video(painter, output, args, beside)
    except settings.SettingsError as error:
        print("\n".join(error.lines), file=sys.stderr)
    except (RunError, video.VideoError) as error:
        print(error, file=sys.stderr)
    except KeyboardInterrupt:
        print("stopped: no video was written", file=sys.stderr)
        return 130
    return 2


def _one_picture(painter: Painter, output: Path, args: argparse.Namespace) -> int:
    count = len(painter.run)
    index = count - 1 if args.frame is None else args.frame
    if not 0 <= index < count:
        raise RunError(f"--frame: {index}: the run has the frames 0..{count - 1}")
    video.write_png(output, painter.draw(index, index / max(count - 1, 1)))
    print(output)
    return 0


def _video(painter: Painter, output: Path, args: argparse.Namespace, beside: Path) -> int:
    begin = time.perf_counter()
    numbers = frame_numbers(painter.run, painter.chosen.frames)
    size, film = painter.chosen.picture, painter.chosen.video
    with video.Mp4(output, size.width, size.height, film.fps, film.quality) as mp4:
        drawn = pictures(painter, args.out, beside, numbers, args.jobs)
        bar = tqdm(drawn, total=len(numbers), unit="frame", disable=True if args.quiet else None)
        for index, picture in zip(numbers, bar):
            mp4.add(picture)
            if args.frames:
                video.write_png(Path(args.frames) / f"frame_{index:05d}.png", picture)
    each = (time.perf_counter() - begin) / len(numbers)
    log.info("%d frames of %d x %d, %.2f s each", len(numbers), size.width, size.height, each)
    print(output)
    return 0


if __name__ == "__main__":
    sys.exit(main())
