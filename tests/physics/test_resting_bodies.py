"""Free rigid bodies that come to rest: on each other for ten seconds, and on sand.

Blocks that lie on each other stay where they are. A stone that is dropped on sand stops, and the
sand bears its weight; it stays nearly where it stopped.
"""

import numpy as np
import pytest

from tests.physics.test_free_bodies import G, on_floor
from tests.support.simulate import advance, begin
from tests.support.validation_record import held

WIDE, HIGH, CELL = 0.08, 0.06, 0.01  # [m] of the blocks
SAND = """
[domain]
size = [0.28, 0.28, 0.24]
cell = 0.01
boundary = { default = "slip", bottom = "stick" }
[time]
end = 10
[accuracy]
precision = "single"
[material.sand]
kind = "sand"
preset = "dry sand"
youngs_modulus = 1e6
[material.stone]
kind = "elastic"
density = 2600
youngs_modulus = 1e9
friction = 0.6
[[object]]
name = "bed"
material = "sand"
shape = { box = [[0, 0, 0], [0.28, 0.28, 0.1]] }
[[object]]
name = "stone"
material = "stone"
rigid = true
shape = { sphere = { center = [0.14, 0.14, 0.17], radius = 0.05 } }
"""


def block(x: float, row: int) -> str:
    return (
        f"box = [[{x - WIDE / 2:.3f}, 0.06, {HIGH * row:.2f}],"
        f" [{x + WIDE / 2:.3f}, 0.14, {HIGH * (row + 1):.2f}]]"
    )


PILES = {
    "stack of five": [block(0.1, row) for row in range(5)],
    "pyramid of ten": [
        block(0.06 + (k + row / 2) * (WIDE + 0.01), row) for row in range(4) for k in range(4 - row)
    ],
}


@pytest.mark.slow
@pytest.mark.parametrize("pile", PILES)
def test_a_pile_stays_for_ten_seconds(tmp_path, pile):
    simulation, bodies = on_floor(tmp_path, PILES[pile], long=0.4, dt=2e-3)
    start = bodies.x.copy()
    for _ in range(5000):
        simulation.advance(2e-3)
    assert simulation.time == pytest.approx(10.0)
    held(f"{pile} rigid blocks: displacement", float(np.abs(bodies.x - start).max() / CELL), 0.0,
         1e-3, kind="below", unit="cells", source="statics", note="10 s")  # fmt: skip
    held(f"{pile} rigid blocks: speed", float(np.abs(bodies.v[:, :3]).max()), 0.0, 1e-6,
         kind="below", unit="m/s", source="statics", note="after 10 s")  # fmt: skip


@pytest.mark.slow
def test_a_stone_comes_to_rest_on_sand(tmp_path):
    simulation, _ = begin(tmp_path, SAND)
    bodies = simulation.features["rigid_bodies"].bodies
    advance(simulation, 0.6)
    began, place, momentum = simulation.time, bodies.x.copy(), bodies.momentum[0, 2]
    assert place[0, 2] < 0.16, "it fell"
    advance(simulation, 1.0)
    span, weight = simulation.time - began, bodies.mass[0] * G
    force = (bodies.momentum[0, 2] - momentum) / span + weight
    sunk = float(np.abs(bodies.x - place).max() / CELL)
    print(f"sunk {(0.15 - bodies.x[0, 2]) / CELL:.2f} cells, {sunk:.3f} in {span:.2f} s,"
          f" speed {np.abs(bodies.v[0, :3]).max():.2e} m/s")  # fmt: skip
    held("rigid stone on sand: force over weight", float(force / weight), 1.0, 0.02,
         source="Newton", note="mean of 0.4 s")  # fmt: skip
    held("rigid stone on sand: displacement in 0.4 s", sunk, 0.0, 0.1, kind="below", unit="cells",
         source="at rest")  # fmt: skip
