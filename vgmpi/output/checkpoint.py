"""Checkpoints: everything a run needs to go on with the same bits, on any number of ranks. The last
two are kept.

Order of events: the HDF5 file under a temporary name, to the disk, renamed; then the manifest in
the same way; only then are older checkpoints removed. A run killed at any moment leaves the
previous one valid.
"""

import json
import logging
import re
from pathlib import Path

import h5py
import numpy as np

from vgmpi.domain.ranks import Alone
from vgmpi.output import layout, manifest, plain, store

log = logging.getLogger("vgmpi")

KEEP = 2
NAME = re.compile(r"checkpoint_(\d+)\.(?:h5|json)(\.tmp)?")


class CheckpointError(RuntimeError):
    """A checkpoint is not valid; one line that names it."""


def write(folder: str | Path, ranks: Alone, state: dict) -> Path:
    """Write a checkpoint into `folder`; collective; returns its path.

    state: {"attrs": JSON-able dict with "step" and "time" [s], "groups": {group: {dataset: local
    rows}}, "whole": {dataset: array, from rank 0}}. Every rank names the same datasets in the same
    order. Raises StoreError on all ranks alike; the previous checkpoint is then still valid.
    """
    folder = Path(folder)
    attrs = {"schema": layout.SCHEMA, **state["attrs"]}
    path = folder / layout.CHECKPOINT_NAME.format(attrs["step"])
    rows = {
        f"{group}/{name}": np.ascontiguousarray(local)
        for group, members in state.get("groups", {}).items()
        for name, local in members.items()
    }
    whole = {name: np.ascontiguousarray(a) for name, a in state.get("whole", {}).items()}
    _check_names({**rows, **whole})
    text = json.dumps(attrs)
    try:
        with store.create(path, ranks) as f:
            for name, local in rows.items():
                f.rows(name, local)
            for name, array in whole.items():
                f.whole(name, array)
            f.text("attrs", text)
        entries = _entries(rows, whole, text, ranks)
        _finish(path, attrs, entries, ranks)
    except store.StoreError as error:
        older = sorted((s for s in _found(folder, ".json") if s != attrs["step"]), reverse=True)
        rest = "there is no earlier checkpoint"
        if older:
            rest = f"{layout.CHECKPOINT_NAME.format(older[0])} is still valid"
        raise store.StoreError(f"{error}; {rest}") from error
    return path


def _check_names(arrays):
    known = layout.named(layout.CHECKPOINT)
    for name, array in arrays.items():
        member = "*/" + name.partition("/")[2]
        if member not in known or not layout.fits(known[member], array):
            raise ValueError(f"{name} {array.dtype} {array.shape} is not in layout.CHECKPOINT")


def _entries(rows, whole, text, ranks):
    """The manifest's entry of every dataset, on rank 0; from memory, not from the file it must
    vouch for."""
    entries = {}
    for name, local in rows.items():
        start, total = ranks.before(len(local)), ranks.total(len(local))
        mine = np.array(manifest.pieces(start, local), np.int64).reshape(-1, 3)
        parts = ranks.root_rows(mine)
        if ranks.rank == 0:
            shape = (total, *local.shape[1:])
            crcs = manifest.join(parts.tolist(), manifest.chunks_of(shape))
            entries[name] = {"shape": shape, "dtype": local.dtype.str, "crc": crcs}
    for name, array in whole.items():
        if array.ndim:
            crcs = manifest.join(manifest.pieces(0, array), manifest.chunks_of(array.shape))
        else:
            crcs = [manifest.crc(array)]
        entries[name] = {"shape": array.shape, "dtype": array.dtype.str, "crc": crcs}
    data = np.frombuffer(text.encode(), np.uint8)
    entries["attrs"] = {"shape": (), "dtype": "text", "crc": [manifest.crc(data)]}
    return entries


def _finish(path, attrs, entries, ranks):
    """Rank 0 writes the manifest, then removes what is no longer needed."""
    error = None
    if ranks.rank == 0:
        whole = {
            "schema": layout.SCHEMA,
            "step": attrs["step"],
            "time": attrs.get("time"),
            "bytes": path.stat().st_size,
            "datasets": entries,
        }
        try:
            store.replace_text(manifest.path_of(path), json.dumps(whole))
            _remove_old(path.parent, attrs["step"])
        except OSError as caught:
            error = caught
    store.agree(ranks, error, manifest.path_of(path))


def _remove_old(folder, step):
    """Keep this checkpoint and the one before it; later ones belong to a future that was given
    up."""
    complete = sorted(s for s in _found(folder, ".json") if s <= step)
    keep = complete[-KEEP:]
    for other in _found(folder):
        if other not in keep:
            _remove(folder, other)
    store.remove_temporaries(folder)


