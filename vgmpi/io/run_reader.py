"""Reader of the files of a run for renderers and scripts, without MPI.

run = RunReader("out")
run.times            (frames,) [s]
run.frame(3)["positions"]    (n, 3) [m]
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

from vgmpi.runtime.message_text import did_you_mean_file

from . import checkpoint_manifest, file_layout, hdf5_validation, integrity

log = logging.getLogger("vgmpi")

INSPECT_ROWS = 1 << 20  # [rows] read together when a file is described


class RunError(RuntimeError):
    """A file of a run is missing or broken; the text is one line that names it."""


@contextlib.contextmanager
def opened(path: Path, series: bool = False):
    """Open an HDF5 file of a run for reading; any error with it becomes a RunError that names it.

    `series`: see hdf5_validation.check_structure.
    """
    if os.path.islink(path):
        raise RunError(f"{path}: is a link to elsewhere, which no file of a run is")
    if not os.path.isfile(path):  # also True for a name too long for a file
        reason = "no regular file" if os.path.exists(path) else "no such file"
        raise RunError(f"{path}: {reason}")
    try:
        with h5py.File(path, "r") as f:
            hdf5_validation.check_structure(f, series)
            hdf5_validation.check_schema(f)
            yield f
    except RunError:
        raise
    except hdf5_validation.CorruptFileError as damaged:
        raise RunError(f"{path}: {damaged}") from damaged
    except Exception as error:  # a damaged file makes HDF5, h5py and json raise many types
        raise RunError(f"{path}: broken or not a file of vgmpi: {_first_line(error)}") from None


def _first_line(error):
    """Return the first line of an error's text, or its type."""
    return (str(error).splitlines() or [type(error).__name__])[0]


