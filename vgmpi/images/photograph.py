"""A photograph as this room works with it: upright, eight bits, red, green and blue."""

import warnings
from pathlib import Path
from typing import NamedTuple

import numpy as np

from vgmpi.inputs import picture

LONGEST = 1280  # pixels of the longer side; larger photographs are made smaller
LEAST = 32  # pixels of the shorter side
_ORIENTATION, _EXIF, _FOCAL_35 = 0x0112, 0x8769, 0xA405
_DIAGONAL_35 = 43.2666  # mm, of the film that equivalent focal lengths are told for


class PhotographError(ValueError):
    """A picture that cannot be worked with; one line that names the file."""


class Photograph(NamedTuple):
    """rgb: (height, width, 3) uint8. alpha: (height, width) uint8, or None where all is opaque.

    size: width and height in the file, turned upright. reduced: pixels there per pixel here. fov:
    vertical [degrees], None where the file does not tell.
    """

    path: Path
    rgb: np.ndarray
    alpha: np.ndarray | None
    size: tuple[int, int]
    reduced: float
    fov: float | None


def read(path: Path) -> Photograph:
    """The photograph in a file: turned as its EXIF says, of any kind of pixels, made smaller where
    it is large. Raises PhotographError."""
    from PIL import Image, ImageOps

    try:
        plain = picture(path)  # refuses what is too large, broken or no file
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with Image.open(path) as opened:
                exif = opened.getexif()
                turned = ImageOps.exif_transpose(_eight_bits(opened, plain))
    except Exception as error:  # the readers of picture formats raise all kinds
        raise PhotographError(f"{path}: {_said(error)}") from None
    width, height = turned.size
    if min(width, height) < LEAST:
        said = f"has {width} x {height} pixels: at least {LEAST} x {LEAST} are needed"
        raise PhotographError(f"{path}: {said}")
    fov = _fov(exif, width, height)
    reduced = max(1.0, max(width, height) / LONGEST)
    if reduced > 1:
        size = (max(1, round(width / reduced)), max(1, round(height / reduced)))
        if min(size) < LEAST:
            said = f"has {width} x {height} pixels: too long and too thin"
            raise PhotographError(f"{path}: {said}")
        turned = turned.resize(size, Image.Resampling.LANCZOS)
    every = np.asarray(turned.convert("RGBA"))
    alpha = every[..., 3]
    clear = None if (alpha == 255).all() else np.ascontiguousarray(alpha)
    return Photograph(
        path, np.ascontiguousarray(every[..., :3]), clear, (width, height), reduced, fov
    )


def grey(path: Path, photo: Photograph) -> np.ndarray:
    """The mask in a file, (height, width) bool: its alpha where it has one, else what is brighter
    than the middle. It is as large as the photograph's file, or as what is made of that here.
    Raises PhotographError."""
    from PIL import Image, ImageOps

    try:
        plain = picture(path)
        with Image.open(path) as opened:
            shown = _eight_bits(opened, plain)
            turned = ImageOps.exif_transpose(shown).convert("RGBA")
    except Exception as error:
        raise PhotographError(f"{path}: {_said(error)}") from None
    here = (photo.rgb.shape[1], photo.rgb.shape[0])
    if turned.size not in (photo.size, here):
        said = "has {} x {} pixels, the photograph {} x {}".format(*turned.size, *photo.size)
        raise PhotographError(f"{path}: {said}")
    every = np.asarray(turned)
    if (every[..., 3] < 255).any():
        return every[..., 3] > 127
    return every[..., :3].mean(axis=2) > 127


def _eight_bits(opened, plain: np.ndarray):
    """A picture of eight bits a channel, with what it says about how it is turned."""
    from PIL import Image

    if plain.dtype.kind in "uif" and plain.dtype != np.uint8:
        top = 65535.0 if plain.dtype.kind in "ui" else 1.0
        if plain.dtype.kind == "i" and plain.max(initial=0) <= 255:
            top = 255.0
        levels = np.clip(np.nan_to_num(plain.astype(np.float64)) / top, 0, 1)
        made = Image.fromarray((255 * levels + 0.5).astype(np.uint8))
        made.getexif()[_ORIENTATION] = opened.getexif().get(_ORIENTATION, 1)
        return made
    opened.load()
    return opened.convert("RGBA" if "A" in opened.getbands() or "transparency" in opened.info
                          else "RGB")  # fmt: skip


def _said(error: Exception) -> str:
    return (str(error).splitlines() or ["unreadable"])[0]


def _fov(exif, width: int, height: int) -> float | None:
    """Vertical field of view [degrees] from the focal length that EXIF tells for 35 mm film."""
    try:
        focal = float(exif.get_ifd(_EXIF).get(_FOCAL_35, 0))
    except (TypeError, ValueError, KeyError, ZeroDivisionError):
        return None
    if not 1 <= focal <= 2000:
        return None
    side = _DIAGONAL_35 * height / np.hypot(width, height)
    return float(np.degrees(2 * np.arctan(side / 2 / focal)))
