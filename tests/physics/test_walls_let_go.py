"""Walls hold what presses on them and let solids and grains go.

Weights and impacts that a clamp at the wall's nodes or the elastic layer of contact does not carry
leave no particle more than a tenth of a cell beyond the wall. A body that nothing holds flies: its
momentum changes by gravity alone (Newton). A gripper lifts a cube without slip, since its pads
press it with 2 mu N > m g.
"""

import numpy as np
import pytest

from tests.support.simulate import advance, begin, by_id

DEPTH = -0.1  # [cells] least height of any particle
DEFAULT, SEPARATE = "", 'boundary = { default = "slip", bottom = "separate" }'
FRICTION = 'boundary = { default = "slip", bottom = { kind = "separate", friction = 0.4 } }'
EGG = """
[domain]
size = [0.32, 0.32, 0.4]
cell = 0.02
BOUNDARY
[time]
end = 1
[material.stuff]
kind = "elastic"
density = 1020
youngs_modulus = YOUNG
poisson_ratio = 0.45
friction = 0.3
[[object]]
name = "egg"
material = "stuff"
velocity = [0, 0, SPEED]
shape = { ellipsoid = { center = [0.15, 0.15, HEIGHT], radii = [0.1, 0.06, 0.15] } }
"""
HEAP = """
[domain]
size = [0.32, 0.32, 0.24]
cell = 0.02
BOUNDARY
[time]
end = 1
[material.grains]
kind = "KIND"
[[object]]
name = "heap"
material = "grains"
shape = { box = [[0.1, 0.1, 0.04], [0.22, 0.22, 0.2]] }
"""
CUBE = """
[domain]
size = [0.2, 0.2, 0.3]
cell = 0.0125
BOUNDARY
GRAVITY
[time]
end = 1
[material.rubber]
kind = "elastic"
density = 1000
youngs_modulus = "0.2 MPa"
[[object]]
name = "cube"
material = "rubber"
shape = { box = [[0.05, 0.05, 0], [0.15, 0.15, 0.1]] }
LOAD
"""
KICK = """
[[load]]
object = "cube"
delta_velocity = [0, 0, 2]
start_time = 0.02
"""
TURN = """gravity_keyframes = [
    { time = 0.05, gravity = [0, 0, -9.8] }, { time = 0.06, gravity = [0, 0, 9.8] },
]"""
PAD = """
[[object]]
name = "NAME"
role = "scenery"
collider = true
friction = 0.8
shape = { box = [[LOW, 0.036, 0.012], [HIGH, 0.084, 0.048]] }
motion = { keyframes = [ { time = 0.05, translation = [PRESS, 0, 0] }, \
{ time = 0.25, translation = [PRESS, 0, 0.06] } ] }
"""
GRIPPER = """
[domain]
size = [0.192, 0.12, 0.18]
cell = 0.012
BOUNDARY
[time]
end = 1
[material.soft]
kind = "elastic"
density = 1000
youngs_modulus = "50 kPa"
[[object]]
name = "cube"
material = "soft"
shape = { box = [[0.066, 0.03, 0], [0.126, 0.09, 0.06]] }
"""


def filled(text, **values):
    """Text with its words in capitals replaced."""
    for name, value in values.items():
        text = text.replace(name, str(value))
    return text


def least_height(folder, text, end, count=40):
    """Least height of any particle [cells] at `count` times up to the end [s]."""
    simulation, _ = begin(folder, text)
    lowest = np.inf
    for k in range(1, count + 1):
        advance(simulation, end * k / count)
        (x,) = by_id(simulation, "x")
        lowest = min(lowest, float(x[:, 2].min()) / simulation.plan.dx)
    return lowest


WALLS = {"default": DEFAULT, "separate": FRICTION}


@pytest.mark.parametrize(
    "young, speed, height, end, wall",
    [
        *((young, 0, 0.154, 0.3, wall) for young in (1000, 1500, 10000) for wall in WALLS),
        # stiff and round: contact has no reliable normals where they touch the wall
        *((young, 0, 0.154, 0.3, "separate") for young in (50000, 100000)),
        # at a third of the wave speed, 27 m/s
        *((2e5, -9, 0.18, 0.03, wall) for wall in WALLS),
    ],
)
def test_holds_eggs(tmp_path, young, speed, height, end, wall):
    text = filled(EGG, BOUNDARY=WALLS[wall], YOUNG=young, SPEED=speed, HEIGHT=height)
    depth = least_height(tmp_path, text, end)
    print(f"egg of {young} Pa at {speed} m/s: least height {depth:.3f} cells")
    assert depth > DEPTH


