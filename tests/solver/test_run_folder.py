"""A run folder has one owner; a resume knows its scene; a finished run goes on."""

import json
import os
import signal
import subprocess
import sys
import time

import h5py
import numpy as np
import pytest

import vgmpi
from tests.support.file_digests import files
from tests.support.launch import PATIENCE, ROOT
from tests.support.small_scenes import write
from vgmpi.commands import cli, messages, run_report
from vgmpi.io import checkpoint, csv_log, file_layout, run_lock, run_reader
from vgmpi.io.run_reader import RunError, RunReader
from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.scene.loader import load
from vgmpi.scene.resume_rules import forbidden_changes
from vgmpi.solver import stop_requests
from vgmpi.solver.restart import resume_point
from vgmpi.solver.run import Runner
from vgmpi.solver.stop_requests import Requests

SCENE = """
[domain]
size = [0.2, 0.2, 0.2]
cell = "2 cm"
[time]
end = "20 ms"
frames = 3
[accuracy]
pressure = "explicit"
precision = "single"
[material.water]
kind = "fluid"
max_speed = "2 m/s"
[[object]]
name = "drop"
material = "water"
shape = { sphere = { center = [0.1, 0.1, 0.1], radius = "4 cm" } }
"""
NUMPY = ("--engine", "numpy")


@pytest.fixture
def scene(tmp_path):
    return write(tmp_path, SCENE)


def run(scene, *flags):
    return cli.main([str(scene), "-q", *flags])


@pytest.mark.parametrize("change", [[], ["--set", "material.water.density=900"], ["--prepare"]])
def test_a_run_is_not_replaced_unasked(scene, capsys, change):
    """Not a byte of it."""
    assert run(scene) == 0
    before = files(scene.parent / "out")
    assert file_layout.LOCK not in before
    assert run(scene, *change) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "a run lies here (3 frames); --resume goes on with it, --overwrite replaces it" in line
    assert files(scene.parent / "out") == before
    assert run(scene, *change, "--overwrite") == 0


@pytest.mark.parametrize(
    "flags",
    [
        ["--set", "material.water.density=900"],
        ["--set", "domain.gravity=[0, 0, -3]"],
        ["--set", "object.drop.velocity=[1, 0, 0]"],
        ["--set", "accuracy.precision=double", "--change"],
        ["--set", "domain.cell=1 cm", "--change"],
    ],
)
def test_a_refused_resume_writes_nothing(scene, capsys, flags):
    assert run(scene, "--stop-after", "3 steps") == 75
    before = files(scene.parent / "out")
    assert run(scene, "--resume", *flags) == 2
    said = capsys.readouterr().err
    assert "Traceback" not in said and files(scene.parent / "out") == before
    if "--change" not in flags:
        key, _, new = flags[1].partition("=")
        first, last = said.splitlines()[0], said.splitlines()[-1]
        assert key in said and "in the run so far" in first, said
        assert "--resume may change title" in last and "--change" in last


def test_particles_of_another_run_are_named(scene, tmp_path, capsys):
    """As many as this one's, in a file that is whole."""
    out, other = scene.parent / "out", tmp_path / "other"
    assert run(scene, "--stop-after", "3 steps", *NUMPY) == 75
    moved = ("--set", "object.drop.position=[0.12, 0.1, 0.1]")
    assert run(scene, "--prepare", "-o", str(other), *moved) == 0
    own = (out / file_layout.GAUSSIANS).read_bytes()
    (out / file_layout.GAUSSIANS).write_bytes((other / file_layout.GAUSSIANS).read_bytes())
    before = files(out)
    capsys.readouterr()
    assert run(scene, "--resume", *NUMPY) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "is of other particles than" in line and "gaussians.h5" in line
    assert files(out) == before
    with pytest.raises(RunError, match="frame_00000.*other particles than gaussians.h5 beside it"):
        RunReader(out).frame(0)
    with pytest.raises(RunError, match="other particles"):
        RunReader(out).positions(0)
    (out / file_layout.GAUSSIANS).write_bytes(own)
    assert run(scene, "--resume", *NUMPY) == 0
    assert len(RunReader(out).frame(2)["id"]) == len(RunReader(out).gaussians.x0)


