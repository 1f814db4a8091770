"""Frames of a run as pictures: the Gaussians of a frame are worked out once for all cameras."""

import contextlib
import functools
import logging
import multiprocessing
import pickle
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from postprocess import settings, video
from postprocess.liquids import Liquids
from postprocess.look import Look, seen
from postprocess.parts import Part
from postprocess.viewpoints import Viewpoint
from vgmpi import room
from vgmpi.output.read import RunError, RunFiles
from vgmpi.splatting import floor, light, liquid, splat
from vgmpi.splatting.camera import Camera, through_lens

log = logging.getLogger("vgmpi")

Pixels = tuple[np.ndarray, ...]  # picture, what comes through, and depths where asked for
STUDIO_BYTES = 400  # of a pixel that the studio draws, at least
LOOKS = 9  # at a run, to see where things are


@dataclass(frozen=True)
class Drawn:
    """One view of a frame.

    picture: uint8 (height, width, 3), or 4 with transparency. alpha: what the Gaussians cover,
    uint16 (height, width) of 0..65535. depth: along the axis of the camera, float32 (height, width)
    [m], infinite where nothing is. The last two are None unless asked for.
    """

    picture: np.ndarray
    alpha: np.ndarray | None = None
    depth: np.ndarray | None = None


class Painter:
    """Draws frames of one run with one set of settings.

    chosen: settings.Settings. folder: of the render.toml, for the files it names. alpha, depth:
    whether to work these out too. longest: of a preview, the longer side of its picture. box: gives
    lower and upper corner of what is to be seen [m]; default: where the run's Gaussians are.
    """

    def __init__(
        self,
        run: RunFiles,
        chosen: settings.Settings,
        folder: Path,
        *,
        alpha: bool = False,
        depth: bool = False,
        longest: int | None = None,
        box: Callable[[], tuple[np.ndarray, np.ndarray]] | None = None,
    ):
        self.run, self.chosen = run, chosen
        self.alpha, self.depth = alpha, depth
        size = chosen.picture
        # of files that some cameras have no need of
        box = box or functools.cache(lambda: reach(run))
        self.views = [
            Viewpoint(one, size, box, folder, longest) for one in chosen.views()
        ]  # before all that takes long: mistakes in files show at once
        self.supersample = 1 if longest else size.supersample
        self.surface = chosen.look.liquid == "surface" and not chosen.studio
        self.afford()
        self.grounds = [
            video.background(chosen.background, one.width, one.height, folder) for one in self.views
        ]
        photograph = any(ground.ndim == 3 for ground in self.grounds)
        self.light = chosen.light.light() if chosen.light else None
        self.floor = None
        drawn = size.floor and size.floor.kind not in ("none", "photograph")
        if drawn and not chosen.studio:  # which has its own
            self.floor = size.floor.floor(photograph, self.light)
        self.clear = chosen.background == "none"
        blurs = chosen.video.shutter > 0
        if not chosen.studio:  # which blurs by depth
            blurs = blurs or any(one.aperture > 0 for one in chosen.views())
        self.samples = size.samples if blurs and not longest else 1
        self.look = Look(run, chosen.look)
        self.liquids = None
        if self.surface:
            sun = self.light or light.Light()
            self.liquids = Liquids(self.look, chosen.liquid, sun, box, folder)
        self.alpha_min = self.look.alpha_min(
            chosen.splatting.alpha_min, self.surface or chosen.studio
        )
        self.studio = None
        if chosen.studio:
            from postprocess.studio import Studio  # compiles much: not for preset "paper"

            self.studio = Studio(self.look, chosen, box, folder, quick=longest is not None)

    def afford(self, at_once: int = 1) -> None:
        """Raises SettingsError where `at_once` pictures do not fit into the memory of a machine."""
        view = max(self.views, key=lambda one: one.width * one.height)
        pixels = view.width * view.height * self.supersample**2
        said = f"{view.width} x {view.height} pixels"
        if self.supersample > 1:
            said = f"{self.supersample} draws {said} as {self.supersample**2} times as many"
        key = "picture.supersample" if self.supersample > 1 else "picture.width"
        often = f", {at_once} pictures at once" if at_once > 1 else ""
        try:
            each = liquid.BYTES if self.surface else splat.BYTES
            each = STUDIO_BYTES if self.chosen.studio else each
            room.check(at_once * each * pixels, f"{key}: {said}{often}: at least")
        except room.TooLarge as error:
            raise settings.SettingsError([str(error)]) from None

    def camera(self, part: float) -> Camera:
        """The first camera at a part 0..1 of the video."""
        return self.views[0].at(part, 0.0)

    def draw(self, index: int, part: float = 0.0) -> np.ndarray:
        """Frame `index` as a uint8 picture (height, width, 3) from the first camera."""
        return self.views_of(index, part)[0].picture

    def views_of(self, index: int, part: float) -> list[Drawn]:
        """Frame `index` at a part 0..1 of the video, from every camera."""
        return [self._finished(pixels) for pixels in self.pixels_of(index, part)]

    def pixels_of(self, index: int, part: float) -> list[Pixels]:
        """The same before it is rounded: colours 0..1 (height, width, 3), what comes through."""
        frame = self.look.frame(index)
        time = float(self.run.times[index]) if self._by_time() else 0.0
        cameras = [view.at(part, time) for view in self.views]
        found, parts, now = [], [], frame
        for sample in range(self.samples):
            if sample == 0 or self.chosen.video.shutter > 0:  # else they stay where they are
                now = self._moment(frame, index, sample)
                if self.studio is None:
                    parts = self._lit(self.look.parts(now), now)
                else:
                    parts = self.studio.moment(now, index)
            found.append(self._pixels(now, parts, cameras, sample))
        return [self._mean(views) for views in zip(*found)]

    def _mean(self, views: tuple[Pixels, ...]) -> Pixels:
        """Of the samples of a view; its depths are those of the first."""
        if len(views) == 1:
            return views[0]
        image, left = (sum(one[k] for one in views) / len(views) for k in (0, 1))
        return image, left, *views[0][2:]

    def _moment(self, frame: dict[str, np.ndarray], index: int, sample: int) -> dict:
        """The frame a little later, while the shutter is open: particles go on as they do."""
        shutter = self.chosen.video.shutter
        if sample == 0:
            return frame
        if "velocity" not in frame:
            raise RunError("video.shutter: the frames hold no velocity: see output.fields")
        times = self.run.times
        near = min(index, len(times) - 2) if len(times) > 1 else 0
        step = float(times[near + 1] - times[near]) if len(times) > 1 else 0.0
        later = shutter * step * sample / self.samples
        return {**frame, "x": frame["x"] + later * np.asarray(frame["velocity"], dtype=np.float64)}

    def _pixels(
        self, frame: dict, parts: list[Part], cameras: list[Camera], sample: int
    ) -> list[Pixels]:
        """Picture, what comes through and depths of a frame's parts from every camera."""
        found = []
        for one, camera, ground in zip(self.chosen.views(), cameras, self.grounds):
            if self.studio is not None:
                found.append(self._in_studio(parts, camera, ground, one))
                continue
            if one.aperture > 0 and self.samples > 1:
                camera = through_lens(camera, one.aperture, one.focus, sample, self.samples)
            found.append(self._drawn(frame, parts, camera, ground))
        return found

    def _in_studio(self, moment: Any, camera: Camera, ground: np.ndarray, one: Any) -> Pixels:
        """A frame from one camera, lit; in `supersample` times as many pixels, then averaged."""
        times = self.supersample
        fine = splat.finer(camera, times)
        under = splat.behind(ground, camera, times)
        options = {"alpha_min": self.alpha_min, **self.chosen.splatting.options()}
        lens = (one.aperture, one.focus or 1.0)
        return splat.coarser(self.studio.render(moment, fine, under, options, lens), times)

    def _by_time(self) -> bool:  # the times of a run are in as many files as it has frames
        return any(one.keys and one.keys[0].time is not None for one in self.chosen.views())

    def _drawn(self, frame: dict, parts: list[Part], camera: Camera, ground: np.ndarray) -> Pixels:
        splats = seen(parts, camera.eye)
        ground = self._ground(splats, camera, ground)
        options = {"alpha_min": self.alpha_min, **self.chosen.splatting.options()}
        if self.liquids is None:
            depth = "median" if self.depth else None
            options |= {"supersample": self.supersample, "depth": depth}
            return splat.render(splats, camera, ground, **options)
        fine = splat.finer(camera, self.supersample)
        under = splat.behind(ground, camera, self.supersample)
        found = self.liquids.render(
            frame, parts, fine, under, self.floor, asked=self.depth, **options
        )
        return splat.coarser(found, self.supersample)

    def _lit(self, parts: list[Part], frame: dict) -> list[Part]:
        """The parts in the light, if there is one."""
        if self.light is None:
            return parts
        x, cov, opacity = (np.concatenate([p[k] for p in parts]) for k in range(3))
        splats = splat.Splats(x, cov, opacity, np.zeros((len(x), 3)))
        liquid = None if self.liquids is None else self.liquids.among(parts, frame)
        bright = light.lit(splats, self.light, self.look.spacing, liquid)
        ends = np.cumsum([len(part.x) for part in parts])[:-1]
        return [part.brighter(own) for part, own in zip(parts, np.split(bright, ends))]

    def _ground(self, splats: splat.Splats, camera: Camera, ground: np.ndarray) -> np.ndarray:
        """What stands behind the Gaussians, as fine as it is drawn where there is a floor."""
        if self.floor is None:
            return ground
        fine = splat.finer(camera, self.supersample)
        under = splat.behind(ground, camera, self.supersample)
        cast = floor.cast(splats, self.floor)
        contact = floor.touch(splats, self.floor) if self.floor.contact else None
        return floor.ground(self.floor, cast, fine, under, contact)

    def _finished(self, pixels: Pixels) -> Drawn:
        image, left, *depth = pixels
        if self.clear:
            picture = video.with_transparency(image, 1 - left)
        else:
            picture = video.to_bytes(image)
        alpha = np.round((1 - left) * 65535).astype(np.uint16) if self.alpha else None
        return Drawn(picture, alpha, depth[0] if depth else None)


