"""Read the files of a run: all that a renderer or a script needs, without MPI.

run = RunFiles("out")
run.times            (frames,) [s]
run.frame(3)["x"]    (n, 3) [m]
run.gaussians.cov0   (n, 6) [m2], a row per particle id
"""

import contextlib
import functools
import json
import logging
import os
import zlib
from collections.abc import Iterable
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np

from vgmpi.misspelt import nearest_file
from vgmpi.output import intact, layout, manifest, plain

log = logging.getLogger("vgmpi")

INSPECT_ROWS = 1 << 20  # rows looked at together when a file is described


class RunError(RuntimeError):
    """A file of a run is missing or broken; one line that names it."""


@contextlib.contextmanager
def opened(path: Path, series: bool = False):
    """An HDF5 file of a run open for reading; any trouble with it becomes a RunError that names it.
    series: see plain.check."""
    if os.path.islink(path):
        raise RunError(f"{path}: is a link to elsewhere, which no file of a run is")
    if not os.path.isfile(path):  # also of a name too long for a file
        said = "no regular file" if os.path.exists(path) else "no such file"
        raise RunError(f"{path}: {said}")
    try:
        with h5py.File(path, "r") as f:
            plain.check(f, series)
            yield f
    except RunError:
        raise
    except plain.Damaged as damaged:
        raise RunError(f"{path}: {damaged}") from None
    except Exception as error:  # HDF5, h5py and json raise all kinds of what is in a file
        raise RunError(f"{path}: broken or not a file of vgmpi: {_first_line(error)}") from None


def _first_line(error):
    return (str(error).splitlines() or [type(error).__name__])[0]


