"""What is damaged, missing, foreign or a link in a run's folder is named; nothing else is read in
its place."""

import h5py
import numpy as np
import pytest

from tests.parallel.files_job import columns, row
from tests.support import damaged_files
from vgmpi.io import checkpoint, csv_log, file_layout, frames, hdf5_writer
from vgmpi.io.run_reader import RunError, RunReader, inspect, read_gaussians
from vgmpi.parallel.communicator import SerialCommunicator


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Read only, but for bits that are turned back."""
    return damaged_files.write(tmp_path_factory.mktemp("whole"))


@pytest.fixture
def out(tmp_path):
    return damaged_files.write(tmp_path / "out")


@pytest.mark.parametrize("kind", damaged_files.LOOKS)
def test_a_flipped_bit_is_named_or_harmless(whole, kind):
    name, look = damaged_files.LOOKS[kind]
    random = np.random.default_rng(list(damaged_files.LOOKS).index(kind))
    found = [damaged_files.flipped(whole / name, look, random) for _ in range(60)]
    # bits of text are all ours; of small HDF5 files many are not
    least = 59 if kind in ("ledger", "probe", "manifest") else 8
    assert found.count("named") >= least, found


def test_every_number_of_a_frame_is_verified(whole):
    """One bit of every dataset: of those that are drawn at reading, of all by --inspect."""
    path = whole / "frames" / "frame_00001.vtkhdf"
    with h5py.File(path) as f:
        places = {}
        f.visititems(
            lambda name, d: places.update(
                {name: d.id.get_offset()} if isinstance(d, h5py.Dataset) and d.size else {}
            )
        )
    assert len(places) > 15
    read = 0
    for name, place in places.items():
        damaged_files.flip(path, place, 1)
        try:
            assert "NOT VALID: damaged: " in inspect(path).splitlines()[1], name
            if "PointData" in name or name in ("VTKHDF/Points", "frame", "crc"):
                with pytest.raises(RunError, match="frame_00001.vtkhdf: damaged: "):
                    RunReader(whole).frame(1)
                read += 1
        finally:
            damaged_files.flip(path, place, 1)
    assert read == 9 and "agrees with its checksums" in inspect(path)


def test_what_a_frame_says_of_itself_is_looked_at(out):
    """With checksums that are right: types, order of ids, and that it is this frame."""
    run, path = RunReader(out), out / "frames" / "frame_00001.vtkhdf"

    def written(**other):
        ids = np.arange(damaged_files.TOTAL)
        with hdf5_writer.create(path, SerialCommunicator()) as f:
            f.attr("", "schema", file_layout.SCHEMA)
            f.root_array(
                "VTKHDF/NumberOfPoints", np.array([other.get("count", damaged_files.TOTAL)])
            )
            f.rows("VTKHDF/PointData/id", other.get("id", ids))
            f.rows("VTKHDF/Points", columns(ids)["positions"].astype(other.get("type", "f4")))
            f.root_array("frame", np.array(other.get("frame", 1)))
            f.seal()

    written()
    assert len(run.frame(1)["positions"]) == damaged_files.TOTAL
    for other, said in (
        ({"id": np.arange(damaged_files.TOTAL)[::-1]}, "id does not ascend"),
        ({"id": np.arange(damaged_files.TOTAL) - 1}, "id does not ascend"),
        ({"type": "f8"}, "positions is float64"),
        ({"frame": 2}, "it is frame 2, not 1"),
        ({"count": 7}, "id should have 7 rows"),
    ):
        written(**other)
        with pytest.raises(RunError, match=f"frame_00001.vtkhdf: damaged: {said}"):
            run.frame(1)


def test_a_frame_without_checksums_is_refused(out):
    path = out / "frames" / "frame_00001.vtkhdf"
    with h5py.File(path, "r+") as f:
        del f["crc"]
    with pytest.raises(RunError, match="frame_00001.vtkhdf: damaged: it has no checksums"):
        RunReader(out).frame(1)
    assert "NOT VALID: damaged: it has no checksums" in inspect(path)
    with h5py.File(path, "r+") as f:
        f["brc"] = 1  # as one bit would make it of crc
    with pytest.raises(RunError, match="it holds 'brc', which is not of such a file"):
        RunReader(out).frame(1)


# ---- frames that are missing or not ours -------------------------------------------------------


def test_frames_keep_their_numbers_where_one_is_missing(out, caplog):
    times = RunReader(out).times
    want = RunReader(out).frame(2)
    (out / "frames" / "frame_00001.vtkhdf").unlink()
    run = RunReader(out)
    assert len(run) == 3 and sorted(run.frames) == [0, 2]
    assert np.isnan(run.times[1]) and (run.times[[0, 2]] == times[[0, 2]]).all()
    for k in (2, -1):
        assert all((run.frame(k)[name] == want[name]).all() for name in want)
    for k in (1, -2):
        with pytest.raises(RunError, match="frame_00001.vtkhdf: no such file"):
            run.frame(k)
    assert (
        run.available_frames(range(3)) == [0, 2] and "frames: missing: 1: left out" in caplog.text
    )
    with pytest.raises(RunError, match="frames: missing: 1$"):
        run.available_frames([1])
    with pytest.raises(RunError, match="frame_00001.vtkhdf: no such file"):
        inspect(out / file_layout.SERIES)


def test_the_last_frame_is_missing_too(out):
    (out / "frames" / "frame_00002.vtkhdf").unlink()
    assert len(RunReader(out)) == 3
    with pytest.raises(RunError, match="frame_00002.vtkhdf: no such file"):
        RunReader(out).frame(-1)


@pytest.mark.parametrize(
    "name", ["frame_²²²²².vtkhdf", "frame_٣٣٣٣٣.vtkhdf", "frame_3.vtkhdf", "frame_00003 (1).vtkhdf",
             "frame_000003.vtkhdf", "frame_9999999.vtkhdf", "mine.vtkhdf"],
)  # fmt: skip
def test_foreign_names_are_told_and_left_alone(out, caplog, name):
    path = out / "frames" / name
    path.write_text("foreign")
    assert sorted(RunReader(out).frames) == [0, 1, 2]
    assert ascii(name) in caplog.text and "\n" not in caplog.records[0].getMessage()
    frames.Frames(out, SerialCommunicator(), damaged_files.TOTAL, first=1)
    assert path.read_text() == "foreign" and sorted(RunReader(out).frames) == [0]


def test_a_copy_under_another_number_is_not_drawn(out):
    one, two = (out / "frames" / f"frame_0000{k}.vtkhdf" for k in (1, 2))
    one.write_bytes(two.read_bytes())
    with pytest.raises(RunError, match="frame_00001.vtkhdf: damaged: it is frame 2, not 1"):
        RunReader(out).frame(1)


@pytest.mark.parametrize(
    "name, other",
    [
        ("frames/frame_00001.vtkhdf", file_layout.SERIES),
        (file_layout.SERIES, "frames/frame_00001.vtkhdf"),
        (file_layout.GAUSSIANS, "checkpoints/checkpoint_000000200.h5"),
    ],
)
def test_a_file_under_the_name_of_another_kind_is_named(out, name, other):
    (out / name).write_bytes((out / other).read_bytes())
    with pytest.raises(RunError, match=f"{(out / name).name}: damaged: it is a .*, not a "):
        inspect(out / name)


def test_a_resume_tells_of_frames_that_are_gone(out, caplog):
    (out / "frames" / "frame_00000.vtkhdf").unlink()
    damaged_files.flip(out / "frames" / "frame_00001.vtkhdf", 0, 0)
    frames.Frames(out, SerialCommunicator(), damaged_files.TOTAL, first=3)
    said = caplog.text
    assert "frame_00000.vtkhdf: missing; it is left out of the series" in said
    assert "frame_00001.vtkhdf" in said and RunReader(out).frames.keys() == {1, 2}


# ---- links -------------------------------------------------------------------------------------


def _external(f, victim):
    del f["VTKHDF/Points"]
    f["VTKHDF/Points"] = h5py.ExternalLink(str(victim), "/secret")


def _soft(f, victim):
    del f["VTKHDF/Points"]
    f["VTKHDF/Points"] = h5py.SoftLink("/VTKHDF/PointData/velocity")


def _virtual(f, victim):
    del f["VTKHDF/Points"]
    whole = h5py.VirtualLayout((damaged_files.TOTAL, 3), "f4")
    whole[:] = h5py.VirtualSource(str(victim), "/secret", (damaged_files.TOTAL, 3), "f4")
    f.create_virtual_dataset("VTKHDF/Points", whole)


def _storage(f, victim):
    del f["VTKHDF/Points"]
    size = 12 * damaged_files.TOTAL
    f.create_dataset(
        "VTKHDF/Points", (damaged_files.TOTAL, 3), "f4", external=[(str(victim), 0, size)]
    )


def _group(f, victim):
    del f["VTKHDF/PointData"]
    f["VTKHDF/PointData"] = h5py.ExternalLink(str(victim), "/")


def _huge(f, victim):
    del f["VTKHDF/Points"]
    f.create_dataset("VTKHDF/Points", (1 << 40, 3), "f4")


LEADS_OUT = {
    _external: "Points is a link to elsewhere",
    _soft: "Points is a link to elsewhere",
    _virtual: "Points keeps its numbers in another file",
    _storage: "Points keeps its numbers in another file",
    _group: "PointData is a link to elsewhere",
    _huge: "Points claims more bytes than the file has",
}


@pytest.mark.parametrize("change", LEADS_OUT)
def test_nothing_leads_out_of_a_frame(out, tmp_path, change):
    """Not where checksums are gone either."""
    victim = tmp_path / "victim.h5"
    with h5py.File(victim, "w") as f:
        f["secret"] = np.full((damaged_files.TOTAL, 3), 42.0, "f4")
    with h5py.File(out / "frames" / "frame_00001.vtkhdf", "r+") as f:
        del f["crc"], f["frame"]
        change(f, victim)
    said = f"frame_00001.vtkhdf: damaged: VTKHDF/{LEADS_OUT[change]}"
    for look in (lambda: RunReader(out).frame(1), lambda: inspect(out / file_layout.SERIES)):
        with pytest.raises(RunError, match=said):
            look()


def test_a_series_is_of_frames_of_its_folder(out, tmp_path):
    with h5py.File(out / file_layout.SERIES, "r+") as f:
        del f["VTKHDF/Points"]
        whole = h5py.VirtualLayout((3, 3), "f4")
        whole[:] = h5py.VirtualSource("../victim.h5", "/secret", (3, 3), "f4")
        f.create_virtual_dataset("VTKHDF/Points", whole)
    with pytest.raises(RunError, match="series.vtkhdf: damaged: VTKHDF/Points is put together of"):
        inspect(out / file_layout.SERIES)


@pytest.mark.parametrize("kind", damaged_files.LOOKS)
def test_files_that_are_links_are_not_followed(out, tmp_path, kind):
    name, look = damaged_files.LOOKS[kind]
    if kind == "series":
        look = lambda path: RunReader(out)  # noqa: E731  --inspect is told the name by the user
    (out / name).rename(tmp_path / "elsewhere")
    (out / name).symlink_to(tmp_path / "elsewhere")
    if kind == "series":
        assert len(look(out / name)) == 3
        return
    with pytest.raises(damaged_files.SAID, match="a link to elsewhere|manifest is not readable"):
        look(out / name)


def test_links_in_gaussians_and_checkpoints(out, tmp_path, caplog):
    with h5py.File(tmp_path / "victim.h5", "w") as f:
        f["secret"] = np.zeros((damaged_files.TOTAL, 3))

    def change(f, name):
        del f[name]
        f[name] = h5py.ExternalLink(str(tmp_path / "victim.h5"), "/secret")

    with h5py.File(out / file_layout.GAUSSIANS, "r+") as f:
        change(f, "x0")
    with pytest.raises(RunError, match="gaussians.h5: damaged: x0 is a link"):
        read_gaussians(out / file_layout.GAUSSIANS)
    path = out / "checkpoints" / "checkpoint_000000200.h5"
    damaged_files.forge(path, lambda f: change(f, "group_000/x"))
    assert checkpoint.latest_valid(path.parent).name == "checkpoint_000000100.h5"
    assert "group_000/x is a link to elsewhere" in caplog.text


@pytest.mark.parametrize("name", ["ledger.csv", "series.vtkhdf.tmp"])
def test_writing_follows_no_link(tmp_path, name):
    victim = tmp_path / "victim"
    victim.write_text("precious")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / name).symlink_to(victim)
    damaged_files.write(tmp_path / "out")
    assert victim.read_text() == "precious" and not (tmp_path / "out" / name).is_symlink()
    table = csv_log.ConservationLog(tmp_path / "out", SerialCommunicator())
    table.path.unlink()
    table.path.symlink_to(victim)
    with pytest.raises(hdf5_writer.StoreError, match="cannot write .*ledger.csv"):
        table.append([row(1)])
    assert victim.read_text() == "precious"