@pytest.mark.parametrize("wall", WALLS)
@pytest.mark.parametrize("kind", ["sand", "snow"])
def test_holds_heaps(tmp_path, kind, wall):
    depth = least_height(tmp_path, filled(HEAP, BOUNDARY=WALLS[wall], KIND=kind), 0.3)
    print(f"heap of {kind}: least height {depth:.3f} cells")
    assert depth > DEPTH


def flight(folder, text, start, end):
    """Height and speed [m, m/s] of the center at two times [s]."""
    simulation, _ = begin(folder, text)
    rows = []
    for time in (start, end):
        advance(simulation, time)
        x, v = by_id(simulation, "x", "v")
        rows.append((x[:, 2].mean(), v[:, 2].mean()))
    return rows


@pytest.mark.parametrize("boundary", [DEFAULT, SEPARATE], ids=["default", "separate"])
def test_lets_a_jumping_cube_go(tmp_path, boundary):
    text = filled(CUBE, BOUNDARY=boundary, GRAVITY="", LOAD=KICK)
    (z0, v0), (z1, v1) = flight(tmp_path, text, 0.0199, 0.12)
    v0, t = v0 + 2.0, 0.12 - 0.02
    print(f"rise {z1 - z0:.5f} m against {v0 * t - 4.9 * t**2:.5f} m")
    assert z1 - z0 == pytest.approx(v0 * t - 4.9 * t**2, rel=0.01)
    assert v1 == pytest.approx(v0 - 9.8 * t, rel=0.01)


@pytest.mark.parametrize("boundary", [DEFAULT, SEPARATE], ids=["default", "separate"])
def test_lets_a_cube_fall_up(tmp_path, boundary):
    text = filled(CUBE, BOUNDARY=boundary, GRAVITY=TURN, LOAD="")
    (z0, v0), (z1, _) = flight(tmp_path, text, 0.08, 0.16)
    print(f"rise {z1 - z0:.5f} m, {v0:.3f} m/s at 0.08 s")
    assert z1 - z0 == pytest.approx(v0 * 0.08 + 4.9 * 0.08**2, rel=0.01)
    assert v0 > 0.15


@pytest.mark.parametrize("boundary", [DEFAULT, SEPARATE], ids=["default", "separate"])
def test_lets_a_gripper_lift_a_cube(tmp_path, boundary):
    """At 0.3 m/s; held by the floor, the cube stays where it is."""
    pads = filled(PAD, NAME="left", LOW=0.03, HIGH=0.06, PRESS=0.01)
    pads += filled(PAD, NAME="right", LOW=0.132, HIGH=0.162, PRESS=-0.01)
    simulation, _ = begin(tmp_path, filled(GRIPPER, BOUNDARY=boundary) + pads)
    advance(simulation, 0.25)
    (x,) = by_id(simulation, "x")
    slip = 0.06 - (x[:, 2].mean() - 0.03)
    print(f"slip {1e3 * slip:.2f} mm")
    assert abs(slip) < 0.0015


SLIDING = """
[domain]
size = [0.6, 0.24, 0.12]
cell = 0.015
boundary = { bottom = { kind = "separate", friction = 0.3 } }
[time]
end = 1
[material.stuff]
MATERIAL
[[object]]
name = "slab"
material = "stuff"
velocity = [0.8, 0, 0]
shape = { box = [[0.06, 0.03, 0], [0.3, 0.21, 0.06]] }
"""
SOFT = 'kind = "elastic"\ndensity = 1000\nyoungs_modulus = "20 kPa"'


@pytest.mark.parametrize("material", ['kind = "snow"', SOFT], ids=["snow", "soft solid"])
def test_friction_is_that_of_all_that_presses(tmp_path, material):
    """Coulomb: mu times the impulse of the wall, which is that of weight and lost momentum."""
    simulation, _ = begin(tmp_path, filled(SLIDING, MATERIAL=material))
    (before,) = by_id(simulation, "v")
    advance(simulation, 0.1)
    (after,) = by_id(simulation, "v")
    change = (after - before).mean(0)
    ratio = -change[0] / (9.8 * simulation.time + change[2])
    print(f"friction over pressure {ratio:.4f}")
    assert ratio == pytest.approx(0.3, rel=0.02)
