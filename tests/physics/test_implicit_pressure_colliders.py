"""An implicit pressure beside colliders: rest, lift, a dam that breaks onto an obstacle.

The numbers from outside are those of hydrostatics and the volume of the water. Slabs of 8 cells.
"""

import numpy as np
import pytest

import vgmpi
from tests.support import dense_multigrid
from tests.support.dense_multigrid import dense_values
from tests.support.simulate import advance, begin, by_id

G, WIDTH = 9.8, 0.08  # [m/s2], [m]
SCENE = """
[domain]
size = [0.64, 0.08, 0.44]
cell = 0.01
[time]
end = 4
frames = 3
[accuracy]
pressure = "implicit"
[material.water]
kind = "fluid"
max_speed = 4
[[object]]
name = "water"
material = "water"
initial_pressure = "INITIAL"
subtract = true
shape = { box = [[0, 0, 0], [LENGTH, 0.08, DEPTH]] }
[[object]]
name = "collider"
role = "scenery"
collider = true
"""
POOL = SCENE.replace("INITIAL", "hydrostatic").replace("LENGTH", "0.64").replace("DEPTH", "0.32")
DAM = SCENE.replace("INITIAL", "zero").replace("LENGTH", "0.2").replace("DEPTH", "0.24")
DAM = DAM.replace("cell = 0.01", "cell = 0.02")
DISC = """
shape = { cylinder = { endpoints = [[0.32, -0.04, 0.16], [0.32, 0.12, 0.16]], radius = 0.063 } }
"""
SQUARE = """
shape = { box = [[-0.056, -0.08, -0.056], [0.056, 0.08, 0.056]] }
rotation = { axis = "y", angle = "17 deg" }
origin = [0.32, 0.04, 0.16]
"""
FLOOR = """
shape = { box = [[-0.3, -0.04, -0.4], [1.26, 0.12, 0.12]] }
rotation = { axis = "y", angle = "17 deg" }
"""
ROOF = 0.12 / np.cos(np.radians(17))  # [m] height of the oblique floor at x = 0
SLOPE = np.tan(np.radians(17))


def force_on_collider(simulation, dt):
    """Force [N] of the water on the collider in the last step, shape (3,)."""
    stage = simulation.features["implicit_pressure"]
    free_part = dense_values(stage.solver, stage.fields.free_part, 2)
    share = np.where(free_part < 1, 1 - dense_values(stage.solver, stage.fields.share, 2), 0)
    push = dense_multigrid.push(dense_values(stage.solver, stage.fields.phi, 1))
    return (share * push).sum((1, 2, 3)) * stage.liquids.mass_of_cell * simulation.plan.dx / dt


def rest(folder, text, end=0.5):
    """(largest rms speed over sqrt(g H), mean force on the collider (3,) [N]) of a pool."""
    simulation, _ = begin(folder, text)
    speeds, forces = [], []
    while simulation.time < end:
        dt, sorts = simulation.bound(), simulation.sorts
        simulation.advance(dt)
        (v,) = by_id(simulation, "v")
        speeds.append(np.sqrt((v**2).sum(1).mean() / (G * 0.32)))
        if simulation.sorts == sorts and simulation.time > 0.1:
            forces.append(force_on_collider(simulation, dt))
    return max(speeds), np.mean(forces, 0)


@pytest.mark.parametrize(
    "shape, area", [(DISC, np.pi * 0.063**2), (SQUARE, 0.112**2)], ids=["disc", "square"]
)
def test_lift_of_a_held_body(tmp_path, shape, area):
    """Archimedes' to 1 %, and the water around it stays at rest."""
    speed, force = rest(tmp_path, POOL + shape)
    weight = 1000 * G * area * WIDTH
    assert speed < 0.002
    assert force[2] / weight == pytest.approx(1, abs=0.01)
    assert np.abs(force[:2]).max() < 0.002 * weight


def test_rest_over_an_oblique_floor(tmp_path):
    """The pressure on it is rho g (h - z), and the water does not move."""
    speed, force = rest(tmp_path, POOL + FLOOR)
    end = ROOF / SLOPE  # where it meets the bottom
    down = 1000 * G * WIDTH * ((0.32 - ROOF) * end + 0.5 * SLOPE * end**2)
    assert speed < 0.002
    assert force[2] == pytest.approx(-down, rel=0.01)
    assert force[0] / force[2] == pytest.approx(SLOPE, rel=0.01)


