"""Rendering of frames; the Gaussians of a frame are computed once for all cameras."""

import contextlib
import functools
import logging
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np

from vgmpi.gaussians.camera import Camera, thin_lens_sample
from vgmpi.io.run_reader import RunError, RunReader
from vgmpi.runtime import process_limits

from ..raster import ground_plane, rasterize, shadow_lighting
from . import image_io, render_config
from .appearance import Appearance, view_dependent_splats
from .camera_paths import CameraPath
from .frame_gaussians import GaussianBatch, moving

log = logging.getLogger("vgmpi")

Pixels = tuple[np.ndarray, ...]  # image, transmittance, and depth if requested
STUDIO_BYTES = 400  # [bytes] least memory per pixel of the studio
DRAFT_SCALE = 0.4  # [-] width and height of a draft, relative to those of the settings
EXTENT_SAMPLES = 9  # frames from which the visible extent is determined


@dataclass(frozen=True)
class RenderedView:
    """One view of a frame.

    picture: uint8 (height, width, 3), or 4 with transparency. alpha: coverage by Gaussians, uint16
    (height, width) in 0..65535. depth: along the axis of the camera, float32 (height, width) [m],
    infinite where nothing is. The last two are None unless requested.
    """

    picture: np.ndarray
    alpha: np.ndarray | None = None
    depth: np.ndarray | None = None


