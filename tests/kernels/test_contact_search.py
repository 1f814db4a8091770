"""The search for contact of rigid bodies leaves out nothing that touches: tables of contacts have
the same bits with its bounds and without them, for bodies of many shapes in random poses."""

import numpy as np
import pytest

from tests.support.simulate import begin
from vgmpi.features.rigid_bodies import body_contact
from vgmpi.features.rigid_bodies.contact_search import find_pairs, search_without_bounds
from vgmpi.kernels.step_records import StepSpan

SCENE = """
[domain]
size = [0.4, 0.4, 0.4]
cell = 0.01
boundary = { default = "slip", bottom = { kind = "separate", friction = 0.3 } }
[time]
end = 1
[material.dust]
kind = "elastic"
youngs_modulus = 500
[material.wood]
kind = "elastic"
youngs_modulus = 1e6
friction = 0.4
[[object]]
name = "speck"
material = "dust"
shape = { box = [[0.0, 0.18, 0.0], [0.02, 0.2, 0.02]] }
[[object]]
name = "cup"
role = "scenery"
collider = true
friction = 0.2
shape = { difference = [{ box = [[0.1, 0.1, 0], [0.3, 0.3, 0.2]] },
                        { box = [[0.12, 0.12, 0.02], [0.28, 0.28, 0.21]] }] }
[[object]]
name = "stirrer"
role = "scenery"
collider = true
shape = { cylinder = { endpoints = [[0.3, 0.2, 0.1], [0.3, 0.2, 0.3]], radius = 0.03 } }
motion = { velocity = [-0.02, 0, 0] }
"""
SHAPES = (
    "sphere = { center = [0.2, 0.2, 0.2], radius = 0.03 }",
    "box = [[0.15, 0.17, 0.19], [0.25, 0.23, 0.21]]",
    "box = [[0.1, 0.1, 0.19], [0.3, 0.3, 0.21]]",
    "cylinder = { endpoints = [[0.2, 0.2, 0.15], [0.2, 0.2, 0.25]], radius = 0.02 }",
    "difference = [{ sphere = { center = [0.2, 0.2, 0.2], radius = 0.05 } },"
    " { box = [[0.1, 0.1, 0.21], [0.3, 0.3, 0.3]] }]",
)
COUNT = 15


@pytest.fixture(scope="module")
def coupling(tmp_path_factory):
    """The coupling of bodies of all shapes with each other and two colliders, and the walls."""
    text = SCENE
    for k in range(COUNT):
        text += f'[[object]]\nname = "b{k}"\nmaterial = "wood"\nrigid = true\n'
        text += f"shape = {{ {SHAPES[k % len(SHAPES)]} }}\n"
    simulation, _ = begin(tmp_path_factory.mktemp("bodies"), text)
    simulation.collider_nodes.begin_step(StepSpan(1, 0.0, 1e-3, 1e-3))
    return simulation.features["rigid_bodies"], simulation.engine.plan_tables.walls


def contacts(coupling, walls, search, reach, dx=0.01):
    """(rows of the table of contacts by column, number of pairs)."""
    bodies, movers = coupling.bodies, coupling.movers.table
    table = body_contact.BodyTable(
        bodies.rows, bodies.x, bodies.rotations(), bodies.radius, bodies.friction,
        np.zeros((len(bodies.rows), 0), bool),
    )  # fmt: skip
    pairs = find_pairs(search, table, movers, coupling.number_of, reach, dx)
    out, size = body_contact.contact_points(4000), np.full(3, 0.4)
    common = reach, dx, out
    n = body_contact.find_wall_contacts(coupling.surface, search, table, size, walls, *common, 0)
    n = body_contact.find_body_contacts(
        coupling.surface, search, pairs, table, movers, 1e-3, coupling.number_of, *common, n
    )
    assert n <= 4000
    return {name: values[:n] for name, values in out._asdict().items()}, len(pairs)


@pytest.mark.parametrize("reach", [1e-3, 3e-3, 1.2e-2])
def test_contacts_are_the_same_without_bounds(coupling, reach):
    """Both within and beyond the reach for which tight boxes hold."""
    coupling, walls = coupling
    random, bodies = np.random.default_rng(5), coupling.bodies
    everything, total, left_out = search_without_bounds(coupling.search), 0, 0
    for case in range(40):
        bodies.x[:] = random.uniform(0.0, 0.4, bodies.x.shape)
        bodies.q[:] = random.normal(size=bodies.q.shape)
        if case % 4 == 0:  # along the axes: faces lie on each other
            bodies.q[:] = [1.0, 0.0, 0.0, 0.0]
            bodies.x[:] = np.round(bodies.x, 2)
        bodies.q /= np.sqrt((bodies.q**2).sum(1))[:, None]
        bodies.place(coupling.movers.table)
        bounded, pairs = contacts(coupling, walls, coupling.search, reach)
        unbounded, all_pairs = contacts(coupling, walls, everything, reach)
        assert all_pairs == COUNT * (COUNT + 1)  # with each other and both colliders
        assert {k: v.tobytes() for k, v in bounded.items()} == {
            k: v.tobytes() for k, v in unbounded.items()
        }
        total, left_out = total + len(bounded["gap"]), left_out + all_pairs - pairs
    assert total > 1000, "nothing touched"
    assert left_out > 0.3 * 40 * COUNT * (COUNT + 1), "nothing was left out"
