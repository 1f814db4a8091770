"""Pictures to PNG files and an mp4, and pictures as backgrounds."""

import contextlib
import os
import re
import subprocess
import tempfile
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

    Speaks to ffmpeg itself: imageio-ffmpeg's writer does not look at ffmpeg's exit code, so that a
    full disk would leave a broken video and no word about it.
    """

    def __init__(self, path: str | Path, width: int, height: int, fps: float, quality: float = 8.0):
        self.path = Path(path)
        self.part = self.path.with_name(f".{self.path.stem}.part.mp4")
        # H.264 in the format that every player knows halves the colour planes: even sizes only
        self.pad = ((0, height % 2), (0, width % 2), (0, 0))
        size = f"{width + width % 2}x{height + height % 2}"
        raw = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", size, "-r", f"{fps}", "-i", "-"]
        crf = round(38 - 2.5 * quality)  # 38 is poor, 18 cannot be told from the pictures
        coded = ["-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", str(crf)]
        self.command = [imageio_ffmpeg.get_ffmpeg_exe(), "-y", "-v", "error", *raw, "-an", *coded]
        self.command += ["-movflags", "+faststart", str(self.part)]

    def __enter__(self) -> "Mp4":
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self.log = tempfile.TemporaryFile()  # a pipe could fill up and block both sides
            self.ffmpeg = subprocess.Popen(
                self.command,
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=self.log,
                start_new_session=True,  # Ctrl-C is for us alone: we stop it
            )
        except OSError as error:
            raise VideoError(f"{self.path}: {error.strerror or error}") from None
        return self

    def add(self, picture: np.ndarray) -> None:
        """Append a picture (height, width, 3) uint8. Raises VideoError."""
        try:
            self.ffmpeg.stdin.write(np.pad(picture, self.pad, mode="edge").tobytes())
        except OSError:  # it has ended; its own words say why
            self._fail()

    def __exit__(self, kind, value, trace) -> None:
        try:
            if kind is not None:
                self.ffmpeg.kill()
                self.ffmpeg.wait()
                return
            with contextlib.suppress(OSError):
                self.ffmpeg.stdin.close()
            if self.ffmpeg.wait() != 0:
                self._fail()
            os.replace(self.part, self.path)
        finally:
            self.part.unlink(missing_ok=True)
            self.log.close()

    def _fail(self) -> None:
        self.ffmpeg.wait()
        self.log.seek(0)
        lines = self.log.read().decode(errors="replace").strip().splitlines()
        said = re.sub(r"^\[.*?\] ", "", lines[0]) if lines else "ffmpeg stopped"
        raise VideoError(f"{self.path}: {said}")


def to_bytes(image: np.ndarray) -> np.ndarray:
    """uint8 picture of colours in 0..1; brighter ones are cut."""
    return (np.clip(image, 0.0, 1.0) * 255 + 0.5).astype(np.uint8)


def write_png(path: str | Path, picture: np.ndarray) -> None:
    """Write a uint8 picture (height, width, 3); the file has its name only when it is complete."""
    path = Path(path)
    data = iio.imwrite("<bytes>", picture, extension=".png", plugin="pillow")
    part = path.with_name(f".{path.name}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            part.write_bytes(data)
            os.replace(part, path)
        finally:
            part.unlink(missing_ok=True)
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
        said = (str(error).splitlines() or ["unreadable"])[0]
        raise VideoError(f"background: {folder / value}: {said}") from None
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
