"""What the live page reads and writes: a folder that changes, tables, the lock, render.toml."""

import json
import os
import shutil
import socket
import subprocess
import sys
import time

import numpy as np
import pytest

from tests.support import drawn_runs
from tests.support.launch import until
from vgmpi.io import csv_log, file_layout, run_lock, run_progress
from vgmpi.io.csv_log import ConservationLog, CsvLog
from vgmpi.io.run_reader import RunError, RunReader
from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.postprocess.frames import field_values, render_config
from vgmpi.postprocess.live import drawn_view, run_tables, saved_camera
from vgmpi.postprocess.live.followed_run import FollowedRun
from vgmpi.postprocess.live.saved_camera import View

EYE = np.array([3.0, 0.0, 1.0])
VIEW = View((1.0, -2.0, 0.5), (0.0, 0.0, 0.25), (0.0, 0.0, 1.0), 40.0, 1.5)


def followed(folder, count=500):
    return FollowedRun(folder, count, render_config.LookSettings())


def test_a_folder_is_followed_from_nothing_to_its_frames(tmp_path):
    out, whole = tmp_path / "out", drawn_runs.write(tmp_path / "whole", frames=3)
    run = followed(out)
    with pytest.raises(RunError, match="no such folder"):
        run.refresh()
    (out / "frames").mkdir(parents=True)
    with pytest.raises(RunError, match="no frames"):
        run.refresh()
    shutil.copy(whole / "frames/frame_00000.vtkhdf", out / "frames")
    with pytest.raises(RunError, match="gaussians.h5"):
        run.refresh()
    shutil.copy(whole / "gaussians.h5", out)
    assert run.refresh() and run.numbers() == [0]
    assert not run.refresh()
    shutil.copy(whole / "frames/frame_00001.vtkhdf", out / "frames")
    assert run.refresh() and run.numbers() == [0, 1]
    shown = run.read_frame(1, EYE, None)
    assert shown.time == pytest.approx(0.04) and shown.bounds is None
    assert run.selection.count == 500
    shutil.rmtree(out)
    with pytest.raises(RunError):
        run.refresh()
    drawn_runs.write(out, frames=1, opacity_scale=0.1)  # another run in its place
    assert run.refresh() and run.numbers() == [0]
    before = run.selection
    drawn_runs.write(out, frames=2, opacity_scale=0.3)  # unseen between two looks
    assert run.refresh() and run.numbers() == [0, 1] and run.selection is not before
    opacity = run.read_frame(0, EYE, None).particles["opacities"]
    assert np.isclose(opacity, 0.8 * 0.3).any()


def test_a_frame_that_is_replaced_or_damaged_is_one_line(tmp_path):
    out = drawn_runs.write(tmp_path / "out", frames=2)
    run = followed(out)
    run.refresh()
    path = out / "frames/frame_00001.vtkhdf"
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    with pytest.raises(RunError) as error:
        run.read_frame(1, EYE, None)
    assert "frame_00001" in str(error.value) and "\n" not in str(error.value)
    other = path.with_suffix(".new")
    other.write_bytes(data)
    os.replace(other, path)
    assert run.read_frame(1, EYE, None).number == 1
    path.unlink()
    path.symlink_to("/etc/passwd")
    with pytest.raises(RunError, match="link"):
        run.read_frame(1, EYE, None)


def test_a_field_colors_the_particles_that_are_shown(tmp_path):
    """velocity.z is the position x: colors follow it, with bounds of all frames so far."""
    out = drawn_runs.write(tmp_path / "out", frames=2)
    run = followed(out, count=10**6)
    run.refresh()
    plain, shown = (run.read_frame(0, EYE, field) for field in (None, "velocity.z"))
    frame = RunReader(out).frame(0)
    low, high = shown.bounds
    assert (low, high) == pytest.approx(
        (frame["velocity"][:, 2].min(), frame["velocity"][:, 2].max())
    )
    expected = field_values.map_colors(frame["velocity"][:, 2], low, high)
    np.testing.assert_allclose(shown.particles["rgbs"], expected, atol=1e-6)
    np.testing.assert_array_equal(shown.particles["centers"], plain.particles["centers"])
    np.testing.assert_array_equal(shown.scenery["rgbs"], plain.scenery["rgbs"])
    assert {"velocity", "velocity.x", "J", "F.8", "object"} <= set(shown.fields)
    assert not {"id", "poses", "id.x"} & set(shown.fields)
    assert run.read_frame(1, EYE, "J").bounds[1] == pytest.approx(1.1)
    assert run.read_frame(0, EYE, "J").bounds[1] == pytest.approx(1.1)
    for name in shown.fields:
        assert len(run.read_frame(0, EYE, name).particles["rgbs"]) == len(frame["id"])
    with pytest.raises(RunError, match="pressure"):
        run.read_frame(0, EYE, "pressure")


