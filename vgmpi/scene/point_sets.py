"""Particles of a body, given one by one."""

import zlib
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, ConfigDict, PlainSerializer

from vgmpi.runtime.config.schema import Positive, StrictModel

POINT_SUFFIXES = (".ply", ".npz", ".vtp")  # of files of points
ARRAYS = ("positions", "volumes", "colors", "velocities")
KEYS_OF_SURFACES = ("collider", "prune", "rigid")  # of objects whose surface is known


def _numbers(value: Any, *row: int) -> np.ndarray:
    """Return finite numbers of shape (n, *row), read-only; raise ValueError for anything else."""
    shape = "a row of 3 numbers per point" if row else "a number per point"
    try:
        array = np.array(value, np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"must be {shape}") from None
    if array.ndim != 1 + len(row) or array.shape[1:] != row or not len(array):
        raise ValueError(f"must be {shape}; its shape is {array.shape}")
    if not np.isfinite(array).all():
        first = int(np.argwhere(~np.isfinite(array))[0, 0])
        raise ValueError(f"must be finite; point {first} has {array[first].tolist()}")
    array.flags.writeable = False
    return array


def _parse_rows(value: Any) -> np.ndarray:
    """Return rows of three numbers, shape (n, 3)."""
    return _numbers(value, 3)


def _parse_volumes(value: Any) -> np.ndarray:
    """Return volumes, shape (n,) [m3]; raise ValueError if one is not positive."""
    volumes = _numbers(value)
    if not (volumes > 0).all():
        first = int(np.argmin(volumes > 0))
        raise ValueError(f"must be > 0 m3; point {first} has {volumes[first]:g}")
    return volumes


def _parse_colors(value: Any) -> np.ndarray:
    """Return colors, shape (n, 3); raise ValueError if a number is not from 0 to 1."""
    colors = _numbers(value, 3)
    outside = ((colors < 0) | (colors > 1)).any(1)
    if outside.any():
        first = int(np.argmax(outside))
        raise ValueError(f"must be from 0 to 1; point {first} has {colors[first].tolist()}")
    return colors


def _summarize(array: np.ndarray | None) -> dict | None:
    """Return what identifies an array in files: its shape and the CRC32 of its numbers."""
    if array is None:
        return None
    return {"shape": list(array.shape), "crc": zlib.crc32(array.tobytes())}


_Summary = PlainSerializer(_summarize)


def as_table(value: Any) -> Any:
    """Return the table of a body of points: the name of a file stands for { file = name }."""
    return {"file": value} if isinstance(value, str) else value


class Points(StrictModel):
    """Particles of a body, given one by one: by a file, `points = "FILE"` or `{ file = "FILE" }`,
    or by a program as arrays, `vgmpi.load` of a dict.

    A file has the numbers of each point by name. .npz: arrays `positions`, `volumes`, `colors`,
    `velocities`; .ply: `x y z`, `volume`, `red green blue`, `vx vy vz`; .vtp: its points, and
    arrays `volume`, `colors`, `velocity`. All but the positions may be missing.
    """

    model_config = ConfigDict(arbitrary_types_allowed=True)

    file: str | None = None
    """a file of points (.ply .npz .vtp), relative to the scene's folder, instead of `positions`"""
    positions: Annotated[np.ndarray | None, BeforeValidator(_parse_rows), _Summary] = None
    """(n, 3) [m], in the object's own coordinates; `origin`, `rotation` and `scale` place them"""
    volumes: Annotated[np.ndarray | None, BeforeValidator(_parse_volumes), _Summary] = None
    """(n,) [m3], rest volumes. They are scaled with the object"""
    spacing: Positive | None = None
    """instead of `volumes`: distance of the points, whose volume is its cube. Without both, the
    points in a lattice cell (`particles_per_cell`) share its volume, as those of a capture do"""
    colors: Annotated[np.ndarray | None, BeforeValidator(_parse_colors), _Summary] = None
    """(n, 3) from 0 to 1; default: `color`"""
    velocities: Annotated[np.ndarray | None, BeforeValidator(_parse_rows), _Summary] = None
    """(n, 3) [m/s], added to `velocity` of the object; turned by `rotation`, not scaled. Their
    gradients are 0 at the start"""

    @property
    def speed(self) -> float:
        """Return the largest speed [m/s] of the points, 0 for those of a file."""
        v = self.velocities
        return 0.0 if v is None else float(np.sqrt((v**2).sum(1).max()))


def validate_points(raw: dict, scenery: bool) -> list[tuple[tuple, str]]:
    """Return (path, message) for keys that do not go together with `points`.

    Args:
        raw: Table of the object as read.
        scenery: Whether it is scenery.
    """
    points = raw.get("points")
    if points is None:
        return []
    errors: list[tuple[tuple, str]] = []
    if scenery:
        errors.append((("points",), "is only for bodies"))
    for key in KEYS_OF_SURFACES:
        if raw.get(key, "off") not in (False, "off"):
            errors.append(((key,), "is not for objects made of points"))
    points = as_table(points)
    if isinstance(points, dict):
        errors += _validate_file(points)
        if "volumes" in points and "spacing" in points:
            message = "volumes and spacing given at once: give one"
            errors.append((("points", "spacing"), message))
        for key in ARRAYS[1:]:
            count, rows = (len(points[k]) if isinstance(points.get(k), list) else None
                           for k in (key, "positions"))  # fmt: skip
            if None not in (count, rows) and count != rows:
                message = f"has {count} rows, positions has {rows}"
                errors.append((("points", key), message))
    return errors


def _validate_file(points: dict) -> list[tuple[tuple, str]]:
    """Return (path, message) for errors of a table with a file or with positions."""
    file, arrays = points.get("file"), [key for key in ARRAYS if key in points]
    if file is None:
        return [] if arrays else [(("points",), "has no points: give file or positions")]
    if arrays:
        return [(("points", arrays[0]), f"file and {arrays[0]} given at once: give one")]
    return []
