"""Pinned parts of bodies: what holds them bears weight and moment, turns them, and takes their
momentum.

A beam of 6 x 6 cells hangs out by 16 cells and bends under its weight. Exact: force and moment at
rest (1e-4). Its sag by Euler and Bernoulli with the shear of Timoshenko (factor 5/6) is
w x^2 (6 L^2 - 4 L x + x^2) / (24 E I) + w (L x - x^2 / 2) / (5/6 G A). The rule attaches the nodes
around the edge, so the beam is a few percent too stiff; where the edge lies among the nodes may
change that by 5 %. A tyre takes from the rim that turns it what angular momentum it has. A tree in
a pot without gravity keeps momentum and angular momentum to 1e-12, in double precision; with
gravity both fall with the weight of all.
"""

import numpy as np
import pytest

from tests.support.simulate import advance, begin, by_id
from tests.support.validation_record import held
from vgmpi.solver.diagnostics.conservation import conservation_rows

DX, E, RHO, G, END, HALF = 0.01, 2e5, 1000.0, 2.0, 0.22, 0.03
BEAM = """
[domain]
size = [0.32, 0.12, 0.24]
cell = 0.01
gravity = [0, 0, -2]
gravity_ramp_time = 0.3
[time]
end = 10
cfl = 0.8
[accuracy]
precision = "double"
transfer = "pic"
[material.rubber]
kind = "elastic"
density = 1000
youngs_modulus = 2e5
poisson_ratio = 0
[[object]]
name = "beam"
material = "rubber"
shape = {{ box = [[0.02, 0.03, 0.1], [0.22, 0.09, 0.16]] }}
pinned = {{ box = [[0, 0, 0], [{edge}, 0.2, 0.2]] }}
[[probe]]
name = "grip"
sampling_rate = 100
collider = "beam"
"""


def pinned_ids(made) -> np.ndarray:
    """Ids of the particles of the first pinned part."""
    runs = np.concatenate([own.runs for own in made.features["pinned_parts"][0].by_material])
    return np.concatenate([np.arange(a, b + 1) for a, b in runs])


def sag_over_theory(folder, edge: float) -> tuple[float, float, float]:
    """Sag of a beam's tip at rest, force and moment of what holds it, each over theory."""
    simulation, made = begin(folder, BEAM.format(edge=edge))
    (x0,) = by_id(simulation, "x")
    advance(simulation, 1.2)
    before, since = simulation.features["reactions"].totals[0].copy(), simulation.time
    advance(simulation, 1.3)
    (x,) = by_id(simulation, "x")
    length, width, free = END - edge, 2 * HALF, np.ones(len(x0), bool)
    free[pinned_ids(made)] = False
    assert np.array_equal(x[~free], x0[~free])
    line, inertia = RHO * G * width**2, width**4 / 12
    r = x0[x0[:, 0] > END - DX / 2, 0].mean() - edge
    theory = line * r**2 * (6 * length**2 - 4 * length * r + r**2) / (24 * E * inertia)
    theory += line * (length * r - r**2 / 2) / (5 / 6 * E / 2 * width**2)
    sag = (x0 - x)[x0[:, 0] > END - DX / 2, 2].mean() / theory
    rate = (simulation.features["reactions"].totals[0] - before) / (simulation.time - since)
    weight = RHO * width**2 * free.sum() / len(x0) * 0.2 * G
    arm = x[free, 0].mean() - made.features["pinned_parts"][0].masses.center[0]
    return float(sag), float(rate[2] / weight), float(-rate[4] / (weight * arm))


def test_a_cantilever_hangs_from_the_world(tmp_path):
    sags = []
    for place, edge in (("on a node", 0.06), ("between two", 0.065)):
        sag, force, moment = sag_over_theory(tmp_path, edge)
        case = f"beam of 6 cells that hangs out, edge of the pinned part {place}"
        held(f"{case}: force over weight", force, 1.0, 1e-4, source="equilibrium")
        held(f"{case}: moment over weight times arm", moment, 1.0, 2e-4, source="equilibrium")
        held(f"{case}: sag", sag, 1.0, 0.06, source="Euler, Timoshenko")
        sags.append(sag)
    assert max(sags) / min(sags) < 1.05