def test_a_resume_asks_once_whose_particles_they_are(scene, monkeypatch):
    assert run(scene, "--stop-after", "3 steps", *NUMPY) == 75
    asked = []
    monkeypatch.setattr(
        resume_point,
        "particle_set_id",
        lambda path: asked.append(path) or run_reader.particle_set_id(path),
    )
    assert run(scene, "--resume", *NUMPY) == 0
    assert asked == [scene.parent / "out" / file_layout.GAUSSIANS]


@pytest.mark.parametrize("keep", [2, 1])
def test_a_table_without_its_last_rows_is_named_at_a_resume(scene, capsys, keep):
    """No line of it is damaged: the checkpoint knows how far it went. Without any row it begins
    anew, as one that was moved away does."""
    assert run(scene) == 0
    path, out = scene.parent / "out" / file_layout.LEDGER, scene.parent / "out"
    lines = path.read_text().splitlines(keepends=True)
    assert len(lines) > 2
    path.write_text("".join(lines[:keep]))
    before = files(out)
    longer = ("--set", "time.end=40 ms", "--set", "time.frames=5")
    if keep == 2:
        assert run(scene, "--resume", *longer) == 1
        (line,) = capsys.readouterr().err.splitlines()
        assert "ledger.csv: damaged: its rows up to step " in line and "put a copy of it" in line
        assert files(out) == before
        path.write_text("".join(lines))
    assert run(scene, "--resume", *longer) == 0
    told = {row["step"] for row in csv_log.read_rows(path)}
    assert (0 in told) == (keep == 2) and len(told) >= 2


def test_a_key_that_is_new_and_not_used_is_no_change(scene):
    """A run begun before gravity had keyframes goes on."""
    now = load(scene)
    before = json.loads(json.dumps(now.to_json()))
    del before["domain"]["gravity_keyframes"]
    assert forbidden_changes(now, before) == []
    keys = 'domain.gravity_keyframes=[{time="1 s", gravity=[0, 0, 0]}]'
    (said,) = forbidden_changes(load(scene, [keys]), before)
    assert said[0] == ("domain", "gravity_keyframes")


def test_a_change_is_noted_in_the_run(scene):
    assert run(scene, "--stop-after", "3 steps") == 75
    assert run(scene, "--resume", "--change", "--set", "domain.gravity=[0, 0, -3]") == 0
    path = checkpoint.latest_valid(scene.parent / "out" / file_layout.CHECKPOINTS)
    with checkpoint.open(path) as saved:
        (noted,) = saved.attrs["resume_history"]
    assert noted["step"] == 3
    assert "[0.0, 0.0, -3.0], in the run so far [0.0, 0.0, -9.8]" in noted["changes"][0]


def test_a_finished_run_goes_on_as_if_it_had_never_ended(scene):
    """Frames of 20 ms and then to 40 ms are those of 40 ms at once, in every byte."""
    longer = ("--set", "time.end=40 ms", "--set", "time.frames=5")
    assert run(scene) == 0
    assert run(scene, "--resume", *longer) == 0
    assert run(scene, "-o", str(scene.parent / "whole"), *longer) == 0
    one, other = files(scene.parent / "out"), files(scene.parent / "whole")
    for name in ("ledger.csv", *(f"frames/frame_{k:05d}.vtkhdf" for k in range(5))):
        assert one[name] == other[name], name


def test_other_frame_times_go_on_in_order(scene):
    """Frames were wanted at 0, 10, 20 ms and then every 5 ms up to 30."""
    assert run(scene) == 0
    assert run(scene, "--resume", "--set", "time.end=30 ms", "--set", "time.frames=7") == 0
    from vgmpi.io.run_reader import RunReader

    times = RunReader(scene.parent / "out").times
    assert list(times) == pytest.approx([0, 0.01, 0.02, 0.025, 0.03])


HOLD = """
import sys, time
from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.io import run_lock
with run_lock.run_lock(sys.argv[1], SerialCommunicator(), into=True):
    print("held", flush=True)
    time.sleep(600)
"""


