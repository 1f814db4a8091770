"""An implicit pressure at walls that let go and at open ones, and below an inlet.

The numbers from outside are those of bodies in free fall.
"""

import numpy as np
import pytest

from tests.support.simulate import advance, begin, by_id

G = 9.81  # [m/s2]
SCENE = """
[domain]
size = [0.24, 0.08, 0.36]
cell = 0.01
boundary = BOUNDARY
[time]
end = 2
frames = 3
[accuracy]
pressure = "implicit"
[material.water]
kind = "fluid"
max_speed = 2
"""
WATER = """
[[object]]
name = "water"
material = "water"
initial_pressure = "INITIAL"
velocity = VELOCITY
shape = { box = [[0, 0, 0], [0.24, 0.08, 0.16]] }
"""


def test_water_at_rest_between_separating_walls(tmp_path):
    """It stays at rest, as between slip walls."""
    text = (SCENE + WATER).replace("BOUNDARY", '"separate"')
    simulation, _ = begin(
        tmp_path, text.replace("INITIAL", "hydrostatic").replace("VELOCITY", "[0, 0, 0]")
    )
    fastest = 0.0
    while simulation.time < 0.4:
        simulation.advance(simulation.bound())
        (v,) = by_id(simulation, "v")
        fastest = max(fastest, np.sqrt((v**2).sum(1).mean()))
    assert fastest < 0.003 * np.sqrt(G * 0.16)


@pytest.mark.parametrize("kind, low, high", [("separate", 0.9, 1.02), ("slip", 0.0, 0.05)])
def test_water_that_is_thrown_up(tmp_path, kind, low, high):
    """It rises by v^2 / 2g off a wall that lets go, and not at all off one that does not."""
    speed = 1.5
    text = (SCENE + WATER).replace("BOUNDARY", f'{{ default = "slip", bottom = "{kind}" }}')
    text = text.replace("INITIAL", "zero").replace("VELOCITY", f"[0, 0, {speed}]")
    simulation, _ = begin(tmp_path, text)
    start, top = by_id(simulation, "x")[0][:, 2].mean(), 0.0
    while simulation.time < 0.25:
        simulation.advance(simulation.bound())
        top = max(top, by_id(simulation, "x")[0][:, 2].mean() - start)
    assert low < top / (speed**2 / (2 * G)) < high


def test_water_falls_through_an_open_floor(tmp_path):
    """What is left is what free fall leaves, and it falls as fast."""
    text = (SCENE + WATER).replace("BOUNDARY", '{ default = "slip", bottom = "open" }')
    text = text.replace("INITIAL", "zero").replace("VELOCITY", "[0, 0, 0]")
    simulation, _ = begin(tmp_path, text.replace("[0, 0, 0], [0.24", "[0, 0, 0.04], [0.24"))
    count = len(by_id(simulation, "x")[0])
    advance(simulation, 0.15)
    fallen = 0.5 * G * simulation.time**2 - 0.03  # [m] into the lowest cell, which is the outlet
    (v,) = by_id(simulation, "v")
    assert len(v) / count == pytest.approx(1 - fallen / 0.12, abs=0.04)
    assert v[:, 2].mean() == pytest.approx(-G * simulation.time, rel=0.02)


def test_a_jet_falls_freely(tmp_path):
    """Its particles have v^2 = v0^2 + 2 g h, and the flow is that of the inlet."""
    text = (
        SCENE.replace("BOUNDARY", '"open"')
        + """
[[inlet]]
name = "pipe"
material = "water"
disc = { center = [0.12, 0.04, 0.33], radius = 0.025 }
direction = [0, 0, -1]
speed = 1
"""
    )
    simulation, _ = begin(tmp_path, text)
    advance(simulation, 0.2)
    x, v = by_id(simulation, "x", "v")
    below = (x[:, 2] < 0.2) & (x[:, 2] > 0.1)
    speed = np.sqrt(1 + 2 * G * (0.33 - x[below, 2]))
    assert (-v[below, 2] / speed).mean() == pytest.approx(1, abs=0.02)
    assert (-v[below, 2] / speed).std() < 0.03


@pytest.mark.parametrize("wall, height", [("slip", 0.2), ("separate", 0.36)])
def test_an_inlet_on_a_wall_pushes_what_is_before_it(tmp_path, wall, height):
    """Water in a full channel has the mean speed of the inlet at once, and stays as dense."""
    walls = f'{{ default = "slip", west = "{wall}", east = "open" }}'
    text = (SCENE + WATER).replace("BOUNDARY", walls)
    text = text.replace("INITIAL", "zero").replace("VELOCITY", "[0, 0, 0]")
    text = text.replace("[domain]", "[domain]\ngravity = [0, 0, 0]")
    text = text.replace("[0, 0, 0], [0.24", "[0.02, 0, 0], [0.23")
    text = text.replace("0.08, 0.16]]", "0.08, 0.36]]")
    simulation, _ = begin(
        tmp_path,
        text
        + f"""
[[inlet]]
name = "pipe"
material = "water"
rectangle = {{ center = [0.02, 0.04, 0.18], width = 0.08, height = {height} }}
direction = "x"
speed = {0.5 * 0.36 / height}
""",
    )
    for time in (0.05, 0.2):
        advance(simulation, time)
        x, v = by_id(simulation, "x", "v")
        inside = (x[:, 0] > 0.06) & (x[:, 0] < 0.2)
        assert v[inside, 0].mean() == pytest.approx(0.5, rel=0.02)
        assert inside.sum() == pytest.approx(14 * 8 * 36 * 8, rel=0.02)