@pytest.mark.slow
def test_the_sag_does_not_depend_on_the_place_of_the_edge(tmp_path):
    sags = [sag_over_theory(tmp_path, 0.06 + DX * k)[0] for k in (0.0, 0.25, 0.4, 0.5, 0.75)]
    print([f"{sag:.3f}" for sag in sags])
    held(
        "beam of 6 cells that hangs out, five places of the edge: largest over smallest sag",
        max(sags) / min(sags), 1.0, 0.05, source="the same beam",
    )  # fmt: skip


WHEEL = "cylinder = { endpoints = [[0.14, 0.03, 0.14], [0.14, 0.07, 0.14]], radius = "
TYRE = f"""
[domain]
size = [0.28, 0.1, 0.28]
cell = 0.01
gravity = [0, 0, 0]
[time]
end = 10
[accuracy]
precision = "double"
[material.rubber]
kind = "elastic"
density = 1000
youngs_modulus = 2e5
[[object]]
name = "rim"
role = "scenery"
collider = true
shape = {{ {WHEEL} 0.06 }} }}
motion = {{ axis = "y", angular_velocity = 20 }}
[[object]]
name = "tyre"
material = "rubber"
shape = {{ {WHEEL} 0.1 }} }}
pinned = {{ {WHEEL} 0.06 }}, to = "rim" }}
[[probe]]
name = "drive"
sampling_rate = 100
collider = "rim"
"""
SELF = TYRE.replace('to = "rim"', 'motion = { axis = "y", angular_velocity = 20 }').replace(
    'collider = "rim"', 'collider = "tyre"'
)
SELF = SELF.replace(SELF[SELF.index("[[object]]") : SELF.index('[[object]]\nname = "tyre"')], "")


def angles(x: np.ndarray) -> np.ndarray:
    """Angle about the axle of each particle, shape (n,)."""
    return np.arctan2(x[:, 0] - 0.14, x[:, 2] - 0.14)


@pytest.mark.parametrize(
    "text, holder", [(TYRE, "a rim"), pytest.param(SELF, "the world", marks=pytest.mark.slow)]
)
def test_a_tyre_turns_with_what_holds_it(tmp_path, text, holder):
    simulation, made = begin(tmp_path, text)
    (x0,) = by_id(simulation, "x")
    advance(simulation, np.pi / 20)  # half a turn
    (x,) = by_id(simulation, "x")
    radius = np.hypot(x0[:, 0] - 0.14, x0[:, 2] - 0.14)
    lag = (angles(x) - angles(x0) - 20 * simulation.time + np.pi) % (2 * np.pi) - np.pi
    assert np.abs(lag[radius < 0.058]).max() < 1e-6
    ring = radius > 0.062
    held(f"tyre that {holder} starts to turn: lag after half a turn", float(lag[ring].mean()), 0.0,
         0.02, kind="absolute", unit="rad", source="rigid rotation")  # fmt: skip
    free = np.setdiff1d(np.arange(len(x)), pinned_ids(made))
    v, C, volume = (row[free] for row in by_id(simulation, "v", "C", "vol0"))
    spin = (x[free, 2] - 0.14) * v[:, 0] - (x[free, 0] - 0.14) * v[:, 2]
    spin = RHO * volume @ (spin + DX**2 / 4 * (C[:, 2] - C[:, 6]))  # with APIC's own share
    impulse = float(simulation.features["reactions"].totals[0, 4])
    held(f"tyre that {holder} starts to turn: angular impulse over its angular momentum",
         impulse / spin, 1.0, 1e-5, source="angular momentum")  # fmt: skip


