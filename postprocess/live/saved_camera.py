"""A camera of the live page in render.toml; all else that people wrote there stays."""

import re
import tomllib
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pydantic import ValidationError

from vgmpi.runtime import user_files
from vgmpi.runtime.user_files import replace_file

from ..frames import render_config
from ..frames.render_config import CAMERA_KEYS, CameraSettings, SettingsError

CAMERA_NAME = "live"  # of the saved camera beside other cameras
DIGITS = 6  # significant digits of saved numbers
SMALLEST = 1e-12
MAX_FOV = 169.0  # [degrees]
WAS = "before the camera of the live page: "  # begins the old keys of a camera
HEADER = re.compile(
    r"^\s*\[\[?\s*camera\s*\]", re.MULTILINE
)  # of a table that has lines of its own
MISSING_TOMLKIT = 'a camera is saved with the package tomlkit: pip install "vgmpi[live]"'


class View(NamedTuple):
    """View of a browser."""

    eye: tuple[float, float, float]  # [m]
    target: tuple[float, float, float]  # point at the center of the image [m]
    up: tuple[float, float, float]  # direction upwards
    fov: float  # vertical field of view [degrees]
    aspect: float  # width over height

    def values(self) -> dict[str, Any]:
        """Return the keys of a fixed camera of render.toml."""
        values: dict[str, Any] = {"kind": "fixed"}
        for key in ("eye", "target", "up"):
            values[key] = [_rounded(v) for v in getattr(self, key)]
        return values | {"fov": _rounded(min(self.fov, MAX_FOV))}

    def settings(self) -> CameraSettings:
        """Return the table [camera]. Raises SettingsError for a view that no camera has."""
        try:
            return CameraSettings.model_validate(self.values())
        except ValidationError as error:
            reason = error.errors()[0]["msg"]
            raise SettingsError([f"this view cannot be saved: {reason}"]) from None


def view_of_camera(camera: Any, cell: float) -> View:
    """Return the view of viser's camera.

    Args:
        camera: Camera of viser, whose unit of length is a grid cell.
        cell: Edge of a grid cell [m].
    """
    eye, target, up = (
        tuple((unit * np.asarray(getattr(camera, name), dtype=np.float64)).tolist())
        for name, unit in (("position", cell), ("look_at", cell), ("up_direction", 1.0))
    )
    fov = float(np.degrees(camera.fov))
    return View(eye, target, up, fov, max(float(camera.aspect), 1e-3))  # type: ignore[arg-type]


def save_camera(path: Path, view: View) -> str:
    """Write a view into a render.toml as a fixed camera; the file is replaced whole or not at all.

    A single camera gets the keys; keys that a fixed camera does not have become comments. Of
    several cameras, the one with the name "live" gets them, and is added if it is absent.

    Args:
        path: The file; it is made if it is absent.
        view: The view.

    Returns:
        One line about what was written.

    Raises:
        SettingsError: The file is wrong already, or cannot be written; nothing has changed.
    """
    try:
        import tomlkit
    except ImportError:
        raise SettingsError([MISSING_TOMLKIT]) from None
    view.settings()
    try:
        exists = path.exists()
        if exists:
            render_config.load(path)  # a wrong file is left as it is
        limit = user_files.MAX_TEXT_BYTES
        text = user_files.read_regular_file(path, limit).decode() if exists else ""
        document = tomlkit.parse(text)
        _set_camera(document, view)
        new_text = tomlkit.dumps(document)
        render_config.Settings.model_validate(tomllib.loads(new_text))
        replace_file(path.resolve() if exists else path, new_text)
    except SettingsError:
        raise
    except OSError as error:
        raise SettingsError([f"{path}: {error.strerror}"]) from None
    except (ValidationError, ValueError) as error:
        reason = str(error).splitlines()[0]
        raise SettingsError([f"{path}: the camera was not saved: {reason}"]) from None
    return f"camera saved in {path}"


def _set_camera(document: Any, view: View) -> None:
    """Set the keys of a view in a document of tomlkit."""
    from tomlkit.items import AoT

    cameras = document.get("camera")
    if cameras is None:
        document["camera"] = view.values()
    elif isinstance(cameras, AoT) or isinstance(cameras, list):
        named = [table for table in cameras if table.get("name") == CAMERA_NAME]
        if len(cameras) == 1:
            named = [cameras[0]]
        if not named:
            cameras.append({"name": CAMERA_NAME, **view.values()})
            return
        _replace_keys(named[0], view, document)
    else:
        _replace_keys(cameras, view, document)


def _replace_keys(table: Any, view: View, document: Any) -> None:
    """Set the keys of a view in a camera's table; keys of other kinds of cameras become comments.

    A camera that was no fixed one keeps all its old values in the comments. They are at the end of
    its table, or of the document where it has no table of its own.
    """
    import tomlkit
    from tomlkit.items import Table

    values = view.values()
    allowed = {"name", "kind", *CAMERA_KEYS["fixed"]}
    was_fixed = table.get("kind") == "fixed"
    old = {
        key: _text_of_item(item)
        for key, item in table.items()
        if key not in allowed or (key in values and not was_fixed)
    }
    for key in old:
        if key not in values:
            del table[key]
    for key, value in values.items():
        if not (was_fixed and table.get(key) == value):
            table[key] = value
    has_own_table = isinstance(table, Table) and HEADER.search(document.as_string()) is not None
    owner = table if has_own_table else document
    for key, text in old.items():
        first, *others = f"{key} = {text}".splitlines()
        for line in (WAS + first, *others):
            owner.add(tomlkit.comment(line))


def _text_of_item(item: Any) -> str:
    """Return the text of a value with the comment behind it."""
    import tomlkit

    item = item if hasattr(item, "trivia") else tomlkit.item(item)
    return f"{item.as_string()}  {item.trivia.comment}".rstrip()


def _rounded(value: float) -> float:
    """Return a number with DIGITS significant digits, 0 for a rounding error of 0."""
    return 0.0 if abs(value) <= SMALLEST else float(f"{value:.{DIGITS}g}")