class RunFiles:
    """The files of one run, read when asked for. Raises RunError.

    frames: paths of those that are there, by number. Frames are known by their numbers: of one that
    is missing the others keep theirs, and `len` counts it.
    """

    def __init__(self, folder: str | Path):
        self.folder = Path(folder)
        if not self.folder.is_dir():
            raise RunError(f"{self.folder}: no such folder{nearest_file(self.folder)}")
        self.frames: dict[int, Path] = {}
        foreign = []
        for path in sorted((self.folder / layout.FRAMES).glob("*.vtkhdf")):
            number = layout.frame_number(path.name)
            if number is None:
                foreign.append(path.name)
            else:
                self.frames[number] = path
        if foreign:
            some = ", ".join(map(ascii, foreign[:3])) + ", ..." * (len(foreign) > 3)
            log.warning("%s: no frames of this run: %s", self.folder / layout.FRAMES, some)
        if not self.frames:
            from vgmpi.output import owner  # MPI comes with it: only who finds nothing waits

            said = f"{self.folder}: no frames in it ({layout.FRAMES}/frame_*.vtkhdf)"
            if who := owner.writer(self.folder):
                said = f"{self.folder}: a run goes on here and has written no frame yet ({who})"
            elif (self.folder / layout.GAUSSIANS).exists():
                said += "; its particles are prepared, python -m vgmpi scene.toml runs it"
            raise RunError(said)
        self._told = False  # of frames without checksums
        self._count = max([*self.frames, *self._listed()]) + 1

    def _listed(self) -> list[int]:
        """Numbers of the frames that the series tells of: the last ones may be missing too."""
        path = self.folder / layout.SERIES
        if not path.exists():
            return []
        try:
            with opened(path, series=True) as f:
                return intact.listed(f)
        except RunError as error:
            log.warning("%s", error)
            return []

    def __len__(self):
        return self._count

    def path(self, i: int) -> Path:
        """Of frame i, whether it is there or not."""
        return self.folder / layout.FRAMES / layout.FRAME_NAME.format(i)

    def present(self, numbers: Iterable[int]) -> list[int]:
        """Those of the frames that are there; says in one line which are not. Raises RunError where
        none is."""
        asked = list(numbers)
        there = [i for i in asked if i in self.frames]
        missing = [i for i in asked if i not in self.frames]
        if missing:
            some = ", ".join(map(str, missing[:10])) + ", ..." * (len(missing) > 10)
            said = f"{self.folder / layout.FRAMES}: missing: {some}"
            if not there:
                raise RunError(said)
            log.warning("%s: left out, no other frame stands for them", said)
        return there

    @functools.cached_property
    def times(self) -> np.ndarray:
        """Simulated time of every frame [s], (frames,); nan of those that are missing."""
        return np.array(
            [self._time(i) if i in self.frames else np.nan for i in range(len(self))], np.float64
        )

    def _time(self, i):
        with opened(self.path(i)) as f:
            time = f["VTKHDF/FieldData/time"][()]
            intact.check_frame(f, i, {"VTKHDF/FieldData/time": time})
            return float(time[0])

    def positions(self, i: int) -> np.ndarray:
        """Positions in frame i alone (n, 3) [m]. Raises RunError."""
        with opened(self.path(i)) as f:
            held = {"VTKHDF/Points": f["VTKHDF/Points"][()]}
            intact.check_frame(f, i, held, self._particles)
        return held["VTKHDF/Points"]

    def frame(self, i: int) -> dict[str, np.ndarray]:
        """Arrays of frame i by the names of layout.FRAME: id and x always, the others as they are
        there; and poses (m, 4, 4) where objects without mass move."""
        if not -len(self) <= i < len(self):
            raise RunError(f"{self.folder}: no frame {i}, there are {len(self)}")
        number = i % len(self)
        with opened(self.path(number)) as f:
            names = [f"VTKHDF/PointData/{name}" for name in f["VTKHDF/PointData"]]
            names += ["VTKHDF/Points", "VTKHDF/NumberOfPoints"]
            held = {name: f[name][()] for name in names}
            intact.check_frame(f, number, held, self._particles)
            count = int(held.pop("VTKHDF/NumberOfPoints")[0])
            arrays = {name.removeprefix("VTKHDF/PointData/"): a for name, a in held.items()}
            arrays = {"id": arrays.pop("id"), "x": arrays.pop("VTKHDF/Points"), **arrays}
            intact.check_arrays(arrays, count)
            if "poses" in f:
                arrays["poses"] = intact.poses(f["poses"][()])
            if layout.CRC not in f and not self._told:
                self._told = True
                log.info("%s: frames of an earlier version, without checksums", self.folder)
        return arrays

    @functools.cached_property
    def _particles(self) -> int | None:
        """Identity of gaussians.h5, where it can be told: who reads the file says what is wrong."""
        try:
            return identity(self.folder / layout.GAUSSIANS)
        except RunError:
            return None

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


def identity(path: str | Path) -> int | None:
    """By which the particles of a gaussians.h5 are known; None of earlier versions. Its texts are
    left out: they tell of the scene, of which something may change at a resume; and what tells of
    the light on colours, which earlier versions did not keep. Raises RunError."""
    with opened(Path(path)) as f:
        found = intact.sums(f)
    if found is None:
        return None
    less = {d.name for d in layout.GAUSSIAN_TEXTS}
    less |= {f"{group}shade" for group in ("", "scenery/", "passive/")}
    told = json.dumps(sorted(pair for pair in found.items() if pair[0] not in less))
    return zlib.crc32(told.encode())


def read_gaussians(path: str | Path) -> SimpleNamespace:
    """gaussians.h5: x0, vol0, object, v0 (None if nothing moves), theta0
    (None if nothing is compressed), surface0 (None if no solid touches anything), cov0,
    opacity, sh, shade (None if no light is painted on it), scenery (those of layout.SCENERY or
    None), passive (those of layout.PASSIVE or None), objects, scene, digest. Raises RunError, also
    where numbers are not those that were written."""
    with opened(Path(path)) as f:
        held = {name: f[name][()] for name in ("objects", "scene")}
        found = _arrays(f, "", layout.GAUSSIAN, held)
        found.scenery = found.passive = None
        for group, datasets in (("scenery", layout.SCENERY), ("passive", layout.PASSIVE)):
            if group in f:
                setattr(found, group, _arrays(f, f"{group}/", datasets, held))
        intact.check_gaussians(f, held)
        found.objects = json.loads(held["objects"])
        found.scene = json.loads(held["scene"])
        found.digest = f.attrs["digest"].decode()
        intact.check_objects(found)
        return found


