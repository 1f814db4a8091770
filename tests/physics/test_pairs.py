"""A cube falls onto a bed, for every pair of materials that meet by contact; two cubes meet in free
space.

Theory: bodies do not overlap and do not keep a distance; momentum is exact. Surfaces are found from
the particles alone (tests/support/particle_surfaces.py). A cube of 6 cells falls 2 cells at 1 m/s
onto a bed 6 cells
deep, wall to wall. Tolerance: penetration <= .35 dx at any time; gap at rest 0 .. .35 dx, with
single precision; momentum to 1e-13 of sum m |v| in double precision.
"""

import numpy as np
import pytest

from tests.support.particle_surfaces import clearance, standoff
from tests.support.simulate import advance, begin, by_id, mass_speed, totals
from tests.support.validation_record import held

DX = 0.02
LAWS = {
    "elastic": 'kind = "elastic"\ndensity = 1000\nyoungs_modulus = 2e5',
    "corotated": 'kind = "corotated"\ndensity = 1000\nyoungs_modulus = 2e5',
    "metal": 'kind = "metal"\ndensity = 2000\nyoungs_modulus = 5e5\nyield_stress = 2e4',
    "foam": 'kind = "foam"\nyoungs_modulus = 2e4\nyield_stress = 500\nviscosity = 50',
    "plasticine": 'kind = "plasticine"\nyoungs_modulus = 5e5\nyield_stress = 1e4',
    "snow": 'kind = "snow"',
    "sand": 'kind = "sand"\nyoungs_modulus = 2e5',
    "fluid": 'kind = "fluid"\ntait_coefficient = 2e4\nviscosity = 0.5',
}
# upper and lower
PAIRS = [
    ("elastic", "elastic"),
    ("elastic", "sand"),
    ("elastic", "snow"),
    ("elastic", "fluid"),
    ("snow", "sand"),
    ("snow", "fluid"),
    ("fluid", "sand"),
    ("corotated", "elastic"),
    ("metal", "elastic"),
    ("metal", "sand"),
    ("foam", "elastic"),
    ("foam", "fluid"),
    ("plasticine", "elastic"),
    ("plasticine", "snow"),
]
HEAD = """
[domain]
size = [{width}, {deep}, 0.48]
cell = 0.02
boundary.default = "slip"
gravity = [0, 0, {gravity}]
[time]
end = 2
[accuracy]
pressure = "explicit"
precision = "{precision}"
[material.one]
{one}
[material.other]
{other}
"""
FALL = """
[[object]]
name = "upper"
material = "one"
shape = {{ box = [[{low}, {low}, 0.16], [{high}, {high}, 0.28]] }}
velocity = [0, 0, -1]
[[object]]
name = "lower"
material = "other"
shape = {{ box = [[0, 0, 0], [0.24, 0.24, 0.12]] }}
"""
MEET = """
[[object]]
name = "first"
material = "one"
shape = { box = [[0.06, 0.06, 0.16], [0.18, 0.18, 0.28]] }
velocity = [0.5, 0.1, 0]
[[object]]
name = "second"
material = "other"
shape = { box = [[0.2, 0.07, 0.17], [0.32, 0.19, 0.29]] }
velocity = [-0.5, 0, 0]
"""


def fall(folder, upper, lower, end, every):
    """(smallest clearance [cells], gaps [cells] in the last half second, rms speed [m/s])."""
    fluid = {upper: "upper", lower: "lower"}.get("fluid", "")
    low, high = (0, 0.24) if fluid == "upper" else (0.06, 0.18)  # a liquid falls as a layer
    head = HEAD.format(
        width=0.24, deep=0.24, gravity=-9.8, precision="single", one=LAWS[upper], other=LAWS[lower]
    )
    simulation, made = begin(folder, head + FALL.format(low=low, high=high))
    above, order = made.object == 0, list(LAWS)
    master = above if order.index(upper) <= order.index(lower) else ~above
    closest, late = np.inf, []
    while simulation.time < end - 1e-9:
        advance(simulation, simulation.time + every)
        x, J = by_id(simulation, "x", "J")
        closest = min(closest, clearance(x, made.vol0 * J, master, DX))
        if simulation.time > end - 0.5:
            middle = x[above, :2].mean(0)
            late.append(standoff(x, made.vol0 * J, above, middle, 2 * DX, fluid, DX))
    found = totals(simulation)
    return closest, np.array(late), np.sqrt(2 * found["kinetic"] / found["mass"])


def hold(upper, lower, closest, end):
    held(
        f"penetration, {upper} on {lower}, {end:g} s",
        -closest,
        0.0,
        0.35,
        kind="below",
        unit="cells",
        source="bodies do not overlap",
        note="a cube of 6 cells, on a bed of 6 cells, at 1.4 m/s",
    )


@pytest.mark.parametrize("pair", PAIRS, ids="-".join)
def test_falls(tmp_path, pair):
    closest, _, _ = fall(tmp_path, *pair, 0.2, 0.02)
    assert closest < 1.0, "they never met"
    hold(*pair, closest, 0.2)


@pytest.mark.slow
@pytest.mark.parametrize("pair", PAIRS, ids="-".join)
def test_comes_to_rest(tmp_path, pair):
    closest, gaps, speed = fall(tmp_path, *pair, 2.0, 0.05)
    hold(*pair, closest, 2.0)
    print(f"{pair}: gap {gaps.min():.3f} .. {gaps.max():.3f}, rms speed {speed:.4f} m/s")
    held(
        f"gap at rest, {pair[0]} on {pair[1]}",
        gaps.mean(),
        0.175,
        0.175,
        kind="absolute",
        unit="cells",
        source="bodies in contact touch",
        note=f"mean over the last half second of 2 s; rms speed {speed:.4f} m/s then",
    )


@pytest.mark.parametrize("pair", PAIRS, ids="-".join)
def test_momentum(tmp_path, pair):
    """Askew, so that friction acts too."""
    head = HEAD.format(
        width=0.4, deep=0.32, gravity=0, precision="double", one=LAWS[pair[0]], other=LAWS[pair[1]]
    )
    simulation, made = begin(tmp_path, head + MEET)
    before, scale = totals(simulation)["momentum"], mass_speed(simulation, made)
    (u0,) = by_id(simulation, "v")
    advance(simulation, 0.05)
    (u,) = by_id(simulation, "v")
    first = made.object == 0
    assert u0[first, 0].mean() - u[first, 0].mean() > 0.02, "they never met"
    drift = np.abs(totals(simulation)["momentum"] - before).max() / scale
    held(
        f"momentum, {pair[0]} meets {pair[1]}",
        drift,
        0.0,
        1e-13,
        kind="absolute",
        source="dP = 0",
        note="relative to sum m |v|; 0.05 s at 1 m/s, double precision",
    )
