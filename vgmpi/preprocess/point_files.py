"""Particles of a body from a file: a table of points as .ply, .npz or .vtp."""

import zipfile
import zlib
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from vgmpi.scene.point_sets import ARRAYS, Points

from .meshes.bounded_reader import MAX_RATIO, read_point_arrays
from .meshes.mesh_formats import read_vertices
from .meshes.triangle_mesh import unit_colors

# names of the numbers of a point in a .ply file, and of arrays in a .vtp file
VELOCITY_NAMES = ("vx", "vy", "vz")
VOLUME_NAMES = ("volume", "volumes")
_FREE_BYTES = 1 << 28  # [bytes] that an array of any file may have
# what the readers raise for damaged files; RuntimeError: an encrypted archive
_FAILURES = (
    ValueError, OSError, EOFError, MemoryError, RuntimeError, zipfile.BadZipFile, zlib.error,
)  # fmt: skip
_HEADERS = {
    (1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0,
}  # fmt: skip


class PointFileError(ValueError):
    """Error of a file of points: one line."""


def read_points(path: Path, spacing: float | None) -> Points:
    """Return the particles in a file.

    Args:
        path: The file.
        spacing: Distance of the points [m], or None.

    Raises:
        PointFileError: The file cannot be read, or an array in it is not possible.
    """
    try:
        arrays = _READERS[path.suffix.lower()](path)
    except _FAILURES as error:
        raise PointFileError(f"{path.name}: {error or 'needs too much memory'}") from None
    if "positions" not in arrays:
        raise PointFileError(f"{path.name}: has no positions")
    count = len(arrays["positions"])
    for name, array in arrays.items():
        if len(array) != count:
            raise PointFileError(
                f"{path.name}: {name} has {len(array)} rows, positions has {count}"
            )
    if spacing is not None and arrays.pop("volumes", None) is not None:
        raise PointFileError(f"{path.name}: has volumes, and spacing is given: leave it out")
    try:
        return Points.model_validate({**arrays, "spacing": spacing})
    except ValidationError as error:
        item = error.errors()[0]
        message = item["msg"].removeprefix("Value error, ")
        raise PointFileError(f"{path.name}: {item['loc'][0]} {message}") from None


def _read_ply(path: Path) -> dict[str, np.ndarray]:
    """Return the arrays of a .ply file: x y z, volume, vx vy vz, red green blue."""
    columns, colors = read_vertices(path)
    arrays = {"positions": np.stack([columns[axis] for axis in "xyz"], 1).astype(float)}
    if all(name in columns for name in VELOCITY_NAMES):
        arrays["velocities"] = np.stack([columns[name] for name in VELOCITY_NAMES], 1).astype(float)
    for name in VOLUME_NAMES:
        if name in columns:
            arrays["volumes"] = columns[name].astype(float)
    if colors is not None:
        arrays["colors"] = colors
    return arrays


def _read_npz(path: Path) -> dict[str, np.ndarray]:
    """Return the arrays of a .npz file; sizes are compared with the file before they are used."""
    arrays, allowance = {}, max(_FREE_BYTES, MAX_RATIO * path.stat().st_size)
    with zipfile.ZipFile(path) as archive:
        names = {Path(name).stem: name for name in archive.namelist() if name.endswith(".npy")}
        unknown = sorted(names.keys() - set(ARRAYS))
        if unknown:
            raise ValueError(f"has an array {unknown[0]!r}; known: {', '.join(ARRAYS)}")
        for name, member in names.items():
            size = archive.getinfo(member).file_size
            with archive.open(member) as file:
                version = np.lib.format.read_magic(file)
                if version not in _HEADERS:
                    raise ValueError(f"{name} has a header of an unknown version")
                shape, _, dtype = _HEADERS[version](file)
            if dtype.kind not in "fiu":
                raise ValueError(f"{name} holds no numbers: its type is {dtype}")
            if size > allowance or np.prod(shape, dtype=float) * dtype.itemsize > size:
                raise ValueError(f"{name} is larger than its file explains: truncated?")
            with archive.open(member) as file:
                arrays[name] = np.lib.format.read_array(file, allow_pickle=False)
                if arrays[name].ndim == 0:
                    raise ValueError(f"{name} is a single number")
    return arrays


def _read_vtp(path: Path) -> dict[str, np.ndarray]:
    """Return the points of a .vtp file, and its point arrays of the names in `ARRAYS`."""
    fields = read_point_arrays(path)
    arrays = {"positions": fields.pop("points")}
    for name, names in (
        ("volumes", VOLUME_NAMES), ("velocities", ("velocities", "velocity")),
        ("colors", ("colors", "color", "rgb")),
    ):  # fmt: skip
        values = next(
            (fields[f"point {each}"] for each in names if f"point {each}" in fields), None
        )
        if values is not None and name == "colors":
            if values.ndim != 2 or values.shape[1] not in (3, 4):
                raise ValueError("colors must have three or four numbers per point")
            values = unit_colors(values, bool(np.issubdtype(values.dtype, np.integer)))
        if values is not None:
            arrays[name] = values
    return arrays


_READERS = {".ply": _read_ply, ".npz": _read_npz, ".vtp": _read_vtp}