def _remove(folder, step):
    path = folder / layout.CHECKPOINT_NAME.format(step)
    manifest.path_of(path).unlink(
        missing_ok=True
    )  # first: without it the rest counts as unfinished
    path.unlink(missing_ok=True)


def _found(folder, ending=""):
    """Steps of which there is any file (with that ending) in the folder."""
    if not folder.is_dir():
        return set()
    matches = [NAME.fullmatch(p.name) for p in folder.iterdir() if p.name.endswith(ending)]
    return {int(m[1]) for m in matches if m}


def clear(folder: str | Path, ranks: Alone) -> None:
    """Remove all checkpoints, at the start of a run that does not resume; collective."""
    folder = Path(folder)
    error = None
    if ranks.rank == 0:
        try:
            for step in _found(folder):
                _remove(folder, step)
            store.remove_temporaries(folder)
        except OSError as caught:
            error = caught
    store.agree(ranks, error, folder, "clear")


def latest(folder: str | Path, ranks: Alone | None = None) -> Path | None:
    """The newest valid checkpoint, or None; collective.

    Warns in one line of the newer ones it passed over.
    """
    folder, ranks = Path(folder), ranks or Alone()
    passed = []
    for step in ranks.bcast(sorted(_found(folder), reverse=True)):
        path = folder / layout.CHECKPOINT_NAME.format(step)
        problem = _problem(path, ranks)
        if problem is None:
            break
        passed.append(f"{path.name} ({problem})")
    else:
        path = None
    if passed and ranks.rank == 0:
        taken = f"resuming from {path.name}" if path else "no valid checkpoint is left"
        log.warning("passed over %s: %s", "; ".join(passed), taken)
    return path


def chosen(asked: str, folder: Path, ranks: Alone) -> Path:
    """The checkpoint `asked` for, or with "" the newest valid one in `folder`; collective. Raises
    CheckpointError on all ranks."""
    if asked:
        verify(asked, ranks)
        return Path(asked)
    found = latest(folder, ranks)
    if found is None:
        raise CheckpointError(f"--resume: no valid checkpoint in {folder}")
    return found


def verify(path: str | Path, ranks: Alone | None = None) -> None:
    """Compare a checkpoint with its manifest; collective. Raises CheckpointError on all ranks."""
    problem = _problem(Path(path), ranks or Alone())
    if problem is not None:
        raise CheckpointError(f"{path}: not a valid checkpoint: {problem}")


def _problem(path, ranks):
    """Why a checkpoint is not valid, or None; each rank reads its share."""
    text = ""
    try:
        manifest.check(path, ranks.rank, ranks.size)
    except manifest.Broken as broken:
        text = str(broken)
    return first_of(ranks, text) or None


def first_of(ranks: Alone, text: str) -> str:
    """The line of the lowest rank that has one to say, "" if none has. Collective."""
    mine = f"{text}\n".encode() if text else b""
    every = bytes(ranks.all_rows(np.frombuffer(mine, np.uint8))).decode()
    return every.splitlines()[0] if every else ""


class Checkpoint:
    """A checkpoint to read from; every rank opens its own."""

    def __init__(self, path: str | Path):
        self.path = Path(path)
        try:
            self.file = h5py.File(self.path, "r")
            plain.check(self.file)
            self.attrs: dict = json.loads(self.file["attrs"][()])
            if not isinstance(self.attrs, dict):
                raise ValueError("attrs is no table")
        except (OSError, LookupError, ValueError, TypeError, RuntimeError) as error:
            raise CheckpointError(f"{path}: not a checkpoint: {store.reason(error)}") from None

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.file.close()

    def names(self, group: str) -> list[str]:
        """Datasets of a group."""
        return sorted(self.file[group])

    def count(self, name: str) -> int:
        """Rows of a dataset ("particles/x")."""
        return int(self.file[name].shape[0])

    def width(self, name: str) -> int:
        """Numbers in a row of a dataset."""
        return int(np.prod(self.file[name].shape[1:]))

    def form(self, name: str) -> tuple[tuple[int, ...], np.dtype]:
        """Shape and type of a dataset."""
        return self.file[name].shape, self.file[name].dtype

    def read_rows(self, name: str, start: int, stop: int) -> np.ndarray:
        """Rows start .. stop - 1 of a dataset."""
        return self.file[name][start:stop]

    def whole(self, name: str) -> np.ndarray:
        return self.file[name][()]


def open(path: str | Path) -> Checkpoint:
    """Open without verifying; `latest` and `verify` do that."""
    return Checkpoint(path)
