"""The names a script uses, and that the example of docs/tutorial/python.md runs as it stands."""

import ast
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import vgmpi
import vgmpi.planning.plan  # takes no name from the package
from tests.support import simulated_ranks
from tests.support.launch import mpirun

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "tutorial" / "python.md").read_text()
EXAMPLE, CONTROL, NOTEBOOK, SERIES, SWEEP = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)

SCENE = """
[accuracy]
pressure = "explicit"
precision = "double"
[domain]
size = [0.24, 0.24, 0.24]
cell = 0.02
[time]
end = 0.01
frames = 3
[material.water]
kind = "fluid"
[[object]]
name = "drop"
material = "water"
shape = { sphere = { center = [0.12, 0.12, 0.12], radius = 0.05 } }
"""


def expected(printed):
    lines = printed.splitlines()
    assert lines[0] == "552 particles"
    assert [line[:7] for line in lines[1:4]] == ["0.000 s", "0.010 s", "0.020 s"]
    # half a newton for 20 ms, of which the ramp takes 5 ms
    assert lines[4] == "momentum 0.007500 kg m/s, force 0.500000 N"
    times, speed = (row.split("]")[0].split() for row in lines[5].split("[")[1:])
    assert [*map(float, times)] == [0.0, 0.01, 0.02]
    assert float(speed[0]) == 0.0124  # momentum over the ball's 0.607 kg


def test_the_example_of_the_docs(tmp_path):
    (tmp_path / "script.py").write_text(EXAMPLE)
    env = {**os.environ, "PYTHONPATH": str(ROOT)}
    job = subprocess.run(
        [sys.executable, "script.py"], cwd=tmp_path, env=env, capture_output=True, text=True
    )
    assert job.returncode == 0, job.stderr
    expected(job.stdout)
    assert (tmp_path / "out" / "probe_ball.csv").exists()


def test_the_controlled_experiment_of_the_docs(tmp_path):
    """A ball that a spring and a damper hold rests m g / k below the target."""
    (tmp_path / "script.py").write_text(CONTROL)
    env = {**os.environ, "PYTHONPATH": str(ROOT)}
    job = subprocess.run(
        [sys.executable, "script.py"], cwd=tmp_path, env=env, capture_output=True, text=True
    )
    assert job.returncode == 0, job.stderr
    rest, height, force = job.stdout.splitlines()
    assert re.fullmatch(r"at rest after 0\.[34]\d s, code 75", rest), rest
    assert height == "6.125 mm below the target, exactly 6.125 mm"
    measured, weight = (float(number) for number in re.findall(r"[\d.]+(?= N)", force))
    assert measured == pytest.approx(weight, rel=1e-4) and 5 < weight < 6
    files = vgmpi.read(tmp_path / "held")
    assert files.frame(-1)["positions"][:, 2].mean() == pytest.approx(0.2 - 6.125e-3, abs=1e-5)
    assert list((tmp_path / "held" / "checkpoints").glob("*.h5"))


def test_the_series_and_the_sweep_of_the_docs(tmp_path):
    """One after the other, as the page has them."""
    end = "\nprint(points.n_points, flat)\n"
    (tmp_path / "script.py").write_text(EXAMPLE + NOTEBOOK + SERIES + SWEEP + end)
    env = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "script.py"]
    job = subprocess.run(command, cwd=tmp_path, env=env, capture_output=True, text=True)
    assert job.returncode == 0, job.stderr
    points, table = job.stdout.splitlines()[-1].split(maxsplit=1)
    assert points == "552"
    flat = ast.literal_eval(table)
    assert list(flat) == [2e4, 5e4, 1e5, 2e5]
    assert list(flat.values()) == sorted(set(flat.values())) and flat[2e4] < 0.06 < flat[2e5] < 0.1


def test_what_does_not_fit_is_one_line(tmp_path):
    (tmp_path / "scene.toml").write_text(SCENE)
    scene = vgmpi.load(tmp_path / "scene.toml")
    with pytest.raises(ValueError, match="engine must be one of cpu, numpy, cuda; got 'nonsense'"):
        vgmpi.run(scene, engine="nonsense")
    with pytest.raises(ValueError, match="threads must be at least 1"):
        vgmpi.run(scene, threads=0)


