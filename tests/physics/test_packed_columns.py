"""Liquids that were shaken, or broken over an obstacle, keep their volume.

A column is released in a tank, in one that stands tilted and is shaken for two seconds, and before
a step in the floor, with a sphere that floats. Theory: a liquid at rest fills the columns that it
stands in, whatever shape its surface has. So the height of its center of mass is that of the same
columns packed at the density at rest, its lowest layer of cells is as dense as at the start, and
its surface is thin. Tolerances after 4 and 8 s: height 2 %, lowest layer 5 %, surface 2 cells (from
a fill of 0.9 to 0.1). Without correction (`volume_correction = "none"`) the liquid crowds: shown
beside.
"""

import numpy as np
import pytest

from tests.benchmarks.liquid_volume import COLUMN, TANK
from tests.support.simulate import advance, begin, by_id
from tests.support.validation_record import held

STEP = 0.28, 0.36, 0.04  # [m] of the floor, from and to along x, and its height
RADIUS = 0.045
TOLERANCES = {
    "height": (1.0, 0.02, "relative"),
    "lowest layer": (1.0, 0.05, "relative"),
    "surface [cells]": (0.0, 2.0, "below"),
}
SHAKEN = """
gravity = [1.7, 0, -9.66]
gravity_keyframes = [
    { time = 0.3, gravity = [1.7, 0, -9.66] }, { time = 0.5, gravity = [3.2, 0, -9.66] },
    { time = 0.9, gravity = [0.2, 0, -9.66] }, { time = 1.3, gravity = [3.2, 0, -9.66] },
    { time = 1.7, gravity = [0.2, 0, -9.66] }, { time = 2.0, gravity = [1.7, 0, -9.66] },
]
"""
SCENE = f"""
[domain]
size = [{TANK[0]}, {TANK[1]}, {TANK[2]}]
cell = CELL
boundary.default = "slip"
GRAVITY
[time]
end = 100
[accuracy]
precision = "single"
volume_correction = "VOLUME"
pressure = "explicit"
[material.water]
kind = "fluid"
max_speed = SPEED
[[object]]
name = "column"
material = "water"
shape = {{ box = [[0, 0, 0], [{COLUMN[0]}, {TANK[1]}, {COLUMN[1]}]] }}
"""
BROKEN = f"""
[material.cork]
kind = "elastic"
density = 500
youngs_modulus = 5e4
[[object]]
name = "step"
role = "scenery"
collider = true
shape = {{ box = [[{STEP[0]}, -0.1, -0.1], [{STEP[1]}, {TANK[1] + 0.1}, {STEP[2]}]] }}
[[object]]
name = "ball"
material = "cork"
shape = {{ sphere = {{ center = [0.5, {TANK[1] / 2}, 0.12], radius = {RADIUS} }} }}
"""


def columns(x, volume, ball, cells):
    """Height of the center of mass over that of packed columns, density of the lowest layer, and
    thickness of the surface [cells], over columns of one cell that hold no part of a step or ball.
    """
    dx = TANK[0] / cells
    edges = np.linspace(0.0, TANK[0], cells + 1)
    middle = 0.5 * (edges[1:] + edges[:-1])
    counts = np.ones(cells, bool)
    if len(ball):
        near = np.abs(middle[:, None] - ball[:, 0]).min(1) < 1.5 * dx
        counts = ~near & ((middle < STEP[0] - dx) | (middle > STEP[1] + dx))
    of = np.clip((x[:, 0] / dx).astype(int), 0, cells - 1)
    total, moment = (np.bincount(of, w, cells) for w in (volume, volume * x[:, 2]))
    packed = total / (dx * TANK[1])
    height = moment[counts].sum() / (0.5 * packed * total)[counts].sum()
    low = np.bincount(of, volume * (x[:, 2] < dx), cells)[counts].mean() / (dx**2 * TANK[1])
    layer = dx / 4
    layers = layer * np.arange(round(TANK[2] / layer) + 1)
    fill = np.histogram2d(of, x[:, 2], [np.arange(cells + 1) - 0.5, layers], weights=volume)[0]
    fill /= dx * TANK[1] * layer
    thick = []
    for column in fill[counts]:
        smooth = np.convolve(column, np.full(4, 0.25), mode="same")
        full, some = np.flatnonzero(smooth > 0.9), np.flatnonzero(smooth > 0.1)
        if len(full):
            thick.append((some.max() - full.max()) / 4)
    return height, low, np.mean(thick)


def after(folder, case, correction, cells=32, speed=2.5):
    """Means of the three measures around 4 and 8 s."""
    text = SCENE.replace("GRAVITY", SHAKEN if case == "shaken" else "")
    text = text.replace("CELL", repr(TANK[0] / cells)).replace("SPEED", repr(speed))
    text = text.replace("VOLUME", correction) + (BROKEN if case == "broken" else "")
    simulation, made = begin(folder, text)
    bodies = [k for k in np.unique(made.object)]
    water = made.object == bodies[0]
    result = {}
    for middle in (4.0, 8.0):
        rows = []
        for time in middle + np.arange(-0.25, 0.26, 0.05):
            advance(simulation, float(time))
            (x,) = by_id(simulation, "x")
            rows.append(columns(x[water], made.vol0[water], x[~water], cells))
        result[middle] = np.mean(rows, 0)
    return result


@pytest.mark.parametrize(
    "case",
    ["released", *(pytest.param(case, marks=pytest.mark.slow) for case in ("shaken", "broken"))],
)
def test_columns_are_packed(tmp_path, case):
    say = {"source": "columns packed at the density at rest", "note": "32 cells long"}
    for time, measures in after(tmp_path, case, "shifting").items():
        for quantity, value in zip(TOLERANCES, measures, strict=True):
            reference, tolerance, kind = TOLERANCES[quantity]
            name = f"liquid that was {case}, after {time:g} s: {quantity}"
            held(name, value, reference, tolerance, kind=kind, **say)
    height, _, surface = after(tmp_path, case, "none")[8.0]
    name = f"liquid that was {case}, without correction, after 8 s"
    held(f"{name}: height", height, 1.0, 0.02, expected=False, **say)
    held(f"{name}: surface [cells]", surface, 0.0, 2.0, kind="below", expected=False, **say)
