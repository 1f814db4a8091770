"""Probes against what is known of a still column, a flying ball and a loaded box."""

import math

import numpy as np
import pytest

import vgmpi
from vgmpi.scene.probes import Probe
from vgmpi.solver.diagnostics import probe_sampling

# 3 x 3 x 10.5 cells of water, at rest: the surface lies in the middle of a cell
STILL = """
[accuracy]
pressure = "explicit"
precision = "double"
[domain]
size = [0.12, 0.12, 0.48]
cell = 0.02
[time]
end = 0.05
frames = 3
[material.water]
kind = "fluid"
tait_coefficient = 2e5
[[object]]
name = "water"
material = "water"
initial_pressure = "hydrostatic"
shape = { box = [[0, 0, 0], [0.12, 0.12, 0.21]] }
[[probe]]
name = "deep"
sampling_interval = "1 ms"
pressure = [0.06, 0.06, 0.05]
[[probe]]
name = "corner"
sampling_rate = "1000 Hz"
pressure = [0, 0.12, 0.1]
[[probe]]
name = "gauge"
sampling_rate = 100
surface_height = [0.05, 0.06]
[[probe]]
name = "edge"
sampling_rate = 100
surface_height = [0, 0]
[[probe]]
name = "stir"
sampling_rate = 100
velocity = [0.06, 0.06, 0.1]
[[probe]]
name = "air"
sampling_rate = 100
pressure = [0.06, 0.06, 0.4]
[[probe]]
name = "box"
sampling_rate = "40 Hz"
wall = "all"
[[probe]]
name = "body"
sampling_rate = "40 Hz"
object = "water"
"""


@pytest.fixture(scope="module")
def still(tmp_path_factory):
    folder = tmp_path_factory.mktemp("still")
    return vgmpi.run(vgmpi.load(folder / "scene.toml", text=STILL))


def column(run, name, key):
    return np.array([row[key] for row in run.probes[name]])


def test_pressure_is_the_weight_above(still):
    """p = rho g depth, plus what the compression of 1 per mille adds; half a per cent of it."""
    for name, z in (("deep", 0.05), ("corner", 0.1)):
        p = column(still, name, "pressure")
        assert len(p) > 20
        want = 1000 * 9.8 * (0.21 - z)
        assert np.abs(p / want - 1).max() < 0.005, (name, p / want - 1)


def test_surface_height(still):
    """Within a thousandth of a cell, in the middle and in a corner."""
    for name in ("gauge", "edge"):
        height = column(still, name, "surface_height")
        assert np.abs(height - 0.21).max() < 1e-3 * 0.02, (name, height - 0.21)


@pytest.mark.parametrize(
    "low, high, height", [(0, 0.01, 0.01), (0, 0.03, 0.03), (0.3, 0.48, 0.48), (0, 0.48, 0.48)]
)
def test_surface_height_at_bottom_and_top(tmp_path, low, high, height):
    """A puddle thinner than a cell, one and a half cells deep, and water up to the top."""
    text = STILL.replace("0, 0, 0]", f"0, 0, {low}]").replace(
        "0.12, 0.12, 0.21", f"0.12, 0.12, {high}"
    )
    text = text.replace('initial_pressure = "hydrostatic"', "").replace("end = 0.05", "end = 1e-5")
    run = vgmpi.run(vgmpi.load(tmp_path / "scene.toml", text=text))
    assert column(run, "gauge", "surface_height")[0] == pytest.approx(height, rel=1e-9)


def test_still_water_is_still(still):
    """Compressed by its own weight it does not bounce: sqrt(2 g h) is 2 m/s."""
    speed = np.sqrt(sum(column(still, "stir", f"velocity_{a}") ** 2 for a in "xyz"))
    assert speed.max() < 1e-3


def test_nothing_there(still):
    assert np.isnan(column(still, "air", "pressure")).all()


def test_the_floor_bears_the_weight(still):
    """And the force on the water, its weight aside, is what the floor gives back."""
    mass = column(still, "body", "mass")[0]
    assert mass == pytest.approx(0.12 * 0.12 * 0.21 * 1000, rel=2e-3)
    floor, water = column(still, "box", "force_z"), column(still, "body", "force_z")
    assert math.isnan(floor[0]) and math.isnan(water[0])
    assert np.abs(floor[1:] / (-9.8 * mass) - 1).max() < 1e-3
    assert np.abs(floor[1:] + water[1:]).max() < 1e-9 * 9.8 * mass


