"""Read the files of a run: all that a renderer or a script needs, without MPI.

run = RunFiles("out")
run.times            (frames,) [s]
run.frame(3)["x"]    (n, 3) [m]
run.gaussians.cov0   (n, 6) [m2], a row per particle id
"""

import contextlib
import functools
import json
import os
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np

from vgmpi.output import layout, manifest

INSPECT_ROWS = 1 << 20  # rows looked at together when a file is described


class RunError(RuntimeError):
    """A file of a run is missing or broken; one line that names it."""


@contextlib.contextmanager
def opened(path: Path):
    """An HDF5 file open for reading; any trouble with it becomes a RunError that names it."""
    if not os.path.isfile(path):  # also of a name too long for a file
        said = "no regular file" if os.path.exists(path) else "no such file"
        raise RunError(f"{path}: {said}")
    try:
        with h5py.File(path, "r") as f:
            yield f
    except (OSError, KeyError, ValueError, RuntimeError, MemoryError) as error:
        if isinstance(error, RunError):
            raise
        raise RunError(f"{path}: broken or not a file of vgmpi: {_first_line(error)}") from None


def _first_line(error):
    return (str(error).splitlines() or [type(error).__name__])[0]


class RunFiles:
    """The files of one run, read when asked for. Raises RunError."""

    def __init__(self, folder: str | Path):
        self.folder = Path(folder)
        if not self.folder.is_dir():
            raise RunError(f"{self.folder}: no such folder")
        frames = sorted((self.folder / layout.FRAMES).glob("frame_*.vtkhdf"))
        self.frames = [p for p in frames if p.stem.removeprefix("frame_").isdigit()]
        if not self.frames:
            raise RunError(f"{self.folder}: no frames in it ({layout.FRAMES}/frame_*.vtkhdf)")

    def __len__(self):
        return len(self.frames)

    @functools.cached_property
    def times(self) -> np.ndarray:
        """Simulated time of every frame [s], (frames,)."""
        return np.array([self._time(path) for path in self.frames])

    def _time(self, path):
        with opened(path) as f:
            return f["VTKHDF/FieldData/time"][0]

    def frame(self, i: int) -> dict[str, np.ndarray]:
        """Arrays of frame i by the names of layout.FRAME: id and x always, the others as they are
        there."""
        if not -len(self) <= i < len(self):
            raise RunError(f"{self.folder}: no frame {i}, there are {len(self)}")
        path = self.frames[i]
        with opened(path) as f:
            root = f["VTKHDF"]
            arrays = {name: d[()] for name, d in root["PointData"].items()}
            arrays = {"id": arrays.pop("id"), "x": root["Points"][()], **arrays}
            count = int(root["NumberOfPoints"][0])
        wrong = [name for name, a in arrays.items() if len(a) != count]
        if wrong:
            raise RunError(f"{path}: broken: {', '.join(wrong)} should have {count} rows")
        return arrays

    @functools.cached_property
    def gaussians(self) -> SimpleNamespace:
        return read_gaussians(self.folder / layout.GAUSSIANS)

    @property
    def objects(self) -> list[dict]:
        return self.gaussians.objects

    @property
    def scene(self) -> dict:
        """The scene with every default filled in."""
        return self.gaussians.scene


def read_gaussians(path: str | Path) -> SimpleNamespace:
    """gaussians.h5: x0, vol0, object, v0 (None if nothing moves), theta0
    (None if nothing is compressed), cov0, opacity, sh, scenery (the
    same or None), passive (those of layout.PASSIVE or None), objects,
    scene, digest. Raises RunError, also where numbers are not those that were written."""
    with opened(Path(path)) as f:
        if f.attrs["schema"] != layout.SCHEMA:
            raise RunError(
                f"{path}: its schema is {f.attrs['schema']}, this program's {layout.SCHEMA}"
            )
        held = {name: f[name][()] for name in ("objects", "scene")}
        found = SimpleNamespace(v0=None, theta0=None, scenery=None, passive=None)
        for d in layout.GAUSSIAN:
            if d.name not in layout.OPTIONAL or d.name in f:
                held[d.name] = f[d.name][()]
                setattr(found, d.name, held[d.name])
        for group, datasets in (("scenery", layout.SCENERY), ("passive", layout.PASSIVE)):
            if group in f:
                arrays = {d.name: f[f"{group}/{d.name}"][()] for d in datasets}
                held |= {f"{group}/{name}": array for name, array in arrays.items()}
                setattr(found, group, SimpleNamespace(**arrays))
        _check_sums(path, json.loads(f["crc"][()]) if "crc" in f else {}, held)
        found.objects = json.loads(held["objects"])
        found.scene = json.loads(held["scene"])
        found.digest = f.attrs["digest"].decode()
        for prefix, part in (("", found), ("scenery/", found.scenery), ("passive/", found.passive)):
            if part is not None and len(part.x0):
                _check_rows(path, prefix, part, len(found.objects))
        return found


