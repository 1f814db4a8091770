"""The cameras of render.toml as functions of the part of the video and the time of the run."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np

from postprocess import camerafiles
from postprocess.settings import CameraSettings, PictureSettings, SettingsError
from vgmpi.splatting.camera import HEIGHT, NEAR, Camera, look_at, orbit_eye, overview


class Viewpoint:
    """Where one camera stands.

    asked: its table. size: width and height of the picture where no file tells them. box: gives
    lower and upper corner of what is to be seen [m]; only cameras that need it ask. beside: folder
    of render.toml. longest: if given, the picture is scaled so that its longer side has so many
    pixels at most. Raises SettingsError.
    """

    def __init__(
        self,
        asked: CameraSettings,
        size: PictureSettings,
        box: Callable[[], tuple[np.ndarray, np.ndarray]],
        beside: Path,
        longest: int | None = None,
    ):
        self.asked, self.box = asked, box
        self.name = asked.name or "camera"
        self.width, self.height = size.width, size.height
        self.listed: list[Camera] = []
        if asked.kind in ("transforms", "colmap"):
            self.listed = _listed(asked, beside)
            self.width, self.height = self.listed[0].width, self.listed[0].height
        scale = asked.scale
        if longest is not None:
            scale = min(scale, longest / max(self.width, self.height))
        self.width, self.height = (max(round(v * scale), 1) for v in (self.width, self.height))

    def at(self, part: float, time: float) -> Camera:
        """The camera at a part 0..1 of the video, at `time` [s]. Raises SettingsError."""
        kinds = {"orbit": self._orbit, "fixed": self._fixed, "keyframes": self._keyed}
        try:
            camera = kinds.get(self.asked.kind, self._along)(part, time)
        except ValueError as error:
            raise SettingsError([f"camera: {self.name}: {error}"]) from None
        return _resized(camera, self.width, self.height)

    def _overview(self, angles) -> tuple[np.ndarray, float, float]:
        asked = self.asked
        return overview(*self.box(), asked.fov, self.width / self.height, angles, asked.up)

    def _look(self, eye, target, fov: float) -> Camera:
        asked = self.asked
        return look_at(eye, target, asked.up, fov, self.width, self.height, asked.near)

    def _target(self) -> np.ndarray:
        asked = self.asked.target
        return np.array(asked) if asked is not None else self._middle()

    def _middle(self) -> np.ndarray:
        lower, upper = self.box()
        return 0.5 * (lower + upper)

    def _orbit(self, part: float, time: float) -> Camera:
        asked = self.asked
        angles = np.arange(0, 360, 10) if asked.turns else [asked.angle]
        distance = asked.distance or self._overview(angles)[1]
        height = HEIGHT * distance if asked.height is None else asked.height
        angle = asked.angle + 360 * asked.turns * part
        eye = orbit_eye(self._target(), distance, height, angle, asked.up)
        return self._look(eye, self._target(), asked.fov)

    def _fixed(self, part: float, time: float) -> Camera:
        return self._look(np.array(self.asked.eye), self._target(), self.asked.fov)

    def _keyed(self, part: float, time: float) -> Camera:
        """Between the keys of a path: smooth, through every key, never beyond two neighbours, so
        that a camera told to stand still does so; before the first and after the last it rests."""
        from scipy.interpolate import PchipInterpolator  # not for those who do not need it

        keys = self.asked.keys
        by_time = keys[0].time is not None
        at = np.array([key.time if by_time else key.part for key in keys], dtype=np.float64)
        target, fov = self._target(), self.asked.fov
        rows = [
            (*key.eye, *(key.target or target), fov if key.fov is None else key.fov) for key in keys
        ]
        now = np.clip(time if by_time else part, at[0], at[-1])
        values = PchipInterpolator(at, np.array(rows, dtype=np.float64))(now)
        return self._look(values[:3], values[3:6], float(values[6]))

    def _along(self, part: float, time: float) -> Camera:
        """On the way through the cameras of a file: the video spans all of them, at even steps."""
        place = part * (len(self.listed) - 1)
        first = min(int(place), max(len(self.listed) - 2, 0))
        camera = self.listed[first]
        if place > first:
            camera = _between(camera, self.listed[first + 1], place - first)
        near = self.asked.near
        if near is None:
            near = max(min(NEAR, 0.05 * np.linalg.norm(self._middle() - camera.eye)), 1e-6)
        return dataclasses.replace(camera, near=near)


def _listed(asked: CameraSettings, beside: Path) -> list[Camera]:
    """The cameras of a file, or the one that is asked for."""
    if asked.kind == "transforms":
        path = beside / asked.file
        named = camerafiles.transforms(path)
    else:
        path = beside / asked.folder
        named = camerafiles.colmap(path)
    if asked.image is not None:
        found = [camera for name, camera in named if asked.image in (name, Path(name).name)]
        if len(found) != 1:
            few = ", ".join(name for name, _ in named[:3])
            raise SettingsError([f"{path}: {len(found)} images '{asked.image}'; the first: {few}"])
        return found
    cameras = [camera for _, camera in named]
    other = [c for c in cameras if (c.width, c.height) != (cameras[0].width, cameras[0].height)]
    if other:
        sizes = [f"{c.width} x {c.height}" for c in (cameras[0], other[0])]
        said = f"pictures of {' and of '.join(sizes)} pixels make no video: choose an image"
        raise SettingsError([f"{path}: {said}"])
    return cameras


def _between(a: Camera, b: Camera, part: float) -> Camera:
    """Eye and lens on the straight line from camera to camera, turned at an even rate."""
    from scipy.spatial.transform import Rotation, Slerp

    if part >= 1:
        return b
    turns = Rotation.from_matrix(np.stack([c.world_to_camera[:3, :3] for c in (a, b)]))
    rotation = Slerp([0.0, 1.0], turns)(part).as_matrix()
    pose = np.eye(4)
    pose[:3, :3] = rotation
    pose[:3, 3] = -rotation @ ((1 - part) * a.eye + part * b.eye)
    names = ("fx", "fy", "cx", "cy")
    lens = {n: (1 - part) * getattr(a, n) + part * getattr(b, n) for n in names}
    return dataclasses.replace(a, world_to_camera=pose, **lens)


def _resized(camera: Camera, width: int, height: int) -> Camera:
    """The same view in a picture of another size."""
    x, y = width / camera.width, height / camera.height
    if x == y == 1:
        return camera
    lens = {"fx": camera.fx * x, "cx": camera.cx * x, "fy": camera.fy * y, "cy": camera.cy * y}
    return dataclasses.replace(camera, width=width, height=height, **lens)
