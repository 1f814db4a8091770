"""Compressed frames: the same numbers, the same bytes on any ranks, and no more than is there."""

import re

import h5py
import numpy as np
import pytest

import vgmpi
from tests.parallel.files_job import columns
from tests.support.file_digests import files
from tests.support.simulated_ranks import run
from tests.support.small_scenes import write
from vgmpi.io import file_layout, frames, hdf5_validation, hdf5_writer
from vgmpi.io.run_reader import RunError, RunReader
from vgmpi.parallel.communicator import SerialCommunicator

COUNT = 5000
SCENE = """
[domain]
size = [0.2, 0.2, 0.2]
cell = "1 cm"
[time]
end = "20 ms"
frames = 3
[output]
compression = "{}"
[material.water]
kind = "fluid"
max_speed = "2 m/s"
[[object]]
name = "drop"
material = "water"
shape = {{ sphere = {{ center = [0.1, 0.1, 0.1], radius = "6 cm" }} }}
"""


def test_bytes_are_those_of_one_rank(tmp_path):
    def job(ranks):
        ids = np.arange(COUNT)[ranks.rank :: ranks.size][::-1]
        series = frames.Frames(tmp_path / str(ranks.size), ranks, COUNT, compresses=True)
        series.write(0, 0.0, 0, ids, columns(ids))

    for size in (1, 3):
        run(size, job)
    assert files(tmp_path / "1") == files(tmp_path / "3")


def test_a_run_has_smaller_frames_of_the_same_numbers(tmp_path):
    sizes, data = {}, {}
    for kind in ("none", "gzip"):
        folder = tmp_path / kind
        folder.mkdir()
        vgmpi.run(vgmpi.load(write(folder, SCENE.format(kind))), folder / "out")
        known = RunReader(folder / "out")
        data[kind] = [known.frame(k) for k in range(len(known))]
        sizes[kind] = sum(p.stat().st_size for p in (folder / "out" / "frames").iterdir())
    assert sizes["gzip"] < 0.75 * sizes["none"]
    for plain, packed in zip(data["none"], data["gzip"], strict=True):
        assert plain.keys() == packed.keys()
        assert all(np.array_equal(plain[name], packed[name]) for name in plain)


@pytest.mark.parametrize(
    "options, says",
    [
        ({"compression": "gzip", "shuffle": True}, "claims more bytes"),
        ({"compression": "lzf", "shuffle": True}, "not stored as this program does it"),
        ({"compression": "gzip"}, "not stored as this program does it"),
        ({"compression": "gzip", "shuffle": True, "fletcher32": True}, "not stored as"),
        ({"compression": "gzip", "shuffle": True, "maxshape": (None, 3)}, "not stored as"),
    ],
)
def test_a_frame_that_claims_more_than_its_bytes_explain_is_refused(tmp_path, options, says):
    """Chunks that were never written take no bytes and read as zeros, as many as a header says."""
    frames.Frames(tmp_path, SerialCommunicator(), 100, compresses=True).write(
        0, 0.0, 0, np.arange(100), columns(np.arange(100))
    )
    path = tmp_path / file_layout.FRAMES / file_layout.FRAME_NAME.format(0)
    with h5py.File(path, "r+") as f:
        del f["VTKHDF/Points"]
        f.create_dataset("VTKHDF/Points", (10**5, 3), "f4", chunks=(1000, 3), **options)
    with h5py.File(path) as f, pytest.raises(hdf5_validation.CorruptFileError, match=says):
        hdf5_validation.check_structure(f)
    with pytest.raises(RunError, match=re.escape(str(path))):
        frames.run_reader.opened(path).__enter__()


def test_a_chunk_is_bounded(tmp_path, monkeypatch):
    monkeypatch.setattr(hdf5_validation, "MAX_CHUNK_BYTES", 1000)
    with hdf5_writer.create(tmp_path / "a.h5", SerialCommunicator(), compresses=True) as f:
        f.rows("x", np.zeros((100, 3)))
    with h5py.File(tmp_path / "a.h5") as f, pytest.raises(hdf5_validation.CorruptFileError):
        hdf5_validation.check_structure(f)
