"""Camera of the photograph where the layout does not give it: vanishing lines, EXIF, defaults."""

import logging

import numpy as np
from scipy import ndimage

from .body_sources import Guess
from .layout_config import LoadedLayout
from .manhattan_frame import Frame, Segments, detect_segments, fit_frame
from .photo_camera import View
from .photograph import Photograph

log = logging.getLogger("vgmpi.tools.photo")

FOV, PITCH = 50.0, 15.0  # [degrees] defaults of an unknown camera
MIN_FOV, MAX_FOV = 5.0, 140.0  # [degrees] limits of the layout
STATED_ROLL = 2.0  # [degrees] a larger roll is stated
MARGIN = 3  # [pixels] by which an outline may lie outside of its mask


def guess_view(
    loaded: LoadedLayout, photo: Photograph, masks: list[np.ndarray], guesses: list[Guess]
) -> View:
    """Return the camera of the photograph; guess what the layout does not give.

    Args:
        loaded: Layout.
        photo: Photograph.
        masks: Objects, each (height, width) bool.
        guesses: Guesses, to which those of the camera are appended (in/out).
    """
    config = loaded.layout.camera
    height, width = photo.rgb.shape[:2]
    fov, pitch = config.fov, config.pitch
    if fov is None and photo.fov is not None:
        fov = _add_guess("fov", photo.fov, "guessed: the photograph's EXIF", guesses)
    if fov is None or pitch is None:
        frame = _vanishing_frame(photo, masks, fov, pitch)
        if frame is not None:
            fov, pitch = _use_frame(frame, height, fov, pitch, guesses)
    if fov is None:
        fov = _add_guess("fov", FOV, "guessed: a usual lens", guesses)
    if pitch is None:
        pitch = _add_guess("pitch", PITCH, "guessed: as one looks at a table", guesses)
    return View(width, height, fov, pitch)


def _add_guess(key: str, value: float, reason: str, guesses: list[Guess]) -> float:
    """Append a guess [degrees] of a key and log it; return the value for the layout."""
    if key == "fov":
        value = min(max(value, MIN_FOV), MAX_FOV)
    value = round(value, 3)
    guesses.append((("camera", key), value, f"degrees, {reason}"))
    log.info("camera: %s %g degrees, %s", key, value, reason)
    return value


def _vanishing_frame(
    photo: Photograph, masks: list[np.ndarray], fov: float | None, pitch: float | None
) -> Frame | None:
    """Return the frame that the photograph's lines follow, or else the lines beside the objects.

    A photograph that is transparent in places has outlines instead of a background.
    """
    if photo.alpha is not None:
        return None
    height = photo.rgb.shape[0]
    segments = detect_segments(photo.rgb)
    frame = fit_frame(segments, height, fov, pitch)
    if frame is None and masks:
        is_beside = _beside_objects(segments, masks)
        if not is_beside.all():
            frame = fit_frame(segments.select(is_beside), height, fov, pitch)
    return frame


def _beside_objects(segments: Segments, masks: list[np.ndarray]) -> np.ndarray:
    """Return whether the middles of segments (n,) lie beside the objects."""
    objects = ndimage.binary_dilation(np.logical_or.reduce(masks), iterations=MARGIN)
    height, width = objects.shape
    column, row = np.floor(segments.middle + (width / 2, height / 2)).astype(int).T
    return ~objects[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)]


def _use_frame(
    frame: Frame, height: int, fov: float | None, pitch: float | None, guesses: list[Guess]
) -> tuple[float, float]:
    """Return field of view and pitch [degrees], from a frame where they are None, and log them."""
    reason = f"vanishing lines, {100 * frame.share:.0f} % of their length agrees"
    words = []
    if pitch is None:
        pitch = round(float(np.degrees(frame.pitch)), 1)
        interval = f"+- {np.degrees(frame.pitch_interval):.1f}"
        guesses.append((("camera", "pitch"), pitch, f"{interval} degrees, guessed: {reason}"))
        words.append(f"pitch {pitch:g} {interval} degrees")
    if fov is None:
        angle = 2 * np.arctan(0.5 * height / frame.focal)
        fov = round(float(np.degrees(angle)), 1)
        interval = f"+- {np.degrees(np.sin(angle) * frame.focal_interval):.1f}"
        guesses.append((("camera", "fov"), fov, f"{interval} degrees, guessed: {reason}"))
        words.append(f"fov {fov:g} {interval} degrees")
    log.info("camera: %s, guessed: %s", ", ".join(words), reason)
    roll = abs(float(np.degrees(frame.roll)))
    if roll > STATED_ROLL:
        log.info("camera: turned by %.1f degrees about its axis, which the scene leaves out", roll)
    return fov, pitch
