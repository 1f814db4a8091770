"""Pinned parts that let go at a time.

References: momentum grows by M g t from the release on, to rounding, and the center of mass falls
by g t^2 / 2; a part with a motion begins with the velocity of this motion.
"""

import numpy as np
import pytest

from tests.support.simulate import advance, begin, by_id, totals
from tests.support.small_scenes import scene
from vgmpi.runtime.config.schema import SceneError

G, RELEASE = 9.8, 0.1
HANGING = """
[accuracy]
precision = "double"
[domain]
size = [0.32, 0.16, 0.6]
cell = 0.02
[time]
end = 1
[material.rubber]
kind = "elastic"
density = 1000
youngs_modulus = 3e5
[material.gum]
kind = "elastic"
density = 1500
youngs_modulus = 2e5
[[object]]
name = "bar"
material = "rubber"
shape = { box = [[0.04, 0.04, 0.3], [0.12, 0.12, 0.5]] }
region = [{ material = "gum", box = [[0.04, 0.04, 0.46], [0.08, 0.12, 0.5]] }]
pinned = { box = [[0.02, 0.02, 0.44], [0.14, 0.14, 0.52]], release_time = 0.1MOTION }
"""
STILL = HANGING.replace("MOTION", "")
MOVED = HANGING.replace("MOTION", ", motion = { velocity = [0.5, 0, 0] }")


def center(simulation, made) -> np.ndarray:
    """Center of mass (3,) [m]."""
    (x,) = by_id(simulation, "x")
    mass = made.vol0 * np.where((made.x[:, 2] > 0.46) & (made.x[:, 0] < 0.08), 1500, 1000)
    return (mass[:, None] * x).sum(0) / mass.sum()


def test_it_falls_with_g(tmp_path):
    """It hangs until the release and falls freely afterwards, while it vibrates."""
    simulation, made = begin(tmp_path, STILL)
    top = made.x[:, 2] > 0.44
    advance(simulation, RELEASE)
    assert simulation.time == RELEASE
    x, v = by_id(simulation, "x", "v")
    np.testing.assert_array_equal(x[top], made.x[top])
    assert not v[top].any()
    at, before, steps = center(simulation, made), totals(simulation), simulation.step
    advance(simulation, RELEASE + 0.08)
    after, t = totals(simulation), 0.08
    assert after["mass"] == pytest.approx(before["mass"], rel=1e-13)
    fallen = before["momentum"] - [0, 0, before["mass"] * G * t]
    np.testing.assert_allclose(after["momentum"], fallen, rtol=0, atol=1e-12 * before["mass"])
    way = before["momentum"] / before["mass"] * t - [0, 0, 0.5 * G * t**2]
    lag = 0.5 * G * t * t / (simulation.step - steps)  # half the fall of a step
    np.testing.assert_allclose(center(simulation, made) - at, way, rtol=0, atol=1.2 * lag)
    (x,) = by_id(simulation, "x")
    assert (x[top, 2] < made.x[top, 2] - 0.02).all()


def test_a_part_keeps_the_velocity_of_its_motion(tmp_path):
    simulation, made = begin(tmp_path, MOVED)
    top = made.x[:, 2] > 0.44
    advance(simulation, RELEASE)
    x, v = by_id(simulation, "x", "v")
    np.testing.assert_allclose(v[top], np.tile([0.5, 0, 0], (top.sum(), 1)), atol=1e-12)
    np.testing.assert_allclose(x[top, 0], made.x[top, 0] + 0.05, atol=1e-12)
    before = totals(simulation)
    advance(simulation, RELEASE + 0.05)
    change = totals(simulation)["momentum"] - before["momentum"]
    np.testing.assert_allclose(
        change, [0, 0, -before["mass"] * G * 0.05], rtol=0, atol=1e-12 * before["mass"]
    )


def test_without_a_time_it_never_lets_go(tmp_path):
    """And it costs nothing: the run has no releases."""
    simulation, _ = begin(tmp_path, STILL.replace(", release_time = 0.1", ""))
    assert "releases" not in simulation.features


POT = '[[object]]\nname = "pot"\nrole = "scenery"\ncollider = true\n'
POT += "shape = { box = [[0.02, 0.02, 0.44], [0.14, 0.14, 0.52]] }\n"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("release_time = 0.1", "release_time = 0", "pinned.release_time: must be > 0 s"),
        ("release_time = 0.1", 'release_time = "1 m"', "pinned.release_time: 'm' does not measure"),
        (
            "release_time = 0.1",
            'release_time = 0.1, to = "pot"',
            'pinned.release_time: is only for to = "world": it lets go',
        ),
    ],
)
def test_what_is_refused(tmp_path, old, new, message):
    with pytest.raises(SceneError) as error:
        scene(tmp_path, STILL.replace(old, new) + POT)
    assert message in str(error.value)
