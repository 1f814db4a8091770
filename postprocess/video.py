"""Pictures to PNG files and an mp4, and pictures as backgrounds."""

import os
from pathlib import Path

import imageio.v3 as iio
import imageio_ffmpeg
import numpy as np
from scipy import ndimage


class VideoError(RuntimeError):
    """A picture or video that cannot be read or written; the message is one line."""


class Mp4:
    """Writes an H.264 video; the file has its name only when it is complete.

    with Mp4("video.mp4", 800, 600, fps=25) as video: video.add(picture)
    """

    def __init__(self, path: str | Path, width: int, height: int, fps: float, quality: float = 8.0):
        self.path = Path(path)
        self.part = self.path.with_name(f".{self.path.stem}.part.mp4")
        # H.264 in the format that every player knows halves the colour planes: even sizes only
        self.pad = ((0, height % 2), (0, width % 2), (0, 0))
        size = (width + width % 2, height + height % 2)
        self.writer = imageio_ffmpeg.write_frames(
            str(self.part),
            size,
            fps=fps,
            quality=quality,
            macro_block_size=1,
            ffmpeg_log_level="error",
            output_params=["-movflags", "+faststart"],
        )

    def __enter__(self) -> "Mp4":
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self.writer.send(None)
        except OSError as error:
            raise VideoError(f"{self.path}: {_last_line(error)}") from None
        return self

    def add(self, picture: np.ndarray) -> None:
        """Append a picture (height, width, 3) uint8."""
        try:
            self.writer.send(np.ascontiguousarray(np.pad(picture, self.pad, mode="edge")))
        except OSError as error:
            raise VideoError(f"{self.path}: {_last_line(error)}") from None

    def __exit__(self, kind, value, trace) -> None:
        try:
            self.writer.close()
            if kind is None:
                os.replace(self.part, self.path)
        except OSError as error:
            if kind is None:
                raise VideoError(f"{self.path}: {_last_line(error)}") from None
        finally:
            self.part.unlink(missing_ok=True)


def _last_line(error: Exception) -> str:
    """The line of a long ffmpeg message that says what is wrong."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return lines[-1] if lines else "the video could not be written"


def to_bytes(image: np.ndarray) -> np.ndarray:
    """uint8 picture of colours in 0..1; brighter ones are cut."""
    return (np.clip(image, 0.0, 1.0) * 255 + 0.5).astype(np.uint8)


def write_png(path: str | Path, picture: np.ndarray) -> None:
    """Write a uint8 picture (height, width, 3)."""
    try:
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        iio.imwrite(path, picture, extension=".png", plugin="pillow")
    except OSError as error:
        raise VideoError(f"{path}: {error.strerror or error}") from None


def background(value: str | tuple, width: int, height: int, folder: Path) -> np.ndarray:
    """A colour (3,) in 0..1 or a picture (height, width, 3).

    value: r, g, b in 0..1, "#rrggbb", or a picture file relative to `folder`, which is cut to the
    shape of the video (its middle stays) and scaled.
    """
    if not isinstance(value, str):
        return np.array(value, dtype=np.float64)
    if value.startswith("#"):
        return np.array([int(value[i : i + 2], 16) for i in (1, 3, 5)]) / 255
    try:
        picture = np.atleast_3d(iio.imread(folder / value, plugin="pillow"))
    except Exception as error:  # the readers of picture formats raise all kinds
        raise VideoError(f"background: {folder / value}: {_last_line(error)}") from None
    top = np.iinfo(picture.dtype).max if picture.dtype.kind == "u" else 1
    if picture.ndim != 3 or picture.shape[2] == 2:
        raise VideoError(f"background: {folder / value}: neither a grey nor a colour picture")
    picture = np.broadcast_to(picture[..., :3], (*picture.shape[:2], 3)) / top
    h, w = picture.shape[:2]
    keep_h, keep_w = min(h, round(w * height / width)), min(w, round(h * width / height))
    y, x = (h - keep_h) // 2, (w - keep_w) // 2
    picture = picture[y : y + max(keep_h, 1), x : x + max(keep_w, 1)]
    scale = (height / picture.shape[0], width / picture.shape[1], 1)
    return np.clip(ndimage.zoom(picture, scale, order=1, grid_mode=True, mode="nearest"), 0, 1)
