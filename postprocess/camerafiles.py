"""Cameras from the files of other tools, with what is wrong with them told as of render.toml."""

from collections.abc import Callable
from pathlib import Path

from postprocess.settings import SettingsError
from vgmpi import camerafiles
from vgmpi.camerafiles import Named


def transforms(path: Path) -> Named:
    """As vgmpi.camerafiles.transforms. Raises SettingsError."""
    return _told(camerafiles.transforms, path)


def colmap(folder: Path) -> Named:
    """As vgmpi.camerafiles.colmap. Raises SettingsError."""
    return _told(camerafiles.colmap, folder)


def _told(reader: Callable[[Path], Named], path: Path) -> Named:
    try:
        return reader(path)
    except camerafiles.CameraFileError as error:
        raise SettingsError(error.lines) from None