def _arrays(f, prefix, datasets, held):
    """The datasets by their names, None for one of layout.OPTIONAL that is not there; those that
    are there go to `held` too, by their names in the file."""
    there = [d.name for d in datasets if d.name not in layout.OPTIONAL or prefix + d.name in f]
    arrays = {name: f[prefix + name][()] for name in there}
    held |= {prefix + name: array for name, array in arrays.items()}
    return SimpleNamespace(**{d.name: arrays.get(d.name) for d in datasets})


def inspect(path: str | Path) -> str:
    """What any of our HDF5 files holds, as text. Raises RunError."""
    path = Path(path)
    if not os.path.exists(path):
        raise RunError(f"{path}: no such file{nearest_file(path)}")
    there = path.resolve()  # who names a link means what it leads to
    with opened(there, series=True) as f:
        kind = _kind(f)
        _check_name(there, kind)
        lines = [f"{path}: {kind}, {there.stat().st_size / 1e6:.1f} MB"]
        lines += _summary(there, f, kind)
        units = _units(kind)
        lines += [_line(name, f[name], units) for name in plain.datasets(f)]
    return "\n".join(lines)


def _kind(f):
    if "VTKHDF" in f:
        return "series of frames" if "Steps" in f["VTKHDF"] else "frame"
    if "attrs" in f:
        return "checkpoint"
    if "objects" in f:
        return "gaussians"
    raise RunError(f"{f.filename}: not a file of vgmpi")


def _check_name(path, kind):
    """A file under a name of ours is of that kind."""
    names = {
        "frame": layout.frame_number(path.name) is not None,
        "series of frames": path.name == layout.SERIES,
        "gaussians": path.name == layout.GAUSSIANS,
    }
    for wanted, is_so in names.items():
        if is_so and kind != wanted:
            raise RunError(f"{path}: damaged: it is a {kind}, not a {wanted}")


def _summary(path, f, kind):
    """The lines that matter most."""
    if kind == "frame":
        data, number = f["VTKHDF/FieldData"], layout.frame_number(path.name)
        state = _state(lambda: intact.check_frame(f, number, _all(f)), f)
        return [f"time {data['time'][0]:.9g} s, step {data['step'][0]}; {state}"]
    if kind == "series of frames":
        times = f["VTKHDF/Steps/Values"][()]
        _check_series(path, f, times)
        return [f"{len(times)} frames, time {times[0]:.9g} .. {times[-1]:.9g} s"]
    if kind == "gaussians":
        objects = json.loads(f["objects"][()])
        lines = [_state(lambda: intact.check_gaussians(f, _all(f)), f)]
        return lines + [
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


def _all(f):
    """Every dataset but the checksums."""
    return {name: f[name][()] for name in plain.datasets(f) if name != layout.CRC}


def _state(check, f):
    """What a check of the whole file says."""
    try:
        check()
    except plain.Damaged as damaged:
        return f"NOT VALID: {damaged}"
    known = layout.CRC in f
    return "agrees with its checksums" if known else "of an earlier version, without checksums"


def _check_series(path, f, times):
    """HDF5 reads zeros for a frame that is not there: say so first. Raises RunError."""
    intact.check_series(f)
    for number, time in zip(intact.listed(f), times, strict=True):
        frame = path.parent / layout.FRAMES / layout.FRAME_NAME.format(number)
        with opened(frame) as f:
            if f["VTKHDF/FieldData/time"][0] != time:
                raise RunError(f"{path}: damaged: {frame.name} is not at {time:.9g} s")


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
