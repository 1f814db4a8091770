"""Inlets and outlets: the lattice, rates and times, ids, and what is planned for them."""

import numpy as np
import pytest

from tests.support.simulate import advance, begin, by_id
from tests.support.small_scenes import scene
from vgmpi.preprocess.scene_builder import build_scene
from vgmpi.scene import inlet_geometry
from vgmpi.solver.boundary.outlets import remove
from vgmpi.solver.initial_particles import known_of, plan_for

TANK = """
[accuracy]
precision = "double"
[domain]
size = [0.4, 0.2, 0.4]
cell = 0.02
[time]
end = 0.2
[material.water]
kind = "fluid"
tait_coefficient = 2e4
[material.sand]
kind = "sand"
youngs_modulus = 1e5
[[object]]
name = "pool"
material = "water"
shape = { box = [[0, 0, 0], [0.2, 0.2, 0.04]] }
"""
TAP = """
[[inlet]]
name = "tap"
material = "water"
disc = { center = [0.1, 0.1, 0.3], radius = 0.03 }
direction = "x"
speed = 1
"""


def inlet(folder, text):
    return scene(folder, TANK + text).inlet[0]


def plan(folder, text):
    loaded = scene(folder, TANK + text)
    return plan_for(loaded, known_of(loaded, build_scene(loaded)))


def test_lattice_of_a_disc(tmp_path):
    tap = inlet(tmp_path, TAP)
    x = inlet_geometry.inlet_points(tap, 0.02) - [0.1, 0.1, 0.3]
    assert (x[:, 0] == 0).all()
    near = np.arange(-5, 5) + 0.5
    wanted = {(i, j) for i in near for j in near if np.hypot(i, j) < 3}
    assert {(round(b, 6), round(c, 6)) for b, c in 100 * x[:, 1:]} == wanted
    assert inlet_geometry.layers_in_nozzle(tap) == 4 and inlet_geometry.spacing(tap, 0.02) == 0.01


@pytest.mark.parametrize(
    "direction, wide, high",
    [
        ("[0, 0, -1]", [1, 0, 0], [0, -1, 0]),
        ("[0, 1, 0]", [-1, 0, 0], [0, 0, 1]),
        ("[1, 0, -1]", [0, 1, 0], [0.5**0.5, 0, 0.5**0.5]),
    ],
)
def test_lattice_of_a_rectangle(tmp_path, direction, wide, high):
    """Its width lies horizontally, along x where it pours straight down."""
    mouth = "rectangle = { center = [0.1, 0.1, 0.3], width = 0.06, height = 0.02 }"
    text = TAP.replace("disc = { center = [0.1, 0.1, 0.3], radius = 0.03 }", mouth)
    tap = inlet(tmp_path, text.replace('"x"', direction))
    one, other, along = inlet_geometry.orthonormal_frame(tap)
    np.testing.assert_allclose([one, np.abs(other)], [wide, np.abs(high)], atol=1e-15)
    x = inlet_geometry.inlet_points(tap, 0.02) - [0.1, 0.1, 0.3]
    assert len(x) == 12
    np.testing.assert_allclose(np.ptp(x @ one), 0.05, rtol=1e-12)
    np.testing.assert_allclose(np.ptp(x @ other), 0.01, rtol=1e-12)
    np.testing.assert_allclose(x @ along, 0.0, atol=1e-15)


def test_a_box_holds_the_nozzle(tmp_path):
    tap = inlet(tmp_path, TAP.replace('"x"', "[1, 0.5, -1]"))
    low, high = inlet_geometry.bounding_box(tap, 0.02)
    back = inlet_geometry.inlet_points(tap, 0.02) - 0.04 * np.array(tap.direction)
    for x in (inlet_geometry.inlet_points(tap, 0.02), back):
        assert (x > low).all() and (x < high).all()
    assert (high - low < 0.1).all()


@pytest.mark.parametrize(
    "amount", ["mass_flow_rate = 1.6", 'volume_flow_rate = "1.6 l/s"', "speed = 0.5"]
)
def test_speed_follows_from_what_flows(tmp_path, amount):
    """32 particles of a cubic centimetre every h / u."""
    (found,) = plan(tmp_path, TAP.replace("speed = 1", amount)).sources
    assert found.speed == pytest.approx(0.5, rel=1e-12)
    assert len(found.mouth) * 1000 * found.volume / found.period == pytest.approx(1.6, rel=1e-12)


def test_density_of_sand_has_its_pores(tmp_path):
    text = TAP.replace('"water"', '"sand"').replace("speed = 1", "mass_flow_rate = 1")
    made = plan(tmp_path, text)
    (found,) = made.sources
    mass = made.groups[found.group].density * found.volume * len(found.mouth) / found.period
    assert mass == pytest.approx(1.0, rel=1e-12)
    assert made.groups[found.group].family == "sand"


