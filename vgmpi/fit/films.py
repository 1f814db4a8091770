"""Films that a user names, picture by picture."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from .. import inputs
from ..misspelt import nearest_file

SAME_SHAPE = 0.02  # of width over height
MOST = 10_000  # pictures of a video that are read


def pictures_in(path: Path) -> Iterator[np.ndarray]:
    """The pictures of a video (.mp4, .webm, .gif, what ffmpeg knows), or of a folder of .png in
    order of their names: uint8 (height, width, 3). Raises ValueError, one line."""
    if path.is_dir():
        names = sorted(path.glob("*.png"))
        if not names:
            raise ValueError("is a folder without .png")
        for name in names:
            try:
                yield _coloured(inputs.picture(name))
            except ValueError as error:
                raise ValueError(f"{name.name}: {error}") from None
        return
    import imageio_ffmpeg  # not for pictures

    if not path.is_file():
        said = "is no regular file" if path.exists() else f"no such file{nearest_file(path)}"
        raise ValueError(said)
    frames = imageio_ffmpeg.read_frames(f"file:{path.resolve()}")
    try:
        width, height = next(frames)["size"]
        for number, frame in enumerate(frames):
            if number == MOST:
                raise ValueError(f"has more than {MOST:,} pictures")
            yield np.frombuffer(frame, np.uint8).reshape(height, width, 3)
    except ValueError:
        raise
    except Exception as error:  # ffmpeg's reader raises all kinds
        raise ValueError(f"no video that ffmpeg reads ({type(error).__name__})") from None
    finally:
        frames.close()


def _coloured(picture: np.ndarray) -> np.ndarray:
    """(height, width, 3) uint8 of a picture of any kind. Raises ValueError."""
    picture = np.atleast_3d(picture)
    if picture.dtype == np.uint16:
        picture = (picture >> 8).astype(np.uint8)
    if picture.dtype != np.uint8 or picture.shape[2] not in (1, 3, 4):
        raise ValueError("neither a grey nor a colour picture")
    return np.repeat(picture, 3, 2) if picture.shape[2] == 1 else picture[..., :3]


def scaled(picture: np.ndarray, width: int, height: int) -> np.ndarray:
    """A uint8 picture in another size, float32 (height, width, 3) of 0..1. Raises ValueError where
    its shape is another."""
    from PIL import Image

    h, w = picture.shape[:2]
    if not alike((w, h), (width, height)):
        raise ValueError(f"is {w} x {h} pixels; render.toml draws {width} x {height}")
    if (w, h) != (width, height):
        picture = np.asarray(Image.fromarray(picture).resize((width, height), Image.Resampling.BOX))
    return picture.astype(np.float32) / 255


def alike(one: tuple[int, ...], other: tuple[int, ...]) -> bool:
    """Whether two pictures of so many pixels are of the same shape."""
    return abs(one[0] * other[1] / (one[1] * other[0]) - 1) <= SAME_SHAPE