def test_rows_come_at_their_times(still):
    """At the start, then after the first step at or after each due time; never two for one."""
    for probe in vgmpi.load("s.toml", text=STILL).probe:
        times = column(still, probe.name, "time")
        assert times[0] == 0 and times[-1] <= 0.05
        due = np.floor(times / probe.period + 1e-6)
        assert (np.diff(due) > 0).all()
    assert [row["time"] for row in still.probes["box"]][1::2] != []
    assert column(still, "box", "time")[-1] == 0.05


FLYING = """
[accuracy]
pressure = "explicit"
precision = "double"
[domain]
size = [0.4, 0.4, 0.4]
cell = 0.02
[time]
end = 0.02
frames = 3
[material.rubber]
kind = "elastic"
youngs_modulus = 2e4
[[object]]
name = "ball"
material = "rubber"
shape = { sphere = { center = [0.2, 0.2, 0.2], radius = 0.06 } }
velocity = [1, 0, 0]
angular_velocity = [0, 0, 3]
[[load]]
object = "ball"
force = [0, 2, 0]
[[probe]]
name = "ball"
sampling_interval = "1 us"
object = "ball"
[[probe]]
name = "all"
sampling_interval = "1 us"
wall = "all"
[[probe]]
name = "core"
sampling_interval = "5 ms"
velocity = [0.214, 0.2, 0.2]
"""


def test_a_flying_ball(tmp_path):
    seen = []
    scene = vgmpi.load(tmp_path / "scene.toml", text=FLYING)
    with vgmpi.simulate(scene) as run:
        for _ in run:
            seen.append((run.time, run.array("positions")))
    rows = run.probes["ball"]
    assert [row["time"] for row in rows[1:]] == [time for time, _ in seen]  # every step
    for row, (_, x) in zip(rows[1:], seen):
        center = np.array([row[f"center_{a}"] for a in "xyz"])
        assert np.abs(center - x.mean(0)).max() < 1e-12  # particles of one mass
    for row in rows[1:]:
        assert row["velocity_x"] == pytest.approx(1, rel=1e-12)
        assert row["velocity_z"] == pytest.approx(-9.8 * row["time"], rel=1e-10)
        assert row["force_y"] == pytest.approx(2, rel=1e-7)
        assert max(abs(row["force_x"]), abs(row["force_z"])) < 1e-8 * 1e3
        assert row["momentum_y"] == pytest.approx(2 * row["time"], rel=1e-10)
    walls = [[row[f"force_{a}"] for a in "xyz"] for row in run.probes["all"][1:]]
    assert np.abs(walls).max() < 1e-5  # it touches nothing
    (first, *_) = run.probes["core"]
    assert first["velocity_x"] == pytest.approx(1, abs=1e-12)
    assert first["velocity_y"] == pytest.approx(3 * 0.014, rel=1e-9)  # hats keep linear fields


def test_when_rows_are_due():
    probe = Probe(name="a", sampling_interval=0.1, surface_height=(0, 0))
    assert not probe.due(0.0, 0.09) and probe.due(0.09, 0.1) and probe.due(0.05, 0.31)
    assert probe.due(0.29, np.nextafter(0.3, 0)) and not probe.due(np.nextafter(0.3, 0), 0.31)
    assert Probe(name="a", sampling_rate=20, surface_height=(0, 0)).period == 0.05


@pytest.mark.parametrize(
    "filled, height",
    [
        ([1, 1, 1, 0, 0], 3.0),
        ([1, 1, 0.7, 0, 0], 2.7),
        ([1, 1, 0.3, 0, 0], 2.3),
        ([1, 0.9, 0.6, 0.1, 0], 2.6),
        ([0.2, 0, 0, 0, 0], 0.2),
        ([0, 0, 0, 0, 0], 0.0),
        ([1, 1, 0.2, 0, 0.1], 2.2),  # spray above
        ([1, 1, 1, 1, 0.9], 4.9),
        ([0.3, 0.1, 0.1, 0.9, 0], 3.0),  # a wave that breaks: its own surface
    ],
)
def test_surface_of_filled_layers(filled, height):
    assert probe_sampling._surface(np.array(filled, float)) == pytest.approx(height)