def test_ids_and_times(tmp_path):
    """Behind those of all objects, layer by layer; as many as are born in the run, or pass the
    mouth before its end."""
    second = TAP.replace('"tap"', '"late"').replace("0.3]", "0.2]").replace(
        "speed = 1", 'speed = 1\nstart_time = "60 ms"\nend_time = "120 ms"'
    )  # fmt: skip
    made = plan(tmp_path, TAP + second)
    tap, late = made.sources
    assert (tap.entity, late.entity) == (1, 2)
    assert tap.first == made.count[0] == made.initial_particle_count
    assert late.first == tap.first + tap.layers * 32 and made.particles == sum(made.count)
    # k + 1/2 layers at a time: born until .2 s those with (k + .5) .01 - .04 <= .2
    assert tap.layers == 24 and tap.spawn_time(23) <= 0.2 < tap.spawn_time(24)
    assert late.layers == 6 and late.mouth_time(5) <= 0.12 < late.mouth_time(6)
    assert tap.spawned_layers(0.0) == 4 and tap.passed_layers(0.0) == 0
    assert late.spawned_layers(0.0) == 0 and late.passed_layers(0.1) == 4


def test_layers_are_counted_as_their_times_are(tmp_path):
    (tap,) = plan(tmp_path, TAP).sources
    times = np.linspace(0, 0.3, 1001)
    for k in range(tap.layers):  # and exactly when they are
        times = np.append(times, [tap.spawn_time(k), tap.mouth_time(k), tap.release_time(k)])
    for time in times:
        assert tap.spawned_layers(time) == sum(tap.spawn_time(k) <= time for k in range(tap.layers))
        assert tap.passed_layers(time) == sum(tap.mouth_time(k) <= time for k in range(tap.layers))
        assert tap.released_layers(time) == sum(
            tap.release_time(k) <= time for k in range(tap.layers)
        )


def test_a_scene_of_an_inlet_alone(tmp_path):
    """It begins with nothing, where the inlet begins later."""
    text = TANK[: TANK.index("[[object]]")] + TAP + "start_time = 0.1\n"
    loaded = scene(tmp_path, text)
    made = plan_for(loaded, known_of(loaded, build_scene(loaded)))
    assert made.initial_particle_count == 0 and made.sources[0].spawned_layers(0.0) == 0


def test_no_inlet_no_trace(tmp_path):
    """What a scene without them resolves to is what it was."""
    resolved = scene(tmp_path, TANK).to_json()
    assert "inlet" not in resolved and "outlet" not in resolved
    assert not plan(tmp_path, "").is_open_system


def test_extending_needs_an_end(tmp_path):
    """More than was kept ready cannot come."""
    known = known_of(one := scene(tmp_path, TANK + TAP), build_scene(one))
    (tmp_path / "longer").mkdir()
    longer = scene(tmp_path / "longer", (TANK + TAP).replace("end = 0.2", "end = 0.4"))
    with pytest.raises(ValueError, match="that does not end cannot be extended"):
        plan_for(longer, known)
    ends = TANK + TAP + "end_time = 0.15\n"
    (tmp_path / "ends").mkdir()
    known = known_of(one := scene(tmp_path / "ends", ends), build_scene(one))
    longer = scene(tmp_path / "longer", ends.replace("end = 0.2", "end = 0.4"))
    assert plan_for(longer, known).sources[0].layers == 15


def carried(simulation):
    """Which rows of `by_id` are in a nozzle, of the only inlet."""
    (inlet,) = simulation.plan.sources
    (ids,) = by_id(simulation, "id")
    n, now = len(inlet.mouth), simulation.time
    first, last = (
        inlet.first + n * by(now) for by in (inlet.released_layers, inlet.spawned_layers)
    )
    return (ids >= first) & (ids < last)


def test_what_is_carried_has_the_flow_and_the_state_of_rest(tmp_path):
    """After a step, and after motion was restored."""
    simulation, _ = begin(tmp_path, TANK + TAP.replace('"x"', "[1, 0, -1]"))
    want = np.array([1, 0, -1]) / 2**0.5
    for time in (0.0, 0.03, 0.06):
        advance(simulation, time) if time else None
        for _ in range(2):
            v, C, J, vol0 = by_id(simulation, "v", "C", "J", "vol0")
            here = carried(simulation)
            assert here.sum() == 3 * 32  # of four layers the first is .25 cells from the mouth
            np.testing.assert_allclose(v[here] - want, 0.0, atol=1e-15)
            assert (C[here] == 0).all() and (J[here] == 1).all()
            np.testing.assert_allclose(vol0[here], 1e-6, rtol=1e-14)
            simulation.restore(0.5 * simulation.bound())
    assert (by_id(simulation, "C")[0][~here] != 0).any()


def test_the_time_step_knows_what_comes(tmp_path):
    """Also before it is there, so that the first step with it is no longer."""
    fast = TAP.replace("speed = 1", 'speed = 20\nstart_time = "20 ms"')
    simulation, _ = begin(tmp_path, TANK + fast)
    wave = np.sqrt(2e4 / 1000)
    assert len(by_id(simulation, "id")[0]) == simulation.plan.initial_particle_count
    most = 0.4 * 0.02 / (wave + 20)
    assert 0.5 * most < simulation.bound() <= most


