"""The one place that opens what a user names: regular files of bounded size, and pictures of
bounded cost.
"""

import errno
import os
import stat
import warnings
from pathlib import Path

import numpy as np

from vgmpi import room
from vgmpi.misspelt import nearest_file

MOST_TEXT = 16 << 20  # bytes of a scene or of settings
MOST_PIXELS = 1 << 26  # of a picture: 1.5 GB as numbers, which is what a reader needs
_PIXEL = 24  # bytes of one as numbers, at least


def content(path: str | Path, most: int, follow: bool = True) -> bytes:
    """What is in a file. Raises OSError, also where it is no regular file (a pipe or a device, of
    which reading may never end), has more than `most` bytes, or is a link and `follow` false."""
    way = 0 if follow else os.O_NOFOLLOW
    try:
        handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC | way)
    except FileNotFoundError as error:
        said = f"{error.strerror}{nearest_file(Path(path)) if follow else ''}"
        raise FileNotFoundError(error.errno, said, str(path)) from None
    try:
        found = os.fstat(handle)
        if not stat.S_ISREG(found.st_mode):
            raise OSError(errno.EINVAL, "is no regular file", str(path))
        if found.st_size > most:
            said = f"has {found.st_size:,} bytes; at most {most:,} are read"
            raise OSError(errno.EFBIG, said, str(path))
        with os.fdopen(handle, "rb", closefd=False) as f:
            return f.read(most)
    finally:
        os.close(handle)


def picture(path: str | Path) -> np.ndarray:
    """Numbers of a picture's pixels (height, width) or (height, width, channels), as they are in
    the file. Raises ValueError, one line, before anything large is read."""
    import imageio.v3 as iio  # only who reads pictures waits for these
    from PIL import Image

    try:
        if not os.path.exists(path):
            raise ValueError(f"no such file{nearest_file(Path(path))}")
        if not os.path.isfile(path):
            raise ValueError("is no regular file")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            with Image.open(path) as opened:  # looks at its head alone
                width, height = opened.size
        if width * height > MOST_PIXELS:
            said = f"has {width:,} x {height:,} pixels"
            raise ValueError(f"{said}; at most {MOST_PIXELS:,} in all are read")
        room.check(_PIXEL * width * height, f"its {width:,} x {height:,} pixels take at least")
        return np.asarray(iio.imread(path, plugin="pillow"))
    except Exception as error:  # the readers of picture formats raise all kinds
        raise ValueError((str(error).splitlines() or ["unreadable"])[0]) from None
