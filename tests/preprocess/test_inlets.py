"""Inlets and outlets: the lattice, rates and times, ids, and what is planned for them."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from tests.support.simulate import advance, begin, by_id, inlets_of
from tests.support.small_scenes import scene
from vgmpi.features.inlets_outlets import geometry
from vgmpi.features.inlets_outlets.coupling import wall_inflow
from vgmpi.features.particle_insertion import remove_particles
from vgmpi.preprocess.scene_builder import build_scene
from vgmpi.solver.initial_particles import known_of, plan_for

TANK = """
[accuracy]
pressure = "explicit"
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
    return scene(folder, TANK + text).lists["inlet"][0]


def plan(folder, text):
    loaded = scene(folder, TANK + text)
    return plan_for(loaded, known_of(loaded, build_scene(loaded)))


def test_lattice_of_a_disc(tmp_path):
    tap = inlet(tmp_path, TAP)
    x = geometry.inlet_points(tap, 0.02) - [0.1, 0.1, 0.3]
    assert (x[:, 0] == 0).all()
    near = np.arange(-5, 5) + 0.5
    wanted = {(i, j) for i in near for j in near if np.hypot(i, j) < 3}
    assert {(round(b, 6), round(c, 6)) for b, c in 100 * x[:, 1:]} == wanted
    assert geometry.layers_in_nozzle(tap) == 4 and geometry.spacing(tap, 0.02) == 0.01


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
    one, other, along = geometry.orthonormal_frame(tap)
    np.testing.assert_allclose([one, np.abs(other)], [wide, np.abs(high)], atol=1e-15)
    x = geometry.inlet_points(tap, 0.02) - [0.1, 0.1, 0.3]
    assert len(x) == 12
    np.testing.assert_allclose(np.ptp(x @ one), 0.05, rtol=1e-12)
    np.testing.assert_allclose(np.ptp(x @ other), 0.01, rtol=1e-12)
    np.testing.assert_allclose(x @ along, 0.0, atol=1e-15)


def test_a_box_holds_the_nozzle(tmp_path):
    tap = inlet(tmp_path, TAP.replace('"x"', "[1, 0.5, -1]"))
    low, high = geometry.bounding_box(tap, 0.02)
    back = geometry.inlet_points(tap, 0.02) - 0.04 * np.array(tap.direction)
    for x in (geometry.inlet_points(tap, 0.02), back):
        assert (x > low).all() and (x < high).all()
    assert (high - low < 0.1).all()


@pytest.mark.parametrize(
    "amount", ["mass_flow_rate = 1.6", 'volume_flow_rate = "1.6 l/s"', "speed = 0.5"]
)
def test_speed_follows_from_what_flows(tmp_path, amount):
    """32 particles of a cubic centimetre every h / u."""
    (found,) = inlets_of(plan(tmp_path, TAP.replace("speed = 1", amount)))
    assert found.speed == pytest.approx(0.5, rel=1e-12)
    assert len(found.mouth) * 1000 * found.volume / found.period == pytest.approx(1.6, rel=1e-12)


def test_density_of_sand_has_its_pores(tmp_path):
    text = TAP.replace('"water"', '"sand"').replace("speed = 1", "mass_flow_rate = 1")
    made = plan(tmp_path, text)
    (found,) = inlets_of(made)
    mass = made.groups[found.group].density * found.volume * len(found.mouth) / found.period
    assert mass == pytest.approx(1.0, rel=1e-12)
    assert made.groups[found.group].family == "sand"


def test_ids_and_times(tmp_path):
    """Behind those of all objects, as they pass the mouth; as many as are born in the run, or pass
    the mouth before its end."""
    second = TAP.replace('"tap"', '"late"').replace("0.3]", "0.2]").replace(
        "speed = 1", 'speed = 1\nstart_time = "60 ms"\nend_time = "120 ms"'
    )  # fmt: skip
    made = plan(tmp_path, TAP + second)
    tap, late = inlets_of(made)
    assert (tap.entity, late.entity) == (1, 2)
    assert tap.first == made.count[0] == made.first_id[1]
    assert late.first == tap.first + tap.particles and made.particles == sum(made.count)
    # 32 particles in .01 s: born until .2 s are the layers k with (k + 1) .01 - .04 <= .2
    assert tap.particles == 24 * 32 and tap.spawn_time(767) <= 0.2 < tap.spawn_time(768)
    assert late.particles == 6 * 32 and late.mouth_time(191) <= 0.12 < late.mouth_time(192)
    assert tap.spawned(0.0) == 4 * 32 and tap.passed(0.0) == 0
    assert late.spawned(0.0) == 0 and late.passed(0.1) == 4 * 32