OUTLET = '[[outlet]]\nname = "hole"\nshape = { box = [[0.21, 0, 0], [0.4, 0.2, 0.4]] }\n'


def moving(folder):
    return begin(folder, TANK + OUTLET, velocity=lambda x: x * 0 + [1.0, 0, 0])


def test_an_outlet_takes_after_every_fourth_step(tmp_path):
    """What is gone does not come back, and nothing else is gone. No sort follows by itself."""
    simulation, made = moving(tmp_path)
    before, taken, sorted_then = set(range(len(made.x))), 0, 0
    while simulation.time < 0.06:
        simulation.advance(simulation.bound())
        ids, x = by_id(simulation, "id", "x")
        there = set(ids.tolist())
        assert there <= before
        if there < before:
            taken += 1
            sorted_then += simulation.sorted_at == simulation.step
            assert simulation.step % 4 == 0
        if simulation.step % 4 == 0:
            assert (x[:, 0] <= 0.21).all()
        before = there
    assert taken >= 2 and sorted_then < taken
    ((came, _, went, _),) = simulation.flow_accounting.totals(simulation.ranks)
    assert came == len(made.x) and went == came - len(before)


@pytest.mark.parametrize("engine", ["cpu", "numpy"])
def test_no_sort_is_missed_where_particles_were_taken(tmp_path, engine):
    """A run that sorts after every taking moves as one that does not, to rounding; also where an
    inlet holds places of particles, and segments are empty."""
    text = TANK + OUTLET + TAP.replace("[0.1, 0.1, 0.3]", "[0.149, 0.1, 0.1]")
    text = text.replace("[0.2, 0.2, 0.04]", "[0.14, 0.2, 0.04]").replace("0.21, 0", "0.155, 0")
    found, empty = [], 0
    for sorts in (True, False):
        (tmp_path / str(sorts)).mkdir()
        simulation, _ = begin(
            tmp_path / str(sorts), text, velocity=lambda x: x * 0 + [2.0, 0, 0], engine=engine
        )
        while simulation.step < 40:
            simulation.advance(0.6e-3)
            (group,) = simulation.groups
            empty += (group.count == 0).any() and not sorts
            if sorts and simulation.step % 4 == 0:
                simulation.sort()
        assert simulation.flow_accounting.part[0][2] > 200
        assert (group.f[:, group.ids < 0] == 0).all()  # what is gone does not move
        found.append(by_id(simulation, "id", "x", "v"))
    assert empty
    (ids, x, v), (same, other_x, other_v) = found
    assert ids.tolist() == same.tolist()
    np.testing.assert_allclose(other_x, x, atol=1e-11)
    np.testing.assert_allclose(other_v, v, atol=1e-8)


@pytest.mark.parametrize("wall, v", [("east", [1, 0, 0]), ("south", [0, -1, 0])])
def test_an_open_wall_does_nothing_to_what_leaves(tmp_path, wall, v):
    """A block that drifts out keeps its velocity to the last particle."""
    text = TANK.replace("[time]", f'boundary = {{ {wall} = "open" }}\ngravity = [0, 0, 0]\n[time]')
    text = text.replace("[[0, 0, 0], [0.2, 0.2, 0.04]]", "[[0.3, 0.04, 0.1], [0.36, 0.1, 0.16]]")
    simulation, made = begin(tmp_path, text + f"velocity = {v}\n")
    while simulation.time < 0.15:
        simulation.advance(min(simulation.bound(), 0.0015))
        (now,) = by_id(simulation, "v")
        assert np.abs(now - v).max(initial=0.0) < 1e-12
        if len(now) == 0:
            break
    ((came, _, went, _),) = simulation.flow_accounting.totals(simulation.ranks)
    assert came == went == len(made.x) == 216


def test_a_pool_at_an_open_wall_is_refused(tmp_path):
    text = TANK.replace("[time]", 'boundary = { west = "open" }\n[time]')
    with pytest.raises(ValueError, match="'west' holds particles of 'pool'"):
        build_scene(scene(tmp_path, text))


def test_what_is_removed_leaves_the_others_in_order(tmp_path):
    simulation, _ = begin(tmp_path, TANK)
    (group,) = simulation.groups
    before = {int(i): group.positions_at(np.array([at]))[0] for i, at in zip(*_ids(group))}
    gone = np.random.default_rng(1).choice(group.index(), 700, replace=False)
    names = set(group.ids[gone].tolist())
    order = [i for i in _ids(group)[0].tolist() if i not in names]
    remove(group, gone)
    ids, places = _ids(group)
    assert ids.tolist() == order
    assert set(group.ids[group.ids >= 0].tolist()) == set(order)
    free = group.ids < 0
    assert (group.xi[:, free] == 0).all() and (group.f[:, free] == 0).all()
    for i, at in zip(ids.tolist(), places):
        assert (group.positions_at(np.array([at]))[0] == before[i]).all()


def _ids(group):
    at = group.index()
    return group.ids[at], at
