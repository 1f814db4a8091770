"""Flow past a cylinder in a channel at Re 20, beside the benchmark 2D-1 of Schaefer and Turek.

Schaefer and Turek 1996 (Notes on Numerical Fluid Mechanics 52, 547-566); drag, lift and difference
of pressures to more digits, and the length of the eddies, as FeatFlow publishes them (DFG
benchmark 2D-1). A channel 0.41 m high with a parabolic profile of 0.2 m/s in the mean, a cylinder
of 0.1 m at (0.2 m, 0.2 m), kinematic viscosity 0.001 m2/s. Here a slab of 4 cells between slip
walls, 0.8 m long in place of 2.2 m, which changes the drag by 0.1 %. The profile is that of one
inlet per cell, each of the mean speed over its height; at the end is an open wall. Means from 5 s
to 6 s, when the drag is steady. Tolerances: 2 % of the drag, with 10 cells per diameter 6 %; 5 % of
the difference of pressures, 8 % of the length of the eddies.
"""

import numpy as np
import pytest

from tests.support.plane_fits import values_at
from tests.support.simulate import advance, begin, by_id
from tests.support.validation_record import held

SOURCE = "Schaefer and Turek 1996"
DRAG, LIFT, EDDY, DIFFERENCE = 5.5795, 0.010619, 0.0846, 0.11752  # [-], [-], [m], [Pa]
HEIGHT, LENGTH, DIAMETER, SPEED = 0.41, 0.8, 0.1, 0.2  # [m], [m], [m], [m/s]
SCENE = """
[domain]
size = [{length!r}, {wide!r}, 0.41]
cell = {dx!r}
gravity = [0, 0, 0]
boundary = {{ default = "stick", south = "slip", north = "slip", east = "open" }}
[time]
end = 7
[accuracy]
pressure = "implicit"
[material.liquid]
kind = "fluid"
density = 1
max_speed = 0.5
viscosity = 0.001
[[object]]
name = "liquid"
material = "liquid"
subtract = true
velocity = [0.2, 0, 0]
shape = {{ box = [[{start!r}, 0, 0], [{end!r}, {wide!r}, 0.41]] }}
[[object]]
name = "cylinder"
role = "scenery"
collider = true
slip_length = 0
shape = {{ cylinder = {{ endpoints = [[{x!r}, -1, 0.2], [{x!r}, 1, 0.2]], radius = 0.05 }} }}
[[probe]]
name = "force"
sampling_interval = 1
collider = "cylinder"
"""
INLET = """
[[inlet]]
name = "row {row}"
material = "liquid"
rectangle = {{ center = [{start!r}, {middle!r}, {z!r}], width = {wide!r}, height = {dx!r} }}
direction = "x"
speed = {speed!r}
"""


def channel(cells: int) -> tuple[str, float, float]:
    """Text of the scene, cell size [m] and start of the channel [m], behind the nozzles."""
    dx = HEIGHT / cells
    start, wide = 2 * dx, 4 * dx
    length = round((start + LENGTH) / dx) * dx
    text = SCENE.format(
        length=length, wide=wide, dx=dx, start=start, end=length - dx, x=start + 0.2
    )
    for row in range(cells):
        low, high = row / cells, (row + 1) / cells
        share = 3 * (high**2 - low**2) - 2 * (high**3 - low**3)  # of the flow
        place = {"row": row, "start": start, "middle": wide / 2, "z": (row + 0.5) * dx}
        text += INLET.format(**place, wide=wide, dx=dx, speed=SPEED * cells * share)
    return text, dx, start


@pytest.mark.parametrize(
    "cells, most_off",
    [(41, 0.06), *(pytest.param(n, 0.02, marks=pytest.mark.slow) for n in (66, 82))],
)
def test_forces_and_eddies(tmp_path, cells, most_off):
    text, dx, start = channel(cells)
    simulation, _ = begin(tmp_path, text)
    reactions = simulation.features["reactions"]
    row, unit = reactions.row("cylinder", -1), 0.5 * SPEED**2 * DIAMETER * 4 * dx
    ends = start + np.array([0.15, 0.25])
    behind = start + 0.25 + np.linspace(dx, 0.15, 30)
    advance(simulation, 5)
    before, since = reactions.totals[row, :3].copy(), simulation.time
    pressures, speeds = 0, 0
    for time in np.linspace(5, 6, 11)[1:]:
        advance(simulation, time)
        x, v, pressure = by_id(simulation, "x", "v", "pressure")
        pressures += values_at(x, pressure[:, None], [(x, 0.2) for x in ends], dx)[:, 0] / 10
        speeds += values_at(x, v, [(x, 0.2) for x in behind], dx)[:, 0] / 10
    force = (before - reactions.totals[row, :3]) / (simulation.time - since) / unit
    k = int(np.argmax(speeds > 0))
    rate = (speeds[k] - speeds[k - 1]) / (behind[k] - behind[k - 1])
    eddy = behind[k] - speeds[k] / rate - (start + 0.25)
    end = f"{round(DIAMETER / dx)} cells per diameter, implicit pressure"
    case = "flow past a cylinder, Re 20"
    held(f"{case}: drag coefficient, {end}", force[0], DRAG, most_off, source=SOURCE)
    held(f"{case}: difference of pressures, {end}", pressures[0] - pressures[1], DIFFERENCE, 0.05,
         unit="Pa", source=SOURCE)  # fmt: skip
    held(f"{case}: length of the eddies, {end}", eddy, EDDY, 0.08, unit="m", source=SOURCE)
    held(f"{case}: lift coefficient, {end}", force[2], LIFT, np.inf, source=SOURCE)
