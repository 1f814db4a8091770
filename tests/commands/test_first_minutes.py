"""What newcomers stumbled on, and what hostile input found: each is gone."""

import re

import numpy as np
import pytest

import vgmpi
from tests.support import small_scenes
from tests.support.small_scenes import BALL, scene
from vgmpi.commands import cli, command_table
from vgmpi.gaussians.shape_distance import distance
from vgmpi.io.csv_log import read_rows
from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.planning.cost.plan_report import format_plan
from vgmpi.planning.cost.throughput import Throughput
from vgmpi.preprocess.shape_sdf import support
from vgmpi.runtime.process_limits import available_cores
from vgmpi.scene.loader import SceneError, load
from vgmpi.scene.shapes import Shape
from vgmpi.solver.initial_particles import plan_for, prepare

ROOM = small_scenes.ROOM.replace('[accuracy]\nprecision = "double"\n', "")  # has the default
TUB = """
[material.water]
preset = "honey"
[[object]]
name = "tub"
material = "water"
shape = { box = [[0, 0, 0], [0.4, 0.4, 0.1]] }
[[outlet]]
name = "drain"
shape = { box = [[0.15, 0.15, -0.02], [0.25, 0.25, 0.02]] }
"""
ROTOR = """
[[object]]
name = "rotor"
role = "scenery"
collider = true
shape = { box = [[0.1, 0.18, 0.02], [0.3, 0.22, 0.06]] }
motion = { MOTION }
"""
PACE = Throughput(20.0, 30.0, "of this test")


def write(folder, text):
    path = folder / "scene.toml"
    path.write_text(text)
    return path


def planned(folder, text):
    made = scene(folder, text)
    plan = plan_for(made, prepare(made, SerialCommunicator(), None))
    return format_plan(made, plan, 1, pace=PACE)


def test_the_version_is_told(capsys):
    assert command_table.main(["--version"]) == 0
    assert re.fullmatch(r"vgmpi \d+\.\d+\S*, Python 3\.\S+\n", capsys.readouterr().out)
    assert vgmpi.__version__ in ("not installed", *re.findall(r"[\d.]+", vgmpi.__version__))


def test_a_preset_implies_its_kind(tmp_path):
    made = scene(tmp_path, ROOM + TUB.replace("[[outlet]]", "[[outlet]]\nstart_time = 0.5"))
    assert made.material["water"].kind == "fluid" and made.material["water"].viscosity > 1
    text = ROOM.replace('kind = "elastic"\ndensity = 400\nyoungs_modulus = 1e5', 'preset = "balsa"')
    assert scene(tmp_path, text + BALL).material["clay"].kind == "elastic"


@pytest.mark.parametrize(
    "keys, says",
    [
        ('preset = "hony"', 'preset: there is no such preset (did you mean "honey"?)'),
        ('kind = "elastic"\npreset = "honey"', 'preset: preset "honey" is of kind "fluid"'),
        ("density = 3", "kind: required key is missing"),
    ],
)
def test_a_wrong_preset_is_told_with_its_kind(tmp_path, keys, says):
    with pytest.raises(SceneError) as caught:
        scene(tmp_path, ROOM + BALL + f"[material.syrup]\n{keys}\n")
    said = "\n".join(caught.value.lines).replace("'", '"')
    assert f"material.syrup.{says}" in said


def test_a_drain_of_a_full_tub_opens_later(tmp_path):
    with pytest.raises(SceneError, match="removes a body at the start.*start_time opens it later"):
        prepare(scene(tmp_path, ROOM + TUB), SerialCommunicator(), None)
    made = scene(tmp_path, ROOM.replace("end = 1", "end = 0.03") + TUB + "start_time = 0.01\n")
    run = vgmpi.run(made, tmp_path / "out")
    assert run.code == 0
    counts = [
        (row["time"], row["particles_out"]) for row in read_rows(tmp_path / "out" / "ledger.csv")
    ]
    assert all(n == 0 for t, n in counts if t < 0.01) and counts[-1][1] > 50