def domain_box(run: RunFiles) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corner of the domain [m]; of the Gaussians if the scene does not tell."""
    try:
        size = np.array(run.scene["domain"]["size"], dtype=np.float64)
        return np.zeros(3), size
    except (KeyError, TypeError, ValueError):
        x = np.asarray(run.gaussians.x0)
        return x.min(axis=0), x.max(axis=0)


def reach(run: RunFiles) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corner [m] of what is to be seen: where the centres of Gaussians are at some
    frames, spread over the run, and at rest; inside the domain."""
    lower, upper = domain_box(run)
    numbers, there = sorted(run.frames), []
    for at in np.unique(np.linspace(0, len(numbers) - 1, LOOKS).round().astype(int)):
        with contextlib.suppress(RunError):  # told when it is to be drawn
            there.append(run.positions(numbers[at]))
    scenery = run.gaussians.scenery
    if scenery is not None:
        there.append(np.asarray(scenery.x0))
    there = [x for x in there if len(x)]
    if not there:
        return lower, upper
    low = np.max([np.min([x.min(axis=0) for x in there], axis=0), lower], axis=0)
    high = np.min([np.max([x.max(axis=0) for x in there], axis=0), upper], axis=0)
    return low, np.maximum(low, high)


Task = tuple[int, float]  # a frame's number and its part of the video
_painter: Painter | None = None  # of a worker process