POT = """
[domain]
size = [0.32, 0.32, 0.40]
cell = 0.01
gravity = [0, 0, {gravity}]
[time]
end = 10
[accuracy]
precision = "double"
[material.wood]
kind = "elastic"
density = 600
youngs_modulus = 2e5
[material.clay]
kind = "elastic"
density = 1800
youngs_modulus = 1e9
[[object]]
name = "pot"
material = "clay"
rigid = true
shape = {{ box = [[0.12, 0.12, 0.12], [0.20, 0.20, 0.18]] }}
velocity = [0.3, 0.1, 0]
angular_velocity = [2, 3, 1]
[[object]]
name = "tree"
material = "wood"
shape = {{ box = [[0.14, 0.14, 0.14], [0.18, 0.18, 0.30]] }}
velocity = [0.3, 0.1, 0]
pinned = {{ box = [[0.1, 0.1, 0.1], [0.22, 0.22, 0.18]], to = "pot" }}
"""


def momenta(simulation) -> tuple[float, np.ndarray, np.ndarray]:
    """Mass of the particles, and momentum and angular momentum of all, shape (3,) each."""
    rows = conservation_rows(simulation)
    sums = [
        np.array([sum(r[f"{kind}momentum_{a}"] for r in rows) for a in "xyz"])
        for kind in ("", "rigid_", "angular_", "rigid_angular_")
    ]
    return sum(r["mass"] for r in rows), sums[0] + sums[1], sums[2] + sums[3]


# the pinned part, up to 0.18 m, holds all of the foot, and of root and wood a part each
REGIONS = """
region = [
  { material = "foot", box = [[0, 0, 0], [1, 1, 0.16]] },
  { material = "root", box = [[0.16, 0, 0.16], [1, 1, 0.21]] },
]
[material.foot]
kind = "elastic"
density = 2400
youngs_modulus = 4e5
[material.root]
kind = "elastic"
density = 1200
youngs_modulus = 1e5
"""


@pytest.mark.parametrize(
    ("gravity", "regions"), [(0.0, ""), (-9.0, ""), (0.0, REGIONS), (-9.0, REGIONS)]
)
def test_a_tree_in_a_pot_has_the_momentum_of_both(tmp_path, gravity, regions):
    simulation, made = begin(tmp_path, POT.format(gravity=gravity) + regions)
    mass, linear, angular = momenta(simulation)
    held_mass, body = (
        made.features["pinned_parts"][0].masses.mass,
        simulation.features["rigid_bodies"].bodies,
    )
    pot = 1800 * 0.08 * 0.08 * 0.06
    assert body.mass[0] == pytest.approx(pot + held_mass, rel=1e-2)
    (x0,) = by_id(simulation, "x")
    advance(simulation, 0.08)
    later, linear_later, angular_later = momenta(simulation)
    assert later == pytest.approx(mass, rel=1e-13)
    section = 0.04 * (600 * 0.04 + bool(regions) * (1800 * 0.02 * 0.04 / 0.04 + 600 * 0.02 / 2))
    assert held_mass == pytest.approx(0.04 * section, rel=1e-12)
    free = body.mass[0] + mass - held_mass
    expected = linear + free * simulation.time * np.array([0, 0, gravity])
    scale = np.abs(expected).max()
    assert np.abs(linear_later - expected).max() < 1e-12 * scale
    if not gravity:
        assert np.abs(angular_later - angular).max() < 1e-12 * np.abs(angular).max()
    (x,) = by_id(simulation, "x")
    pose = simulation.collider_nodes.free.matrices()[0]
    ids = pinned_ids(made)
    carried = x0[ids] @ pose[:3, :3].T + pose[:3, 3]
    assert np.abs(carried - x[ids]).max() < 1e-13
    assert np.abs(x[ids] - x0[ids]).max() > DX


def test_the_conservation_log_counts_pinned_parts(tmp_path):
    simulation, made = begin(tmp_path, BEAM.format(edge=0.06))
    rows = conservation_rows(simulation)
    assert rows[0]["particles"] == len(made.x)
    assert rows[0]["mass"] == pytest.approx(RHO * 0.2 * 0.06**2, rel=1e-12)
