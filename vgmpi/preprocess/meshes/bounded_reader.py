"""Meshes that libraries read, in a process of its own: VTK (.vtk, .vtp, .vtu), meshio (.msh).

Their readers trust all sizes in a file, unpack all data, and may crash on damaged files. The
process has a bound on its memory and its time, so that a file costs no more than its size explains.
"""

import io
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np

from vgmpi.runtime import process_limits

from .triangle_mesh import COLOR_NAMES, Mesh, unit_colors

SUFFIXES = (".vtk", ".vtp", ".vtu", ".msh")
_FREE_BYTES = 1 << 28  # [bytes] memory that any file may take
MAX_RATIO = 100  # [-] memory relative to the file, of large ones
_FREE_SECONDS, _SECONDS_PER_BYTE = 60.0, 1e-6  # [s] time that a file may take
_PROGRAM = Path(__file__).with_name("reader_process.py")
_REFUSED = 2  # exit code of the program where it says why


def read_by_library(path: Path) -> Mesh:
    """Return the triangles of a file: polygons, strips, and the surface of VTK's volume cells.

    Raises:
        ValueError: The file cannot be read, or takes more than its size can explain.
    """
    fields = _read_arrays(path, "triangles")
    points, triangles = fields["points"], fields["triangles"].astype(np.int64)
    return Mesh(
        points, triangles, _colors(fields, "point", len(points)),
        triangle_rgb=_colors(fields, "cell", len(triangles)),
    )  # fmt: skip


def read_point_arrays(path: Path) -> dict[str, np.ndarray]:
    """Return the points (n, 3) of a file of VTK as "points", and their arrays as "point NAME".

    Raises:
        ValueError: The file cannot be read, or takes more than its size can explain.
    """
    return _read_arrays(path, "points")


def _read_arrays(path: Path, content: str) -> dict[str, np.ndarray]:
    """Return the arrays that the program reads; content: "triangles" or "points"."""
    size = path.stat().st_size
    allowance = max(_FREE_BYTES, MAX_RATIO * size)
    available = process_limits.available_memory(swap=True)
    allowance = min(allowance, available) if available else allowance
    command = [sys.executable, "-P", str(_PROGRAM), str(path.resolve()), str(allowance)]
    command.append(content)
    try:
        job = subprocess.run(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
            timeout=_FREE_SECONDS + _SECONDS_PER_BYTE * size,
        )  # fmt: skip
    except subprocess.TimeoutExpired as error:
        raise ValueError(f"takes more than {error.timeout:.0f} s to read: damaged?") from None
    if job.returncode == _REFUSED:
        raise ValueError(job.stdout.decode(errors="replace"))
    if job.returncode != 0:
        raise ValueError(
            f"its reader ended by {_cause(job.returncode)}: the file is damaged, or takes more"
            f" than {process_limits.format_bytes(allowance)} of memory"
        )
    with np.load(io.BytesIO(job.stdout), allow_pickle=False) as arrays:
        return {name: arrays[name] for name in arrays.files}


def _cause(code: int) -> str:
    """Return what ended a process."""
    try:
        return signal.Signals(-code).name
    except ValueError:
        return f"exit code {code}"


def _colors(fields: dict[str, np.ndarray], place: str, count: int) -> np.ndarray | None:
    """Return the colors 0..1 (count, 3) of points or cells, or None."""
    names = [f"{place} {name}" for name in COLOR_NAMES[0]]
    if all(name in fields for name in names):
        values = np.stack([fields[name] for name in names], axis=1)
    else:
        # VTK's own colors, of bytes, come after arrays that are named so
        wide = [v for k, v in fields.items() if k.startswith(f"{place} ") and v.ndim == 2]
        wide.sort(key=lambda each: each.dtype == np.uint8)
        values = wide[0] if wide else np.empty((0, 3))
    if len(values) != count or not count:
        return None
    return unit_colors(values, bool(np.issubdtype(values.dtype, np.integer)))