class RunReader:
    """Files of one run, read on demand. Raises RunError.

    Frames are identified by their numbers: if one is missing, the others keep theirs, and `len`
    counts it.

    Attributes:
        frames: Paths of the available frames, by number.
    """

    def __init__(self, folder: str | Path):
        """Find the frames of a run; nothing is read but the series."""
        self.folder = Path(folder)
        if not self.folder.is_dir():
            raise RunError(f"{self.folder}: no such folder{did_you_mean_file(self.folder)}")
        self.refresh()

    def refresh(self) -> None:
        """Find the frames again, those of a run that goes on. Raises RunError without any."""
        frames, foreign = {}, []
        for path in sorted((self.folder / file_layout.FRAMES).glob("*.vtkhdf")):
            number = file_layout.frame_number(path.name)
            if number is None:
                foreign.append(path.name)
            else:
                frames[number] = path
        if foreign:
            some = ", ".join(map(ascii, foreign[:3])) + ", ..." * (len(foreign) > 3)
            log.warning("%s: no frames of this run: %s", self.folder / file_layout.FRAMES, some)
        if not frames:
            from . import run_lock  # imports MPI, so only if there are no frames

            message = f"{self.folder}: no frames in it ({file_layout.FRAMES}/frame_*.vtkhdf)"
            if who := run_lock.current_writer(self.folder):
                message = f"{self.folder}: a run goes on here and has written no frame yet ({who})"
            elif (self.folder / file_layout.GAUSSIANS).exists():
                message += "; its particles are prepared, python -m vgmpi scene.toml runs it"
            raise RunError(message)
        self.frames: dict[int, Path] = frames
        self._count = max([*frames, *self._series_frames()]) + 1
        self.__dict__.pop("times", None)

    def __repr__(self) -> str:
        return f"<run {str(self.folder)!r}: {len(self.frames)} frames>"

    def _series_frames(self) -> list[int]:
        """Return the numbers of the frames in the series: the last ones may be missing too."""
        path = self.folder / file_layout.SERIES
        if not path.exists():
            return []
        try:
            with opened(path, series=True) as f:
                return integrity.series_frames(f)
        except RunError as error:
            if isinstance(error.__cause__, hdf5_validation.SchemaVersionError):
                raise  # the frames have the same schema
            log.warning("%s", error)
            return []

    def __len__(self):
        """Return the number of frames, including missing ones."""
        return self._count

    def path(self, i: int) -> Path:
        """Return the path of frame i, which may be missing."""
        return self.folder / file_layout.FRAMES / file_layout.FRAME_NAME.format(i)

    def available_frames(self, numbers: Iterable[int]) -> list[int]:
        """Return the numbers of the available frames, and log a line on the others.

        Raises RunError if none is available.
        """
        requested = list(numbers)
        available = [i for i in requested if i in self.frames]
        missing = [i for i in requested if i not in self.frames]
        if missing:
            some = ", ".join(map(str, missing[:10])) + ", ..." * (len(missing) > 10)
            message = f"{self.folder / file_layout.FRAMES}: missing: {some}"
            if not available:
                raise RunError(message)
            log.warning("%s: left out, no other frame stands for them", message)
        return available

    @functools.cached_property
    def times(self) -> np.ndarray:
        """Simulated time of every frame, shape (frames,) [s]; NaN for missing frames."""
        return np.array(
            [self.time_and_step(i)[0] if i in self.frames else np.nan for i in range(len(self))]
        )

    def time_and_step(self, i: int) -> tuple[float, int]:
        """Return the simulated time [s] and the step of frame i. Raises RunError."""
        with opened(self.path(i)) as f:
            data = {f"VTKHDF/FieldData/{name}": f[f"VTKHDF/FieldData/{name}"][()]
                    for name in ("time", "step")}  # fmt: skip
            integrity.check_frame(f, i, data)
        time, step = data.values()
        return float(time[0]), int(step[0])

    def particle_count(self, i: int) -> int:
        """Return the number of particles in frame i, without reading them. Raises RunError."""
        with opened(self.path(i)) as f:
            count = f["VTKHDF/NumberOfPoints"][()]
            integrity.check_frame(f, i, {"VTKHDF/NumberOfPoints": count})
        return int(count[0])

    def positions(self, i: int) -> np.ndarray:
        """Return the positions in frame i alone, shape (n, 3) [m]. Raises RunError."""
        with opened(self.path(i)) as f:
            data = {"VTKHDF/Points": f["VTKHDF/Points"][()]}
            integrity.check_frame(f, i, data, self._particles)
        return data["VTKHDF/Points"]

    def frame(self, i: int) -> dict[str, np.ndarray]:
        """Return the arrays of frame i by the names of file_layout.FRAME.

        The arrays id and x are always present, the others as in the file. `poses` (m, 4, 4) is
        present if objects without mass move.
        """
        if not -len(self) <= i < len(self):
            raise RunError(f"{self.folder}: no frame {i}, there are {len(self)}")
        number = i % len(self)
        with opened(self.path(number)) as f:
            names = [f"VTKHDF/PointData/{name}" for name in f["VTKHDF/PointData"]]
            names += ["VTKHDF/Points", "VTKHDF/NumberOfPoints"]
            data = {name: f[name][()] for name in names}
            integrity.check_frame(f, number, data, self._particles)
            count = int(data.pop("VTKHDF/NumberOfPoints")[0])
            arrays = {name.removeprefix("VTKHDF/PointData/"): a for name, a in data.items()}
            arrays = {"id": arrays.pop("id"), "positions": arrays.pop("VTKHDF/Points"), **arrays}
            integrity.check_arrays(arrays, count)
            if "poses" in f:
                arrays["poses"] = integrity.checked_poses(f["poses"][()])
        return arrays

    @functools.cached_property
    def _particles(self) -> int | None:
        """Identity of gaussians.h5, None if unknown; errors are reported when the file is read."""
        try:
            return particle_set_id(self.folder / file_layout.GAUSSIANS)
        except RunError:
            return None

    @functools.cached_property
    def gaussians(self) -> SimpleNamespace:
        """Contents of gaussians.h5, see `read_gaussians`."""
        return read_gaussians(self.folder / file_layout.GAUSSIANS)

    @property
    def objects(self) -> list[dict]:
        """Objects of the scene, a dict each."""
        return self.gaussians.objects

    @property
    def scene(self) -> dict:
        """Scene with all defaults filled in."""
        return self.gaussians.scene


