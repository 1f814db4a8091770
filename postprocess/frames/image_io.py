"""Reading and writing of images and videos."""

import contextlib
import io
import os
import re
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from vgmpi.runtime import user_files
from vgmpi.runtime.user_files import replace_file


class VideoError(RuntimeError):
    """Error of a picture or video that cannot be read or written; one line."""


# Colors by the matrix of BT.601 with tags that say so: without tags, browsers take BT.709 for some
# sizes and formats. BT.709 with tags was off by 12 of 255 in Chromium without a graphics card.
# The tags come from a filter, because ffmpeg 9 ignores -color_primaries and -color_trc.
COLORS = (
    "scale=out_color_matrix=bt601:out_range=tv,"
    "setparams=colorspace=smpte170m:color_primaries=bt709:color_trc=iec61966-2-1:range=tv"
)
FORMATS = {  # ffmpeg options of each file format
    ".mp4": ["-vf", COLORS, "-c:v", "libx264", "-pix_fmt", "yuv420p", "-movflags", "+faststart"],
    ".webm": [
        *("-vf", COLORS, "-c:v", "libvpx-vp9"),
        *("-b:v", "0", "-deadline", "good", "-cpu-used", "5"),
    ],
    # each picture has a palette; a common one would keep the whole film in memory
    ".gif": [
        "-filter_complex",
        "[0:v]split[a][b];[a]palettegen=stats_mode=single[p];[b][p]paletteuse=new=1",
    ],
}
PNG_KEY = "vgmpi"  # keyword of the text in a picture
TRANSPARENT = (".webm",)  # formats with an alpha channel


class Film:
    """Writer of a video; the file gets its name only when it is complete.

    It is a context, in which `add` takes the pictures.

    The formats are .mp4 (H.264), .webm (VP9) and .gif. The class runs ffmpeg itself:
    imageio-ffmpeg's writer ignores ffmpeg's exit code, so that a full disk would leave a broken
    video without an error.
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
        """Assemble the ffmpeg command.

        Args:
            path: File to write.
            width: Width [pixels].
            height: Height [pixels].
            fps: Frames per second.
            quality: Quality from 0 to 10.
            clear: Whether pictures have an alpha channel (.webm).
        """
        import imageio_ffmpeg  # single pictures do not need it

        self.path = Path(path)
        suffix = self.path.suffix
        self.part = self.path.with_name(f".{self.path.stem}.part{suffix}")
        # widely supported formats halve the color planes and need even sizes
        even = suffix != ".gif"
        pad_right, pad_below = (width % 2, height % 2) if even else (0, 0)
        self.pad = ((0, pad_below), (0, pad_right), (0, 0))
        size = f"{width + pad_right}x{height + pad_below}"
        input_options = ["-f", "rawvideo", "-pix_fmt", "rgba" if clear else "rgb24", "-s", size]
        output_options = list(FORMATS[suffix])
        if suffix == ".mp4":
            # 38 is poor, 18 looks like the pictures
            output_options += ["-crf", f"{round(38 - 2.5 * quality)}"]
        elif suffix == ".webm":
            output_options += ["-crf", f"{round(50 - 3 * quality)}"]
            output_options += ["-pix_fmt", "yuva420p" if clear else "yuv420p"]
        self.command = [imageio_ffmpeg.get_ffmpeg_exe(), "-y", "-v", "error", *input_options]
        self.command += ["-r", f"{fps}", "-i", "-", "-an", *output_options]
        # the prefix keeps ffmpeg from reading a URL or an option
        self.command.append(f"file:{self.part}")

    def __enter__(self) -> "Film":
        """Start ffmpeg. Raises VideoError."""
        if self.path.is_dir():
            raise VideoError(f"{self.path}: is a folder")
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self.log = tempfile.TemporaryFile()  # a pipe could fill up and block both processes
            self.ffmpeg = subprocess.Popen(
                self.command,
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=self.log,
                start_new_session=True,  # Ctrl-C reaches this process only, which stops ffmpeg
            )
        except OSError as error:
            raise VideoError(f"{self.path}: {error.strerror or error}") from None
        return self

    def add(self, picture: np.ndarray) -> None:
        """Append a picture (height, width, 3 or 4) uint8. Raises VideoError."""
        assert self.ffmpeg.stdin is not None
        try:
            self.ffmpeg.stdin.write(np.pad(picture, self.pad, mode="edge").tobytes())
        except OSError:  # ffmpeg has ended, and its log says why
            self._fail()

    def __exit__(self, kind, value, trace) -> None:
        """Finish the file, or remove it after an error."""
        try:
            if kind is not None:
                self.ffmpeg.kill()
                self.ffmpeg.wait()
                return
            assert self.ffmpeg.stdin is not None
            with contextlib.suppress(OSError):
                self.ffmpeg.stdin.close()
            if self.ffmpeg.wait() != 0:
                self._fail()
            try:
                os.replace(self.part, self.path)
            except OSError as error:
                raise VideoError(f"{self.path}: {error.strerror or error}") from None
        finally:
            with contextlib.suppress(OSError):  # a file system may be read-only
                self.part.unlink(missing_ok=True)
            self.log.close()

    def _fail(self) -> None:
        """Raise VideoError with the message of ffmpeg."""
        self.ffmpeg.wait()
        self.log.seek(0)
        lines = self.log.read().decode(errors="replace").strip().splitlines()
        message = re.sub(r"^\[.*?\] ", "", lines[0]) if lines else "ffmpeg stopped"
        raise VideoError(f"{self.path}: {message}")


class Sequence:
    """Writer of pictures as PNG files in a folder, named by frame numbers.

    text: text in each file, see `write_png`.
    """

    def __init__(self, folder: Path, numbers: list[int], text: str = ""):
        self.paths = iter([folder / f"frame_{index:05d}.png" for index in numbers])
        self.text = text

    def __enter__(self) -> "Sequence":
        return self

    def __exit__(self, kind, value, trace) -> None:
        pass

    def add(self, picture: np.ndarray) -> None:
        """Write the next picture."""
        write_png(next(self.paths), picture, self.text)


def to_bytes(image: np.ndarray) -> np.ndarray:
    """Convert colors in 0..1 to uint8; brighter ones are clipped."""
    return (np.clip(image, 0.0, 1.0) * 255 + 0.5).astype(np.uint8)


def with_transparency(image: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Convert an image over black and its coverage alpha to uint8 (height, width, 4)."""
    # files hold colors that are not premultiplied
    color = image / np.maximum(alpha, 1e-6)[..., None]
    return to_bytes(np.concatenate([color, alpha[..., None]], axis=2))


