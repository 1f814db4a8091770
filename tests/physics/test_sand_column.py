"""A column of dry sand collapses in a channel: how far it runs out.

Published: Lube, Huppert, Sparks, Freundt, Collapses of two-dimensional granular columns (2005,
Phys. Rev. E 72, 041301): a column of length L against a wall, a = height / length, runs out by dL =
1.2 a L for a < 2.3 (and 1.9 a^(2/3) L above), whatever the grains and the floor. The channel is a
slab 4 cells wide between slipping walls, the floor holds. (Columns of round cross-section follow
another law: Lube et al. 2004.) Tolerance: 30 %; the run-out grows with the resolution.
"""

import numpy as np
import pytest

from tests.simulate import advance, begin, by_id, totals

CELLS, DX, GRAVITY = 16, 0.01, 9.81
L = CELLS * DX
SCENE = """
[domain]
size = [{long}, 0.04, {high}]
cell = 0.01
gravity = [0, 0, -9.81]
boundary = {{ default = "slip", floor = "stick" }}
[time]
end = 1
[accuracy]
precision = "single"
[material.sand]
kind = "sand"
friction_angle = "31 deg"
match = "plane-strain"
youngs_modulus = 5e5
[[object]]
name = "column"
material = "sand"
shape = {{ box = [[0, 0, 0], [{edge}, 0.04, {top}]] }}
"""


def front(x, volume):
    """Largest x [m] connected to the wall by sand at least dx / 2 deep."""
    held = np.bincount((x[:, 0] / DX).astype(int), volume, minlength=400)
    return np.argmax(held / (DX * 0.04) < DX / 2) * DX


@pytest.mark.parametrize("a", [1, 2])
def test_run_out(tmp_path, a):
    text = SCENE.format(long=6 * L, high=round(a * L + 0.02, 6), edge=L, top=a * L)
    simulation, made = begin(tmp_path, text)
    before = totals(simulation)
    advance(simulation, 4.5 * np.sqrt(a * L / GRAVITY))
    after = totals(simulation)
    (x,) = by_id(simulation, "x")
    found = (front(x, made.vol0) - L) / L
    still = after["kinetic"] / before["energy"]
    print(
        f"column a = {a}: run-out {found:.2f}, published {1.2 * a:.2f}; kinetic share {still:.1e}"
    )
    assert after["mass"] == pytest.approx(1590 * a * L * L * 0.04, rel=1e-6)
    assert after["energy"] < before["energy"]
    assert still < 1e-3, "it still moves"
    assert found == pytest.approx(1.2 * a, rel=0.3)
