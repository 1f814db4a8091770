"""Frames and the series open in VTK from any working directory, and the reader gives back what was
written."""

import os
import time

import h5py
import numpy as np
import pytest
import pyvista
from vtkmodules.vtkIOHDF import vtkHDFReader

from tests.parallel.files_job import columns
from tests.support.simulated_ranks import run
from vgmpi.io import file_layout, frames, hdf5_writer
from vgmpi.io.run_reader import RunError, RunReader, inspect
from vgmpi.parallel.communicator import SerialCommunicator

COUNTS = [5, 9, 7, 12]  # particles come and go
TOTAL = 20


def ids_of(index):
    """Ids of a frame, not in order."""
    return np.random.default_rng(index).permutation(TOTAL)[: COUNTS[index]]


@pytest.fixture(params=[False, True], ids=["plain", "compressed"])
def out(tmp_path, request):
    series = frames.Frames(tmp_path / "out", SerialCommunicator(), TOTAL, compresses=request.param)
    for index in range(len(COUNTS)):
        ids = ids_of(index)
        series.write(index, index / 10, 100 * index, ids, columns(ids))
    return tmp_path / "out"


def test_pyvista_reads_a_frame(out):
    mesh = pyvista.read(out / "frames" / "frame_00001.vtkhdf")
    ids = np.sort(ids_of(1))
    want = columns(ids)
    assert type(mesh) is pyvista.PolyData
    assert mesh.n_points == mesh.n_verts == mesh.n_cells == 9
    assert set(mesh.point_data) == {"id", "velocity", "J", "F", "object", "phase"}
    assert np.array_equal(mesh.points, want["positions"].astype(np.float32))
    assert np.array_equal(mesh.point_data["id"], ids)
    for name in mesh.point_data:
        if name != "id":
            array = mesh.point_data[name]
            assert array.dtype.str[1:] == file_layout.named(file_layout.FRAME)[name].dtype
            assert np.array_equal(array, want[name].astype(array.dtype))
    assert mesh.field_data["time"] == 0.1 and mesh.field_data["step"] == 100
    assert mesh.verts.reshape(-1, 2)[:, 1].tolist() == list(range(9))


@pytest.mark.parametrize("cwd", ["/", "{out}", "{out}/frames"])
def test_vtk_steps_through_the_series(out, monkeypatch, cwd):
    monkeypatch.chdir(cwd.format(out=out))
    file = os.path.relpath(out / "series.vtkhdf")
    reader = vtkHDFReader()
    reader.SetFileName(file)
    reader.UpdateInformation()
    assert reader.GetNumberOfSteps() == len(COUNTS)
    for index in [3, 0, 2, 1]:
        reader.SetStep(index)
        reader.Update()
        mesh = pyvista.wrap(reader.GetOutput())
        ids = np.sort(ids_of(index))
        assert mesh.n_points == mesh.n_verts == COUNTS[index]
        assert np.array_equal(mesh.point_data["id"], ids)
        assert np.array_equal(mesh.points, columns(ids)["positions"].astype(np.float32))
        assert np.array_equal(mesh.point_data["F"], columns(ids)["F"].astype(np.float32))
        assert mesh.verts.reshape(-1, 2)[:, 1].tolist() == list(range(COUNTS[index]))
        assert mesh.field_data["time"] == index / 10
        assert reader.GetTimeValue() == index / 10


@pytest.mark.parametrize("lost", [[0, 1, 2, 3], [1]])
def test_a_series_without_its_frames_shows_no_particles_at_the_origin(out, tmp_path, lost):
    """A copy of the series alone, or without one frame: nan and -1 instead of zeros."""
    for index in lost:
        (out / "frames" / f"frame_{index:05d}.vtkhdf").unlink()
    for index in range(len(COUNTS)):
        reader = vtkHDFReader()
        reader.SetFileName(str(out / "series.vtkhdf"))
        reader.UpdateInformation()
        reader.SetStep(index)
        reader.Update()
        mesh = pyvista.wrap(reader.GetOutput())
        assert mesh.n_points == COUNTS[index]
        assert mesh.field_data["step"] == (-1 if index in lost else 100 * index)
        for name in ("id", "object", "phase"):
            assert ((mesh.point_data[name] == -1) == (index in lost)).all()
        for values in (mesh.points, *(mesh.point_data[n] for n in ("velocity", "J", "F"))):
            assert (np.isnan(values) == (index in lost)).all()


def test_series_is_valid_after_every_frame_and_moves_with_its_folder(tmp_path):
    series = frames.Frames(tmp_path / "a", SerialCommunicator(), TOTAL)
    for index in range(2):
        ids = ids_of(index)
        series.write(index, float(index), index, ids, {"positions": columns(ids)["positions"]})
        (tmp_path / "a").rename(tmp_path / "b")
        with h5py.File(tmp_path / "b" / "series.vtkhdf") as f:
            assert f["VTKHDF/NumberOfPoints"][()].tolist() == COUNTS[: index + 1]
            last = f["VTKHDF/Points"][-COUNTS[index] :]
        assert np.array_equal(last, columns(np.sort(ids))["positions"].astype(np.float32))
        (tmp_path / "b").rename(tmp_path / "a")