def test_two_runs_do_not_meet_and_a_killed_one_leaves_no_lock(scene, capsys):
    out = scene.parent / "out"
    other = subprocess.Popen(
        [sys.executable, "-c", HOLD, out], cwd=ROOT, stdout=subprocess.PIPE, text=True
    )
    try:
        assert other.stdout.readline() == "held\n"
        assert run(scene) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert f"another run writes here now (process {other.pid} on " in line
        assert sorted(files(out)) == [file_layout.LOCK]
    finally:
        other.kill()
        other.wait()
    assert (out / file_layout.LOCK).exists()
    assert run(scene) == 0
    assert not (out / file_layout.LOCK).exists()


def test_a_lock_that_is_a_link_is_not_followed(scene, capsys):
    victim = scene.parent / "victim"
    victim.write_text("precious")
    (scene.parent / "out").mkdir()
    os.symlink(victim, scene.parent / "out" / file_layout.LOCK)
    assert run(scene) == 1
    assert victim.read_text() == "precious" and "cannot write" in capsys.readouterr().err


def test_a_run_that_comes_to_nothing_leaves_no_folder(scene, capsys, monkeypatch):
    monkeypatch.setattr(
        messages.process_limits, "available_memory", lambda swap=False: 1 << 40 if swap else 1000
    )
    assert run(scene) == 2
    assert "GiB" in capsys.readouterr().err and not (scene.parent / "out").exists()


def test_at_twenty_delays_one_of_two_runs_has_the_folder(tmp_path):
    """Takers that come at any time: one at a time holds it, and it says who."""
    holding, lost = tmp_path / "holding", 0
    code = (
        "import sys, time\n"
        "from vgmpi.parallel.communicator import SerialCommunicator\n"
        "from vgmpi.io import run_lock\n"
        "time.sleep(float(sys.argv[2]))\n"
        "for k in range(40):\n"
        "    try:\n"
        "        with run_lock.run_lock(sys.argv[1], SerialCommunicator(), into=True):\n"
        "            mark = open(sys.argv[3], 'x')\n"
        "            time.sleep(0.002)\n"
        "            import os; os.unlink(sys.argv[3])\n"
        "    except run_lock.RunFolderInUseError:\n"
        "        time.sleep(0.001)\n"
    )
    for pair in range(10):
        both = [
            subprocess.Popen(
                [sys.executable, "-c", code, tmp_path / "out", str(0.001 * k * pair), holding],
                cwd=ROOT,
            )
            for k in range(2)
        ]
        lost += sum(process.wait(PATIENCE) != 0 for process in both)
    assert lost == 0 and not holding.exists()


def test_who_has_it_is_json(tmp_path):
    with run_lock.run_lock(tmp_path / "out", SerialCommunicator(), into=False):
        who = json.loads((tmp_path / "out" / file_layout.LOCK).read_text())
        assert who["pid"] == os.getpid() and who["ranks"] == 1
        assert time.strptime(who["since"], "%Y-%m-%d %H:%M:%S")
    assert not (tmp_path / "out").exists()


def test_a_run_that_was_only_prepared_is_told_from_none(scene, capsys):
    assert run(scene, "--prepare") == 0
    out = scene.parent / "out"
    with pytest.raises(RunError, match="no frames in it .*; its particles are prepared"):
        RunReader(out)
    said = rf"out: a run goes on here and has written no frame yet \(process {os.getpid()} on "
    with (
        run_lock.run_lock(out, SerialCommunicator(), into=True),
        pytest.raises(RunError, match=said),
    ):
        RunReader(out)  # while it compiles
    assert run_lock.current_writer(out) == "" and run_lock.current_writer(out.parent / "none") == ""


def interrupted_at(monkeypatch, steps):
    """A run gets Ctrl-C once in front of each of these steps; the number of steps begun."""
    begun, flags = [0], Requests.poll

    def counted(self, done):
        begun[0] += 1
        if begun[0] in steps:
            signal.raise_signal(signal.SIGINT)
        return flags(self, done)

    monkeypatch.setattr(stop_requests, "_heard", [])
    monkeypatch.setattr(Requests, "poll", counted)
    return begun


def test_ctrl_c_stops_with_a_checkpoint(scene, capsys, monkeypatch):
    begun = interrupted_at(monkeypatch, [3])
    try:
        code = cli.main([str(scene), *NUMPY])
    except KeyboardInterrupt:  # which would end all tests
        pytest.fail("the first Ctrl-C ended the run at once")
    assert code == 75 and begun == [3]
    said = capsys.readouterr()
    assert said.err.count("interrupted: stops with a checkpoint; Ctrl-C again ends at once") == 1
    assert "stopped; go on with --resume" in said.out
    (saved,) = (scene.parent / "out" / file_layout.CHECKPOINTS).glob("*.h5")
    assert saved.name == "checkpoint_000000003.h5"


