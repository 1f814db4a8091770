"""Readers of camera files of other tools, with errors reported as those of render.toml."""

from collections.abc import Callable
from pathlib import Path

from vgmpi.gaussians import camera_files
from vgmpi.gaussians.camera_files import NamedCameras

from .render_config import SettingsError


def transforms(path: Path) -> NamedCameras:
    """Read cameras by vgmpi.gaussians.camera_files.transforms. Raises SettingsError."""
    return _with_settings_error(camera_files.transforms, path)


def colmap(folder: Path) -> NamedCameras:
    """Read cameras by vgmpi.gaussians.camera_files.colmap. Raises SettingsError."""
    return _with_settings_error(camera_files.colmap, folder)


def _with_settings_error(reader: Callable[[Path], NamedCameras], path: Path) -> NamedCameras:
    """Read cameras and convert the error."""
    try:
        return reader(path)
    except camera_files.CameraFileError as error:
        raise SettingsError(error.lines) from None
