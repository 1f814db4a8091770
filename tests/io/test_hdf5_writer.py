"""The writer of HDF5 files and the checksums."""

import zlib

import h5py
import numpy as np
import pytest

from tests.support.simulated_ranks import run
from vgmpi.io import checkpoint_manifest, hdf5_writer
from vgmpi.parallel.communicator import SerialCommunicator


def test_everything_that_can_be_written(tmp_path):
    text = "höhe " * 30_000
    with hdf5_writer.create(tmp_path / "new" / "a.h5", SerialCommunicator()) as f:
        f.rows("group/x", np.arange(6.0).reshape(3, 2))
        f.rows("group/none", np.zeros((0, 3), np.float32))
        f.root_array("numbers", np.arange(4))
        f.text("long", text)
        f.text("empty", "")
        f.attr("", "schema", 1)
        f.attr("group", "name", "water")
    with h5py.File(tmp_path / "new" / "a.h5") as f:
        assert f["group/x"][()].tolist() == [[0, 1], [2, 3], [4, 5]]
        assert f["group/x"].chunks is None and f["group/x"].compression is None
        assert f["group/none"].shape == (0, 3) and f["group/none"].dtype == np.float32
        assert f["numbers"][()].tolist() == [0, 1, 2, 3]
        assert f["long"][()].decode() == text
        assert f["empty"][()] == b""
        assert f.attrs["schema"] == 1 and f["group"].attrs["name"] == b"water"
    assert [p.name for p in (tmp_path / "new").iterdir()] == ["a.h5"]


def test_rows_stand_in_rank_order_also_in_many_pieces(tmp_path, monkeypatch):
    monkeypatch.setattr(hdf5_writer, "MAX_WRITE_BYTES", 100)

    def job(ranks):
        count = [0, 40, 1, 0][ranks.rank]
        with hdf5_writer.create(tmp_path / "a.h5", ranks) as f:
            f.rows("x", 100.0 * ranks.rank + np.arange(3 * count).reshape(count, 3))
            f.rows("rank", np.full(count, ranks.rank, np.int32))

    run(4, job)
    with h5py.File(tmp_path / "a.h5") as f:
        assert f["rank"][()].tolist() == [1] * 40 + [2]
        assert np.array_equal(f["x"][:40].ravel(), 100.0 + np.arange(120))
        assert f["x"][40].tolist() == [200, 201, 202]


def test_an_exception_in_the_block_leaves_the_old_file(tmp_path):
    path = tmp_path / "a.h5"
    with hdf5_writer.create(path, SerialCommunicator()) as f:
        f.rows("x", np.arange(3))
    before = path.read_bytes()
    with pytest.raises(ZeroDivisionError), hdf5_writer.create(path, SerialCommunicator()) as f:
        f.rows("x", np.arange(5))
        raise ZeroDivisionError
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_all_ranks_get_the_same_error(tmp_path):
    (tmp_path / "file").write_text("not a folder")
    said = []

    def job(ranks):
        with pytest.raises(hdf5_writer.StoreError) as caught:
            with hdf5_writer.create(tmp_path / "file" / "a.h5", ranks) as f:
                f.rows("x", np.arange(3))
        said.append(str(caught.value))

    run(3, job)
    assert len(set(said)) == 1 and len(said) == 3
    assert "file/a.h5" in said[0] and "\n" not in said[0]


def test_an_error_of_one_rank_is_the_error_of_all(tmp_path):
    def job(ranks):
        with pytest.raises(hdf5_writer.StoreError, match="cannot write a: out of luck"):
            error = OSError("out of luck\nand more") if ranks.rank == 1 else None
            hdf5_writer.raise_on_all_ranks(ranks, error, hdf5_writer.Path("a"))

    run(3, job)


@pytest.mark.parametrize("cut", [0, 1, 7, 65_536, 99_999, 100_000])
def test_joined_checksums(cut):
    data = np.random.default_rng(0).integers(0, 256, 100_000).astype(np.uint8).tobytes()
    first, second = data[:cut], data[cut:]
    joined = checkpoint_manifest.combine(zlib.crc32(first), zlib.crc32(second), len(second))
    assert joined == zlib.crc32(data)


def test_checksums_do_not_depend_on_the_cuts():
    rows = np.random.default_rng(0).random((200_000, 2))
    whole = checkpoint_manifest.combine_checksums(
        checkpoint_manifest.chunk_checksums(0, rows), checkpoint_manifest.chunks_of(rows.shape)
    )
    assert len(whole) == 4
    assert whole[1] == zlib.crc32(rows[65536:131072].tobytes())
    parts = []
    for start, stop in [(0, 10), (10, 10), (10, 70_000), (70_000, 70_001), (70_001, 200_000)]:
        parts += checkpoint_manifest.chunk_checksums(start, rows[start:stop])
    assert checkpoint_manifest.combine_checksums(parts, 4) == whole
