"""Web page that plays moving Gaussians: the viewer's JavaScript and the bytes of a run in one file.

The page is encoded in windows-1252, in which every byte is a character, and the bytes that HTML
would change are escaped: the page is 2 % larger than the bytes.
"""

import html
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from vgmpi.gaussians.formats.motion_stream import MotionGroup, MotionReader
from vgmpi.gaussians.formats.validation import GaussianFileError, naming_file

from ..frames.appearance import Appearance
from ..frames.camera_paths import CameraPath
from ..frames.render_config import Settings
from ..raster.rasterize import LOWPASS

SCRIPTS = ("motion_decoder.js", "motion_viewer.js", "motion_page.js")
_FOLDER = Path(__file__).parent
_OPENING, _CLOSING = b'id="gaussians" type="application/octet-stream">', b"</script>"
_ESCAPE = b"="
_ESCAPED = b"=\0\r<"  # bytes that are written as "=" and the byte plus 64


def assemble_page(stream: bytes, title: str) -> bytes:
    """Return the page that plays a stream of motion_stream.MotionWriter."""
    template = (_FOLDER / "page.html").read_text()
    script = "\n".join((_FOLDER / name).read_text() for name in SCRIPTS)
    text = template.replace(
        "$title", html.escape(title).encode("ascii", "xmlcharrefreplace").decode()
    )
    text = text.replace("$script", script)
    before, after = (part.encode("ascii") for part in text.split("$payload"))
    return before + _escape(stream) + after


def read_page(path: str | Path) -> MotionReader:
    """Return the moving Gaussians of a page.

    Raises:
        GaussianFileError: If the page holds none.
    """
    with naming_file(path):
        page = Path(path).read_bytes()
        start = page.find(_OPENING)
        stop = page.find(_CLOSING, start)
        if start < 0 or stop < 0:
            raise GaussianFileError("holds no moving Gaussians")
        return MotionReader(_unescape(page[start + len(_OPENING) : stop]))


def _escape(data: bytes) -> bytes:
    """Return the bytes in a form that HTML does not change."""
    for byte in _ESCAPED:  # the escape itself comes first
        data = data.replace(bytes([byte]), _ESCAPE + bytes([byte + 64]))
    return data


def _unescape(data: bytes) -> bytes:
    """Return the bytes before `_escape`."""
    for byte in reversed(_ESCAPED):
        data = data.replace(_ESCAPE + bytes([byte + 64]), bytes([byte]))
    return data


def _background_color(value: tuple[float, float, float] | str | None) -> list[float]:
    """Return the color of a background; white stands for a picture and for none."""
    if isinstance(value, tuple):
        return list(value)
    if value is None or not value.startswith("#"):
        return [1.0, 1.0, 1.0]
    return [byte / 255 for byte in bytes.fromhex(value[1:])]


def view_settings(
    look: Appearance,
    chosen: Settings,
    folder: Path,
    box: Callable[[], tuple[np.ndarray, np.ndarray]],
    fps: float,
) -> dict[str, Any]:
    """Return what the viewer begins with: camera, background, cutoff and frame rate.

    Args:
        look: Appearance of the run.
        chosen: Contents of render.toml.
        folder: Folder of render.toml.
        box: Function that returns the lower and upper corner of the visible extent [m].
        fps: Frames per second.

    Raises:
        SettingsError: If a camera is wrong.
    """
    settings, options = chosen.views()[0], chosen.splatting.options()
    camera = CameraPath(settings, chosen.picture, box, folder).camera_at(0.0, 0.0)
    target = camera.axis_point(0.5 * np.sum(box(), axis=0))
    return {
        "camera": {
            "eye": camera.eye.tolist(),
            "target": target.tolist(),
            "up": list(settings.up),
            "fov": float(np.degrees(camera.vertical_fov())),
        },
        "background": _background_color(chosen.background),
        "alpha_min": look.alpha_min(chosen.splatting.alpha_min),
        "fps": fps,
        "lowpass": options["lowpass"] or LOWPASS,
        "antialias": bool(options["antialias"]),
    }


def groups_as_drawn(groups: Sequence[MotionGroup], chosen: Settings) -> list[MotionGroup]:
    """Return the groups with the lowpass that `chosen` draws them with."""
    options = chosen.splatting.options()

    def lowpass(group: MotionGroup) -> float:
        """Return the compensated variance of a group [pixels^2]."""
        if options["antialias"] is not None or not group.compensated_lowpass:
            return 0.0
        return options["lowpass"] or group.compensated_lowpass

    return [replace(group, compensated_lowpass=lowpass(group)) for group in groups]
