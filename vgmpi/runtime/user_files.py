"""Files of users: read with bounds, replaced whole or not at all.

Reading takes regular files of bounded size, and images of bounded cost. Writing is done here alone.
"""

import contextlib
import errno
import os
import secrets
import stat
import warnings
from pathlib import Path

import numpy as np

from . import process_limits
from .message_text import did_you_mean_file

MAX_TEXT_BYTES = 16 << 20  # [bytes] largest scene or settings file
MAX_PIXELS = 1 << 26  # [pixels] largest image: 1.5 GB as numbers, as its reader needs
_PIXEL = 24  # [bytes] least memory of a pixel as numbers
# a name that no other process chooses; a killed process may leave it behind
TEMPORARY_NAME = "{name}.{token}.tmp"


def read_regular_file(path: str | Path, max_bytes: int, follow: bool = True) -> bytes:
    """Return the content of a file.

    Args:
        path: The file.
        max_bytes: Largest size that is read [bytes].
        follow: Whether a link is followed.

    Raises:
        OSError: Also if it is no regular file (reading a pipe or a device may never end), has more
            than `max_bytes` bytes, or is a link that is not followed.
    """
    no_follow = 0 if follow else os.O_NOFOLLOW
    try:
        handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC | no_follow)
    except FileNotFoundError as error:
        message = f"{error.strerror}{did_you_mean_file(Path(path)) if follow else ''}"
        raise FileNotFoundError(error.errno, message, str(path)) from None
    try:
        status = os.fstat(handle)
        if not stat.S_ISREG(status.st_mode):
            raise OSError(errno.EINVAL, "is no regular file", str(path))
        if status.st_size > max_bytes:
            message = f"has {status.st_size:,} bytes; at most {max_bytes:,} are read"
            raise OSError(errno.EFBIG, message, str(path))
        with os.fdopen(handle, "rb", closefd=False) as f:
            return f.read(max_bytes)
    finally:
        os.close(handle)


def read_image(path: str | Path) -> np.ndarray:
    """Return the pixels of an image, (height, width) or (height, width, channels), as in the file.

    Raises:
        ValueError: One line, before anything large is read.
    """
    import imageio.v3 as iio  # imported late: only readers of images wait for these
    from PIL import Image

    try:
        if not os.path.exists(path):
            raise ValueError(f"no such file{did_you_mean_file(Path(path))}")
        if not os.path.isfile(path):
            raise ValueError("is no regular file")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            with Image.open(path) as opened:  # reads the header alone
                width, height = opened.size
        if width * height > MAX_PIXELS:
            message = f"has {width:,} x {height:,} pixels"
            raise ValueError(f"{message}; at most {MAX_PIXELS:,} in all are read")
        process_limits.require_memory(
            _PIXEL * width * height, f"its {width:,} x {height:,} pixels take at least"
        )
        return np.asarray(iio.imread(path, plugin="pillow"))
    except Exception as error:  # readers of image formats raise all kinds of errors
        raise ValueError((str(error).splitlines() or ["unreadable"])[0]) from None


def replace_file(path: str | Path, *parts: bytes | str) -> None:
    """Write a file under a temporary name, flush it to the disk, and rename it.

    Whatever fails, the old file stays as it was, or no file is there if there was none. Several
    processes may write the same file at the same time; the last one wins.

    Args:
        path: The file.
        parts: Its content, one after the other; texts are encoded as UTF-8.

    Raises:
        OSError: The file cannot be written.
    """
    path = Path(path)
    temporary = path.with_name(TEMPORARY_NAME.format(name=path.name, token=secrets.token_hex(4)))
    try:
        with open(temporary, "xb") as file:  # exclusive creation follows no link
            for part in parts:
                file.write(part.encode() if isinstance(part, str) else part)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)
    sync_folder(path.parent)


def sync_folder(folder: Path) -> None:
    """Flush a rename in a folder to the disk, where the file system can."""
    with contextlib.suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
