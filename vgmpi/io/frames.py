"""Frames: VTKHDF PolyData in one part, rows in ascending particle id, and series.vtkhdf over all.

Ranks hold particles in the order of the grid; a file holds them in the order of their ids, so that
its bytes do not depend on the number of ranks. Each rank receives one range of ids, sorts it, and
writes it as one contiguous piece.
"""

import logging
from pathlib import Path
from typing import NamedTuple

import h5py
import numpy as np

from vgmpi.parallel.communicator import SerialCommunicator

from . import file_layout, hdf5_writer, integrity, run_reader

log = logging.getLogger("vgmpi")

FIELDS = file_layout.named(file_layout.FRAME)
EMPTY_KINDS = ("Lines", "Polygons", "Strips")


class _Written(NamedTuple):
    """Data of a written frame that the series needs."""

    file: str
    time: float  # [s]
    step: int
    rows: int  # particles
    arrays: dict  # name -> (shape of a row, dtype) of /VTKHDF/PointData
    index_dtype: str


class Frames:
    """Writer of the frames of one run."""

    def __init__(
        self, folder: str | Path, ranks: SerialCommunicator, total_ids: int, first: int = 0,
        particles: int | None = None, compresses: bool = False,
    ):  # fmt: skip
        """Prepare the folder. Collective.

        Args:
            folder: Output folder of the run.
            ranks: Communicator.
            total_ids: Number of particle ids.
            first: Frames from this number on are removed.
            particles: Identity of the run's gaussians.h5 (particle_set_id), None without.
            compresses: Whether frames are compressed.
        """
        self.particles, self.compresses = particles, compresses
        self.folder, self.ranks, self.total_ids = Path(folder), ranks, total_ids
        self.index_dtype = "i4" if total_ids < 2**31 - 1 else "i8"
        self._written: dict[int, _Written] = {}
        self._removed: list[str] = []  # files of this run that have gone
        error = None
        if ranks.rank == 0:
            try:
                self._start(first)
            except OSError as caught:
                error = caught
        hdf5_writer.raise_on_all_ranks(ranks, error, self.folder / file_layout.FRAMES)

    def _start(self, first):
        """Remove old frames and collect those that remain, on rank 0."""
        frames = self.folder / file_layout.FRAMES
        frames.mkdir(parents=True, exist_ok=True)
        hdf5_writer.remove_temporaries(frames)
        for path in sorted(frames.glob("frame_*.vtkhdf")):
            number = file_layout.frame_number(path.name)
            if number is None:
                continue
            if number >= first:
                path.unlink()
                continue
            try:
                self._written[number] = _read_written(path, number)
            except run_reader.RunError as error:
                log.warning("%s; it is left out of the series", error)
        for number in sorted(set(range(first)) - set(self._written)):
            path = frames / file_layout.FRAME_NAME.format(number)
            if not path.exists():
                log.warning("%s: missing; it is left out of the series", path)
        if self._written:
            self._write_series()
        else:
            (self.folder / file_layout.SERIES).unlink(missing_ok=True)

    def write(
        self, index: int, time: float, step: int, ids: np.ndarray, fields: dict[str, np.ndarray],
        poses: np.ndarray | None = None,
    ) -> Path:  # fmt: skip
        """Write one frame and the series. Collective. Raises StoreError on all ranks.

        Args:
            index: Number of the frame.
            time: Simulated time [s].
            step: Number of the step.
            ids: Particle ids of this rank, shape (n_local,).
            fields: Rows in the order of `ids`: "positions", and others of file_layout.FRAME.
            poses: Poses of moving objects without mass, shape (m, 4, 4), equal on all ranks.
        """
        path = self.folder / file_layout.FRAMES / file_layout.FRAME_NAME.format(index)
        names = [d.name for d in file_layout.FRAME if d.name in fields]
        if "positions" not in fields or set(fields) - set(names):
            raise ValueError(
                f"a frame has positions and fields of file_layout.FRAME, not {sorted(fields)}"
            )
        redistribute = _Redistribution(ids, self.total_ids, self.ranks)
        with hdf5_writer.create(path, self.ranks, self.compresses) as f:
            f.attr("", "schema", file_layout.SCHEMA)
            f.attr("VTKHDF", "Version", np.array([2, 0], np.int64))
            f.attr("VTKHDF", "Type", "PolyData")
            f.rows("VTKHDF/PointData/id", redistribute.ids)
            arrays = {"id": ((), "i8")}
            for name in names:
                field = FIELDS[name]
                rows = redistribute(np.asarray(fields[name]).astype(field.dtype, copy=False))
                if not file_layout.fits(field, rows):
                    raise ValueError(
                        f"frame field {name}: rows are {field.shape}, not {rows.shape}"
                    )
                f.rows("VTKHDF/Points" if name == "positions" else f"VTKHDF/PointData/{name}", rows)
                if name != "positions":
                    arrays[name] = (rows.shape[1:], field.dtype)
            count = self._topology(f, len(redistribute.ids))
            f.root_array("VTKHDF/FieldData/time", np.array([time], np.float64))
            f.root_array("VTKHDF/FieldData/step", np.array([step], np.int64))
            f.root_array("frame", np.array(index, np.int64))
            if self.particles is not None:
                f.root_array("gaussians_crc", np.array(self.particles, np.uint32))
            if poses is not None:
                f.root_array("poses", poses)
            f.seal()
        self._written[index] = _Written(path.name, time, step, count, arrays, self.index_dtype)
        error = None
        if self.ranks.rank == 0:
            try:
                self._leave_out_removed()
                self._write_series()
            except (OSError, RuntimeError) as caught:
                error = caught
        hdf5_writer.raise_on_all_ranks(self.ranks, error, self.folder / file_layout.SERIES)
        return path

    def check_written(self) -> None:
        """Raise StoreError on all ranks if frames have gone that were written. Collective."""
        error = None
        if self.ranks.rank == 0:
            self._leave_out_removed()
            if names := self._removed:
                listed = ", ".join(names[:3]) + (", ..." if len(names) > 3 else "")
                count = "a frame was" if len(names) == 1 else f"{len(names):,} frames were"
                error = OSError(f"{count} removed during the run: {listed}")
        folder = self.folder / file_layout.FRAMES
        hdf5_writer.raise_on_all_ranks(self.ranks, error, folder, "find all of")

    def _leave_out_removed(self):
        """Leave frames whose files have gone out of the series, with a warning; on rank 0."""
        folder = self.folder / file_layout.FRAMES
        present = {path.name for path in folder.iterdir()} if folder.is_dir() else set()
        for number in [n for n, w in self._written.items() if w.file not in present]:
            file = self._written.pop(number).file
            self._removed.append(file)
            log.warning("%s: removed during the run; it is left out of the series", folder / file)

    def _topology(self, f, count):
        """Write a vertex per particle and return the particles of all ranks.

        VTK requires the three other kinds of cells too.
        """
        first, total = self.ranks.before(count), self.ranks.total(count)
        last = self.ranks.rank == self.ranks.size - 1
        for name in (
            "NumberOfPoints",
            "Vertices/NumberOfCells",
            "Vertices/NumberOfConnectivityIds",
        ):
            f.root_array(f"VTKHDF/{name}", np.array([total], np.int64))
        numbers = np.arange(first, first + count + last, dtype=self.index_dtype)
        f.rows("VTKHDF/Vertices/Connectivity", numbers[:count])
        f.rows("VTKHDF/Vertices/Offsets", numbers)  # n + 1 entries: the last rank has one more
        for kind in EMPTY_KINDS:
            for name, values in _empty_cells(1).items():
                f.root_array(f"VTKHDF/{kind}/{name}", values)
        return total

    def _write_series(self):
        """Write all frames as virtual datasets with paths relative to the series; on one rank."""
        numbers = sorted(self._written)
        frames = [self._written[i] for i in numbers]
        counts = [w.rows for w in frames]
        with hdf5_writer.create(self.folder / file_layout.SERIES, SerialCommunicator()) as s:
            s.attr("", "schema", file_layout.SCHEMA)
            s.attr("VTKHDF", "Version", np.array([2, 0], np.int64))
            s.attr("VTKHDF", "Type", "PolyData")
            _virtual(s, "Points", frames, counts, (3,), "f4")
            shared = set.intersection(*(set(w.arrays) for w in frames))
            arrays = {n: a for n, a in frames[0].arrays.items() if n in shared}
            for name, (shape, dtype) in arrays.items():
                _virtual(s, f"PointData/{name}", frames, counts, shape, dtype)
            ones = [1] * len(frames)
            _virtual(s, "FieldData/time", frames, ones, (), "f8")
            _virtual(s, "FieldData/step", frames, ones, (), "i8")
            index = max(w.index_dtype for w in frames)
            _virtual(s, "Vertices/Connectivity", frames, counts, (), index)
            _virtual(s, "Vertices/Offsets", frames, [c + 1 for c in counts], (), index)
            for name in (
                "NumberOfPoints",
                "Vertices/NumberOfCells",
                "Vertices/NumberOfConnectivityIds",
            ):
                s.root_array(f"VTKHDF/{name}", np.array(counts, np.int64))
            for kind in EMPTY_KINDS:
                for name, values in _empty_cells(len(frames)).items():
                    s.root_array(f"VTKHDF/{kind}/{name}", values)
            _steps(s, frames, counts, arrays)
            s.root_array("frames", np.array(numbers, np.int64))
            s.seal()


