"""A video as the target: its pictures beside what the renderer makes of a run's."""

import functools
import math
from pathlib import Path

import numpy as np
from scipy import ndimage

from .. import room
from .films import pictures_in, scaled
from .pictures import SHOWN, Pictures
from .settings import FitFile
from .target import Target, frames_at, held_out

WIDTHS = (16, 48, 140)  # of a picture: shares of it by which films are blurred
LEAST = 2 / 255  # change of a colour in a video
SAME_TIME = 1e-3  # of the time between frames
SHIFTS = 4  # rounds in which a camera that is off is found


class Video(Target):
    """Pictures of a video, blurred from coarse to fine; a camera that is off by less than so many
    pixels is made up for, of each run the way that suits it best."""

    def __init__(self, file: FitFile):
        super().__init__()
        asked = file.settings.target
        self.said = "rms of the difference of pictures, over the rms of what changes in the video"
        render = file.folder / str(asked.render)
        self.compared, self.large = Pictures(render, asked.pixels), Pictures(render, SHOWN)
        self.pictures = self.large
        self.path, self.most = file.folder / str(asked.video), asked.camera_shift
        film = self._read(file)
        width, height = self.compared.size
        self.blur = asked.blur or tuple(width / share for share in WIDTHS)
        self.frames, self.used = self._paired(file, len(film))
        film = film[self.used]
        self.held_pictures = held_out(np.arange(len(film)), asked.hold_out)
        self.film = [self._blurred(film, stage) for stage in range(len(self.blur))]
        change = [one - one.mean(0) for one in self.film]
        if np.abs(change[-1]).max() < LEAST:
            raise file.wrong(("target", "video"), "shows nothing that changes")
        self.unit = [float(np.sqrt(np.mean(one**2))) for one in change]
        # of pictures that are blurred, every so many pixels tell all
        self.apart = [max(1, math.floor(pixels)) for pixels in self.blur]
        self.values = [self._numbers(one, stage) for stage, one in enumerate(self.film)]
        each = [len(values) // len(film) for values in self.values]
        self.held = [np.repeat(self.held_pictures, count) for count in each]
        self.size = f"{width} x {height}"
        beside = zip(self.blur, self.apart)
        self.alike = [max(1.0, 4 * math.pi * (pixels / step) ** 2) for pixels, step in beside]
        most = file.settings.method.runs * sum(map(len, self.values)) * np.float32().itemsize
        try:
            room.check(most, f"{file.settings.method.runs} runs of such pictures take")
        except room.TooLarge as error:
            raise file.wrong(("target", "pixels"), f"{error}; got {asked.pixels}") from None
        # a run is looked at for each stage in turn
        self.raw = functools.lru_cache(8)(lambda folder: self.compared.of(folder, self.frames))

    def _read(self, file: FitFile) -> np.ndarray:
        """(pictures, height, width, 3) in the size that runs are drawn in. Raises FitFileError."""
        size = self.compared.size
        try:
            found = [scaled(picture, *size) for picture in pictures_in(self.path)]
        except ValueError as error:
            given = file.settings.target.video
            raise file.wrong(("target", "video"), f"{error}; got '{given}'") from None
        if len(found) < 2:
            raise file.wrong(
                ("target", "video"), f"has {len(found)} pictures: a video has two or more"
            )
        return np.stack(found)

    def _paired(self, file: FitFile, count: int) -> tuple[list[int], np.ndarray]:
        """Numbers of the scene's frames, and which of so many pictures show these moments."""
        asked, time = file.settings.target, file.scene.time
        drawn = self.compared.frames(time.frames)
        if not drawn:
            said = f"draws none of the scene's {time.frames} frames; got '{asked.render}'"
            raise file.wrong(("target", "render"), said)
        if asked.frame_time is None:
            if count > len(drawn):
                said = f"has {count} pictures; of the scene {len(drawn)} frames are drawn"
                raise file.wrong(("target", "video"), f"{said}: time.end and time.frames say when")
            return drawn[:count], np.arange(count)
        at = asked.time_zero + asked.frame_time * np.arange(count)
        near, apart = frames_at(time, at, drawn)
        fits = apart < SAME_TIME
        if fits.sum() < 2:
            every = time.end / (time.frames - 1)
            said = f"{fits.sum()} pictures are of a moment of which the scene has a frame, every"
            raise file.wrong(
                ("target", "frame_time"), f"{said} {every:g} s: two or more are needed"
            )
        return [drawn[k] for k in near[fits]], np.flatnonzero(fits)

    def _blurred(self, film: np.ndarray, stage: int) -> np.ndarray:
        """Each picture, over so many pixels."""
        wide = (0, self.blur[stage], self.blur[stage], 0)
        return ndimage.gaussian_filter(film, wide, mode="nearest")

    def of(self, folder: Path, stage: int) -> np.ndarray:
        film = self._blurred(self.raw(folder), stage)
        if self.most:
            film = shifted(film, self._shift(film, stage))
        return self._numbers(film, stage)

    def _numbers(self, film: np.ndarray, stage: int) -> np.ndarray:
        step = self.apart[stage]
        return film[:, ::step, ::step].ravel() / self.unit[stage]

    def _shift(self, film: np.ndarray, stage: int) -> np.ndarray:
        """How far [pixels down, right] a run's pictures are moved to lie on the video's as well as
        they can, of what is fitted (Gauss and Newton)."""
        own, there = film[~self.held_pictures], self.film[stage][~self.held_pictures]
        by = np.zeros(2)
        for _ in range(SHIFTS):
            now = shifted(own, by)
            slopes = np.stack([np.gradient(now, axis=k).ravel() for k in (1, 2)], axis=1)
            onto = slopes.T @ (now - there).ravel()
            step = np.linalg.lstsq(slopes.T @ slopes, onto, rcond=1e-9)[0]
            by = np.clip(by + step, -self.most, self.most)
        return by

    def shown(self) -> np.ndarray:
        wanted, size = set(self.used.tolist()), self.large.size
        film = enumerate(pictures_in(self.path))  # one after the other: they may be large
        return np.stack([scaled(picture, *size) for k, picture in film if k in wanted])

    def notes(self, folder: Path) -> list[str]:
        stage = self.stages - 1
        count = f"{len(self.frames)} pictures of {self.size} pixels"
        if not self.most:
            return [f"Compared: {count}."]
        down, right = self._shift(self._blurred(self.raw(folder), stage), stage)
        said = f"the run's moved by {right:+.2f} to the right and {down:+.2f} down"
        ends = (
            " (as far as camera_shift lets it)" if max(abs(down), abs(right)) >= self.most else ""
        )
        return [f"Compared: {count}, {said}{ends}."]


def shifted(film: np.ndarray, by: np.ndarray) -> np.ndarray:
    """Pictures moved by so many pixels down and right, what lies beyond their edges as at these.
    By cubic convolution (Keys 1981), which splines of scipy take fifty times as long for."""
    for axis, way in zip((1, 2), by):
        if way:
            film = _along(film, axis, float(way))
    return film


def _along(film: np.ndarray, axis: int, way: float) -> np.ndarray:
    whole, count = math.floor(way), film.shape[axis]
    t = way - whole  # between the pixels -whole - 1 and -whole
    places = np.arange(count) - whole
    terms = [
        np.float32(weight) * film.take((places + step).clip(0, count - 1), axis)
        for weight, step in zip(_weights(t), (-2, -1, 0, 1))
    ]
    return sum(terms[1:], terms[0])


def _weights(t: float) -> tuple[float, float, float, float]:
    """Of pixels at -2, -1, 0, 1 for a place t of 0..1 before 0."""
    s = 1 - t  # behind the pixel at -1
    return (
        0.5 * (-s + 2 * s**2 - s**3),
        0.5 * (2 - 5 * s**2 + 3 * s**3),
        0.5 * (s + 4 * s**2 - 3 * s**3),
        0.5 * (-(s**2) + s**3),
    )