def test_the_color_map_is_that_of_matplotlib():
    colors = pytest.importorskip("matplotlib").colormaps["viridis"]
    part = np.linspace(0, 1, 200)
    own = field_values.map_colors(10 + 5 * part, 10, 15)
    np.testing.assert_allclose(own, colors(part)[:, :3], atol=0.03)
    assert (field_values.map_colors(np.array([np.nan]), 0, 1) == 0.5).all()
    bar = field_values.color_bar("velocity", 0.0, 2.0)
    assert "velocity [m/s]" in bar and ">0.5<" in bar and "#fde725" in bar
    assert "<b>" not in field_values.color_bar("<b>", 0, 1)


def written_tables(out):
    """A run with a ledger of two phases and a probe."""
    log = ConservationLog(out, SerialCommunicator(), liquids=True, rigid=True)
    names = [d.name for d in log.columns]
    for k in range(3):
        rows = []
        for phase, mass, fullest in (("a", 2.0, np.nan), ("b", 3.0, 1.0 + k)):
            row = dict.fromkeys(names, 0.0)
            row |= {"time": 0.1 * k, "step": k, "phase": phase, "particles": 1, "mass": mass}
            row |= {"kinetic_energy": 1.0 * k, "momentum_x": -1.0, "fullest_cell": fullest}
            row["rigid_momentum_x"] = 5.0 * (phase == "a")  # of all rigid bodies, in the first row
            rows.append(row)
        log.append(rows)
    probe = CsvLog(out / "probe_p.csv", file_layout.PROBE_COLUMNS["velocity"], SerialCommunicator())
    for k in range(4):
        velocity = {f"velocity_{a}": float(k) if k else np.nan for a in "xyz"}
        probe.append([{"time": 0.1 * k, "step": k, **velocity}])


def test_tables_become_curves(tmp_path):
    written_tables(tmp_path)
    names = run_tables.list_plots(tmp_path)
    assert names == [
        "mass", "momentum", "angular momentum", "energy", "fullest cell", "p: velocity",
    ]  # fmt: skip
    plots = {name: run_tables.read_plot(tmp_path, name) for name in names}
    np.testing.assert_allclose(plots["mass"].time, [0.0, 0.1, 0.2])
    np.testing.assert_allclose(plots["mass"].curves["mass"], [5.0, 5.0, 5.0])
    np.testing.assert_allclose(plots["energy"].curves["total"], [0.0, 2.0, 4.0])
    np.testing.assert_allclose(plots["momentum"].curves["momentum_x"], [3.0, 3.0, 3.0])
    np.testing.assert_allclose(plots["fullest cell"].curves["fullest cell"], [1.0, 2.0, 3.0])
    assert plots["p: velocity"].title == "p: velocity [m/s]"
    np.testing.assert_allclose(plots["p: velocity"].curves["velocity_z"], [1.0, 2.0, 3.0])
    assert [list(csv_log.read_probe(tmp_path / "probe_p.csv")[0])[:2]] == [["time", "step"]]


def test_damaged_and_foreign_tables_are_one_line(tmp_path):
    written_tables(tmp_path)
    path = tmp_path / "probe_p.csv"
    path.write_text(path.read_text().replace("2.0", "2.5"))
    with pytest.raises(RunError, match="damaged"):
        run_tables.read_plot(tmp_path, "p: velocity")
    path.write_text("a,b\n1,2\n")
    with pytest.raises(RunError, match="those of no probe"):
        run_tables.read_plot(tmp_path, "p: a")
    path.unlink()
    path.symlink_to("/etc/passwd")
    assert not any(name.startswith("p:") for name in run_tables.list_plots(tmp_path))
    with pytest.raises(RunError):
        run_tables.read_plot(tmp_path, "p: a")
    with pytest.raises(RunError):
        run_tables.read_plot(tmp_path, "../../x: a")


def test_long_curves_are_thinned_and_keep_their_end(tmp_path):
    n = 12345
    plot = run_tables._thinned(run_tables.Plot("", np.arange(n), {"a": np.arange(n) * 1.0}))
    assert 1000 <= len(plot.time) < 1200 and plot.time[-1] == n - 1 == plot.curves["a"][-1]