def _check_sums(path: str | Path, sums: dict[str, int], held: dict) -> None:
    """Raises RunError where something in gaussians.h5 is not what was written; files of before
    have no sums."""
    for name, want in sums.items():
        if name not in held:
            raise RunError(f"{path}: damaged: there is no {name}")
        rows = held[name]
        if isinstance(rows, bytes):
            rows = np.frombuffer(rows, np.uint8)
        if manifest.crc(np.ascontiguousarray(rows)) != want:
            raise RunError(f"{path}: damaged: {name} is not what was written")


def _check_rows(path: str | Path, prefix: str, rows: SimpleNamespace, objects: int) -> None:
    """Raises RunError where a row cannot be."""
    if not np.isfinite(rows.x0).all():
        raise RunError(f"{path}: damaged: {prefix}x0 holds what is no number")
    if rows.object.min() < 0 or rows.object.max() >= objects:
        raise RunError(f"{path}: damaged: {prefix}object names objects that are not there")


def inspect(path: str | Path) -> str:
    """What any of our HDF5 files holds, as text. Raises RunError."""
    path = Path(path)
    with opened(path) as f:
        kind = _kind(f)
        lines = [f"{path}: {kind}, {path.stat().st_size / 1e6:.1f} MB"]
        lines += _summary(path, f, kind)
        names: list[str] = []
        f.visititems(
            lambda name, item: names.append(name) if isinstance(item, h5py.Dataset) else None
        )
        units = _units(kind)
        for name in names:
            lines.append(_line(name, f[name], units))
    return "\n".join(lines)


def _kind(f):
    if "VTKHDF" in f:
        return "series of frames" if "Steps" in f["VTKHDF"] else "frame"
    if "attrs" in f:
        return "checkpoint"
    if "objects" in f:
        return "gaussians"
    raise RunError(f"{f.filename}: not a file of vgmpi")


def _summary(path, f, kind):
    """The lines that matter most."""
    if kind == "frame":
        data = f["VTKHDF/FieldData"]
        return [f"time {data['time'][0]:.9g} s, step {data['step'][0]}"]
    if kind == "series of frames":
        times = f["VTKHDF/Steps/Values"][()]
        return [f"{len(times)} frames, time {times[0]:.9g} .. {times[-1]:.9g} s"]
    if kind == "gaussians":
        objects = json.loads(f["objects"][()])
        return [
            "object {}: {} {}, {} rows from {}".format(
                i, *(o.get(k, "-") for k in ("name", "kind", "count", "first"))
            )
            for i, o in enumerate(objects)
        ]
    attrs = json.loads(f["attrs"][()])
    try:
        manifest.check(path)
        state = "agrees with its manifest"
    except manifest.Broken as broken:
        state = f"NOT VALID: {broken}"
    return [f"time {attrs.get('time')} s, step {attrs.get('step')}; {state}"]


def _units(kind):
    tables = {
        "frame": (layout.FRAME, layout.FRAME_FIELD_DATA),
        "series of frames": (layout.FRAME, layout.FRAME_FIELD_DATA),
        "gaussians": (layout.GAUSSIAN, layout.PASSIVE),
        "checkpoint": (layout.CHECKPOINT,),
    }
    units = {d.name.split("/")[-1]: d.unit for table in tables[kind] for d in table}
    return {**units, "Points": "m"}


def _line(name, dataset, units):
    text = f"  {name:34} {str(dataset.shape):16} {dataset.dtype!s:8}"
    if dataset.dtype.kind not in "fiu" or dataset.size == 0:
        return text.rstrip()
    low, high = np.inf, -np.inf
    for first in range(0, dataset.shape[0] if dataset.shape else 1, INSPECT_ROWS):
        rows = dataset[first : first + INSPECT_ROWS] if dataset.shape else dataset[()]
        low, high = np.minimum(low, np.min(rows)), np.maximum(high, np.max(rows))  # keep NaN
    unit = units.get(name.split("/")[-1], "")
    return f"{text} {low:.6g} .. {high:.6g} {'' if unit == '1' else unit}".rstrip()
