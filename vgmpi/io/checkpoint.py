"""Checkpoints: everything a run needs to continue with the same bits, on any number of ranks.

The last two are retained. The order of events is: the HDF5 file is written under a temporary name,
flushed to the disk and renamed; then the manifest in the same way; only then are older checkpoints
removed. A run that is killed at any moment leaves the previous checkpoint valid.
"""

import json
import logging
import re
from pathlib import Path

import h5py
import numpy as np

from vgmpi.parallel.communicator import SerialCommunicator

from . import checkpoint_manifest, file_layout, hdf5_validation, hdf5_writer

log = logging.getLogger("vgmpi")

RETAINED_CHECKPOINTS = 2  # number of checkpoints that are retained
NAME = re.compile(r"checkpoint_(\d+)\.(?:h5|json)(\.tmp)?")


class CheckpointError(RuntimeError):
    """A checkpoint is not valid; its text is one line that names the file."""


class Mismatch(CheckpointError):
    """Error of a checkpoint that does not belong to a scene."""


def is_number(value: object) -> bool:
    """Return whether a value of a file is a number and no boolean."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def is_count(value: object, upper: int = 1 << 62) -> bool:
    """Return whether a value of a file is an integer in the half-open range from 0 to `upper`."""
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < upper


def write(folder: str | Path, ranks: SerialCommunicator, state: dict) -> Path:
    """Write a checkpoint into `folder` and return its path. Collective.

    Every rank names the same datasets in the same order.

    Args:
        folder: Folder of the checkpoints.
        ranks: Communicator.
        state: {"attrs": JSON-able dict with "step" and "time" [s], "groups": {group: {dataset:
            local rows}}, "whole": {dataset: array, from rank 0}}.

    Raises:
        StoreError: Writing failed, on all ranks; the previous checkpoint is still valid.
    """
    folder = Path(folder)
    attrs = {"schema": file_layout.SCHEMA, **state["attrs"]}
    path = folder / file_layout.CHECKPOINT_NAME.format(attrs["step"])
    rows = {
        f"{group}/{name}": np.ascontiguousarray(local)
        for group, members in state.get("groups", {}).items()
        for name, local in members.items()
    }
    root_arrays = {name: np.ascontiguousarray(a) for name, a in state.get("whole", {}).items()}
    _check_names({**rows, **root_arrays})
    text = json.dumps(attrs)
    try:
        with hdf5_writer.create(path, ranks) as f:
            for name, local in rows.items():
                f.rows(name, local)
            for name, array in root_arrays.items():
                f.root_array(name, array)
            f.text("attrs", text)
        entries = _manifest_entries(rows, root_arrays, text, ranks)
        _finish(path, attrs, entries, ranks)
    except hdf5_writer.StoreError as error:
        older = sorted((s for s in _steps_in(folder, ".json") if s != attrs["step"]), reverse=True)
        remedy = "there is no earlier checkpoint"
        if older:
            remedy = f"{file_layout.CHECKPOINT_NAME.format(older[0])} is still valid"
        raise hdf5_writer.StoreError(f"{error}; {remedy}") from error
    return path


def _check_names(arrays):
    """Check that the datasets and their shapes are in the layout."""
    datasets = file_layout.named(file_layout.CHECKPOINT)
    for name, array in arrays.items():
        member = "*/" + name.partition("/")[2]
        if member not in datasets or not file_layout.fits(datasets[member], array):
            raise ValueError(f"{name} {array.dtype} {array.shape} is not in layout.CHECKPOINT")


def _manifest_entries(rows, root_arrays, text, ranks):
    """Return the manifest's entry of every dataset, on rank 0.

    They are computed from memory, not from the file that they must verify.
    """
    entries = {}
    for name, local in rows.items():
        start, total = ranks.before(len(local)), ranks.total(len(local))
        mine = np.array(checkpoint_manifest.chunk_checksums(start, local), np.int64).reshape(-1, 3)
        chunks = ranks.gather_rows(mine)
        if ranks.rank == 0:
            shape = (total, *local.shape[1:])
            crcs = checkpoint_manifest.combine_checksums(
                chunks.tolist(), checkpoint_manifest.chunks_of(shape)
            )
            entries[name] = {"shape": shape, "dtype": local.dtype.str, "crc": crcs}
    for name, array in root_arrays.items():
        if array.ndim:
            crcs = checkpoint_manifest.combine_checksums(
                checkpoint_manifest.chunk_checksums(0, array),
                checkpoint_manifest.chunks_of(array.shape),
            )
        else:
            crcs = [checkpoint_manifest.crc(array)]
        entries[name] = {"shape": array.shape, "dtype": array.dtype.str, "crc": crcs}
    data = np.frombuffer(text.encode(), np.uint8)
    entries["attrs"] = {"shape": (), "dtype": "text", "crc": [checkpoint_manifest.crc(data)]}
    return entries


def _finish(path, attrs, entries, ranks):
    """Write the manifest on rank 0, then remove older checkpoints."""
    error = None
    if ranks.rank == 0:
        content = {
            "schema": file_layout.SCHEMA,
            "step": attrs["step"],
            "time": attrs.get("time"),
            "bytes": path.stat().st_size,
            "datasets": entries,
        }
        try:
            hdf5_writer.replace_text(checkpoint_manifest.path_of(path), json.dumps(content))
            _remove_old(path.parent, attrs["step"])
        except OSError as caught:
            error = caught
    hdf5_writer.raise_on_all_ranks(ranks, error, checkpoint_manifest.path_of(path))


def _remove_old(folder, step):
    """Remove all checkpoints but this one and the one before it.

    Later ones belong to an abandoned continuation.
    """
    complete = sorted(s for s in _steps_in(folder, ".json") if s <= step)
    retained = complete[-RETAINED_CHECKPOINTS:]
    for old in _steps_in(folder):
        if old not in retained:
            _remove(folder, old)
    hdf5_writer.remove_temporaries(folder)


def _remove(folder, step):
    """Remove the files of one checkpoint."""
    path = folder / file_layout.CHECKPOINT_NAME.format(step)
    # The manifest is first: without it the remaining file counts as unfinished.
    checkpoint_manifest.path_of(path).unlink(missing_ok=True)
    path.unlink(missing_ok=True)


def _steps_in(folder, ending=""):
    """Return the steps with any file, or any with this ending, in the folder."""
    if not folder.is_dir():
        return set()
    matches = [NAME.fullmatch(p.name) for p in folder.iterdir() if p.name.endswith(ending)]
    return {int(m[1]) for m in matches if m}


def clear(folder: str | Path, ranks: SerialCommunicator) -> None:
    """Remove all checkpoints, at the start of a run that does not resume. Collective."""
    folder = Path(folder)
    error = None
    if ranks.rank == 0:
        try:
            for step in _steps_in(folder):
                _remove(folder, step)
            hdf5_writer.remove_temporaries(folder)
        except OSError as caught:
            error = caught
    hdf5_writer.raise_on_all_ranks(ranks, error, folder, "clear")


def latest_valid(folder: str | Path, ranks: SerialCommunicator | None = None) -> Path:
    """Return the newest valid checkpoint. Collective.

    It logs a one-line warning on newer ones that are not valid. Raises CheckpointError on all ranks
    if none is.
    """
    ranks = ranks or SerialCommunicator()
    invalid: list[str] = []
    for step in ranks.bcast(sorted(_steps_in(Path(folder)), reverse=True)):
        path = Path(folder) / file_layout.CHECKPOINT_NAME.format(step)
        problem = _problem(path, ranks)
        if problem is None:
            if invalid and ranks.rank == 0:
                log.warning("passed over %s: resuming from %s", "; ".join(invalid), path.name)
            return path
        invalid.append(f"{path.name} ({problem})")
    reason = f": {'; '.join(invalid)}" if invalid else ""
    raise CheckpointError(f"--resume: no valid checkpoint in {folder}{reason}")


def select(requested: str, folder: Path, ranks: SerialCommunicator) -> Path:
    """Return the requested checkpoint, by default the newest valid one in `folder`. Collective.

    Raises CheckpointError on all ranks.
    """
    if requested:
        verify(requested, ranks)
        return Path(requested)
    return latest_valid(folder, ranks)


def verify(path: str | Path, ranks: SerialCommunicator | None = None) -> None:
    """Compare a checkpoint with its manifest. Collective. Raises CheckpointError on all ranks."""
    problem = _problem(Path(path), ranks or SerialCommunicator())
    if problem is not None:
        raise CheckpointError(f"{path}: not a valid checkpoint: {problem}")


def _problem(path, ranks):
    """Return the reason why a checkpoint is not valid, or None; each rank reads its part."""
    text = ""
    try:
        checkpoint_manifest.check(path, ranks.rank, ranks.size)
    except checkpoint_manifest.InvalidCheckpoint as broken:
        text = str(broken)
    return lowest_rank_message(ranks, text) or None


def lowest_rank_message(ranks: SerialCommunicator, text: str) -> str:
    """Return the message of the lowest rank that has one, "" if none has. Collective."""
    mine = f"{text}\n".encode() if text else b""
    lines = bytes(ranks.all_rows(np.frombuffer(mine, np.uint8))).decode()
    return lines.splitlines()[0] if lines else ""


class Checkpoint:
    """Open checkpoint for reading; every rank opens its own."""

    def __init__(self, path: str | Path):
        self.path = Path(path)
        try:
            self.file = h5py.File(self.path, "r")
            hdf5_validation.check_structure(self.file)
            self.attrs: dict = json.loads(self.file["attrs"][()])
            if not isinstance(self.attrs, dict):
                raise ValueError("attrs is no table")
        except (OSError, LookupError, ValueError, TypeError, RuntimeError) as error:
            raise CheckpointError(
                f"{path}: not a checkpoint: {hdf5_writer.reason(error)}"
            ) from None

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.file.close()

    def names(self, group: str) -> list[str]:
        """Return the names of the datasets of a group."""
        return sorted(self.file[group])

    def count(self, name: str) -> int:
        """Return the number of rows of a dataset ("particles/x")."""
        return int(self.file[name].shape[0])

    def width(self, name: str) -> int:
        """Return the numbers per row of a dataset."""
        return int(np.prod(self.file[name].shape[1:]))

    def form(self, name: str) -> tuple[tuple[int, ...], np.dtype]:
        """Return shape and type of a dataset."""
        return self.file[name].shape, self.file[name].dtype

    def read_rows(self, name: str, start: int, stop: int) -> np.ndarray:
        """Return consecutive rows of a dataset.

        Args:
            name: Name of the dataset.
            start: First row.
            stop: Row after the last one.
        """
        return self.file[name][start:stop]

    def array(self, name: str) -> np.ndarray:
        """Return a complete dataset."""
        return self.file[name][()]


def open(path: str | Path) -> Checkpoint:
    """Open a checkpoint without verification; see `latest_valid` and `verify`."""
    return Checkpoint(path)