def _empty_cells(parts):
    """Return the datasets of a kind of cells that no part has."""
    zero = np.zeros(parts, np.int64)
    return {
        "NumberOfCells": zero,
        "NumberOfConnectivityIds": zero,
        "Connectivity": np.zeros(0, np.int64),
        "Offsets": zero,
    }


def _steps(s, frames, counts, arrays):
    """Write the group that makes a time series of the parts."""
    n = len(frames)
    first = np.cumsum([0, *counts[:-1]]).astype(np.int64)
    cells = np.zeros((n, 4), np.int64)  # columns: Vertices, Lines, Polygons, Strips
    cells[:, 0] = first
    s.attr("VTKHDF/Steps", "NSteps", np.int64(n))
    steps = {
        "Values": np.array([w.time for w in frames]),
        "PartOffsets": np.arange(n, dtype=np.int64),
        "NumberOfParts": np.ones(n, np.int64),
        "PointOffsets": first,
        # VTK adds the part's number, because Offsets has n + 1 entries per part.
        "CellOffsets": cells,
        "ConnectivityIdOffsets": cells,
    }
    steps |= {f"PointDataOffsets/{name}": first for name in arrays}
    for name in ("time", "step"):
        steps[f"FieldDataOffsets/{name}"] = np.arange(n, dtype=np.int64)
        steps[f"FieldDataSizes/{name}"] = np.ones((n, 2), np.int64)
    for name, values in steps.items():
        s.root_array(f"VTKHDF/Steps/{name}", values)


