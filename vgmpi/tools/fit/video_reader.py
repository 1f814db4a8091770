"""Reader of target videos, one picture at a time."""

import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from vgmpi.runtime import user_files
from vgmpi.runtime.message_text import did_you_mean_file

ASPECT_TOLERANCE = 0.02  # [-] relative difference of aspect ratios that is accepted
MAX_PICTURES = 10_000  # a video with more pictures is refused


def pictures_in(path: Path) -> Iterator[np.ndarray]:
    """Yield the pictures of a video file or of a folder of .png files.

    A video may be .mp4, .webm, .gif or anything else that ffmpeg reads; a folder is read in the
    order of file names. Pictures are uint8 (height, width, 3). Each picture of the file is read
    once, however long it is shown.

    Raises:
        ValueError: With one line that says why the path cannot be read.
    """
    if path.is_dir():
        names = sorted(path.glob("*.png"))
        if not names:
            raise ValueError("is a folder without .png")
        for name in names:
            try:
                yield _to_rgb(user_files.read_image(name))
            except ValueError as error:
                raise ValueError(f"{name.name}: {error}") from None
        return
    import imageio_ffmpeg  # folders of pictures do not need it

    if not path.is_file():
        message = (
            "is no regular file" if path.exists() else f"no such file{did_you_mean_file(path)}"
        )
        raise ValueError(message)
    frames = imageio_ffmpeg.read_frames(
        f"file:{path.resolve()}",
        output_params=["-fps_mode", "passthrough"],  # the default repeats and drops pictures
    )
    try:
        width, height = next(frames)["size"]
        for number, frame in enumerate(frames):
            if number == MAX_PICTURES:
                raise ValueError(f"has more than {MAX_PICTURES:,} pictures")
            yield np.frombuffer(frame, np.uint8).reshape(height, width, 3)
    except ValueError:
        raise
    except Exception as error:  # the reader of ffmpeg raises exceptions of many classes
        raise ValueError(f"no video that ffmpeg reads ({type(error).__name__})") from None
    finally:
        frames.close()


def describe_pictures(path: Path, count: int) -> str:
    """Return count and times of a target's pictures as text.

    Args:
        path: Video file or folder of pictures.
        count: Number of its pictures that were read.
    """
    times = np.zeros(0) if path.is_dir() else _time_stamps(path)
    if len(times) != count or count < 2 or not (np.diff(times) > 0).all():
        return f"{count} pictures"
    low, high = (f"{distance:.4g}" for distance in np.sort(np.diff(times))[[0, -1]])
    distances = low if low == high else f"{low} to {high}"
    return f"{count} pictures, {distances} s apart, over {times[-1] - times[0]:.4g} s"


def _time_stamps(path: Path) -> np.ndarray:
    """Return when the pictures of a video begin, shape (n,) [s]; empty if ffmpeg does not tell."""
    import imageio_ffmpeg

    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error", "-i", f"file:{path.resolve()}"]
    # packets as they are, with a line of text for each
    command += ["-an", "-c:v", "copy", "-frames:v", f"{MAX_PICTURES}", "-f", "framecrc", "-"]
    text = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True).stdout
    unit, stamps = 0.0, []
    for line in text.splitlines():
        if line.startswith("#tb 0:"):
            numerator, denominator = line.removeprefix("#tb 0:").split("/")
            unit = int(numerator) / int(denominator)
        elif (stamp := line.split(",")[2].strip() if line[:1].isdigit() else "NOPTS") != "NOPTS":
            stamps.append(int(stamp))
    return np.sort(np.array(stamps, dtype=np.float64)) * unit


def _to_rgb(picture: np.ndarray) -> np.ndarray:
    """Convert a gray, RGB or RGBA picture to uint8 (height, width, 3), or raise ValueError."""
    picture = np.atleast_3d(picture)
    if picture.dtype == np.uint16:
        picture = (picture >> 8).astype(np.uint8)
    if picture.dtype != np.uint8 or picture.shape[2] not in (1, 3, 4):
        raise ValueError("neither a grey nor a color picture")
    return np.repeat(picture, 3, 2) if picture.shape[2] == 1 else picture[..., :3]


def scaled(picture: np.ndarray, width: int, height: int) -> np.ndarray:
    """Resize a uint8 picture and return it as float32 (height, width, 3) in [0, 1].

    Raises:
        ValueError: If the aspect ratio differs.
    """
    from PIL import Image

    h, w = picture.shape[:2]
    if not same_aspect((w, h), (width, height)):
        raise ValueError(f"is {w} x {h} pixels; render.toml draws {width} x {height}")
    if (w, h) != (width, height):
        picture = np.asarray(Image.fromarray(picture).resize((width, height), Image.Resampling.BOX))
    return picture.astype(np.float32) / 255


def same_aspect(size: tuple[int, ...], other_size: tuple[int, ...]) -> bool:
    """Return whether two (width, height) have the same aspect ratio."""
    return abs(size[0] * other_size[1] / (size[1] * other_size[0]) - 1) <= ASPECT_TOLERANCE
