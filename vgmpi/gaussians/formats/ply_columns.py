"""Columns of the plain layout of a .ply file: log scales, logit opacities, colors, labels.

References:
    B. Kerbl et al. 2023 (the layout); B. Huang et al. 2024 (2D Gaussians, which have two scales);
    Z. Yu et al. 2024 (Mip-Splatting, whose files have the column filter_3D).
"""

import re
from collections.abc import Iterable

import numpy as np

from vgmpi.gaussians.spherical_harmonics import dc_from_rgb, limit_degree

from .validation import Columns, GaussianFileError

DISC_THICKNESS = 1e-3  # [-] of a 2D Gaussian, relative to its smaller scale
FILTER = "filter_3D"
_HIGHER_COUNTS = (0, 9, 24, 45, 72)  # properties f_rest of degrees 0 to 4
_CENTER = ["x", "y", "z"]
_CONSTANT = ["f_dc_0", "f_dc_1", "f_dc_2"]
_RGB = ["red", "green", "blue"]
_ROTATION = ["rot_0", "rot_1", "rot_2", "rot_3"]
_SCALES = ["scale_0", "scale_1", "scale_2"]
# integer columns that are no labels
_STANDARD = re.compile(
    r"n?[xyz]|(f_dc|f_rest|scale|rot)_\d+|opacity|red|green|blue|alpha|" + FILTER
)
# columns that some programs store as floating-point numbers
_LABEL = re.compile(
    r"(labels?|ids?|class|classes|category|object|instance|segment|semantic|cluster|part|group)"
    r"(_?(labels?|ids?|index|indices|class))?",
    re.IGNORECASE,
)


def has_only_points(names: Iterable[str]) -> bool:
    """Return whether columns are those of a cloud of points without sizes and rotations."""
    columns = set(names)
    return columns.issuperset(_CENTER) and columns.isdisjoint((*_SCALES, *_ROTATION))


def is_flat(names: Iterable[str]) -> bool:
    """Return whether columns are those of 2D Gaussians: two scales instead of three."""
    columns = set(names)
    return "scale_2" not in columns and columns.issuperset(_SCALES[:2])


def has_float_rgb(row: np.dtype) -> bool:
    """Return whether colors are red, green and blue as floating-point numbers."""
    names = row.names or ()
    return "f_dc_0" not in names and "red" in names and row["red"].kind == "f"


def read_columns(rows: np.ndarray, names: list[str]) -> np.ndarray:
    """Return the named properties as float64 columns (n, len(names)).

    Raises:
        GaussianFileError: If one is missing.
    """
    present = rows.dtype.names or ()
    missing = [name for name in names if name not in present]
    if missing:
        raise GaussianFileError(f"has no property {', '.join(missing)}: not a cloud of Gaussians?")
    return np.stack([rows[name].astype(np.float64) for name in names], axis=1)


def count_higher(row: np.dtype) -> int:
    """Return the number of properties f_rest_*.

    Raises:
        GaussianFileError: If it belongs to no degree.
    """
    count = sum(name.startswith("f_rest_") for name in row.names or ())
    if count not in _HIGHER_COUNTS:
        allowed = ", ".join(map(str, _HIGHER_COUNTS[:-1]))
        raise GaussianFileError(
            f"has {count} f_rest properties: allowed are {allowed} or {_HIGHER_COUNTS[-1]}"
        )
    return count


def read_higher(rows: np.ndarray) -> np.ndarray | None:
    """Return the properties f_rest_* as stored (n, 3 (K - 1)), or None."""
    count = count_higher(rows.dtype)
    return read_columns(rows, [f"f_rest_{i}" for i in range(count)]) if count else None


def join_coefficients(dc: np.ndarray, f_rest: np.ndarray | None) -> np.ndarray:
    """Join constant (n, 3) and channel-major higher coefficients to (n, K, 3), up to degree 3."""
    if f_rest is None:
        return dc[:, None, :]
    higher = f_rest.reshape(len(dc), 3, -1).transpose(0, 2, 1)
    return limit_degree(np.concatenate([dc[:, None, :], higher], axis=1))


def integer_columns(rows: np.ndarray, others: Iterable[str] = ()) -> dict[str, np.ndarray]:
    """Return the columns of labels by name, in the machine's byte order.

    They are all columns of integers that have no meaning for Gaussians, and columns of
    floating-point numbers with the name of a label, whose values are checked later.

    Args:
        rows: Rows of a file, shape (n,).
        others: Names of further columns that are no labels.
    """
    columns = {}
    for name in rows.dtype.names or ():
        if _STANDARD.fullmatch(name) or name in others:
            continue
        if rows.dtype[name].kind in "iu":
            is_wide = rows.dtype[name].itemsize == 4 and rows.dtype[name].kind == "u"
            columns[name] = rows[name].astype(np.int64 if is_wide else np.int32)
        elif _LABEL.fullmatch(name):
            columns[name] = rows[name].astype(np.float64)
    return columns


def decode_plain(rows: np.ndarray) -> Columns:
    """Return x, quat, scale, opacity, sh and labels of the plain layout."""
    names = rows.dtype.names or ()
    x = read_columns(rows, _CENTER)
    quat = read_columns(rows, _ROTATION)
    flat = is_flat(names)
    scale = np.exp(read_columns(rows, _SCALES[:2] if flat else _SCALES))
    opacity = 1 / (1 + np.exp(-read_columns(rows, ["opacity"])[:, 0]))
    if FILTER in names:
        scale, opacity = apply_filter(scale, opacity, read_columns(rows, [FILTER]))
    if flat:
        thickness = DISC_THICKNESS * scale.min(axis=1, keepdims=True)
        scale = np.concatenate([scale, thickness], axis=1)
    sh = join_coefficients(_constant_coefficients(rows), read_higher(rows))
    return x, quat, scale, opacity, sh, integer_columns(rows)


def apply_filter(
    scale: np.ndarray, opacity: np.ndarray, size: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return scales and opacities after the 3D smoothing filter of Mip-Splatting.

    scale' = sqrt(scale^2 + size^2), and the opacity is multiplied by the square root of the ratio
    of the determinants of the covariances before and after.

    Args:
        scale: Standard deviations, shape (n, 2) or (n, 3).
        opacity: Opacities, shape (n,).
        size: Standard deviation of the filter, shape (n, 1), in the units of `scale`.
    """
    smoothed = np.hypot(scale, size)
    ratio = np.divide(scale, smoothed, out=np.ones_like(scale), where=smoothed != 0)
    return smoothed, opacity * ratio.prod(axis=1)


def _constant_coefficients(rows: np.ndarray) -> np.ndarray:
    """Return the constant colors (n, 3): f_dc_0..2, or red, green and blue if these are missing.

    Integers count in fractions of the largest of their type, other numbers lie in 0..1.
    """
    names = rows.dtype.names or ()
    if "f_dc_0" in names or not set(_RGB).issubset(names):
        return read_columns(rows, _CONSTANT)
    rgb = read_columns(rows, _RGB)
    kinds = [rows.dtype[name] for name in _RGB]
    top = [float(np.iinfo(kind).max) if kind.kind in "iu" else 1.0 for kind in kinds]
    return dc_from_rgb(rgb / top)