@pytest.mark.parametrize("axis", ["-x", "-y", "-z", "x"])
def test_every_axis_has_both_directions(tmp_path, axis):
    tap = f"""
[[inlet]]
name = "tap"
material = "clay"
disc = {{ center = [0.2, 0.2, 0.2], radius = 0.05 }}
direction = "{axis}"
speed = 1
phase = "clay"
"""
    (direction,) = [inlet.direction for inlet in scene(tmp_path, ROOM + BALL + tap).lists["inlet"]]
    sign, name = -1.0 if axis[0] == "-" else 1.0, axis[-1]
    assert direction == tuple(sign * (name == a) for a in "xyz")
    default = tap.replace(f'direction = "{axis}"\n', "")
    assert scene(tmp_path, ROOM + BALL + default).lists["inlet"][0].direction == (0.0, 0.0, -1.0)


BOWL = Shape.model_validate(
    {
        "difference": [
            {"sphere": {"center": [0, 0, 0], "radius": 1}},
            {"box": [[-2, -2, 0], [2, 2, 2]]},
            {"sphere": {"center": [0, 0, 0], "radius": 0.8}},
        ]
    }
)
LENS = Shape.model_validate(
    {
        "intersection": [
            {"sphere": {"center": [0, 0, -0.8], "radius": 1}},
            {"sphere": {"center": [0, 0, 0.8], "radius": 1}},
        ]
    }
)


@pytest.mark.parametrize(
    "shape, low, high",
    [(BOWL, (-1, -1, -1), (1, 1, 0)), (LENS, (-0.6, -0.6, -0.2), (0.6, 0.6, 0.2))],
    ids=["bowl", "lens"],
)
def test_extents_know_all_parts(shape, low, high):
    """The rim of the lens is at sqrt(1 - 0.8^2)."""
    for a, axis in enumerate(np.eye(3)):
        assert support(shape, axis) == pytest.approx(high[a], abs=1e-7)
        assert -support(shape, -axis) == pytest.approx(low[a], abs=1e-7)


def test_an_intersection_is_what_lies_in_all_parts():
    x = np.random.default_rng(3).uniform(-1, 1, (2000, 3))
    parts = [np.linalg.norm(x - [0, 0, z], axis=1) < 1 for z in (-0.8, 0.8)]
    np.testing.assert_array_equal(distance(LENS, x) < 0, parts[0] & parts[1])


@pytest.mark.parametrize("threads", ["0", "1000000"])
def test_threads_are_bounded_before_memory_is_taken(tmp_path, capsys, threads, monkeypatch):
    monkeypatch.setattr("vgmpi.solver.run.prepare", lambda *_: pytest.fail("it went on"))
    path = write(tmp_path, ROOM + BALL)
    try:
        code = cli.main([str(path), "--threads", threads])
    except SystemExit as end:
        code = end.code
    assert code == 2 and not (tmp_path / "out").exists()
    assert "threads" in capsys.readouterr().err
    assert int(threads) != 1000000 or available_cores() < 250_000


@pytest.mark.parametrize("what", ["a file", "a link to nothing"])
def test_an_output_folder_that_is_something_else(tmp_path, capsys, what):
    path, out = write(tmp_path, ROOM + BALL), tmp_path / "taken"
    if what == "a file":
        out.write_text("mine")
    else:
        out.symlink_to(tmp_path / "nothing")
    assert cli.main([str(path), "-o", str(out)]) == 2
    assert f"taken: is {what}, a folder is needed" in capsys.readouterr().err
    assert what != "a file" or out.read_text() == "mine"