def particle_set_id(path: str | Path) -> int:
    """Return the identity of the particles of a gaussians.h5.

    Its texts are excluded: they describe the scene, which may change partly at a resume. The data
    on the light in the colors are excluded too: they change no particle. Raises RunError.
    """
    with opened(Path(path)) as f:
        checksums = integrity.read_checksums(f)
    excluded = {d.name for d in file_layout.GAUSSIAN_TEXTS}
    excluded |= {f"{group}shade" for group in ("", "scenery/", "passive/")}
    text = json.dumps(sorted(pair for pair in checksums.items() if pair[0] not in excluded))
    return zlib.crc32(text.encode())


def read_gaussians(path: str | Path) -> SimpleNamespace:
    """Return the contents of gaussians.h5. Raises RunError, also if a checksum is wrong.

    The attributes are x0, vol0, object, v0 (None if nothing moves), theta0 (None if nothing is
    compressed), surface0 (None if no solid touches anything), cov0, opacity, sh, shade (None if no
    light is painted on it), scenery (arrays of file_layout.SCENERY or None), passive (arrays of
    file_layout.PASSIVE or None), objects, scene and digest.
    """
    with opened(Path(path)) as f:
        data = {name: f[name][()] for name in ("objects", "scene")}
        result = _arrays(f, "", file_layout.GAUSSIAN, data)
        result.scenery = result.passive = None
        for group, datasets in (("scenery", file_layout.SCENERY), ("passive", file_layout.PASSIVE)):
            if group in f:
                setattr(result, group, _arrays(f, f"{group}/", datasets, data))
        integrity.check_gaussians(f, data)
        result.objects = json.loads(data["objects"])
        result.scene = json.loads(data["scene"])
        result.digest = f.attrs["digest"].decode()
        integrity.check_objects(result)
        return result


def _arrays(f, prefix, datasets, data):
    """Return the datasets by their names, None for an absent one of file_layout.OPTIONAL.

    Those that are present are also added to `data`, by their names in the file.
    """
    names = [d.name for d in datasets if d.name not in file_layout.OPTIONAL or prefix + d.name in f]
    arrays = {name: f[prefix + name][()] for name in names}
    data |= {prefix + name: array for name, array in arrays.items()}
    return SimpleNamespace(**{d.name: arrays.get(d.name) for d in datasets})


def inspect(path: str | Path) -> str:
    """Return a description of any HDF5 file of this program. Raises RunError."""
    path = Path(path)
    if not os.path.exists(path):
        raise RunError(f"{path}: no such file{did_you_mean_file(path)}")
    target = path.resolve()  # a link that a user names stands for its target
    with opened(target, series=True) as f:
        kind = _kind(f)
        _check_name(target, kind)
        lines = [f"{path}: {kind}, {target.stat().st_size / 1e6:.1f} MB"]
        lines += _summary(target, f, kind)
        units = _units(kind)
        lines += [_line(name, f[name], units) for name in hdf5_validation.datasets(f)]
    return "\n".join(lines)


def _kind(f):
    """Return the kind of a file. Raises RunError."""
    if "VTKHDF" in f:
        return "series of frames" if "Steps" in f["VTKHDF"] else "frame"
    if "attrs" in f:
        return "checkpoint"
    if "objects" in f:
        return "gaussians"
    raise RunError(f"{f.filename}: not a file of vgmpi")