def write_png(path: str | Path, picture: np.ndarray, text: str = "") -> None:
    """Write a picture: uint8 (height, width, 3 or 4) or uint16 (height, width).

    Args:
        path: The file.
        picture: The picture.
        text: Text that the file holds besides, for `png_text`.
    """
    from PIL import Image, PngImagePlugin  # imageio takes a third of a second to load

    data, about = io.BytesIO(), PngImagePlugin.PngInfo()
    if text:
        about.add_text(PNG_KEY, text)
    Image.fromarray(picture).save(data, "png", compress_level=4, pnginfo=about)
    write(path, data.getvalue())


def png_text(path: Path) -> str:
    """Return the text in a file of `write_png`; empty if there is none, or no such file."""
    from PIL import Image

    try:
        with Image.open(path) as picture:
            return str(picture.info.get(PNG_KEY, ""))
    except (OSError, ValueError, SyntaxError):
        return ""


def write_array(path: str | Path, array: np.ndarray) -> None:
    """Write an array as .npy."""
    data = io.BytesIO()
    np.save(data, array)
    write(path, data.getvalue())


def write(path: str | Path, data: bytes) -> None:
    """Write a file atomically. Raises VideoError."""
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        replace_file(path, data)
    except OSError as error:
        raise VideoError(f"{path}: {error.strerror or error}") from None


def background(value: str | tuple, width: int, height: int, folder: Path) -> np.ndarray:
    """Return a color (3,) in 0..1 or a picture (height, width, 3).

    Args:
        value: r, g, b in 0..1, "#rrggbb", "none" (black, made transparent later), or a picture
            file, which is cropped around its center to the aspect ratio of the video and scaled.
        width: Width of the video [pixels].
        height: Height of the video [pixels].
        folder: Folder of the picture file.
    """
    if not isinstance(value, str):
        return np.array(value, dtype=np.float64)
    if value == "none":
        return np.zeros(3)
    if value.startswith("#"):
        return np.array([int(value[i : i + 2], 16) for i in (1, 3, 5)]) / 255
    from scipy import ndimage  # only pictures need it

    picture = photograph("picture.background", folder / value)
    h, w = picture.shape[:2]
    crop_h, crop_w = min(h, round(w * height / width)), min(w, round(h * width / height))
    y, x = (h - crop_h) // 2, (w - crop_w) // 2
    picture = picture[y : y + max(crop_h, 1), x : x + max(crop_w, 1)]
    scale = (height / picture.shape[0], width / picture.shape[1], 1)
    return np.clip(ndimage.zoom(picture, scale, order=1, grid_mode=True, mode="nearest"), 0, 1)


def photograph(key: str, path: Path) -> np.ndarray:
    """Read a picture (height, width, 3) in 0..1. Raises VideoError that names the key."""
    try:
        picture = np.atleast_3d(user_files.read_image(path))
    except ValueError as error:
        raise VideoError(f"{key}: {path}: {error}") from None
    top = np.iinfo(picture.dtype).max if picture.dtype.kind == "u" else 1
    if picture.ndim != 3 or picture.shape[2] == 2:
        raise VideoError(f"{key}: {path}: neither a grey nor a color picture")
    return np.broadcast_to(picture[..., :3], (*picture.shape[:2], 3)) / top