def test_a_dam_breaks_onto_an_obstacle(tmp_path):
    """No particle goes far into it, no cell crowds, and the water around it keeps its volume."""
    simulation, _ = begin(tmp_path, DAM + DISC.replace("0.16]", "0.12]"))
    stage, fullest, levels = simulation.features["implicit_pressure"], [], []
    (volume,) = by_id(simulation, "vol0")
    while simulation.time < 3.5:
        advance(simulation, simulation.time + 0.05)
        fullest.append(stage.fields.filled.max())
        (x,) = by_id(simulation, "x")
        depth = 0.063 - np.hypot(x[:, 0] - 0.32, x[:, 2] - 0.12)
        assert depth.max() < 0.01  # half a cell
        is_beside = np.abs(x[:, 0] - 0.32) > 0.12
        levels.append(volume[is_beside].sum() / (WIDTH * (0.64 - 0.24)))
    assert max(fullest) < 1.25
    assert np.mean(levels[-20:]) == pytest.approx(level_around(0.12, 0.063, 0.2 * 0.24), rel=0.03)


def level_around(center, radius, area):
    """Height [m] of water of an area [m2] around a disc in a tank of 0.64 m."""
    z = np.linspace(0, 0.44, 44001)
    chord = 2 * np.sqrt(np.maximum(radius**2 - (z - center) ** 2, 0))
    return z[np.searchsorted(np.cumsum((0.64 - chord) * 1e-5), area)]


PROBE = """
[[probe]]
name = "NAME"
KEY = "NAME"
sampling_rate = "200 Hz"
"""


def probes(**places):
    """Probes of the forces on colliders and walls, by name."""
    return "".join(PROBE.replace("NAME", name).replace("KEY", key) for name, key in places.items())


def test_forces_of_a_pool_on_walls_and_a_disc(tmp_path):
    """Its weight on the floor, its thrust on the sides, and Archimedes' lift."""
    text = POOL.replace("end = 4", "end = 0.3") + DISC
    text += probes(bottom="wall", west="wall", east="wall", collider="collider")
    run = vgmpi.run(vgmpi.load(tmp_path / "scene.toml", text=text))
    force = {
        name: [np.mean([row[f"force_{a}"] for row in rows if row["time"] > 0.1]) for a in "xz"]
        for name, rows in run.probes.items()
    }
    per_area = 1000 * G * WIDTH
    assert force["bottom"][1] == pytest.approx(-per_area * 0.64 * 0.32, rel=2e-3)
    assert force["west"][0] == pytest.approx(-per_area * 0.5 * 0.32**2, rel=3e-3)
    assert force["east"][0] == pytest.approx(per_area * 0.5 * 0.32**2, rel=3e-3)
    assert force["collider"][1] == pytest.approx(per_area * np.pi * 0.063**2, rel=3e-3)


@pytest.mark.parametrize("bottom", ["slip", "stick", "separate"])
def test_what_the_water_loses_walls_and_colliders_take(tmp_path, bottom):
    """Momentum of a dam break around a disc: all reactions and gravity are what changes it."""
    friction = ", friction = 0.3 }" if bottom == "separate" else " }"
    wall = (
        f'cell = 0.02\nboundary = {{ default = "slip", bottom = {{ kind = "{bottom}"{friction} }}'
    )
    text = (DAM + DISC).replace("cell = 0.02", wall) + probes(collider="collider")
    text = text.replace('pressure = "implicit"', 'pressure = "implicit"\nprecision = "double"')
    simulation, _ = begin(tmp_path, text)
    advance(simulation, 0.35)
    v, volume = by_id(simulation, "v", "vol0")
    momentum = 1000 * (v * volume.reshape(-1, 1)).sum(0)
    weight = 1000 * volume.sum() * np.array([0, 0, -G])
    taken = simulation.features["reactions"].totals[:, :3].sum(0)
    scale = np.abs(weight * simulation.time).max()
    assert np.abs(momentum).max() > 0.05 * scale
    np.testing.assert_allclose(momentum, weight * simulation.time + taken, atol=1e-6 * scale)
