"""Cameras of render.toml as functions of the video position and the simulation time."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np

from vgmpi.gaussians import camera_files
from vgmpi.gaussians.camera import HEIGHT, NEAR_PLANE, Camera, fit_orbit_to_box, look_at, orbit_eye
from vgmpi.gaussians.camera_files import NamedCameras

from .render_config import CameraSettings, PictureSettings, SettingsError


class CameraPath:
    """Camera path of one table [camera]."""

    def __init__(
        self,
        settings: CameraSettings,
        size: PictureSettings,
        box: Callable[[], tuple[np.ndarray, np.ndarray]],
        folder: Path,
        longest: int | None = None,
        share: float = 1.0,
    ):
        """Read the cameras of files and determine the image size.

        Args:
            settings: Table of the camera.
            size: Width and height of the image unless a file defines them.
            box: Function that returns the lower and upper corner of the visible extent [m]; it is
                called only by cameras that need it.
            folder: Folder of render.toml.
            longest: If given, upper bound of the longer side of the image [pixels].
            share: Factor on the size of the image.

        Raises:
            SettingsError: If a camera file is wrong.
        """
        self.settings, self.box = settings, box
        self.name = settings.name or "camera"
        self.width, self.height = size.width, size.height
        self.cameras: list[Camera] = []
        if settings.kind in ("transforms", "colmap"):
            self.cameras = _cameras_of_file(settings, folder)
            self.width, self.height = self.cameras[0].width, self.cameras[0].height
        scale = share * settings.scale
        if longest is not None:
            scale = min(scale, longest / max(self.width, self.height))
        self.width, self.height = (max(round(v * scale), 1) for v in (self.width, self.height))

    def camera_at(self, part: float, time: float) -> Camera:
        """Return the camera at a part 0..1 of the video, at `time` [s]. Raises SettingsError."""
        kinds = {"orbit": self._orbit, "fixed": self._fixed, "keyframes": self._keyframed}
        try:
            camera = kinds.get(self.settings.kind, self._along_cameras)(part, time)
        except ValueError as error:
            raise SettingsError([f"camera: {self.name}: {error}"]) from None
        return _resized(camera, self.width, self.height)

    def _overview(self, angles) -> tuple[np.ndarray, float, float]:
        """Return target, distance and height that show the visible extent."""
        settings = self.settings
        return fit_orbit_to_box(
            *self.box(), settings.fov, self.width / self.height, angles, settings.up
        )

    def _look_at(self, eye, target, fov: float) -> Camera:
        """Return a camera at `eye` that looks at `target`."""
        settings = self.settings
        return look_at(eye, target, settings.up, fov, self.width, self.height, settings.near)

    def _target(self) -> np.ndarray:
        """Return the target, by default the center of the visible extent."""
        settings = self.settings.target
        return np.array(settings) if settings is not None else self._center()

    def _center(self) -> np.ndarray:
        """Return the center of the visible extent [m]."""
        lower, upper = self.box()
        return 0.5 * (lower + upper)

    def _orbit(self, part: float, time: float) -> Camera:
        """Return the camera on a circle around the target."""
        settings = self.settings
        angles = np.arange(0, 360, 10) if settings.revolutions else [settings.azimuth]
        distance = settings.distance or self._overview(angles)[1]
        height = HEIGHT * distance if settings.height is None else settings.height
        angle = settings.azimuth + 360 * settings.revolutions * part
        eye = orbit_eye(self._target(), distance, height, angle, settings.up)
        return self._look_at(eye, self._target(), settings.fov)

    def _fixed(self, part: float, time: float) -> Camera:
        """Return a static camera."""
        return self._look_at(np.array(self.settings.eye), self._target(), self.settings.fov)

    def _keyframed(self, part: float, time: float) -> Camera:
        """Interpolate between the keyframes of a path with monotone cubics.

        The path goes through every keyframe and never beyond two adjacent ones, so that a camera
        between equal ones rests; it rests before the first and after the last one.
        """
        from scipy.interpolate import PchipInterpolator  # only keyframes need it

        keyframes = self.settings.keyframes
        assert keyframes is not None  # the settings are refused without
        by_time = keyframes[0].time is not None
        key_positions = np.array(
            [key.time if by_time else key.progress for key in keyframes], dtype=np.float64
        )
        target, fov = self._target(), self.settings.fov
        rows = [
            (*key.eye, *(key.target or target), fov if key.fov is None else key.fov)
            for key in keyframes
        ]
        position = np.clip(time if by_time else part, key_positions[0], key_positions[-1])
        values = PchipInterpolator(key_positions, np.array(rows, dtype=np.float64))(position)
        return self._look_at(values[:3], values[3:6], float(values[6]))

    def _along_cameras(self, part: float, time: float) -> Camera:
        """Interpolate evenly between the cameras of a file; the video spans all of them."""
        position = part * (len(self.cameras) - 1)
        first = min(int(position), max(len(self.cameras) - 2, 0))
        camera = self.cameras[first]
        if position > first:
            camera = _interpolated(camera, self.cameras[first + 1], position - first)
        near_distance = self.settings.near
        if near_distance is None:
            near_distance = max(
                min(NEAR_PLANE, 0.05 * float(np.linalg.norm(self._center() - camera.eye))), 1e-6
            )
        return dataclasses.replace(camera, near_plane=near_distance)


def _cameras_of_file(settings: CameraSettings, folder: Path) -> list[Camera]:
    """Return the cameras of a file, or the selected one."""
    if settings.kind == "transforms":
        assert settings.file is not None
        path = folder / settings.file
        named = read_transforms(path)
    else:
        assert settings.folder is not None
        path = folder / settings.folder
        named = read_colmap(path)
    if settings.image is not None:
        matching = [camera for name, camera in named if settings.image in (name, Path(name).name)]
        if len(matching) != 1:
            first_names = ", ".join(name for name, _ in named[:3])
            raise SettingsError(
                [f"{path}: {len(matching)} images '{settings.image}'; the first: {first_names}"]
            )
        return matching
    cameras = [camera for _, camera in named]
    deviating = [c for c in cameras if (c.width, c.height) != (cameras[0].width, cameras[0].height)]
    if deviating:
        sizes = [f"{c.width} x {c.height}" for c in (cameras[0], deviating[0])]
        message = f"pictures of {' and of '.join(sizes)} pixels make no video: choose an image"
        raise SettingsError([f"{path}: {message}"])
    return cameras


def _interpolated(a: Camera, b: Camera, part: float) -> Camera:
    """Interpolate eye and lens linearly and the rotation at a uniform rate."""
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
    """Return the same view with an image of another size."""
    x, y = width / camera.width, height / camera.height
    if x == y == 1:
        return camera
    return dataclasses.replace(
        camera, width=width, height=height, fx=camera.fx * x, cx=camera.cx * x, fy=camera.fy * y,
        cy=camera.cy * y,
    )  # fmt: skip


def read_transforms(path: Path) -> NamedCameras:
    """Read cameras by vgmpi.gaussians.camera_files.transforms. Raises SettingsError."""
    return _with_settings_error(camera_files.transforms, path)


def read_colmap(folder: Path) -> NamedCameras:
    """Read cameras by vgmpi.gaussians.camera_files.colmap. Raises SettingsError."""
    return _with_settings_error(camera_files.colmap, folder)


def _with_settings_error(reader: Callable[[Path], NamedCameras], path: Path) -> NamedCameras:
    """Read cameras and convert the error."""
    try:
        return reader(path)
    except camera_files.CameraFileError as error:
        raise SettingsError(error.lines) from None
