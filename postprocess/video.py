"""Pictures to PNG files and films, and pictures as backgrounds."""

import contextlib
import io
import os
import re
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from vgmpi import inputs


class VideoError(RuntimeError):
    """A picture or video that cannot be read or written; the message is one line."""


FORMATS = {  # how ffmpeg is to write each kind of film
    ".mp4": ["-c:v", "libx264", "-pix_fmt", "yuv420p", "-movflags", "+faststart"],
    ".webm": ["-c:v", "libvpx-vp9", "-b:v", "0", "-deadline", "good", "-cpu-used", "5"],
    # a palette for each picture: one for all would keep the whole film in memory
    ".gif": [
        "-filter_complex",
        "[0:v]split[a][b];[a]palettegen=stats_mode=single[p];[b][p]paletteuse=new=1",
    ],
}
TRANSPARENT = (".webm",)  # the films that can be


class Film:
    """Writes a video; the file has its name only when it is complete.

    with Film("video.mp4", 800, 600, fps=25) as film: film.add(picture)

    .mp4 (H.264), .webm (VP9), .gif. clear: pictures have a fourth channel, their opacity (.webm).
    Speaks to ffmpeg itself: imageio-ffmpeg's writer does not look at ffmpeg's exit code, so that a
    full disk would leave a broken video and no word about it.
    """

    def __init__(
        self,
        path: str | Path,
        width: int,
        height: int,
        fps: float,
        quality: float = 8.0,
        clear: bool = False,
    ):
        import imageio_ffmpeg  # not for a single picture

        self.path = Path(path)
        suffix = self.path.suffix
        self.part = self.path.with_name(f".{self.path.stem}.part{suffix}")
        # films in the formats that every player knows halve the colour planes: even sizes only
        even = suffix != ".gif"
        right, below = (width % 2, height % 2) if even else (0, 0)
        self.pad = ((0, below), (0, right), (0, 0))
        size = f"{width + right}x{height + below}"
        raw = ["-f", "rawvideo", "-pix_fmt", "rgba" if clear else "rgb24", "-s", size]
        coded = list(FORMATS[suffix])
        if suffix == ".mp4":
            coded += ["-crf", f"{round(38 - 2.5 * quality)}"]  # 38 is poor, 18 like the pictures
        elif suffix == ".webm":
            coded += ["-crf", f"{round(50 - 3 * quality)}"]
            coded += ["-pix_fmt", "yuva420p" if clear else "yuv420p"]
        self.command = [imageio_ffmpeg.get_ffmpeg_exe(), "-y", "-v", "error", *raw]
        self.command += ["-r", f"{fps}", "-i", "-", "-an", *coded]
        self.command.append(f"file:{self.part}")  # no URL, no flag

    def __enter__(self) -> "Film":
        if self.path.is_dir():
            raise VideoError(f"{self.path}: is a folder")
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
        """Append a picture (height, width, 3 or 4) uint8. Raises VideoError."""
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
            try:
                os.replace(self.part, self.path)
            except OSError as error:
                raise VideoError(f"{self.path}: {error.strerror or error}") from None
        finally:
            self.part.unlink(missing_ok=True)
            self.log.close()

    def _fail(self) -> None:
        self.ffmpeg.wait()
        self.log.seek(0)
        lines = self.log.read().decode(errors="replace").strip().splitlines()
        said = re.sub(r"^\[.*?\] ", "", lines[0]) if lines else "ffmpeg stopped"
        raise VideoError(f"{self.path}: {said}")


class Sequence:
    """Writes pictures as PNG files of a folder. numbers: of the frames, for the names."""

    def __init__(self, folder: Path, numbers: list[int]):
        self.paths = iter([folder / f"frame_{index:05d}.png" for index in numbers])

    def __enter__(self) -> "Sequence":
        return self

    def __exit__(self, kind, value, trace) -> None:
        pass

    def add(self, picture: np.ndarray) -> None:
        write_png(next(self.paths), picture)


def to_bytes(image: np.ndarray) -> np.ndarray:
    """uint8 picture of colours in 0..1; brighter ones are cut."""
    return (np.clip(image, 0.0, 1.0) * 255 + 0.5).astype(np.uint8)


def with_transparency(image: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """uint8 (height, width, 4) of what was drawn before black; alpha: covered, 0..1."""
    color = image / np.maximum(alpha, 1e-6)[..., None]  # files hold what is seen, not its share
    return to_bytes(np.concatenate([color, alpha[..., None]], axis=2))


def write_png(path: str | Path, picture: np.ndarray) -> None:
    """Write a picture: uint8 (height, width, 3 or 4) or uint16 (height, width)."""
    from PIL import Image  # imageio would take a third of a second to load

    data = io.BytesIO()
    Image.fromarray(picture).save(data, "png", compress_level=4)
    write(path, data.getvalue())


def write_array(path: str | Path, array: np.ndarray) -> None:
    """Write an array as .npy."""
    data = io.BytesIO()
    np.save(data, array)
    write(path, data.getvalue())


def write(path: str | Path, data: bytes) -> None:
    """Write a file that has its name only when it is complete. Raises VideoError."""
    path = Path(path)
    part = path.with_name(f".{path.name}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            part.unlink(missing_ok=True)
            with open(part, "xb") as f:  # new: no link is followed
                f.write(data)
            os.replace(part, path)
        finally:
            part.unlink(missing_ok=True)
    except OSError as error:
        raise VideoError(f"{path}: {error.strerror or error}") from None


def background(value: str | tuple, width: int, height: int, folder: Path) -> np.ndarray:
    """A colour (3,) in 0..1 or a picture (height, width, 3).

    value: r, g, b in 0..1, "#rrggbb", "none" (black, to be made transparent), or a picture file
    relative to `folder`, which is cut to the shape of the video (its middle stays) and scaled.
    """
    if not isinstance(value, str):
        return np.array(value, dtype=np.float64)
    if value == "none":
        return np.zeros(3)
    if value.startswith("#"):
        return np.array([int(value[i : i + 2], 16) for i in (1, 3, 5)]) / 255
    from scipy import ndimage  # only for those who need it

    picture = photograph("picture.background", folder / value)
    h, w = picture.shape[:2]
    keep_h, keep_w = min(h, round(w * height / width)), min(w, round(h * width / height))
    y, x = (h - keep_h) // 2, (w - keep_w) // 2
    picture = picture[y : y + max(keep_h, 1), x : x + max(keep_w, 1)]
    scale = (height / picture.shape[0], width / picture.shape[1], 1)
    return np.clip(ndimage.zoom(picture, scale, order=1, grid_mode=True, mode="nearest"), 0, 1)


def photograph(key: str, path: Path) -> np.ndarray:
    """Colours 0..1 of a picture file, (height, width, 3). Raises VideoError that names the key."""
    try:
        picture = np.atleast_3d(inputs.picture(path))
    except ValueError as error:
        raise VideoError(f"{key}: {path}: {error}") from None
    top = np.iinfo(picture.dtype).max if picture.dtype.kind == "u" else 1
    if picture.ndim != 3 or picture.shape[2] == 2:
        raise VideoError(f"{key}: {path}: neither a grey nor a colour picture")
    return np.broadcast_to(picture[..., :3], (*picture.shape[:2], 3)) / top
