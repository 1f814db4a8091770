"""Photograph as the package works with it: upright, eight bits, red, green and blue."""

import warnings
from pathlib import Path
from typing import NamedTuple

import numpy as np

from vgmpi.runtime.user_files import read_image

MAX_SIDE = 1280  # [pixels] larger photographs are reduced to this longer side
MIN_SIDE = 32  # [pixels] smallest shorter side
_ORIENTATION, _EXIF, _FOCAL_35 = 0x0112, 0x8769, 0xA405
_DIAGONAL_35 = 43.2666  # [mm] diagonal of the film to which equivalent focal lengths refer


class PhotographError(ValueError):
    """Error of an unusable picture; one line that names the file."""


class Photograph(NamedTuple):
    """Photograph in memory."""

    path: Path
    rgb: np.ndarray  # (height, width, 3) uint8
    alpha: np.ndarray | None  # (height, width) uint8, None if everything is opaque
    size: tuple[int, int]  # [pixels] width and height in the file, turned upright
    reduced: float  # [-] pixels of the file per pixel here
    fov: float | None  # [degrees] vertical field of view, None if the file does not tell


def read(path: Path) -> Photograph:
    """Read a photograph: turned as its EXIF says, any pixel format, reduced if it is large.

    Raises:
        PhotographError: The picture is unreadable, too small or too thin.
    """
    from PIL import Image, ImageOps

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of damaged tags
            plain = read_image(path)  # refuses too large and broken files
            with Image.open(path) as opened:
                exif = opened.getexif()
                turned = ImageOps.exif_transpose(_to_eight_bits(opened, plain))
    except Exception as error:  # readers of picture formats raise many kinds of errors
        raise PhotographError(f"{path}: {_first_line(error)}") from None
    width, height = turned.size
    if min(width, height) < MIN_SIDE:
        message = f"has {width} x {height} pixels: at least {MIN_SIDE} x {MIN_SIDE} are needed"
        raise PhotographError(f"{path}: {message}")
    fov = _fov(exif, width, height)
    reduced = max(1.0, max(width, height) / MAX_SIDE)
    if reduced > 1:
        size = (max(1, round(width / reduced)), max(1, round(height / reduced)))
        if min(size) < MIN_SIDE:
            message = f"has {width} x {height} pixels: too long and too thin"
            raise PhotographError(f"{path}: {message}")
        turned = turned.resize(size, Image.Resampling.LANCZOS)
    rgba = np.asarray(turned.convert("RGBA"))
    alpha = rgba[..., 3]
    transparency = None if (alpha == 255).all() else np.ascontiguousarray(alpha)
    return Photograph(
        path, np.ascontiguousarray(rgba[..., :3]), transparency, (width, height), reduced, fov
    )


def read_mask(path: Path, photo: Photograph) -> np.ndarray:
    """Read a mask, (height, width) bool: its alpha if it has one, else pixels brighter than half.

    The mask has the size of the photograph's file or of the reduced photograph.

    Raises:
        PhotographError: The picture is unreadable or has another size.
    """
    from PIL import Image, ImageOps

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            plain = read_image(path)
            with Image.open(path) as opened:
                image = _to_eight_bits(opened, plain)
                turned = ImageOps.exif_transpose(image).convert("RGBA")
    except Exception as error:
        raise PhotographError(f"{path}: {_first_line(error)}") from None
    reduced_size = (photo.rgb.shape[1], photo.rgb.shape[0])
    if turned.size not in (photo.size, reduced_size):
        message = "has {} x {} pixels, the photograph {} x {}".format(*turned.size, *photo.size)
        raise PhotographError(f"{path}: {message}")
    rgba = np.asarray(turned)
    if (rgba[..., 3] < 255).any():
        return rgba[..., 3] > 127
    return rgba[..., :3].mean(axis=2) > 127


def _to_eight_bits(opened, plain: np.ndarray):
    """Convert a picture to eight bits a channel, keeping its orientation tag."""
    from PIL import Image

    if plain.dtype.kind in "uif" and plain.dtype != np.uint8:
        top = 65535.0 if plain.dtype.kind in "ui" else 1.0
        if plain.dtype.kind == "i" and plain.max(initial=0) <= 255:
            top = 255.0
        levels = np.clip(np.nan_to_num(plain.astype(np.float64)) / top, 0, 1)
        image = Image.fromarray((255 * levels + 0.5).astype(np.uint8))
        image.getexif()[_ORIENTATION] = opened.getexif().get(_ORIENTATION, 1)
        return image
    opened.load()
    return opened.convert("RGBA" if "A" in opened.getbands() or "transparency" in opened.info
                          else "RGB")  # fmt: skip


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or ["unreadable"])[0]


def _fov(exif, width: int, height: int) -> float | None:
    """Return the vertical field of view [degrees] from the EXIF focal length for 35 mm film."""
    try:
        focal = float(exif.get_ifd(_EXIF).get(_FOCAL_35, 0))
    except (TypeError, ValueError, KeyError, ZeroDivisionError):
        return None
    if not 1 <= focal <= 2000:
        return None
    side = _DIAGONAL_35 * height / np.hypot(width, height)
    return float(np.degrees(2 * np.arctan(side / 2 / focal)))