def _check_name(path, kind):
    """Check that a file with a reserved name is of its kind."""
    names = {
        "frame": file_layout.frame_number(path.name) is not None,
        "series of frames": path.name == file_layout.SERIES,
        "gaussians": path.name == file_layout.GAUSSIANS,
    }
    for expected, is_so in names.items():
        if is_so and kind != expected:
            raise RunError(f"{path}: damaged: it is a {kind}, not a {expected}")


def _summary(path, f, kind):
    """Return the most important lines."""
    if kind == "frame":
        data, number = f["VTKHDF/FieldData"], file_layout.frame_number(path.name)
        state = _state(lambda: integrity.check_frame(f, number, _all(f)))
        return [f"time {data['time'][0]:.9g} s, step {data['step'][0]}; {state}"]
    if kind == "series of frames":
        times = f["VTKHDF/Steps/Values"][()]
        _check_series(path, f, times)
        return [f"{len(times)} frames, time {times[0]:.9g} .. {times[-1]:.9g} s"]
    if kind == "gaussians":
        objects = json.loads(f["objects"][()])
        lines = [_state(lambda: integrity.check_gaussians(f, _all(f)))]
        return lines + [
            "object {}: {} {}, {} rows from {}".format(
                i, *(o.get(k, "-") for k in ("name", "kind", "row_count", "first_row"))
            )
            + (f", render model {o['render_model']}" if "render_model" in o else "")
            for i, o in enumerate(objects)
        ]
    attrs = json.loads(f["attrs"][()])
    try:
        checkpoint_manifest.check(path)
        state = "agrees with its manifest"
    except checkpoint_manifest.InvalidCheckpoint as broken:
        state = f"NOT VALID: {broken}"
    return [f"time {attrs.get('time')} s, step {attrs.get('step')}; {state}"]


def _all(f):
    """Return every dataset but the checksums."""
    return {name: f[name][()] for name in hdf5_validation.datasets(f) if name != file_layout.CRC}


def _state(check):
    """Return the result of a check of the whole file, as text."""
    try:
        check()
    except hdf5_validation.CorruptFileError as damaged:
        return f"NOT VALID: {damaged}"
    return "agrees with its checksums"


def _check_series(path, f, times):
    """Check that all frames of a series exist: HDF5 reads zeros for a missing one."""
    integrity.check_series(f)
    for number, time in zip(integrity.series_frames(f), times, strict=True):
        frame = path.parent / file_layout.FRAMES / file_layout.FRAME_NAME.format(number)
        with opened(frame) as f:
            if f["VTKHDF/FieldData/time"][0] != time:
                raise RunError(f"{path}: damaged: {frame.name} is not at {time:.9g} s")


def _units(kind):
    """Return the unit of each dataset of a kind of file."""
    tables = {
        "frame": (file_layout.FRAME, file_layout.FRAME_FIELD_DATA),
        "series of frames": (file_layout.FRAME, file_layout.FRAME_FIELD_DATA),
        "gaussians": (file_layout.GAUSSIAN, file_layout.PASSIVE),
        "checkpoint": (file_layout.CHECKPOINT,),
    }
    units = {d.name.split("/")[-1]: d.unit for table in tables[kind] for d in table}
    return {**units, "Points": "m"}


def _line(name, dataset, units):
    """Return the line on one dataset: shape, type, range and unit."""
    text = f"  {name:34} {str(dataset.shape):16} {dataset.dtype!s:8}"
    if dataset.dtype.kind not in "fiu" or dataset.size == 0:
        return text.rstrip()
    low, high = np.inf, -np.inf
    for first in range(0, dataset.shape[0] if dataset.shape else 1, INSPECT_ROWS):
        rows = dataset[first : first + INSPECT_ROWS] if dataset.shape else dataset[()]
        low, high = np.minimum(low, np.min(rows)), np.maximum(high, np.max(rows))  # keep NaN
    unit = units.get(name.split("/")[-1], "")
    return f"{text} {low:.6g} .. {high:.6g} {'' if unit == '1' else unit}".rstrip()