def test_resume_and_start_anew(out):
    four = (out / "series.vtkhdf").read_bytes()
    (out / "frames" / "frame_00003.vtkhdf.tmp").write_text("half")
    series = frames.Frames(out, SerialCommunicator(), TOTAL, first=2)
    assert len(RunReader(out)) == 2
    time.sleep(1.1)  # HDF5 counts seconds: the time of day is no part of the bytes
    for index in (2, 3):
        ids = ids_of(index)
        series.write(index, index / 10, 100 * index, ids, columns(ids))
    assert (out / "series.vtkhdf").read_bytes() == four
    assert not list(out.rglob("*.tmp"))
    frames.Frames(out, SerialCommunicator(), TOTAL)
    assert [p.name for p in out.iterdir()] == ["frames"]
    assert list((out / "frames").iterdir()) == []


def test_fields_that_are_not_asked_for_are_not_there(tmp_path):
    series = frames.Frames(tmp_path, SerialCommunicator(), 3)
    series.write(0, 0.0, 0, np.arange(3), {"positions": np.zeros((3, 3))})
    assert set(RunReader(tmp_path).frame(0)) == {"id", "positions"}


@pytest.mark.parametrize(
    "ids, fields, text",
    [
        ([0, 1, 1], {}, "twice"),
        ([0, 1, 20], {}, "0 .. 19"),
        ([0, 1, -1], {}, "0 .. 19"),
        ([0, 1, 2], {"color_sh": np.zeros(3)}, "color_sh"),
        ([0, 1, 2], {"velocity": np.zeros(3)}, "velocity"),
        ([0, 1, 2], {"J": np.zeros(2)}, "2 rows for 3 ids"),
    ],
)
def test_wrong_rows_are_refused(tmp_path, ids, fields, text):
    series = frames.Frames(tmp_path, SerialCommunicator(), TOTAL)
    with pytest.raises(ValueError, match=text):
        series.write(0, 0.0, 0, np.array(ids), {"positions": np.zeros((3, 3)), **fields})
    assert list((tmp_path / "frames").iterdir()) == []


def test_ranks_without_particles(tmp_path):
    def job(ranks):
        ids = np.arange(TOTAL)[::-1] if ranks.rank == 2 else np.zeros(0, np.int64)
        series = frames.Frames(tmp_path, ranks, TOTAL)
        series.write(0, 0.0, 0, ids, columns(ids))

    run(4, job)
    mesh = pyvista.read(tmp_path / "frames" / "frame_00000.vtkhdf")
    assert mesh.point_data["id"].tolist() == list(range(TOTAL))


def test_run(out):
    run_ = RunReader(out)
    assert np.array_equal(run_.times, [0.0, 0.1, 0.2, 0.3])
    frame = run_.frame(-1)
    assert list(frame)[:2] == ["id", "positions"]
    assert np.array_equal(frame["velocity"], columns(np.sort(ids_of(3)))["velocity"].astype("f4"))
    assert "4 frames" in inspect(out / "series.vtkhdf")
    text = inspect(out / "frames" / "frame_00001.vtkhdf")
    assert "time 0.1 s, step 100" in text and "PointData/velocity" in text and "m/s" in text


def test_broken_frames_and_folders_are_one_clear_line(out, tmp_path):
    def says(*words):
        return pytest.raises(RunError, match="^[^\n]*" + "[^\n]*".join(words) + "[^\n]*$")

    path = out / "frames" / "frame_00001.vtkhdf"
    path.write_bytes(path.read_bytes()[:2000])
    with says("frame_00001.vtkhdf", "broken"):
        RunReader(out).frame(1)
    with h5py.File(out / "frames" / "frame_00002.vtkhdf", "r+") as f:
        del f["VTKHDF/PointData/J"]
        f["VTKHDF/PointData/J"] = np.zeros(3)
    with says("frame_00002.vtkhdf", "damaged", "J is not what was written"):
        RunReader(out).frame(2)
    with h5py.File(out / "frames" / "frame_00002.vtkhdf", "r+") as f:
        del f["crc"]
    with says("frame_00002.vtkhdf", "damaged", "it has no checksums"):
        RunReader(out).frame(2)
    with says("no frame 4", "there are 4"):
        RunReader(out).frame(4)
    with says("gaussians.h5: no such file"):
        _ = RunReader(out).gaussians
    with says("no such folder"):
        RunReader(tmp_path / "nowhere")
    (tmp_path / "empty").mkdir()
    with says("no frames in it"):
        RunReader(tmp_path / "empty")
    with h5py.File(tmp_path / "other.h5", "w") as f:
        f["x"] = 1
    with says("other.h5", "not a file of vgmpi"):
        inspect(tmp_path / "other.h5")


def test_a_file_that_cannot_be_written_is_one_clear_line(tmp_path):
    series = frames.Frames(tmp_path, SerialCommunicator(), 3)
    (tmp_path / "frames").rmdir()
    (tmp_path / "frames").write_text("in the way")
    with pytest.raises(
        hdf5_writer.StoreError, match="^cannot write [^\n]*frame_00000.vtkhdf: [^\n]*$"
    ):
        series.write(0, 0.0, 0, np.arange(3), {"positions": np.zeros((3, 3))})
