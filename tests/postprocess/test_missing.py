"""A frame that is missing or damaged is named, and none is drawn in its place."""

import shutil

import h5py
import imageio.v3 as iio
import numpy as np
import pytest

from tests.support import damaged_files, drawn_runs
from vgmpi.io import file_layout, initial_state
from vgmpi.io.frames import Frames
from vgmpi.io.run_reader import RunError, RunReader
from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.postprocess.commands import export, render, view
from vgmpi.postprocess.frames.appearance import Appearance

SMALL = "[picture]\nwidth = 96\nheight = 80\n[camera]\nrevolutions = 0.5\n"
GONE = 2


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return drawn_runs.write(tmp_path_factory.mktemp("run") / "out", frames=5)


@pytest.fixture
def out(whole, tmp_path):
    shutil.copytree(whole, tmp_path / "out")
    (tmp_path / "out" / "frames" / f"frame_{GONE:05d}.vtkhdf").unlink()
    return tmp_path / "out"


def draw(out, folder, *argv):
    folder.mkdir(exist_ok=True)
    (folder / "render.toml").write_text(drawn_runs.on_paper(SMALL))
    return render.main([str(out), str(folder / "render.toml"), *map(str, argv)])


def test_the_others_are_drawn_as_if_it_were_there(whole, out, tmp_path, caplog):
    """The camera turns from frame to frame: a wrong number would be a wrong view."""
    assert draw(whole, tmp_path, "-q", "-o", tmp_path / "want") == 0
    assert draw(out, tmp_path, "-q", "-o", tmp_path / "got") == 0
    assert f"frames: missing: {GONE}: left out, no other frame stands for them" in caplog.text
    want = {path.name for path in (tmp_path / "want").iterdir()}
    got = {path.name for path in (tmp_path / "got").iterdir()}
    assert want - got == {f"frame_{GONE:05d}.png"} and got < want
    for name in got:
        one, other = (iio.imread(tmp_path / where / name) for where in ("want", "got"))
        np.testing.assert_array_equal(one, other)


def test_a_film_is_shorter_by_it(out, tmp_path):
    assert draw(out, tmp_path, "-q", "-o", tmp_path / "a.webm", "--frames", tmp_path / "p") == 0
    assert len(iio.imread(tmp_path / "a.webm", plugin="FFMPEG", index=None)) == 4
    assert len(list((tmp_path / "p").iterdir())) == 4


def test_alone_it_is_refused(out, tmp_path, capfd):
    where = tmp_path / "a.png"
    for command in (
        lambda: draw(out, tmp_path, "-o", where, "--frame", GONE),
        lambda: view.main([str(out), "--frame", str(GONE), "-o", str(where)]),
    ):
        assert command() == 2
        (line,) = capfd.readouterr().err.splitlines()
        assert line.endswith(f"frames/frame_{GONE:05d}.vtkhdf: no such file")
    assert export.main([str(out), "--frames", str(GONE), "-o", str(tmp_path / "e")]) == 2
    assert f"frames: missing: {GONE}" in capfd.readouterr().err
    (out / "frames" / "frame_00004.vtkhdf").unlink()
    assert draw(out, tmp_path, "--preview") == 2  # of the last frame
    assert "frame_00004.vtkhdf: no such file" in capfd.readouterr().err
    assert not where.exists() and not (tmp_path / "e").exists()


def test_an_export_keeps_the_numbers(out, tmp_path):
    assert export.main([str(out), "-q", "-o", str(tmp_path / "e")]) == 0
    assert [int(path.stem[-5:]) for path in sorted((tmp_path / "e").iterdir())] == [0, 1, 3, 4]


def test_a_damaged_frame_ends_a_film_by_name(out, tmp_path, capfd):
    path = out / "frames" / "frame_00003.vtkhdf"
    with h5py.File(path) as f:
        place = f["VTKHDF/Points"].id.get_offset() + 100
    damaged_files.flip(path, place, 0)
    assert draw(out, tmp_path, "-q", "-o", tmp_path / "a.webm") == 2
    (line,) = capfd.readouterr().err.splitlines()
    assert "frame_00003.vtkhdf: damaged: VTKHDF/Points is not what was written" in line
    assert not (tmp_path / "a.webm").exists()


def test_colors_that_relax_need_every_frame(out, tmp_path, capfd):
    (tmp_path / "render.toml").write_text(SMALL + '[look]\ncolor_transfer = "relax"\n')
    rows, objects, _ = drawn_runs.rest_state()
    rows["sh"][: drawn_runs.WATER // 2] += 0.5  # water of two colors, which may travel
    scene = {"domain": {"size": [1.0, 1.0, 1.0], "cell": 0.1}}
    objects[0]["phase"] = 0
    initial_state.write(
        out / file_layout.GAUSSIANS, SerialCommunicator(), rows, objects, None, scene
    )
    argv = [str(out), str(tmp_path / "render.toml"), "-o", str(tmp_path / "a.png")]
    assert render.main([*argv, "--frame", "1"]) == 0
    assert render.main([*argv, "--frame", "3"]) == 2
    said = capfd.readouterr().err
    assert f"frame_{GONE:05d}.vtkhdf: No such file or directory: colors that relax" in said
    cache = out / "colors" / "frame_00001.npz"
    want = cache.read_bytes()
    victim = tmp_path / "victim"
    victim.write_text("precious")
    for harm in (lambda: cache.write_bytes(want[:50]), lambda: damaged_files.flip(cache, 300, 0)):
        harm()
        assert render.main([*argv, "--frame", "1"]) == 0
        assert cache.read_bytes() == want
    cache.unlink()
    cache.symlink_to(victim)
    assert render.main([*argv, "--frame", "1"]) == 0
    assert not cache.is_symlink() and victim.read_text() == "precious"


@pytest.mark.parametrize("field", ["positions", "F", "J"])
def test_numbers_that_are_none_are_not_drawn(out, field):
    rows, _, _ = drawn_runs.rest_state()
    fields = drawn_runs.frame_fields(rows, 1, 5)
    fields[field][7] = np.nan
    Frames(out, SerialCommunicator(), len(rows["x0"]), first=1).write(
        1, 0.04, 1, np.arange(len(rows["x0"])), fields
    )
    with pytest.raises(RunError, match=f"frame 1 holds {field} that are not finite"):
        Appearance(RunReader(out)).frame(1)
