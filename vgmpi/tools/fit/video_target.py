"""Target made of a video: its pictures compared with rendered images of a run."""

import functools
import math
from pathlib import Path

import numpy as np
from scipy import ndimage

from vgmpi.runtime import process_limits

from .fit_config import FitFile
from .target_base import MAX_DISPLAY_SIZE, Pictures, Target, held_out, nearest_frames
from .video_reader import describe_pictures, pictures_in, scaled

BLUR_FRACTIONS = (16, 48, 140)  # [-] image width over blur width, by stage
MIN_CHANGE = 2 / 255  # [-] change of a color below which a video counts as still
TIME_TOLERANCE = 1e-3  # [frame intervals]
SHIFT_ITERATIONS = 4  # Gauss-Newton iterations for the shift of the camera


class VideoTarget(Target):
    """Pictures of a video, blurred from coarse to fine.

    A misaligned camera is compensated: the pictures of each run are shifted by the best-fitting
    distance of at most max_camera_shift pixels.
    """

    def __init__(self, file: FitFile):
        super().__init__()
        settings = file.settings.target
        self.loss_description = (
            "rms of the difference of pictures, over the rms of what changes in the video"
        )
        render = file.folder / str(settings.render)
        self.compared, self.display_renderer = (
            Pictures(render, settings.pixels),
            Pictures(render, MAX_DISPLAY_SIZE),
        )
        self.pictures = self.display_renderer
        self.path, self.max_shift = file.folder / str(settings.video), settings.max_camera_shift
        film = self._read(file)
        self.preamble = f"target {settings.video}: {describe_pictures(self.path, len(film))}"
        width, height = self.compared.size
        self.blur = settings.blur or tuple(width / share for share in BLUR_FRACTIONS)
        self.frames, self.used = self._paired(file, len(film))
        film = film[self.used]
        self.held_pictures = held_out(np.arange(len(film)), settings.holdout_every)
        self.film = [self._blurred(film, stage) for stage in range(len(self.blur))]
        change = [blurred - blurred.mean(0) for blurred in self.film]
        if np.abs(change[-1]).max() < MIN_CHANGE:
            raise file.wrong(("target", "video"), "shows nothing that changes")
        self.unit = [float(np.sqrt(np.mean(blurred**2))) for blurred in change]
        # a blurred picture is sampled at intervals of the blur width
        self.strides = [max(1, math.floor(pixels)) for pixels in self.blur]
        self.values = [self._numbers(blurred, stage) for stage, blurred in enumerate(self.film)]
        sizes = [len(values) // len(film) for values in self.values]
        self.holdout_mask = [np.repeat(self.held_pictures, count) for count in sizes]
        self.size = f"{width} x {height}"
        widths = zip(self.blur, self.strides)
        self.correlated_counts = [
            max(1.0, 4 * math.pi * (pixels / step) ** 2) for pixels, step in widths
        ]
        memory = file.settings.method.max_runs * sum(map(len, self.values)) * np.float32().itemsize
        try:
            process_limits.require_memory(
                memory, f"{file.settings.method.max_runs} runs of such pictures take"
            )
        except process_limits.InsufficientMemoryError as error:
            raise file.wrong(("target", "pixels"), f"{error}; got {settings.pixels}") from None
        # the stages are evaluated one after the other, and share the images of a run
        self.raw = functools.lru_cache(8)(
            lambda folder: self.compared.render_run(folder, self.frames)
        )

    def _read(self, file: FitFile) -> np.ndarray:
        """Return the video in the size of rendered images. Raises FitFileError."""
        size = self.compared.size
        try:
            pictures = [scaled(picture, *size) for picture in pictures_in(self.path)]
        except ValueError as error:
            name = file.settings.target.video
            raise file.wrong(("target", "video"), f"{error}; got '{name}'") from None
        if len(pictures) < 2:
            raise file.wrong(
                ("target", "video"), f"has {len(pictures)} pictures: a video has two or more"
            )
        return np.stack(pictures)

    def _paired(self, file: FitFile, count: int) -> tuple[list[int], np.ndarray]:
        """Return the frames of the scene and the pictures that show the same moments."""
        settings, time = file.settings.target, file.scene.time
        drawn = self.compared.frames(time.frames)
        if not drawn:
            message = f"draws none of the scene's {time.frames} frames; got '{settings.render}'"
            raise file.wrong(("target", "render"), message)
        if settings.frame_time is None:
            if count > len(drawn):
                message = f"has {count} pictures; of the scene {len(drawn)} frames are drawn"
                raise file.wrong(
                    ("target", "video"), f"{message}: time.end and time.frames say when"
                )
            return drawn[:count], np.arange(count)
        times = settings.time_offset + settings.frame_time * np.arange(count)
        nearest, distance = nearest_frames(time, times, drawn)
        is_paired = distance < TIME_TOLERANCE
        if is_paired.sum() < 2:
            interval = time.end / (time.frames - 1)
            message = (
                f"{is_paired.sum()} pictures are of a moment of which the scene has a frame, every"
            )
            raise file.wrong(
                ("target", "frame_time"), f"{message} {interval:g} s: two or more are needed"
            )
        return [drawn[k] for k in nearest[is_paired]], np.flatnonzero(is_paired)

    def _blurred(self, film: np.ndarray, stage: int) -> np.ndarray:
        """Return the pictures, each blurred by the width of a stage."""
        sigma = (0, self.blur[stage], self.blur[stage], 0)
        return ndimage.gaussian_filter(film, sigma, mode="nearest")

    def observe(self, folder: Path, stage: int) -> np.ndarray:
        """Return the scaled pixels of a run in a stage, aligned with the video, shape (n,)."""
        film = self._blurred(self.raw(folder), stage)
        if self.max_shift:
            film = shifted(film, self._shift(film, stage))
        return self._numbers(film, stage)

    def _numbers(self, film: np.ndarray, stage: int) -> np.ndarray:
        """Sample blurred pictures and scale them by the video's change, shape (n,)."""
        step = self.strides[stage]
        return film[:, ::step, ::step].ravel() / self.unit[stage]

    def _shift(self, film: np.ndarray, stage: int) -> np.ndarray:
        """Return the shift [pixels down, right] that aligns a run's pictures with the video.

        Gauss-Newton iterations minimize the difference over the pictures that are not held out.
        """
        pictures, reference = film[~self.held_pictures], self.film[stage][~self.held_pictures]
        shift = np.zeros(2)
        for _ in range(SHIFT_ITERATIONS):
            moved = shifted(pictures, shift)
            slopes = np.stack([np.gradient(moved, axis=k).ravel() for k in (1, 2)], axis=1)
            right_hand_side = slopes.T @ (moved - reference).ravel()
            step = np.linalg.lstsq(slopes.T @ slopes, right_hand_side, rcond=1e-9)[0]
            shift = np.clip(shift + step, -self.max_shift, self.max_shift)
        return shift

    def images(self) -> np.ndarray:
        """Return the pictures of the video in the size for viewing."""
        wanted, size = set(self.used.tolist()), self.display_renderer.size
        # pictures are read one at a time, because they may be large
        film = enumerate(pictures_in(self.path))
        return np.stack([scaled(picture, *size) for k, picture in film if k in wanted])

    def report_lines(self, folder: Path) -> list[str]:
        """Return the report's lines about the compared pictures and their shift."""
        stage = self.stages - 1
        count = f"{len(self.frames)} pictures of {self.size} pixels"
        if not self.max_shift:
            return [f"Compared: {count}."]
        down, right = self._shift(self._blurred(self.raw(folder), stage), stage)
        message = f"the run's moved by {right:+.2f} to the right and {down:+.2f} down"
        ends = (
            " (as far as max_camera_shift lets it)"
            if max(abs(down), abs(right)) >= self.max_shift
            else ""
        )
        return [f"Compared: {count}, {message}{ends}."]


def shifted(film: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """Shift pictures by pixels down and right, with edge values continued outward.

    The interpolation is cubic convolution (Keys 1981); splines of scipy take fifty times as long.
    """
    for axis, distance in zip((1, 2), shift):
        if distance:
            film = _shift_axis(film, axis, float(distance))
    return film


def _shift_axis(film: np.ndarray, axis: int, distance: float) -> np.ndarray:
    """Shift pictures along one axis by a distance [pixels]."""
    pixels, count = math.floor(distance), film.shape[axis]
    fraction = distance - pixels  # position between the pixels -pixels - 1 and -pixels
    positions = np.arange(count) - pixels
    terms = [
        np.float32(weight) * film.take((positions + step).clip(0, count - 1), axis)
        for weight, step in zip(_cubic_weights(fraction), (-2, -1, 0, 1))
    ]
    return sum(terms[1:], terms[0])


def _cubic_weights(t: float) -> tuple[float, float, float, float]:
    """Return weights of pixels at -2, -1, 0, 1 for a position at distance t in [0, 1] before 0."""
    s = 1 - t  # distance from the pixel at -1
    return (
        0.5 * (-s + 2 * s**2 - s**3),
        0.5 * (2 - 5 * s**2 + 3 * s**3),
        0.5 * (s + 4 * s**2 - 3 * s**3),
        0.5 * (-(s**2) + s**3),
    )