def test_progress_is_read_from_the_frames(tmp_path):
    out = drawn_runs.write(tmp_path / "out", frames=5)
    reader = RunReader(out)
    reader.scene["time"] = {"end": 0.4, "frames": 11}
    now = time.time()
    for k in range(5):  # a frame of 0.04 s and of a step takes 2 s
        os.utime(reader.path(k), (now, now - 2 * (4 - k)))
    progress = run_progress.read_progress(reader)
    assert (progress.frame, progress.step, progress.end) == (4, 4, 0.4)
    assert progress.time == pytest.approx(0.16)
    assert progress.steps_per_second == pytest.approx(0.5, rel=0.01)
    assert progress.remaining == pytest.approx(12.0, abs=0.5)
    text = "\n".join(progress.lines())
    assert "no run writes here now" in text and "0.16 of 0.4 s" in text and "left" not in text
    writer = run_lock.RunWriter("node", 1, 2, "now")
    text = "\n".join(progress._replace(writer=writer).lines())
    assert "running: process 1 on node, 2 ranks" in text and "about 12 s left" in text
    assert "ended: complete" in progress._replace(time=0.4).lines()[0]
    assert "blew up" in progress._replace(blew_up=True).lines()[0]


def test_the_pace_of_a_resumed_run_is_that_since_its_restart(tmp_path):
    """Frames of an earlier process are an hour old; those since the restart took 2 s each."""
    out = drawn_runs.write(tmp_path / "out", frames=5)
    reader, now = RunReader(out), time.time()
    reader.scene["time"] = {"end": 0.4, "frames": 11}
    with run_lock.run_lock(out, SerialCommunicator(), True):
        os.utime(out / file_layout.LOCK, (now, now - 5))
        for k in range(5):
            os.utime(reader.path(k), (now, now - (2 * (4 - k) if k > 1 else 3600)))
        progress = run_progress.read_progress(reader)
        assert progress.writer is not None
        assert progress.steps_per_second == pytest.approx(0.5, rel=0.01)
        assert progress.remaining == pytest.approx(12.0, abs=0.5)
        os.utime(out / file_layout.LOCK, (now, now + 5))  # no frame since the restart
        assert np.isnan(run_progress.read_progress(reader).remaining)


def test_a_lock_that_goes_while_progress_is_read_is_no_fault(tmp_path, monkeypatch):
    reader = RunReader(drawn_runs.write(tmp_path / "out", frames=3))
    writer = run_lock.RunWriter("node", 1, 2, "now")
    monkeypatch.setattr(run_lock, "find_writer", lambda _: writer)
    assert not (tmp_path / "out" / file_layout.LOCK).exists()
    assert run_progress.read_progress(reader).writer is writer


HOLDER = """
import signal, sys, time
from pathlib import Path
from vgmpi.io import run_lock
from vgmpi.parallel.communicator import SerialCommunicator
if sys.argv[2] == "handles":
    signal.signal(signal.SIGUSR1, lambda *_: sys.exit(75))
with run_lock.run_lock(Path(sys.argv[1]), SerialCommunicator(), True):
    print("locked", flush=True)
    time.sleep(1000)
"""


@pytest.fixture
def holder(tmp_path):
    """Start processes that hold the lock of a folder."""
    started = []

    def start(folder, word):
        job = subprocess.Popen(
            [sys.executable, "-c", HOLDER, folder, word], stdout=subprocess.PIPE, text=True
        )
        started.append(job)
        assert job.stdout.readline() == "locked\n"
        return job

    yield start
    for job in started:
        job.kill()
        job.communicate()


def test_the_run_of_the_folder_is_asked_to_stop(tmp_path, holder):
    assert run_progress.request_stop(tmp_path) == (
        False, f"{tmp_path}: no run writes here now, so there is nothing to stop"
    )  # fmt: skip
    job = holder(tmp_path, "handles")
    done, line = run_progress.request_stop(tmp_path)
    assert done and f"process {job.pid} was asked to stop" in line
    assert job.wait(60) == 75


def test_no_other_process_gets_the_signal(tmp_path, holder):
    """A lock file may name any process: of another machine, without a handler, without the lock."""
    job = holder(tmp_path, "does not")
    done, line = run_progress.request_stop(tmp_path)
    assert not done and "does not handle SIGUSR1" in line and job.poll() is None
    lock = tmp_path / file_layout.LOCK
    who = json.loads(lock.read_text())
    with open(lock, "r+") as file:
        file.truncate()
        file.write(json.dumps(who | {"host": "elsewhere"}))
    done, line = run_progress.request_stop(tmp_path)
    assert not done and "on elsewhere" in line and "kill -USR1" in line and "\n" not in line
    code = (
        "import signal, sys, time\n"
        "signal.signal(signal.SIGUSR1, lambda *_: sys.exit(3))\n"
        "print('ready', flush=True)\n"
        "time.sleep(1000)"
    )
    sleeper = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert sleeper.stdout.readline() == "ready\n"
    for text in (who | {"pid": sleeper.pid}, who | {"pid": 2**22 + 1}, who | {"pid": -1}):
        with open(lock, "r+") as file:
            file.truncate()
            file.write(json.dumps(text | {"host": socket.gethostname()}))
        done, line = run_progress.request_stop(tmp_path)
        assert not done and "nothing was sent" in line and "\n" not in line
    with pytest.raises(subprocess.TimeoutExpired):
        sleeper.wait(0.5)
    sleeper.kill()
    sleeper.communicate()
    lock.write_text("{")
    assert not run_progress.request_stop(tmp_path)[0]


