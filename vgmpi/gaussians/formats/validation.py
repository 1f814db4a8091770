"""Validation shared by all readers of Gaussian files: one error class, blocks of rows, valid rows.

Rows are decoded block by block: scratch memory stays small, and an invalid file fails at its
first block or hundredth instead of filling the memory.
"""

import contextlib
import logging
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from vgmpi.gaussians.cloud import CaptureRecord, GaussianCloud
from vgmpi.runtime import process_limits

log = logging.getLogger("vgmpi")

MAX_MAGNITUDE = 1e18  # [file units] bound of positions and sizes: squares stay finite in float32
MAX_COUNT = (
    100_000_000  # [Gaussians] bound of a file: captures have fewer, broken counts often more
)
BLOCK = 1 << 14  # [rows] decoded together; a multiple of the 256 that share bounds in a .ply
_BROKEN_LIMIT = 0.01  # [-] fraction of invalid rows (NaN, no rotation) dropped with a warning

_MAX_LABEL = 2.0**53  # integers below it are exact as floating-point numbers

# x, quat (of any length), scale, opacity, sh as in Cloud; then labels by name, or nothing
Columns = tuple[Any, ...]


class GaussianFileError(ValueError):
    """File without readable Gaussians; the message is one line and names the file."""


@contextlib.contextmanager
def naming_file(path: str | Path) -> Iterator[None]:
    """Turn every error inside the context into a GaussianFileError that names the file."""
    try:
        yield
    except GaussianFileError as error:
        raise GaussianFileError(f"{path}: {error}") from None
    except OSError as error:
        raise GaussianFileError(f"{path}: {error.strerror or error}") from None
    except MemoryError:
        raise GaussianFileError(f"{path}: needs more memory than there is") from None


def validate_count(count: int) -> int:
    """Return `count` if a file may hold as many Gaussians.

    Raises:
        GaussianFileError: If it is 0 or too large.
    """
    if count == 0:
        raise GaussianFileError("holds no Gaussians")
    if count > MAX_COUNT:
        raise GaussianFileError(f"claims {count:,} Gaussians: allowed are at most {MAX_COUNT:,}")
    return count


def read_validated(
    count: int, decoded: Callable[[int, int], Columns], record: CaptureRecord | None = None
) -> GaussianCloud:
    """Read all valid rows of a file as a cloud.

    Args:
        count: Rows of the file.
        decoded: Function of start and stop that returns the columns of these rows.
        record: What is known of the file; rows and values that are left out are added to it.

    Raises:
        GaussianFileError: If more than a small fraction of the rows is invalid.
    """
    parts: list[Columns] = []
    labels: list[dict[str, np.ndarray]] = []
    what = "not finite (or above 1e18), have no size or no rotation"
    broken, clamped, first = 0, 0, None
    for start in range(0, validate_count(count), BLOCK):
        stop = min(start + BLOCK, count)
        with np.errstate(all="ignore"):  # hostile numbers are counted below
            columns = decoded(start, stop)
            valid, part = _valid_rows(*columns[:5])
        invalid = np.flatnonzero(~valid)
        if len(invalid) and first is None:
            first = start + invalid[0]
        broken += len(invalid)
        if broken > _BROKEN_LIMIT * count or not valid.any():
            bound = "" if stop == count else "at least "
            raise GaussianFileError(
                f"{bound}{broken:,} of {count:,} Gaussians are {what}; the first is row {first}"
            )
        clamped += int((columns[3][valid] != part[3]).sum())
        if len(columns) > len(part):
            labels.append({name: label[valid] for name, label in columns[5].items()})
        if not parts:
            _check_memory(count, [*part, *(labels[0].values() if labels else ())])
        parts.append(part)
    if broken and record is None:  # the record is told with the object's name
        log.warning("%d of %d Gaussians are %s: dropped", broken, count, what)
    integers, others = _join_labels(labels)
    omissions = []
    if broken:
        omissions.append(f"{broken:,} of {count:,} Gaussians are {what}: left out")
    if clamped:
        omissions.append(f"opacities outside of 0..1 of {clamped:,} Gaussians are clamped")
    omissions += [f"the column '{name}' holds no integers and is left out" for name in others]
    if record is not None:
        record = replace(record, omissions=(*record.omissions, *omissions))
    x, quat, scale, opacity, sh = (np.concatenate(column) for column in zip(*parts))
    return GaussianCloud(x, quat, scale, opacity, sh, labels=integers, record=record)


def _join_labels(parts: list[dict[str, np.ndarray]]) -> tuple[dict[str, np.ndarray], list[str]]:
    """Join the columns of labels of all blocks.

    Returns:
        Columns of integers by name, and the names of columns that have other numbers.
    """
    integers, others = {}, []
    for name in parts[0] if parts else ():
        label = np.concatenate([part[name] for part in parts])
        if label.dtype.kind == "f":
            if not ((label % 1 == 0) & (np.abs(label) < _MAX_LABEL)).all():
                others.append(name)
                continue
            label = label.astype(np.int64)
        integers[name] = label
    return integers, others


def _check_memory(count: int, sample: Iterable[np.ndarray]) -> None:
    """Check that `count` Gaussians fit into memory, first block by block and then joined.

    Raises:
        GaussianFileError: If they do not fit.
    """
    row_bytes = sum(column[0].nbytes for column in sample)
    try:
        process_limits.require_memory(
            2 * (1 - _BROKEN_LIMIT) * count * row_bytes, f"its {count:,} Gaussians take at least"
        )
    except process_limits.InsufficientMemoryError as error:
        raise GaussianFileError(str(error)) from None


def _valid_rows(x, quat, scale, opacity, sh) -> tuple[np.ndarray, Columns]:
    """Return the mask of valid rows (n,), and these rows with unit quaternions."""
    n = len(x)
    length = np.linalg.norm(quat, axis=1)
    sh = sh.astype(np.float32)
    valid = (length > 1e-8) & np.isfinite(length) & np.isfinite(opacity)
    valid &= (scale >= 0).all(axis=1) & (scale > 0).any(axis=1)
    valid &= np.isfinite(sh.reshape(n, -1)).all(axis=1)
    for value in (x, scale):
        valid &= (np.abs(value) <= MAX_MAGNITUDE).all(axis=1)
    quat = quat[valid] / length[valid, None]
    return valid, (x[valid], quat, scale[valid], np.clip(opacity[valid], 0.0, 1.0), sh[valid])