def _virtual(s, name, frames, counts, shape, dtype):
    """Create a dataset that concatenates the frames' datasets of that name.

    Where the file of a frame is missing, as in a copy of the series alone, its rows are nan or -1
    and not values that look right. Vertices then name point 0, since -1 would be read as an index.
    """
    properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    properties.set_layout(h5py.h5d.VIRTUAL)
    # the low-level interface of HDF5: thousands of selections take many times as long by objects
    space, origin = h5py.h5s.create_simple((sum(counts), *shape)), (0,) * len(shape)
    spaces = {count: h5py.h5s.create_simple((count, *shape)) for count in set(counts) - {0}}
    dataset, start = f"/VTKHDF/{name}".encode(), 0
    for w, count in zip(frames, counts):
        if count:
            space.select_hyperslab((start, *origin), (count, *shape))
            file = f"{file_layout.FRAMES}/{w.file}".encode()
            properties.set_virtual(space, file, dataset, spaces[count])
        start += count
    kind = np.dtype(dtype).kind
    missing = np.nan if kind == "f" else 0 if name.startswith("Vertices/") else -1
    properties.set_fill_value(np.array([missing]))
    space.select_all()
    s.dataset(f"VTKHDF/{name}", np.dtype(dtype), space, properties)


def _read_written(path: Path, number: int) -> _Written:
    """Return the data of an earlier frame that the series needs. Raises RunError."""
    with run_reader.opened(path) as f:
        root = f["VTKHDF"]
        names = ("FieldData/time", "FieldData/step", "NumberOfPoints")
        integrity.check_frame(f, number, {f"VTKHDF/{name}": root[name][()] for name in names})
        arrays = {k: (d.shape[1:], d.dtype.str[1:]) for k, d in root["PointData"].items()}
        arrays = {n: arrays[n] for n in ("id", *FIELDS) if n in arrays}  # in the order of writing
        return _Written(
            path.name,
            float(root["FieldData/time"][0]),
            int(root["FieldData/step"][0]),
            int(root["NumberOfPoints"][0]),
            arrays,
            root["Vertices/Connectivity"].dtype.str[1:],
        )


class _Redistribution:
    """Redistribution of rows to the rank that writes their id.

    Rank r has the ids from total * r / size to total * (r + 1) / size.
    """

    def __init__(self, ids, total, ranks):
        ids = np.asarray(ids, np.int64)
        if len(ids) and (ids.min() < 0 or ids.max() >= total):
            raise ValueError(f"particle ids must lie in 0 .. {total - 1}")
        self.ranks = ranks
        self.order = np.argsort(ids, kind="stable")
        bounds = [total * r // ranks.size for r in range(1, ranks.size)]
        self.cuts = np.searchsorted(ids[self.order], bounds)
        self.sort, self.ids = None, self._exchange(ids)
        if np.any(np.diff(self.ids) <= 0):  # of several ranks
            self.sort = np.argsort(self.ids, kind="stable")
            self.ids = self.ids[self.sort]
        if np.any(np.diff(self.ids) == 0):
            raise ValueError("a particle id is there twice")

    def _exchange(self, rows):
        """Return the rows that the other ranks send to this one."""
        sorted_rows = np.take(rows, self.order, axis=0)
        received = self.ranks.exchange(np.split(sorted_rows, self.cuts))
        return received[0] if len(received) == 1 else np.concatenate(received)

    def __call__(self, rows):
        """Return this rank's rows of the file, in the order of ids."""
        if len(rows) != len(self.order):
            raise ValueError(f"{len(rows)} rows for {len(self.order)} ids")
        received = self._exchange(rows)
        return received if self.sort is None else np.take(received, self.sort, axis=0)