def test_the_flow_is_exact_to_a_particle(tmp_path):
    """What has passed the mouth at any time, and what an end in the middle of a layer lets pass."""
    cut = TAP.replace("speed = 1", "speed = 1\nend_time = 0.1234")
    (tap,) = inlets_of(plan(tmp_path, cut))
    assert abs(tap.particles - 0.1234 * 3200) <= 0.5
    for time in np.linspace(0.0, 0.1234, 997):
        assert abs(tap.passed(time) - time * 3200) <= 0.5 + 1e-9


def greatest_plane(x):
    """Largest part of the positions x (n,) [spacings] that one wave of .3 to 1.7 spacings finds in
    phase: 1 where they are in planes."""
    numbers = np.linspace(0.6, 3.4, 801)
    return np.abs(np.exp(2j * np.pi * numbers[:, None] * x).mean(axis=1)).max()


@pytest.mark.parametrize("per_cell", [1, 8, 27, 64])
def test_a_stream_is_even_however_it_stretches(tmp_path, per_cell):
    """Stretched by s along the flow and drawn in by s^-1/2 across it, as a liquid that falls is:
    seen along the flow, its particles form no planes, and none comes close to another."""
    inlet = TAP.replace("speed = 1", f"speed = 1\nparticles_per_cell = {per_cell}")
    (tap,) = inlets_of(plan(tmp_path, inlet.replace("radius = 0.03", "radius = 0.045")))
    n, h = len(tap.mouth), tap.spacing
    x = tap.places(tap.first + np.arange(min(24 * n, tap.particles)), 0.0)
    s = -(x[:, 0] - 0.1) / h
    gaps = np.diff(np.sort(s))
    np.testing.assert_allclose(gaps, 1 / n, rtol=1e-6)
    assert greatest_plane(s) < 0.1
    for stretch in (1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0):
        inside = np.column_stack([stretch * s, (x[:, 1:] - 0.1) / h / stretch**0.5])
        away = cKDTree(inside).query(inside, k=2)[0][:, 1]
        assert away.min() > 0.45  # 2^(1/6) = 1.12 is the most that is possible


def test_particles_are_counted_as_their_times_are(tmp_path):
    (tap,) = inlets_of(plan(tmp_path, TAP))
    every = np.arange(tap.particles)
    events = (tap.spawn_time(every), tap.mouth_time(every), tap.release_time(every))
    for time in np.concatenate([np.linspace(0, 0.3, 1001), *events]):  # also exactly when they are
        counts = (tap.spawned(time), tap.passed(time), tap.released(time))
        assert counts == tuple((event <= time).sum() for event in events)


def test_a_scene_of_an_inlet_alone(tmp_path):
    """It begins with nothing, where the inlet begins later."""
    text = TANK[: TANK.index("[[object]]")] + TAP + "start_time = 0.1\n"
    loaded = scene(tmp_path, text)
    made = plan_for(loaded, known_of(loaded, build_scene(loaded)))
    assert inlets_of(made)[0].first == 0 == inlets_of(made)[0].spawned(0.0)


BESIDE = """
[accuracy]
pressure = "explicit"
precision = "double"
[domain]
size = [WIDE, 0.4, 0.4]
cell = 0.05
[time]
end = 0.05
[material.water]
kind = "fluid"
tait_coefficient = 2e4
[[inlet]]
name = "tap"
material = "water"
rectangle = { center = [0.2, 0.3, 0.2], width = 0.2, height = 0.2 }
direction = "-x"
speed = 1
"""
TOUCHED = {  # what ends at x = 0.3: the nozzle ends at 0.2 + 0.1, which is 0.30000000000000004
    "a wall": "",
    "an outlet": '[[outlet]]\nname = "hole"\nshape = { box = [[0.3, 0, 0], [0.4, 0.4, 0.4]] }\n',
    "a collider": '[[object]]\nname = "block"\nrole = "scenery"\ncollider = true\n'
    "shape = { box = [[0.3, 0, 0], [0.4, 0.4, 0.4]] }\n",
    "an inlet": '[[inlet]]\nname = "next"\nmaterial = "water"\ndirection = "-x"\nspeed = 1\n'
    "rectangle = { center = [0.3, 0.3, 0.2], width = 0.2, height = 0.2 }\n",
}