class FrameRenderer:
    """Renderer of the frames of one run with one set of settings.

    chosen: contents of render.toml. folder: its folder, for the files it names. alpha, depth:
    whether to compute these too. longest: longer side of a preview [pixels]. draft: whether to draw
    a smaller image with the coarser grids and single samples of a preview. box: function that
    returns the lower and upper corner of the visible extent [m]; default: the extent of the run's
    Gaussians.
    """

    def __init__(
        self, run: RunReader, chosen: render_config.Settings, folder: Path, *, alpha: bool = False,
        depth: bool = False, longest: int | None = None, draft: bool = False,
        box: Callable[[], tuple[np.ndarray, np.ndarray]] | None = None,
    ):  # fmt: skip
        self.run, self.chosen = run, chosen
        self.alpha, self.depth, self.draft = alpha, depth, draft
        quick = self.quick = draft or longest is not None
        size = chosen.picture
        # some cameras do not need it, and it reads files
        box = box or functools.cache(lambda: visible_extent(run))
        # errors in files show before long work begins
        share = DRAFT_SCALE if draft else 1.0
        self.views = [
            CameraPath(entry, size, box, folder, longest, share) for entry in chosen.views()
        ]
        self.supersample = 1 if quick else size.supersample
        self.afford()
        self.grounds = [
            image_io.background(chosen.background, entry.width, entry.height, folder)
            for entry in self.views
        ]
        photograph = any(ground.ndim == 3 for ground in self.grounds)
        self.light = chosen.light.light() if chosen.light else None
        self.floor = None
        if size.floor and not chosen.studio:  # the studio has a ground of its own
            if size.floor.kind not in ("none", "photograph"):
                self.floor = size.floor.floor(photograph, self.light)
        self.clear = chosen.background == "none"
        has_blur = chosen.video.shutter > 0
        if not chosen.studio:  # the studio blurs by depth
            has_blur = has_blur or any(entry.aperture > 0 for entry in chosen.views())
        self.samples = size.blur_samples if has_blur and not quick else 1
        self.look = Appearance(run, chosen.look)
        self.alpha_min = self.look.alpha_min(chosen.splatting.alpha_min, chosen.studio)
        self.studio = None
        if chosen.studio:
            # it compiles much, and preset "paper" does without
            from ..studio.studio_renderer import Studio

            self.studio = Studio(self.look, chosen, box, folder, quick)

    def afford(self, at_once: int = 1) -> None:
        """Raise SettingsError if `at_once` pictures exceed the memory of the machine."""
        view = max(self.views, key=lambda entry: entry.width * entry.height)
        pixels = view.width * view.height * self.supersample**2
        message = f"{view.width} x {view.height} pixels"
        if self.supersample > 1:
            message = f"{self.supersample} draws {message} as {self.supersample**2} times as many"
        key = "picture.supersample" if self.supersample > 1 else "picture.width"
        count_text = f", {at_once} pictures at once" if at_once > 1 else ""
        try:
            bytes_per_pixel = STUDIO_BYTES if self.chosen.studio else rasterize.BYTES
            process_limits.require_memory(
                at_once * bytes_per_pixel * pixels, f"{key}: {message}{count_text}: at least"
            )
        except process_limits.InsufficientMemoryError as error:
            raise render_config.SettingsError([str(error)]) from None

    def camera(self, part: float) -> Camera:
        """Return the first camera at a part 0..1 of the video."""
        return self.views[0].camera_at(part, 0.0)

    def draw(self, index: int, part: float = 0.0) -> np.ndarray:
        """Return frame `index` as a uint8 image (height, width, 3) from the first camera."""
        return self.views_of(index, part)[0].picture

    def views_of(self, index: int, part: float) -> list[RenderedView]:
        """Return frame `index` at a part 0..1 of the video, from every camera."""
        return [self._to_view(pixels) for pixels in self.pixels_of(index, part)]

    def pixels_of(self, index: int, part: float) -> list[Pixels]:
        """Return the views before rounding: colors 0..1 (height, width, 3), transmittance."""
        frame = self.look.frame(index)
        time = float(self.run.times[index]) if self._needs_time() else 0.0
        cameras = [view.camera_at(part, time) for view in self.views]
        samples, sample_frame = [], frame
        parts: Any = []  # Gaussians, or the moment of the studio
        for sample in range(self.samples):
            if (
                sample == 0 or self.chosen.video.shutter > 0
            ):  # without a shutter the particles do not move
                sample_frame = self._moment(frame, index, sample)
                if self.studio is None:
                    parts = self._apply_light(self.look.parts(sample_frame))
                else:
                    parts = self.studio.moment(sample_frame, index)
            samples.append(self._pixels(parts, cameras, sample))
        return [self._mean(views) for views in zip(*samples)]

    def warm_up(self) -> None:
        """Draw an empty studio, so that what lights and composes its pictures is compiled."""
        cameras = [view.camera_at(0.0, 0.0) for view in self.views]
        if self.studio is not None:
            self._pixels(self.studio.empty_moment(), cameras, 0)

    def _mean(self, views: tuple[Pixels, ...]) -> Pixels:
        """Average the samples of a view; the depth is that of the first sample."""
        if len(views) == 1:
            return views[0]
        image, transmittance = (
            cast(np.ndarray, sum(entry[k] for entry in views)) / len(views) for k in (0, 1)
        )
        return image, transmittance, *views[0][2:]

    def _moment(self, frame: dict[str, np.ndarray], index: int, sample: int) -> dict:
        """Return the frame at a later time of the open shutter, with constant velocities."""
        shutter = self.chosen.video.shutter
        if sample == 0:
            return frame
        if "velocity" not in frame:
            raise RunError("video.shutter: the frames hold no velocity: see output.fields")
        times = self.run.times
        interval = min(index, len(times) - 2) if len(times) > 1 else 0
        step = float(times[interval + 1] - times[interval]) if len(times) > 1 else 0.0
        delay = shutter * step * sample / self.samples
        return {
            **frame,
            "positions": frame["positions"]
            + delay * np.asarray(frame["velocity"], dtype=np.float64),
        }

    def _pixels(self, parts: Any, cameras: list[Camera], sample: int) -> list[Pixels]:
        """Return image, transmittance and depth of a frame from every camera."""
        pixels = []
        for entry, camera, ground in zip(self.chosen.views(), cameras, self.grounds):
            if self.studio is not None:
                pixels.append(self._render_in_studio(parts, camera, ground, entry))
                continue
            if entry.aperture > 0 and self.samples > 1:
                assert entry.focus is not None  # the settings are refused without
                camera = thin_lens_sample(camera, entry.aperture, entry.focus, sample, self.samples)
            pixels.append(self._rasterize(parts, camera, ground))
        return pixels

    def _render_in_studio(
        self, moment: Any, camera: Camera, ground: np.ndarray, camera_settings: Any
    ) -> Pixels:
        """Render a lit frame from one camera, supersampled and then averaged."""
        assert self.studio is not None
        times = self.supersample
        fine = rasterize.supersampled_camera(camera, times)
        under = rasterize.background_image(ground, camera, times)
        options = {"alpha_min": self.alpha_min, **self.chosen.splatting.options()}
        lens = (camera_settings.aperture, camera_settings.focus or 1.0)
        return rasterize.box_downsample(
            self.studio.render(moment, fine, under, options, lens), times
        )

    def _needs_time(self) -> bool:
        """Return whether a camera moves by time; times are read from one file per frame."""
        paths = [view.keyframes for view in self.chosen.views() if view.keyframes]
        return any(keyframes[0].time is not None for keyframes in paths)

    def _rasterize(self, parts: list[GaussianBatch], camera: Camera, ground: np.ndarray) -> Pixels:
        """Render a frame from one camera by splatting."""
        splats = view_dependent_splats(parts, camera.eye)
        ground = self._background_with_floor(splats, camera, ground)
        options = {
            "alpha_min": self.alpha_min,
            "supersample": self.supersample,
            "depth": "median" if self.depth else None,
            **self.chosen.splatting.options(),
        }
        return rasterize.render(splats, camera, ground, **options)

    def _apply_light(self, parts: list[GaussianBatch]) -> list[GaussianBatch]:
        """Apply the light to the parts, if there is one."""
        if self.light is None:
            return parts
        splats = rasterize.join_gaussians([part.without_color() for part in parts])
        brightness = shadow_lighting.shade(splats, self.light, self.look.spacing)
        ends = np.cumsum([len(part.x) for part in parts])[:-1]
        return [
            part.scaled_brightness(factor)
            for part, factor in zip(parts, np.split(brightness, ends))
        ]

    def _background_with_floor(
        self, splats: rasterize.ProjectableGaussians, camera: Camera, ground: np.ndarray
    ) -> np.ndarray:
        """Return the background, supersampled if there is a floor on it."""
        if self.floor is None:
            return ground
        fine = rasterize.supersampled_camera(camera, self.supersample)
        under = rasterize.background_image(ground, camera, self.supersample)
        shadow = ground_plane.cast_shadow(splats, self.floor)
        contact = ground_plane.contact_shadow(splats, self.floor) if self.floor.contact else None
        return ground_plane.composite_ground(self.floor, shadow, fine, under, contact)

    def _to_view(self, pixels: Pixels) -> RenderedView:
        """Convert pixels to images of integers."""
        image, transmittance, *depth = pixels
        if self.clear:
            picture = image_io.with_transparency(image, 1 - transmittance)
        else:
            picture = image_io.to_bytes(image)
        alpha = np.round((1 - transmittance) * 65535).astype(np.uint16) if self.alpha else None
        return RenderedView(picture, alpha, depth[0] if depth else None)