def test_ctrl_c_again_ends_at_once(scene, monkeypatch):
    begun = interrupted_at(monkeypatch, [2])
    monkeypatch.setattr(Runner, "_checkpoint", lambda self: signal.raise_signal(signal.SIGINT))
    with pytest.raises(KeyboardInterrupt):  # of which the command makes exit code 130
        run(scene, *NUMPY)
    assert begun == [2]


def test_ctrl_c_before_the_first_step_ends_at_once(scene, monkeypatch):
    monkeypatch.setattr(run_report, "Clock", lambda: signal.raise_signal(signal.SIGINT))
    with pytest.raises(KeyboardInterrupt):
        run(scene, *NUMPY)
    assert not list((scene.parent / "out").glob("frames/*"))


def test_ctrl_c_from_python_is_python_s(scene, monkeypatch):
    begun = interrupted_at(monkeypatch, [2])
    with pytest.raises(KeyboardInterrupt):
        vgmpi.run(vgmpi.load(scene), engine="numpy")
    assert begun == [2]


def test_what_a_script_ignores_stays_ignored(scene, monkeypatch):
    """As of a command behind `&` in a script."""
    monkeypatch.setattr(stop_requests, "_heard", [])
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    interrupted_at(monkeypatch, [2])
    assert run(scene, *NUMPY) == 0


def test_the_plan_of_a_resume_is_of_what_is_left(scene, capsys):
    assert cli.main([str(scene), *NUMPY, "--set", "time.end=10 ms", "--set", "time.frames=2"]) == 0
    assert "for 0.01 s and 2 frames" in capsys.readouterr().out
    for flag in ("--plan", "--engine=numpy"):
        assert cli.main([str(scene), flag, "--resume"]) == 0
        assert "for 0.01 of 0.02 s and 1 of 3 frames" in capsys.readouterr().out
    assert cli.main([str(scene), "--plan", "--resume"]) == 0
    assert "steps       about 0 for 0 of 0.02 s and 0 of 3 frames" in capsys.readouterr().out


def test_damaged_particles_are_made_anew_and_not_resumed_from(scene, capsys):
    out = scene.parent / "out"
    assert run(scene, "--prepare") == 0
    whole = (out / file_layout.GAUSSIANS).read_bytes()
    with h5py.File(out / file_layout.GAUSSIANS, "r+") as f:
        f["x0"][7] += 1e-9
    assert cli.main([str(scene), "--stop-after", "3 steps"]) == 75
    assert "x0 is not what was written; the particles are made anew" in capsys.readouterr().err
    assert (out / file_layout.GAUSSIANS).read_bytes() == whole
    with h5py.File(out / file_layout.GAUSSIANS, "r+") as f:
        f["vol0"][7] = np.nan
    assert run(scene, "--resume") == 1
    assert "damaged: vol0 is not what was written" in capsys.readouterr().err


@pytest.mark.parametrize("where", ["../victim", "/elsewhere/victim", "link/victim"])
def test_a_scene_does_not_write_where_it_likes(scene, capsys, where):
    os.symlink(scene.parent.parent, scene.parent / "link")
    text = scene.read_text()
    scene.write_text(text + f'[output]\nfolder = "{where}"\n')
    assert run(scene, "--check") == 2
    (line,) = capsys.readouterr().err.splitlines()
    place = f"{scene}:{len(text.splitlines()) + 2}: output.folder: lies outside"
    assert line.startswith(place) and "-o" in line
    scene.write_text("allow_outside = true\n" + scene.read_text())
    assert run(scene, "--check") == 0


@pytest.mark.parametrize("flag", ["--check", "--plan"])
def test_term_ends_what_only_looks(scene, monkeypatch, flag):
    """The handler that asks a run for a checkpoint is not there."""
    before = signal.getsignal(signal.SIGTERM)
    assert run(scene, flag) == 0
    assert signal.getsignal(signal.SIGTERM) is before
