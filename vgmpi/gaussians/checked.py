"""What all readers of Gaussian files share: one kind of error, blocks of rows, which are usable.

Rows are decoded block by block: scratch memory stays small, and a file of nonsense ends with its
first block or hundredth instead of filling the memory.
"""

import contextlib
import logging
import os
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from vgmpi import room
from vgmpi.gaussians.cloud import Cloud

log = logging.getLogger("vgmpi")

LARGEST = 1e18  # of positions and sizes: their squares are numbers in single precision
MOST = 100_000_000  # Gaussians in a file: no capture has more, and a broken count often does
BLOCK = 1 << 14  # rows decoded together; a multiple of the 256 that share bounds in a .ply
_BROKEN_LIMIT = 0.01  # share of unusable rows (NaN, no rotation) that is dropped with a warning

Columns = tuple[np.ndarray, ...]  # x, quat (of any length), scale, opacity, sh as in Cloud


class GaussianFileError(ValueError):
    """A file that holds no readable Gaussians; the message is one line and names the file."""


@contextlib.contextmanager
def named(path: str | Path) -> Iterator[None]:
    """Whatever goes wrong inside becomes a GaussianFileError that names the file."""
    try:
        yield
    except GaussianFileError as error:
        raise GaussianFileError(f"{path}: {error}") from None
    except OSError as error:
        raise GaussianFileError(f"{path}: {error.strerror or error}") from None
    except MemoryError:
        raise GaussianFileError(f"{path}: needs more memory than there is") from None


def save(path: str | Path, *parts: bytes) -> None:
    """Write a file that has its name only when it is complete. Raises OSError."""
    temporary = Path(f"{path}.part")
    try:
        with open(temporary, "wb") as file:
            for part in parts:
                file.write(part)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def count_checked(count: int) -> int:
    """`count` Gaussians, if that can be. Raises GaussianFileError."""
    if count == 0:
        raise GaussianFileError("holds no Gaussians")
    if count > MOST:
        raise GaussianFileError(f"claims {count:,} Gaussians: allowed are at most {MOST:,}")
    return count


def gathered(count: int, decoded: Callable[[int, int], Columns]) -> Cloud:
    """The cloud of all rows that make sense; an error if more than a stray few do not.

    decoded(start, stop): the columns of these rows. Raises GaussianFileError.
    """
    parts: list[Columns] = []
    what = "not finite (or above 1e18), have no size or no rotation"
    broken, first = 0, None
    for start in range(0, count_checked(count), BLOCK):
        stop = min(start + BLOCK, count)
        with np.errstate(all="ignore"):  # hostile numbers are found and counted
            good, kept = _usable(*decoded(start, stop))
        bad = np.flatnonzero(~good)
        if len(bad) and first is None:
            first = start + bad[0]
        broken += len(bad)
        if broken > _BROKEN_LIMIT * count or not good.any():
            seen = "" if stop == count else "at least "
            raise GaussianFileError(
                f"{seen}{broken:,} of {count:,} Gaussians are {what}; the first is row {first}"
            )
        if not parts:
            _afford(count, kept)
        parts.append(kept)
    if broken:
        log.warning("%d of %d Gaussians are %s: dropped", broken, count, what)
    return Cloud(*(np.concatenate(column) for column in zip(*parts)))


def _afford(count: int, some: Columns) -> None:
    """Raises GaussianFileError where `count` Gaussians like these do not fit into the memory: part
    after part, and then all together."""
    each = sum(column[0].nbytes for column in some)
    try:
        room.check(2 * (1 - _BROKEN_LIMIT) * count * each, f"its {count:,} Gaussians take at least")
    except room.TooLarge as error:
        raise GaussianFileError(str(error)) from None


def _usable(x, quat, scale, opacity, sh) -> tuple[np.ndarray, Columns]:
    """Which rows make sense (n,), and these rows with unit quaternions."""
    n = len(x)
    length = np.linalg.norm(quat, axis=1)
    sh = sh.astype(np.float32)
    good = (length > 1e-8) & np.isfinite(length) & np.isfinite(opacity)
    good &= (scale >= 0).all(axis=1) & (scale > 0).any(axis=1)
    good &= np.isfinite(sh.reshape(n, -1)).all(axis=1)
    for value in (x, scale):
        good &= (np.abs(value) <= LARGEST).all(axis=1)
    quat = quat[good] / length[good, None]
    return good, (x[good], quat, scale[good], np.clip(opacity[good], 0.0, 1.0), sh[good])