def draw_preview(
    run: RunReader, chosen: render_config.Settings, folder: Path, number: int, longest: int
) -> np.ndarray:
    """Draw a small picture of one frame, uint8 (height, width, 3 or 4).

    Args:
        run: Files of the run.
        chosen: Contents of render.toml.
        folder: Folder of render.toml, for the files it names.
        number: Number of the frame.
        longest: Longer side of the picture [pixels].

    Raises:
        RunError: If the frame cannot be drawn.
        SettingsError: If the settings are wrong.
    """
    try:
        painter = FrameRenderer(run, chosen, folder, longest=longest)
        return painter.draw(number, number / max(len(run) - 1, 1))
    except image_io.VideoError as error:
        raise RunError(str(error)) from None


def domain_box(run: RunReader) -> tuple[np.ndarray, np.ndarray]:
    """Return the lower and upper corner of the domain [m].

    It is the extent of the Gaussians if the scene does not hold the domain.
    """
    try:
        size = np.array(run.scene["domain"]["size"], dtype=np.float64)
        return np.zeros(3), size
    except (KeyError, TypeError, ValueError):
        x = np.asarray(run.gaussians.x0)
        return x.min(axis=0), x.max(axis=0)


def positions_of_bodies(run: RunReader, number: int) -> list[np.ndarray]:
    """Return the centers of the Gaussians (n, 3) [m] of each rigid body in a frame."""
    scenery, poses = run.gaussians.scenery, run.frame(number).get("poses", ())
    bodies = zip(moving(run.objects), poses, strict=False)
    rows = [(np.asarray(scenery.x0)[scenery.object == k], pose) for k, pose in bodies]
    return [x @ pose[:3, :3].T + pose[:3, 3] for x, pose in rows]


def visible_extent(run: RunReader) -> tuple[np.ndarray, np.ndarray]:
    """Return the lower and upper corner of the visible extent [m].

    It encloses the centers of the Gaussians in some frames, spread over the run, and at rest,
    within the domain.
    """
    lower, upper = domain_box(run)
    numbers, positions = sorted(run.frames), []
    for sample in np.unique(np.linspace(0, len(numbers) - 1, EXTENT_SAMPLES).round().astype(int)):
        with contextlib.suppress(RunError):  # the error is reported when that frame is drawn
            positions.append(run.positions(numbers[sample]))
            if not len(run.gaussians.x0):  # all that moves is rigid
                positions += positions_of_bodies(run, numbers[sample])
    scenery = run.gaussians.scenery
    if scenery is not None:
        positions.append(np.asarray(scenery.x0))
    positions = [x for x in positions if len(x)]
    if not positions:
        return lower, upper
    low = np.max([np.min([x.min(axis=0) for x in positions], axis=0), lower], axis=0)
    high = np.min([np.max([x.max(axis=0) for x in positions], axis=0), upper], axis=0)
    return low, np.maximum(low, high)