@pytest.mark.parametrize(
    "before",
    [
        "",
        "# mine\n[look]\npreset = 'paper'  # quick\n",
        "[camera]\n# round\nname = 'a'\nkind = 'orbit'  # k\nrevolutions = 1\n\n"
        "[picture]\nwidth = 400\n",
        "camera.kind = 'orbit'\ncamera.revolutions = 1\npicture.width = 400\n[look]\n",
        "camera = { azimuth = 30 }  # c\n[look]\npreset = 'paper'\n",
        "[[camera]]\nname = 'a'\n[[camera]]\nname = 'b'\nazimuth = 3\n[video]\nfps = 5\n",
        "[[camera]]\nname = 'a'\n[[camera]]\nname = 'live'\nazimuth = 3  # 3\n[video]\nfps = 5\n",
        "[camera]\nkind = 'keyframes'\nkeyframes = [\n  {progress = 0, eye = [1, 1, 1]},\n  # k\n"
        "  {progress = 1, eye = [2, 1, 1]},\n]\n",
    ],
)
def test_a_saved_camera_leaves_all_else_alone(tmp_path, before):
    """Comments and other tables stay, old keys of the camera become comments."""
    pytest.importorskip("tomlkit")
    path = tmp_path / "render.toml"
    if before:
        path.write_text(before)
    assert "camera saved" in saved_camera.save_camera(path, VIEW)
    text = path.read_text()
    entries = render_config.load(path).views()
    (camera,) = [entry for entry in entries if len(entries) == 1 or entry.name == "live"]
    assert (camera.kind, camera.eye, camera.target, camera.fov) == (
        "fixed",
        VIEW.eye,
        VIEW.target,
        40,
    )
    for comment in ("# mine", "# quick", "# round", "# k", "# c", "# 3"):
        assert (comment in before) <= (comment in text)
    for line in ("revolutions = 1", "azimuth = 30", "keyframes = [", "width = 400", "fps = 5"):
        assert (line in before) <= (line in text)
    saved_camera.save_camera(path, VIEW)
    assert path.read_text() == text
    moved = VIEW._replace(eye=(4.0, 4.0, 4.0))
    saved_camera.save_camera(path, moved)
    assert path.read_text().count("eye") == text.count("eye")
    assert os.listdir(tmp_path) == ["render.toml"]


def test_a_wrong_file_is_left_as_it_is(tmp_path):
    path = tmp_path / "render.toml"
    for text in ("[camera\n", "[camera]\nknid = 'orbit'\n", "camera = 3\n"):
        path.write_text(text)
        with pytest.raises(render_config.SettingsError) as error:
            saved_camera.save_camera(path, VIEW)
        assert path.read_text() == text and "render.toml" in str(error.value)
    with pytest.raises(render_config.SettingsError):
        saved_camera.save_camera(tmp_path / "none" / "render.toml", VIEW)
    with pytest.raises(render_config.SettingsError, match="cannot be saved"):
        saved_camera.save_camera(path, VIEW._replace(eye=VIEW.target))
    with pytest.raises(render_config.SettingsError, match="cannot be saved"):
        saved_camera.save_camera(path, VIEW._replace(eye=(float("nan"), 0, 0)))


def test_without_tomlkit_one_line_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "tomlkit", None)
    with pytest.raises(render_config.SettingsError, match=r'pip install "vgmpi\[live\]"'):
        saved_camera.save_camera(tmp_path / "render.toml", VIEW)
    assert not list(tmp_path.iterdir())


def test_a_view_is_drawn_in_another_process(tmp_path):
    out = drawn_runs.write(tmp_path / "out", frames=2)
    settings = tmp_path / "render.toml"
    settings.write_text("[look]\npreset = 'paper'\n[picture]\nbackground = '#00ff00'\n")
    renderer = drawn_view.ViewRenderer()
    assert renderer.poll() is None and not renderer.is_busy
    view = View((0.5, -2.0, 0.5), (0.5, 0.5, 0.5), (0.0, 0.0, 1.0), 40.0, 2.0)
    results = []

    def draw(number):
        renderer.start(out, settings, number, view)
        assert renderer.is_busy
        until(lambda: (result := renderer.poll()) is not None and not results.append(result), "it")
        return results.pop()

    picture, reason = draw(1)
    assert reason == "" and picture.shape == (400, 800, 3)
    assert (picture[0, 0] == (0, 255, 0)).all() and (picture != picture[0, 0]).any()
    (out / "frames/frame_00001.vtkhdf").write_bytes(b"")
    picture, reason = draw(1)
    assert picture is None and "frame_00001" in reason and "\n" not in reason
    renderer.close()