@pytest.mark.mpi
def test_the_example_on_two_ranks(tmp_path):
    """Both print; what they print is the same but for rank 0's line."""
    (tmp_path / "script.py").write_text(EXAMPLE)
    job = mpirun(2, "script.py", cwd=tmp_path)
    assert job.returncode == 0, job.stderr
    assert job.stdout.count("552 particles") == 2 and job.stdout.count("0.010 s: center") == 2
    assert job.stdout.count("momentum 0.007500 kg m/s, force 0.500000 N") == 1


def test_names():
    assert callable(vgmpi.plan) and callable(vgmpi.run) and vgmpi.plan.__module__ == "vgmpi.api"
    with pytest.raises(AttributeError, match="has no attribute 'lode'"):
        _ = vgmpi.lode
    with pytest.raises(vgmpi.SceneError, match="no such|No such"):
        vgmpi.load("nowhere.toml")


def test_overrides():
    given = {
        "domain.cell": "4 cm",
        "domain.gravity": [0, "-1 m/s2", 0.5],
        "allow_outside": True,
        "time.frames": 7,
    }
    scene = vgmpi.load("a.toml", given, text=SCENE)
    assert scene.domain.cell == 0.04 and scene.domain.gravity == (0, -1, 0.5)
    assert scene.time.frames == 7
    assert vgmpi.load("a.toml", ["domain.cell=1 cm"], text=SCENE).domain.cell == 0.01
    with pytest.raises(vgmpi.SceneError, match="^a.toml:7: domain.cell: must be"):
        vgmpi.load("a.toml", text=SCENE.replace("cell = 0.02", "cell = 0"))


def test_nothing_is_written_without_a_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    frames = []
    scene = vgmpi.load("a.toml", text=SCENE)

    def look(run):
        frames.append((run.frame, run.time, run.array("velocity")[:, 2].mean()))

    run = vgmpi.run(scene, on_frame=look)
    assert list(tmp_path.iterdir()) == []
    assert [f[:2] for f in frames] == [(0, 0.0), (1, 0.005), (2, 0.01)]
    assert [f[2] for f in frames] == pytest.approx([0, -0.049, -0.098], rel=1e-9, abs=1e-15)
    assert run.ledger[0]["mass"] == pytest.approx(vgmpi.plan(scene).particles * 1e-3, rel=1e-12)
    found = run.arrays("id", "J", "vol0", "object", "C", "positions")
    assert (found["id"] == np.arange(len(found["id"]))).all()
    assert {name: a.shape[1:] for name, a in found.items() if a.ndim > 1} == {
        "C": (9,),
        "positions": (3,),
    }


def test_the_same_with_and_without_files_and_ranks(tmp_path):
    scene = vgmpi.load("a.toml", text=SCENE)
    one = vgmpi.run(scene, tmp_path / "out").arrays("positions", "velocity")
    for n in (1, 3):
        for found in simulated_ranks.run(
            n, lambda r: vgmpi.run(scene, ranks=r).arrays("positions", "velocity")
        ):
            assert all((found[name] == one[name]).all() for name in one)
    assert (
        vgmpi.read(tmp_path / "out").frame(-1)["positions"] == one["positions"].astype(np.float32)
    ).all()


def test_plain_numpy_has_one_rank_and_one_thread(tmp_path):
    scene = vgmpi.load("a.toml", text=SCENE)
    for n, threads in ((1, 2), (2, 1)):

        def refused(ranks, threads=threads):
            with pytest.raises(ValueError, match="engine numpy computes on one rank") as caught:
                vgmpi.run(scene, tmp_path / "out", ranks=ranks, threads=threads, engine="numpy")
            return str(caught.value)

        want = f"engine numpy computes on one rank and one thread; asked for {n} x {threads}"
        assert simulated_ranks.run(n, refused) == [want] * n
    assert not (tmp_path / "out").exists()


def test_a_blow_up_is_a_code():
    text = SCENE.replace("[accuracy]", '[accuracy]\nvolume_correction = "none"')
    text += "velocity = [0, 0, 300]\n"
    assert vgmpi.run(vgmpi.load("a.toml", text=text)).code == 3
