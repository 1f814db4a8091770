"""Half a metre of water on a plate of 2 cells: no particle passes.

The plate is an elastic table whose legs stand on the floor, bending over 4 cells, or a rigid box,
its face on a node plane or between two. The water falls into its weight at once, so that the plate
bears twice of it at first. Tolerance: none passes, none enters the elastic plate by .35 dx (see
tests/support/particle_surfaces.py). 20 cells of water, 8 x 8 cells wide; single precision.
"""

import numpy as np
import pytest

from tests.support.particle_surfaces import clearance
from tests.support.simulate import advance, begin, by_id
from tests.support.validation_record import held

DX = 0.025
SCENE = """
[domain]
size = [0.2, 0.2, 0.75]
cell = 0.025
boundary.default = "slip"
[time]
end = 4
[accuracy]
pressure = "explicit"
precision = "single"
[material.hard]
kind = "elastic"
density = 2000
youngs_modulus = 5e6
[material.water]
kind = "fluid"
max_depth = 0.5
[[object]]
name = "water"
material = "water"
shape = { box = [[0, 0, 0.15], [0.2, 0.2, 0.65]] }
"""
TABLE = """
[[object]]
name = "plate"
material = "hard"
[[object.shape.union]]
box = [[0, 0, 0.1], [0.2, 0.2, 0.15]]
[[object.shape.union]]
box = [[0, 0, 0], [0.05, 0.2, 0.1]]
[[object.shape.union]]
box = [[0.15, 0, 0], [0.2, 0.2, 0.1]]
"""
RIGID = """
[[object]]
name = "plate"
role = "scenery"
collider = true
shape = {{ box = [[-0.1, -0.1, {low}], [0.3, 0.3, {high}]] }}
"""
PLATES = {
    "elastic table": TABLE,
    "rigid, on nodes": RIGID.format(low=0.1, high=0.15),
    "rigid, between nodes": RIGID.format(low=0.091, high=0.141),
}


def stand(folder, plate, end, every):
    """Watch the water on a plate until `end` [s]."""
    simulation, made = begin(folder, SCENE + PLATES[plate])
    water = made.object == 0
    passed, closest = 0, np.inf
    while simulation.time < end - 1e-9:
        advance(simulation, simulation.time + every)
        x, J = by_id(simulation, "x", "J")
        # below the middle of the plate, wherever it bends to
        passed = max(passed, int((x[water, 2] < 0.12).sum()))
        if not water.all():
            closest = min(closest, clearance(x, made.vol0 * J, ~water, DX))
    held(
        f"particles through a plate of 2 cells, {plate}, {end:g} s",
        passed,
        0.0,
        0.0,
        kind="absolute",
        unit="particles",
        source="no particle passes",
        note="0.5 m of water, 20 cells deep",
    )
    if not water.all():
        held(
            f"penetration of a plate of 2 cells, {plate}, {end:g} s",
            -closest,
            0.0,
            0.35,
            kind="below",
            unit="cells",
            source="bodies do not overlap",
        )
    assert x[water, 2].max() > 0.6, "the water is gone"


@pytest.mark.parametrize("plate", PLATES)
def test_holds(tmp_path, plate):
    stand(tmp_path, plate, 0.3, 0.05)


@pytest.mark.slow
@pytest.mark.parametrize("plate", PLATES)
def test_holds_long(tmp_path, plate):
    stand(tmp_path, plate, 2.0, 0.1)