def _start_worker(folder: str, chosen: settings.Settings, beside: Path, options: dict) -> None:
    global _painter
    logging.disable(logging.WARNING)  # the first process has said it already
    _painter = Painter(RunFiles(folder), chosen, beside, **options)


def _work(task: Task) -> list[Drawn]:
    return _painter.views_of(*task)


def by_processes(painter: Painter, beside: Path, tasks: list[Task], jobs: int) -> Iterator:
    """The views of the frames in order, drawn by `jobs` processes."""
    jobs = min(jobs, len(tasks))
    if jobs <= 1:
        yield from (painter.views_of(*task) for task in tasks)
        return
    painter.look.colours.prepare(tasks[-1][0])
    context = multiprocessing.get_context("spawn")  # a fork would share the open files
    options = {"alpha": painter.alpha, "depth": painter.depth}
    start = (str(painter.run.folder), painter.chosen, beside, options)
    with context.Pool(jobs, _start_worker, start) as pool:
        yield from pool.imap(_work, tasks)


class OtherRankError(RunError):
    """Raised on ranks other than 0 when any rank has met an error: rank 0 tells it."""


def agree(ranks: Any, make) -> Any:
    """What make() returns on this rank; where it fails on any rank, it fails on all of them.

    Rank 0 raises the error of the lowest rank, the others OtherRankError. Collective.
    """
    result, error = None, None
    try:
        result = make()
    except (RunError, settings.SettingsError, video.VideoError) as caught:
        error = caught
    failed = ranks.max(np.array([error is not None], dtype=np.int64))
    if failed[0]:
        errors = _at_root(ranks, error)
        raise next(e for e in errors if e is not None) if ranks.rank == 0 else OtherRankError()
    return result


def by_ranks(painter: Painter, ranks: Any, tasks: list[Task]) -> Iterator:
    """The views of the frames in order, on rank 0; as many Nones on the others.

    Round after round every rank draws one frame and rank 0 gathers them: neighbouring frames take
    nearly the same time. ranks: vgmpi.domain.ranks. Collective.
    """
    if ranks.rank == 0:
        painter.look.colours.prepare(tasks[-1][0])
    ranks.barrier()
    for first in range(0, len(tasks), ranks.size):
        mine = tasks[first + ranks.rank : first + ranks.rank + 1]
        views = agree(ranks, lambda mine=mine: [painter.views_of(*task) for task in mine])
        together = _at_root(ranks, views)
        count = min(ranks.size, len(tasks) - first)
        try:
            yield from (one[0] for one in together[:count]) if ranks.rank == 0 else [None] * count
        except GeneratorExit:  # rank 0 cannot write: the others wait for the next round
            if first + ranks.size < len(tasks):
                with contextlib.suppress(RunError):
                    agree(ranks, _give_up)
            raise


def _give_up() -> None:
    raise RunError("rank 0 cannot write")


def _at_root(ranks: Any, thing: Any) -> list | None:
    """The things of all ranks, in rank order, on rank 0. Collective."""
    data = np.frombuffer(pickle.dumps(thing, protocol=5), dtype=np.uint8)
    sizes = ranks.all_rows(np.array([len(data)], dtype=np.int64))
    rows = ranks.root_rows(data)
    if rows is None:
        return None
    ends = np.cumsum(sizes)
    return [pickle.loads(rows[end - size : end].tobytes()) for size, end in zip(sizes, ends)]
