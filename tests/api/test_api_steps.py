"""A loop over the steps of a run: what it sees, what it may not write, and how it ends."""

import numpy as np
import pytest

import vgmpi
from tests.support import simulated_ranks
from vgmpi.io import checkpoint
from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.solver import run as runs

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
[output]
fields = ["velocity", "J", "F", "stress", "pressure", "strain"]
[material.water]
kind = "fluid"
[material.rubber]
kind = "elastic"
youngs_modulus = "0.1 MPa"
[[object]]
name = "drop"
material = "water"
shape = { sphere = { center = [0.12, 0.12, 0.16], radius = 0.04 } }
[[object]]
name = "ball"
material = "rubber"
velocity = [0, 0, 2]
shape = { sphere = { center = [0.12, 0.12, 0.06], radius = 0.04 } }
"""


@pytest.fixture(scope="module")
def scene():
    return vgmpi.load("a.toml", text=SCENE)


@pytest.fixture(scope="module")
def whole(scene, tmp_path_factory):
    """The run of the scene in one piece."""
    run = vgmpi.run(scene, tmp_path_factory.mktemp("whole") / "out")
    return run, vgmpi.read(run._inner.options.folder)


def test_a_loop_makes_every_step(scene, whole, tmp_path):
    steps, times, at_frames = [], [], []
    with vgmpi.simulate(scene, tmp_path / "out") as sim:
        assert (sim.time, sim.step, sim.frame, sim.code) == (0.0, 0, 0, None)
        for step in sim:
            steps.append(step)
            times.append(sim.time)
            if sim.is_at_frame:
                at_frames.append(sim.time)
            assert sim.code is None
    assert sim.code == 0 and list(sim) == []
    assert steps == list(range(1, whole[0].step + 1)) and times == sorted(set(times))
    assert at_frames == [0.005, 0.01]
    one, other = (run.arrays("positions", "velocity", "F") for run in (sim, whole[0]))
    assert all((one[name] == other[name]).all() for name in one)
    assert len(vgmpi.read(tmp_path / "out")) == 3


def test_arrays_are_those_of_the_files_and_read_only(whole):
    run, files = whole
    frame = files.frame(-1)
    found = run.arrays(*frame, "vol0", "C")
    for name in frame:
        assert frame[name].shape == found[name].shape
        rounding = 2e-7 if name == "F" else 0.0  # that of water comes from J, which is rounded
        kind = frame[name].dtype
        np.testing.assert_allclose(found[name].astype(kind), frame[name], rounding, 1e-12)
    assert np.abs(found["stress"]).max() > 100 and set(found["phase"]) == {0, 1}
    assert (found["vol0"] == files.gaussians.vol0[found["id"]]).all() and found["C"].any()
    for name, array in found.items():
        assert array.dtype in (np.float64, np.int64), name
        with pytest.raises(ValueError, match="read-only"):
            array[:] = 0


def test_a_name_that_no_file_has(whole):
    with pytest.raises(KeyError, match=r"there is no array 'v'.*; there are id, positions, "):
        whole[0].array("v")
    with pytest.raises(KeyError, match=r"no array 'velocities' \(did you mean 'velocity'\?\)"):
        whole[0].arrays("positions", "velocities")


def test_a_loop_that_is_left_goes_on(scene, whole):
    with vgmpi.simulate(scene) as sim:
        for step in sim:
            if step == 3:
                break
        assert sim.step == 3 and sim.code is None
        last = list(sim)[-1]
    assert last == whole[0].step
    assert (sim.array("positions") == whole[0].array("positions")).all()


def test_stop_ends_with_a_checkpoint(scene, whole, tmp_path):
    """The command goes on from it, to the same bits."""
    with vgmpi.simulate(scene, tmp_path / "out") as sim:
        for step in sim:
            if step == 5:
                sim.stop()
                assert sim.step == 5 and sim.code is None
    assert (sim.step, sim.code) == (5, 75)
    assert len(vgmpi.read(tmp_path / "out")) == 1
    path = checkpoint.select("", tmp_path / "out" / "checkpoints", SerialCommunicator())
    with checkpoint.open(path) as saved:
        assert (saved.attrs["step"], saved.attrs["time"]) == (5, sim.time)
    options = runs.Options(tmp_path / "out", resume="")
    with runs.prepared_run(scene, SerialCommunicator(), options) as resumed:
        assert resumed.run() == 0
    one, other = vgmpi.read(tmp_path / "out").frame(-1), whole[1].frame(-1)
    assert all((one[name] == other[name]).all() for name in one)


def test_stop_with_a_frame(scene, tmp_path):
    with vgmpi.simulate(scene, tmp_path / "out") as sim:
        for step in sim:
            if step == 5:
                sim.stop(frame=True)
    files = vgmpi.read(tmp_path / "out")
    assert [*files.times] == [0.0, sim.time]
    assert (files.frame(1)["positions"] == sim.array("positions").astype(np.float32)).all()


def test_stop_before_the_first_step_and_in_on_frame(scene, tmp_path):
    with vgmpi.simulate(scene, tmp_path / "out") as sim:
        sim.stop(frame=True)
        assert list(sim) == []
    assert (sim.step, sim.code) == (0, 75) and len(vgmpi.read(tmp_path / "out")) == 1
    run = vgmpi.run(scene, on_frame=lambda run: run.stop() if run.frame == 1 else None)
    assert (run.time, run.code) == (0.005, 75)
    run = vgmpi.run(scene, on_frame=lambda run: run.stop() if run.frame == 2 else None)
    assert (run.time, run.code) == (0.01, 0)  # it was the last step


def test_ranks_stop_together(scene):
    """Also if only one of them asks."""

    def stopped(ranks):
        with vgmpi.simulate(scene, ranks=ranks) as sim:
            for step in sim:
                if step == 4 and ranks.rank == ranks.size - 1:
                    sim.stop()
        return sim.step, sim.code, sim.time

    alone = simulated_ranks.run(1, stopped)[0]
    assert alone[:2] == (4, 75)
    assert simulated_ranks.run(3, stopped) == [alone] * 3


def test_a_blow_up_ends_the_loop():
    text = SCENE.replace("[accuracy]", '[accuracy]\nvolume_correction = "none"')
    text = text.replace("radius = 0.04 } }\n[[", "radius = 0.04 } }\nvelocity = [0, 0, 300]\n[[")
    with vgmpi.simulate(vgmpi.load("a.toml", text=text)) as sim:
        steps = list(sim)
    assert sim.code == 3 and len(steps) >= 1
