"""Files of a run with a fault in them: a flipped bit, a forged checkpoint.

A campaign over every kind of file: `write(folder)` makes them, `LOOKS` reads each and `flipped`
says what became of one bit: "named" or "harmless"; anything else fails.
"""

import json
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np

from tests.parallel.files_job import columns, rest_rows, row
from vgmpi.io import checkpoint, checkpoint_manifest, csv_log, file_layout, frames, initial_state
from vgmpi.io.run_reader import RunError, RunReader, inspect, read_gaussians
from vgmpi.parallel.communicator import SerialCommunicator

TOTAL, FRAMES = 50, 3
PROBE = file_layout.PROBE_COLUMNS["velocity"]
SAID = (RunError, checkpoint.CheckpointError)


def write(folder: Path) -> Path:
    """One of every file of a run, small, so that bits of HDF5's own are hit as well."""
    objects = [{"name": "pool", "first_row": 0, "row_count": TOTAL}] * 3
    initial_state.write(
        folder / file_layout.GAUSSIANS,
        SerialCommunicator(),
        rest_rows(TOTAL),
        objects,
        None,
        {"a": 1},
        "abc",
    )
    series, book = (
        frames.Frames(folder, SerialCommunicator(), TOTAL),
        csv_log.ConservationLog(folder, SerialCommunicator()),
    )
    probe = csv_log.CsvLog(folder / "probe_tap.csv", PROBE, SerialCommunicator())
    ids = np.random.default_rng(0).permutation(TOTAL)
    for k in range(FRAMES):
        series.write(k, k / 10, 100 * k, ids, columns(ids))
        book.append([row(100 * k), {**row(100 * k), "phase": 'sand, "wet"'}])
        probe.append([{d.name: 1 / 3 + k for d in PROBE} | {"step": 100 * k}])
    for step in (100, 200):
        x = np.arange(3.0 * TOTAL).reshape(TOTAL, 3) + step
        state = {"id": np.arange(TOTAL), "x": x, "v": -x}
        attrs = {"step": step, "time": step / 1000}
        checkpoint.write(
            folder / file_layout.CHECKPOINTS,
            SerialCommunicator(),
            {"attrs": attrs, "groups": {"group_000": state}},
        )
    return folder


def _frame(path: Path) -> list:
    run, number = RunReader(path.parents[1]), file_layout.frame_number(path.name)
    return [run.times[number], *(a.tobytes() for a in run.frame(number).values())]


def _gaussians(path: Path) -> list:
    found = vars(read_gaussians(path))
    return [a.tobytes() if isinstance(a, np.ndarray) else a for a in found.values()]


def _checkpoint(path: Path) -> list:
    path = path.with_suffix(".h5")
    checkpoint.verify(path)
    with checkpoint.open(path) as saved:
        names = saved.names("group_000")
        return [saved.attrs, *(saved.array(f"group_000/{name}").tobytes() for name in names)]


# of each kind of file: which one, and what reading it gives
LOOKS: dict[str, tuple[str, Callable[[Path], object]]] = {
    "gaussians": (file_layout.GAUSSIANS, _gaussians),
    "frame": ("frames/frame_00001.vtkhdf", _frame),
    "series": (file_layout.SERIES, inspect),
    "checkpoint": ("checkpoints/checkpoint_000000200.h5", _checkpoint),
    "manifest": ("checkpoints/checkpoint_000000200.json", _checkpoint),
    "ledger": (file_layout.LEDGER, csv_log.read_rows),
    "probe": ("probe_tap.csv", lambda path: csv_log.read_rows(path, PROBE)),
}


def flip(path: Path, place: int, bit: int) -> None:
    """Turn over one bit of a file."""
    content = bytearray(path.read_bytes())
    content[place] ^= 1 << bit
    path.write_bytes(content)


def flipped(path: Path, look: Callable[[Path], object], random: np.random.Generator) -> str:
    """Turn over a random bit, read the file, and mend it: "named" where the reader names the file
    in one line, "harmless" where it gives what was written. Raises AssertionError otherwise."""
    before, place = look(path), int(random.integers(path.stat().st_size))
    bit = int(random.integers(8))
    flip(path, place, bit)
    where = f"{path.name}: bit {bit} of byte {place}"
    try:
        after = look(path)
    except SAID as error:
        assert path.stem in str(error) and "\n" not in str(error), f"{where}: {error}"
        return "named"
    finally:
        flip(path, place, bit)
    assert after == before, where
    return "harmless"


def forge(path: Path, change: Callable[[h5py.File], None], attrs: dict | None = None) -> None:
    """Change a checkpoint and write the manifest that goes with it, as one who wants it read."""
    with h5py.File(path, "r+") as f:
        change(f)
        if attrs is not None:
            data = json.dumps(json.loads(f["attrs"][()]) | attrs).encode()
            del f["attrs"]
            f.create_dataset("attrs", (), h5py.string_dtype("utf-8", len(data)), data=data)
    entries = {}
    with h5py.File(path) as f:
        names: list[str] = []
        f.visititems(lambda name, d: names.append(name) if isinstance(d, h5py.Dataset) else None)
        for name in names:
            value, chunks = f[name][()], checkpoint_manifest.chunks_of(f[name].shape)
            if isinstance(value, bytes):
                value, kind = np.frombuffer(value, np.uint8), "text"
                crcs = [checkpoint_manifest.crc(value)]
            else:
                kind = value.dtype.str
                crcs = checkpoint_manifest.combine_checksums(
                    checkpoint_manifest.chunk_checksums(0, np.ascontiguousarray(value)), chunks
                )
            entries[name] = {"shape": f[name].shape, "dtype": kind, "crc": crcs}
    said = json.loads(checkpoint_manifest.path_of(path).read_text())
    said |= {"bytes": path.stat().st_size, "datasets": entries}
    checkpoint_manifest.path_of(path).write_text(json.dumps(said))