def test_a_plan_knows_the_speed_of_colliders(tmp_path):
    """At 500 rad/s the corners travel 5 cells in 1 ms; a step takes them at most 0.3 cells."""
    text = ROOM.replace("end = 1", "end = 0.05") + BALL
    slow = planned(tmp_path, text + ROTOR.replace("MOTION", "angular_velocity = 1"))
    fast = planned(tmp_path, text + ROTOR.replace("MOTION", "angular_velocity = 500"))

    def steps(report):
        return int(re.search(r"steps +(?:about )?([\d,]+)", report)[1].replace(",", ""))

    far = np.hypot(0.1, 0.02)
    assert steps(fast) == pytest.approx(500 * 0.05 * far / (0.3 * 0.02), rel=0.03)
    assert steps(slow) < 0.5 * steps(fast)
    assert "shorter where colliders or prescribed bodies move fast" in fast
    assert "shorter where" not in slow


def test_a_motion_of_too_many_steps_is_refused(tmp_path):
    motion = 'keyframes = [{ time = "50 ms", angle = 1e18 }]'
    text = ROOM.replace("end = 1", "end = 0.05") + BALL + ROTOR.replace("MOTION", motion)
    with pytest.raises(SceneError, match=r":\d+: object.rotor.motion.*steps of 0.3 cells"):
        prepare(load(write(tmp_path, text)), SerialCommunicator(), None)


def test_a_plan_without_a_measurement_says_unknown(tmp_path):
    made = scene(tmp_path, ROOM + BALL)
    plan = plan_for(made, prepare(made, SerialCommunicator(), None))
    assert "time        unknown: this processor is not measured yet" in format_plan(made, plan, 1)
    assert "time        about" in format_plan(made, plan, 1, pace=PACE)


@pytest.mark.parametrize(
    "change, allowed",
    [
        ("object.ball.shape.sphere.radius=0.06", False),
        ("object.ball.velocity=[1, 0, 0]", False),
        ("seed=5", False),
        ("material.clay.youngs_modulus=2e5", True),
    ],
)
def test_a_resume_refuses_what_it_cannot_change(tmp_path, capsys, change, allowed):
    path = write(tmp_path, ROOM.replace("end = 1", "end = 0.02") + BALL)
    assert cli.main([str(path), "--stop-after", "2 steps"]) == 75
    assert cli.main([str(path), "--resume", "--change", "--set", change]) == (0 if allowed else 2)
    said = capsys.readouterr().err
    assert ("a new run makes others" in said) == (not allowed)


def test_a_resumed_run_keeps_its_precision(tmp_path, capsys):
    text = ROOM.replace("end = 1", "end = 0.02") + BALL
    path = write(tmp_path, text.replace("[time]", '[accuracy]\nprecision = "double"\n[time]'))
    assert cli.main([str(path), "--stop-after", "2 steps"]) == 75
    write(tmp_path, text)
    assert load(path).accuracy.precision == "single"
    capsys.readouterr()
    assert cli.main([str(path), "--resume"]) == 0
    assert "double precision" in capsys.readouterr().out.splitlines()[0]
    assert cli.main([str(path), "--resume", "--set", "accuracy.precision=single"]) == 2


def test_texts_of_objects_are_short(tmp_path):
    made = scene(tmp_path, ROOM.replace("end = 1", "end = 0.002") + BALL)
    assert repr(made) == "<Scene 'scene.toml': 1 bodies, 20 x 20 x 20 cells, 0.002 s>"
    run = vgmpi.run(made, tmp_path / "out")
    assert repr(run).startswith("<Run done at 0.002 s, step ")
    assert repr(vgmpi.read(tmp_path / "out")).endswith("out': 50 frames>")


def test_a_run_from_python_shows_its_progress_when_asked(tmp_path, capsys):
    made = scene(tmp_path, ROOM.replace("end = 1", "end = 0.002") + BALL)
    vgmpi.run(made, progress=True)
    assert "s [" in capsys.readouterr().err
    vgmpi.run(made)
    assert capsys.readouterr().err == ""