@pytest.mark.parametrize("touched", TOUCHED)
def test_a_nozzle_may_end_where_something_begins(tmp_path, touched):
    """Rounding does not decide, and what comes is there from the start on."""
    text = BESIDE.replace("WIDE", "0.3" if touched == "a wall" else "0.5") + TOUCHED[touched]
    simulation, _ = begin(tmp_path, text)
    tap = inlets_of(simulation.plan)[0]
    advance(simulation, 0.02)
    ids, x = by_id(simulation, "id", "x")
    came = x[(ids >= tap.first) & (ids < tap.first + tap.particles)]
    assert len(came) == tap.spawned(0.02) and came[:, 0].max() < 0.3
    with pytest.raises(ValueError, match="two cells behind its mouth|lies in"):
        build_scene(scene(tmp_path, text.replace("[0.2, 0.3, 0.2]", "[0.2002, 0.3, 0.2]")))


def test_no_inlet_no_trace(tmp_path):
    """What a scene without them resolves to is what it was."""
    resolved = scene(tmp_path, TANK).to_json()
    assert "inlet" not in resolved and "outlet" not in resolved
    assert not plan(tmp_path, "").changes_mass


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
    assert inlets_of(plan_for(longer, known))[0].particles == 15 * 32


def carried(simulation):
    """Which rows of `by_id` are in a nozzle, of the only inlet."""
    (inlet,) = inlets_of(simulation.plan)
    (ids,) = by_id(simulation, "id")
    first, last = (inlet.first + by(simulation.time) for by in (inlet.released, inlet.spawned))
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
            assert here.sum() == 115  # of four layers 13 particles are .2 cells from the mouth
            np.testing.assert_allclose(v[here] - want, 0.0, atol=1e-15)
            assert (C[here] == 0).all() and (J[here] == 1).all()
            np.testing.assert_allclose(vol0[here], 1e-6, rtol=1e-14)
            simulation.correct_transfers(0.5 * simulation.bound())
    assert (by_id(simulation, "C")[0][~here] != 0).any()


def test_the_time_step_knows_what_comes(tmp_path):
    """Also before it is there, so that the first step with it is no longer."""
    fast = TAP.replace("speed = 1", 'speed = 20\nstart_time = "20 ms"')
    simulation, _ = begin(tmp_path, TANK + fast)
    wave = np.sqrt(2e4 / 1000)
    assert len(by_id(simulation, "id")[0]) == inlets_of(simulation.plan)[0].first
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
    ((came, _, went, _),) = simulation.features["inlets_outlets"].flow.totals()
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
        assert simulation.features["inlets_outlets"].flow.part[0][2] > 200
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
    ((came, _, went, _),) = simulation.features["inlets_outlets"].flow.totals()
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
    remove_particles(group, gone)
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


@pytest.mark.parametrize(
    "mouth",
    [
        "disc = { center = [0.04, 0.1, 0.3], radius = 0.03 }",
        "rectangle = { center = [0.04, 0.1, 0.385], width = 0.2, height = 0.03 }",
    ],
)
def test_nodes_of_a_wall_let_in_what_a_nozzle_on_it_brings(tmp_path, mouth):
    """Also at the edges of the wall, where a node has half as much of it."""
    old = "disc = { center = [0.1, 0.1, 0.3], radius = 0.03 }"
    made = plan(tmp_path, TAP.replace(old, mouth))
    (source,) = inlets_of(made)
    flow = wall_inflow(source, made)
    assert (flow.nodes[:, 0] == 0).all() and not flow.velocities[:, 1:].any()
    edges = ((flow.nodes == 0) | (flow.nodes == made.cells))[:, 1:].sum(1)
    rate = (flow.velocities[:, 0] * 0.5**edges).sum() * 0.02**2
    assert rate == pytest.approx(len(source.mouth) * 0.01**2, rel=1e-12)
    assert flow.velocities[:, 0].max() <= 1 + 1e-12
    assert wall_inflow(inlets_of(plan(tmp_path, TAP))[0], made) is None
