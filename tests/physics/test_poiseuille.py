"""A column of Bingham paste falling between two plates: width and speed of its plug.

Theory, half width h, gravity g along the plates: a plug where the shear stress rho g |x| is below
the yield stress, of half width p = tau_y / (rho g) and speed rho g (h - p)^2 / (2 mu), and a
parabola from there to the plates (Bird et al., Transport Phenomena, 2nd ed. 2002, section 8.3).
Stick walls, 16 cells from plate to plate, free ends far from the middle. Tolerance: 10 % of the
plug's width, 3 % of its speed.
"""

import numpy as np

from tests.simulate import advance, begin, by_id

H, CELLS, RHO, MU, G = 0.01, 16, 1000.0, 1.0, 2.0  # H: half width [m]; CELLS from plate to plate
DX = 2 * H / CELLS
SCENE = f"""
[domain]
size = [{2 * H!r}, {4 * DX!r}, {72 * DX!r}]
cell = {DX!r}
gravity = [0, 0, {-G}]
boundary = {{ default = "slip", west = "stick", east = "stick" }}
[time]
end = 1
[material.stuff]
density = {RHO}
bulk_modulus = 200
KEYS
[[object]]
name = "column"
material = "stuff"
shape = {{ box = [[0, 0, {28 * DX!r}], [{2 * H!r}, {4 * DX!r}, {68 * DX!r}]] }}
"""


def profile(folder, keys, end):
    """(distance from the middle plane [m], downward speed [m/s]) of particles half way up."""
    simulation, _ = begin(folder, SCENE.replace("KEYS", keys))
    advance(simulation, end)
    x, v = by_id(simulation, "x", "v")
    middle = np.abs(x[:, 2] - np.median(x[:, 2])) < 4 * DX
    return np.abs(x[middle, 0] - H), -v[middle, 2]


def test_plug_of_a_bingham_paste(tmp_path):
    yield_stress = 8.0
    keys = (
        f'kind = "paste"\nyield_stress = {yield_stress}\nconsistency = {MU}\nshear_modulus = 2000'
    )
    x, u = profile(tmp_path, keys, 2.5 * RHO * H**2 / MU)
    plug = yield_stress / (RHO * G)
    want = RHO * G * (H - plug) ** 2 / (2 * MU)
    top = np.median(u[x < 0.5 * plug])
    flank = (u > 0.1 * top) & (u < 0.8 * top)
    # 1 - u / top = ((|x| - p) / (h - p))^2: a straight line's root
    slope, value = np.polyfit(x[flank], np.sqrt(1 - u[flank] / top), 1)
    found = -value / slope
    print(f"plug: {found / plug:.4f} of its width, {top / want:.4f} of its speed")
    assert abs(found / plug - 1) < 0.10
    assert abs(top / want - 1) < 0.03
    assert np.ptp(u[x < 0.8 * plug]) < 0.02 * top
