"""Flow between two plates under its own weight: Newton's parabola, a Bingham paste's plug.

Theory, half width h, gravity g along the plates, nu = mu / rho. Newtonian, from rest (Bird et al.,
Transport Phenomena, 2nd ed. 2002, sections 2.3 and 4.1), y = x / h, a = (k + 1/2) pi:

    u = g h^2 / (2 nu) [1 - y^2 - 4 sum_k (-1)^k / a^3 cos(a y) exp(-a^2 nu t / h^2)]

Bingham (section 8.3): a plug where the shear stress rho g |x| is below the yield stress, of half
width p = tau_y / (rho g) and speed rho g (h - p)^2 / (2 mu), and a parabola from there to the
plates. Stick walls, 16 cells from plate to plate, free ends far from the middle. The Newtonian
column falls less than a cell: where its ends come near, the middle runs up to 5 % too fast, as does
the paste's where the column is 40 cells long and not 80.
Tolerances: 3 % of the speed, 10 % of the plug's width.
"""

import numpy as np

from tests.support.simulate import advance, begin, by_id
from tests.support.validation_record import held

H, CELLS, RHO, MU = 0.01, 16, 1000.0, 1.0  # H: half width [m]; CELLS from plate to plate
DX = 2 * H / CELLS
BIRD = "Bird et al., Transport Phenomena, 2002, "
SCENE = """
[accuracy]
pressure = "explicit"
precision = "double"
[domain]
size = [{wide!r}, {deep!r}, {high!r}]
cell = {dx!r}
gravity = [0, 0, {gravity}]
boundary = {{ default = "slip", west = "stick", east = "stick" }}
[time]
end = 1
[material.stuff]
density = 1000
tait_coefficient = 200
{keys}
[[object]]
name = "column"
material = "stuff"
shape = {{ box = [[0, 0, {low!r}], [{wide!r}, {deep!r}, {top!r}]] }}
"""


def column(folder, keys, gravity, cells, low):
    """A simulation of a column that begins `low` cells above the floor and is `cells` long."""
    sizes = {"wide": 2 * H, "deep": 4 * DX, "dx": DX, "high": (low + cells + 4) * DX}
    sizes |= {"low": low * DX, "top": (low + cells) * DX}
    return begin(folder, SCENE.format(keys=keys, gravity=-gravity, **sizes))[0]


def profile(simulation):
    """(distance from the middle plane [m], downward speed [m/s]) of particles half way up."""
    x, v = by_id(simulation, "x", "v")
    middle = np.abs(x[:, 2] - np.median(x[:, 2])) < 4 * DX
    return np.abs(x[middle, 0] - H), -v[middle, 2]


def starting(y, time):
    """Newtonian speed over g h^2 / (2 nu) at y = x / h, time [h^2 / nu]."""
    k = np.arange(40)
    a = (k[:, None] + 0.5) * np.pi
    sums = 4 * (-1.0) ** k[:, None] / a**3 * np.cos(a * y) * np.exp(-(a**2) * time)
    return 1 - y**2 - sums.sum(0)


def test_newtonian(tmp_path):
    gravity = 0.02
    simulation = column(tmp_path, f'kind = "fluid"\nviscosity = {MU}', gravity, 128, 4)
    top = RHO * gravity * H**2 / (2 * MU)
    curves = {}
    for time in (0.5, 2.5):
        advance(simulation, time * RHO * H**2 / MU)
        x, u = profile(simulation)
        want = starting(x / H, time)
        held(
            f"plane Poiseuille flow after {time} h2/nu",
            float((u / top * want).sum() / (want**2).sum()),
            1.0,
            0.03,
            unit="of the speed",
            source=BIRD + "sections 2.3, 4.1",
            note="best factor on the profile; 16 cells from plate to plate",
        )
        order = np.argsort(x)
        curves[f"ours, t = {time} h2/nu"] = (x[order][::64] / H, u[order][::64] / top)
        curves[f"exact, t = {time} h2/nu"] = (np.linspace(0, 1), starting(np.linspace(0, 1), time))
    off = np.sqrt(np.mean((u / top - want) ** 2))
    held(
        "plane Poiseuille profile",
        off,
        0.0,
        0.03,
        kind="below",
        unit="of the top speed, rms",
        source=BIRD + "section 2.3",
        curves=curves,
        axes=("distance from the middle / h", "speed / (g h2 / 2 nu)"),
    )


def test_plug_of_a_bingham_paste(tmp_path):
    yield_stress, gravity = 8.0, 2.0
    keys = f'kind = "paste"\nyield_stress = {yield_stress}\nconsistency_index = {MU}\n'
    keys += "shear_modulus = 2000"
    simulation = column(tmp_path, keys, gravity, 80, 28)
    advance(simulation, 2.5 * RHO * H**2 / MU)
    x, u = profile(simulation)
    plug = yield_stress / (RHO * gravity)
    want = RHO * gravity * (H - plug) ** 2 / (2 * MU)
    top = np.median(u[x < 0.5 * plug])
    flank = (u > 0.1 * top) & (u < 0.8 * top)
    # 1 - u / top = ((|x| - p) / (h - p))^2: a straight line's root
    slope, value = np.polyfit(x[flank], np.sqrt(1 - u[flank] / top), 1)
    note, bird = "16 cells from plate to plate", BIRD + "section 8.3"
    held("Bingham plug, half width", -value / slope, plug, 0.10, unit="m", source=bird, note=note)
    x_exact = np.linspace(0, H)
    exact = 1 - (np.maximum(x_exact - plug, 0) / (H - plug)) ** 2
    order = np.argsort(x)[::64]
    curves = {"ours": (x[order] / H, u[order] / want), "exact": (x_exact / H, exact)}
    axes = ("distance from the middle / h", "speed / its top speed")
    say = {"unit": "m/s", "source": bird, "note": note, "curves": curves, "axes": axes}
    held("Bingham plug, speed", top, want, 0.03, **say)
    assert np.ptp(u[x < 0.8 * plug]) < 0.02 * top
