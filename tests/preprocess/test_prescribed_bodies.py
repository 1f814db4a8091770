"""Bodies that are driven and held: what is refused, when they are let go, what they are then."""

import numpy as np
import pytest

from tests.scene.test_bad_scenes import broken, lines
from tests.support.simulate import advance, begin, by_id, conservation_rows
from tests.support.small_scenes import scene
from vgmpi.features.prescribed_motion.plan import PrescribedMotionPlan
from vgmpi.planning.plan import make_plan
from vgmpi.preprocess.scene_builder import build_scene
from vgmpi.runtime.config.schema import SceneError
from vgmpi.scene.loader import load
from vgmpi.solver.diagnostics.liquid_fill import liquid_phases
from vgmpi.solver.engines.cpu import Cpu

BALL = 'name = "ball"\n'
POOL = 'name = "pool"\n'
WAY = "motion = {{ {} }}"
KEYS = 'keyframes = [{ time = "1 s" }, { time = "2 s", translation = [0.4, 0, 0] }]'
SPUN = 'keyframes = [{ time = "1 s", angle = "90 deg", translation = [-0.2, 0, 0] }], axis = "z"'
WAVES = 'release_time = "1 s"\nvelocity_mode = { amplitude = [1, 0, 0], wave_vector = [1, 0, 0] }'
WRONG = {
    "held and moved": (
        BALL, 'release_time = "1 s"\nmotion = { velocity = [1, 0, 0] }', "release_time",
        "motion and release_time given at once: give one",
    ),
    "never frozen": (BALL, "release_time = 0", "release_time", "must be > 0"),
    "frozen for metres": (BALL, 'release_time = "1 m"', "release_time",
                          "'m' does not measure a time"),
    "a push of its own": (
        POOL, 'release_time = "1 s"\nvelocity = [1, 0, 0]', "velocity",
        "[[load]] delta_velocity with start_time = release_time gives it one then",
    ),
    "an angular velocity besides": (
        POOL, WAY.format("angular_velocity = 1") + "\nangular_velocity = [0, 0, 3]",
        "angular_velocity",
        "is not for a body with motion: until it is let go it moves as that says",
    ),
    "waves": (
        POOL, WAVES,
        "velocity_mode", "is not for a body with release_time",
    ),
    "a volume fraction": (
        POOL, 'release_time = "1 s"\nvolume_fraction = 0.5', "volume_fraction",
        "until it is let go it shares its space with none",
    ),
    "layers of what is free": (
        POOL, 'release_order = "top-down"\nrelease_end_time = "1 s"', "release_order",
        "is only for bodies with release_time",
    ),
    "an end without layers": (
        POOL, 'release_time = "1 s"\nrelease_end_time = "2 s"', "release_end_time",
        "is only for bodies with release_order",
    ),
    "layers without an end": (
        POOL, 'release_time = "1 s"\nrelease_order = "bottom-up"', "release_order",
        "needs release_end_time: when the last layer is let go",
    ),
    "layers from the side": (
        POOL, 'release_time = "1 s"\nrelease_order = "from left"\nrelease_end_time = "2 s"',
        "release_order", "must be one of bottom-up, top-down",
    ),
    "ends before it begins": (
        POOL, 'release_time = "1 s"\nrelease_order = "bottom-up"\nrelease_end_time = "0.5 s"',
        "release_end_time", "must be later than release_time = 1 s; got 0.5 s",
    ),
    "layers of a solid": (
        BALL, 'release_time = "1 s"\nrelease_order = "bottom-up"\nrelease_end_time = "2 s"',
        "release_order", "is not for solids: their layers would come apart",
    ),
    "no motion": (BALL, WAY.format(""), "motion", "has no motion: give keyframes, velocity"),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_wrong_bodies(tmp_path, name):
    old, keys, where, says = WRONG[name]
    path, touched = broken(tmp_path, old, f"{old}{keys}\n")
    thing = old.split('"')[1]
    found = [line for line in lines(path) if f": object.{thing}.{where}: " in line]
    assert len(found) == 1 and says in found[0], lines(path)
    assert int(found[0].removeprefix(f"{path}:").split(":")[0]) in touched


def test_scenery_is_not_frozen(tmp_path):
    post = (
        'name = "post"\nrole = "scenery"\nshape = { sphere = { center = [0, 0, 0], radius = 1 } }'
    )
    path, _ = broken(tmp_path, "friction = 0.1\n",
                     f'friction = 0.1\n[[object]]\n{post}\nrelease_time = "1 s"\n')  # fmt: skip
    said = "object.post.release_time: is not for scenery: it has no mass and does not move"
    assert any(line.endswith(said) for line in lines(path)), lines(path)


@pytest.mark.parametrize(
    "keys, where, says",
    [
        (KEYS, "motion.keyframes.1", "takes the body out of the domain: at 1.688 s it is at x ="),
        ("velocity = [-0.31, 0, 0]", "motion.velocity", "the domain is 0 .. 0.64 m"),
        (SPUN + ", pivot = [0.3, 0, 0.2]", "motion.keyframes.0", "it is at x ="),
    ],
)
def test_it_stays_in_the_domain(tmp_path, keys, where, says):
    path, _ = broken(tmp_path, BALL, BALL + WAY.format(keys) + "\n")
    found = lines(path, make=lambda path, _: build_scene(load(path)))
    assert len(found) == 1 and f": object.ball.{where}: " in found[0] and says in found[0], found


def test_a_fixed_step_is_short_enough(tmp_path):
    path, _ = broken(
        tmp_path, BALL, BALL + WAY.format('velocity = [2, 0, 0], end_time = "0.1 s"') + "\n"
    )
    build_scene(load(path))
    found = lines(path, ["time.dt=4 ms"], make=lambda p, o: build_scene(load(p, o)))
    assert len(found) == 1 and "object.ball.motion.velocity: moves at up to 2 m/s" in found[0]


TWO = """
[domain]
size = [0.24, 0.16, 0.16]
cell = 0.01
gravity = [0, 0, -9.8]
boundary = "slip"
[time]
end = 0.1
frames = 3
[accuracy]
precision = "double"
[material.sand]
kind = "sand"
youngs_modulus = 2e5
[material.rubber]
kind = "elastic"
youngs_modulus = 1e5
density = 1000
[[object]]
name = "heap"
material = "sand"
shape = { box = [[0.02, 0.02, 0], [0.08, 0.08, 0.055]] }
release_time = "20 ms"
release_order = "RELEASE"
release_end_time = "60 ms"
[[object]]
name = "free"
material = "sand"
shape = { box = [[0.02, 0.1, 0], [0.08, 0.14, 0.03]] }
[[object]]
name = "wheel"
material = "rubber"
shape = { box = [[0.14, 0.04, 0.06], [0.18, 0.12, 0.1]] }
motion = { angular_velocity = "2 rad/s", velocity = [0.3, 0, 0.5], axis = "y", end_time = "30 ms" }
"""


def test_let_go_layer_by_layer(tmp_path):
    for release in ("bottom-up", "top-down"):
        simulation, made = begin(tmp_path, TWO.replace("RELEASE", release))
        heap, sand = made.object == 0, simulation.plan.phases[-3]
        assert sand.name == "sand" and heap.sum() == 12 * 12 * 11
        low = {p.name: k for k, p in enumerate(simulation.plan.phases)}
        assert sorted(low) == ["heap (frozen)", "sand", "wheel", "wheel (driven)"]
        x0 = by_id(simulation, "x")[0]
        for layer, time in enumerate([0.02, 0.028, 0.036, 0.044, 0.052, 0.06]):
            advance(simulation, time)
            assert simulation.time == pytest.approx(time, rel=1e-12)
            held = simulation.groups[simulation.plan.group_of[0]]
            z = x0[np.sort(held.ids[held.index()]), 2] / 0.01
            edge = 1 + layer if release == "bottom-up" else 5 - layer
            rest = x0[heap][:, 2] / 0.01
            rest = rest[rest > edge] if release == "bottom-up" else rest[rest < edge]
            assert np.array_equal(np.sort(z), np.sort(rest))
        rows = {row["phase"]: row for row in conservation_rows(simulation)}
        assert rows["heap (frozen)"]["particles"] == 0
        assert rows["sand"]["particles"] == (made.object < 2).sum()


def test_what_is_held_stays_to_the_bit(tmp_path):
    simulation, made = begin(tmp_path, TWO.replace("RELEASE", "bottom-up"))
    before = by_id(simulation, "x")[0]
    advance(simulation, 0.0199)
    x, v = by_id(simulation, "x", "v")
    heap = made.object == 0
    assert np.array_equal(x[heap], before[heap]) and not v[heap].any()
    assert not np.array_equal(x[made.object == 1], before[made.object == 1])


def test_what_moves_goes_where_it_is_sent_and_goes_on_so(tmp_path):
    """Free of gravity and of others, to rounding; then its middle keeps its velocity."""
    text = TWO.replace("RELEASE", "bottom-up").replace("-9.8", "0")
    simulation, made = begin(tmp_path, text)
    wheel, middle = made.object == 2, np.array([0.16, 0.08, 0.08])
    x0, v0 = by_id(simulation, "x", "v")
    spin = np.array([0, 2.0, 0])
    assert np.allclose(v0[wheel], [0.3, 0, 0.5] + np.cross(spin, x0[wheel] - middle), atol=1e-14)
    advance(simulation, 0.03)
    angle = 0.06
    R = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    want = (x0[wheel] - middle) @ R.T + middle + 0.03 * np.array([0.3, 0, 0.5])
    x, v, C = by_id(simulation, "x", "v", "C")
    assert np.abs(x[wheel] - want).max() < 1e-14
    there = middle + 0.03 * np.array([0.3, 0, 0.5])
    assert np.allclose(v[wheel], [0.3, 0, 0.5] + np.cross(spin, x[wheel] - there), atol=1e-14)
    assert np.allclose(C[wheel].reshape(-1, 3, 3)[:, 0, 2], 2.0)
    F = [g for g in simulation.groups if g.plan.name == "wheel/rubber"][0]
    H = F.get("H", F.index()).reshape(-1, 3, 3)
    assert np.abs(H + np.eye(3) - R).max() < 1e-13  # it has turned, and is not strained
    advance(simulation, 0.05)
    x, _ = by_id(simulation, "x", "v")
    assert np.abs(x[wheel].mean(0) - there - 0.02 * np.array([0.3, 0, 0.5])).max() < 1e-12


def test_steps_are_short_enough_for_what_moves(tmp_path):
    text = TWO.replace("RELEASE", "bottom-up").replace("[0.3, 0, 0.5]", "[-3, 0, 0]")
    simulation, _ = begin(tmp_path, text.replace('"2 rad/s"', '"1000 rad/s"'))
    simulation.advance(1e-6)
    limit = 0.3 * 0.01 / (3 + 1000 * np.hypot(0.0175, 0.0175))  # of its outermost particles
    assert 0.8 * limit < simulation.bound() < limit * (1 + 1e-12)


def test_while_all_is_held_steps_are_as_long_as_frames(tmp_path):
    text = TWO.replace('release_order = "RELEASE"\nrelease_end_time = "60 ms"', "")
    text = text[: text.rindex("[[object]]")].replace(
        'name = "free"', 'name = "free"\nrelease_time = "20 ms"'
    )
    simulation, _ = begin(tmp_path, text)
    advance(simulation, 0.02)
    assert simulation.step < 4
    motion = simulation.plan.feature(PrescribedMotionPlan)
    assert [len(one.objects) for one in motion.bodies] == [2]  # let go together
    advance(simulation, 0.03)
    assert simulation.step > 20


def test_off_is_off(tmp_path):
    """A scene without it has no tables of it, and hands its kernels none."""
    text = TWO[: TWO.index("release_time")] + TWO[TWO.index('[[object]]\nname = "free"') :]
    loaded = scene(tmp_path, text[: text.rindex("[[object]]")])
    plan = make_plan(loaded, [1, 1], [1e-6, 1e-6], False)
    assert plan.features == () and [phase.name for phase in plan.phases] == ["sand"]
    simulation, _ = begin(tmp_path, text[: text.rindex("[[object]]")])
    assert "prescribed_motion" not in simulation.features and "releases" not in simulation.features
    assert isinstance(simulation.engine, Cpu)
    assert not simulation.engine.plan_tables.boundaries.motions.driven.size


GATE = """
[accuracy]
precision = "double"
[domain]
size = [0.24, 0.08, 0.16]
cell = 0.02
boundary = { default = "slip", east = { kind = "slip", removal_time = "50 ms" } }
[time]
end = 0.2
frames = 3
[material.water]
kind = "fluid"
tait_coefficient = 2e4
[[object]]
name = "pool"
material = "water"
shape = { box = [[0, 0, 0], [0.24, 0.08, 0.1]] }
initial_pressure = "hydrostatic"
"""


def test_a_wall_vanishes(tmp_path):
    """What it held is at rest before; then it leaves, and is counted."""
    simulation, made = begin(tmp_path, GATE)
    advance(simulation, 0.0499)
    (row,) = conservation_rows(simulation)
    assert row["particles_out"] == 0
    assert row["kinetic_energy"] < 1e-4 * abs(row["potential_energy"])
    advance(simulation, 0.05)
    codes = [part.segments.mirror[:, 0, 1] for part in simulation.engine.parts]
    assert not np.concatenate(codes).any()
    advance(simulation, 0.2)
    (row,) = conservation_rows(simulation)
    assert 0.15 * len(made.x) < row["particles_out"] < 0.8 * len(made.x)
    assert row["particles"] + row["particles_out"] == len(made.x) == row["particles_in"]


def test_an_open_wall_does_not_vanish(tmp_path):
    with pytest.raises(SceneError) as caught:
        scene(tmp_path, GATE.replace('kind = "slip", removal', 'kind = "open", removal'))
    said = 'domain.boundary.east: removal_time is not for kind = "open": it is from the start on'
    assert any(said in line for line in caught.value.lines), caught.value.lines


def test_a_frozen_fluid_shares_space_with_nothing(tmp_path):
    """It mixes once it is released; the ledger counts its volume from the start."""
    text = """
[accuracy]
precision = "double"
[domain]
size = [0.16, 0.16, 0.16]
cell = 0.02
[time]
end = 0.01
[[coupling]]
between = ["ale", "beer"]
kind = "mixing"
diffusivity = 1e-6
"""
    for k, name in enumerate(("ale", "beer")):
        text += f'[material.{name}]\nkind = "fluid"\ntait_coefficient = 1e4\n'
        text += f'[[object]]\nname = "{name}"\nmaterial = "{name}"\nphase = "{name}"\n'
        text += f"shape = {{ box = [[0, 0, {0.04 * k}], [0.16, 0.16, {0.04 * k + 0.04}]] }}\n"
    simulation, _ = begin(tmp_path, text + 'release_time = "5 ms"\n')
    groups = simulation.plan.groups
    assert [group.shares_space for group in groups if not group.driven] == [True, True]
    (frozen,) = (group for group in groups if group.driven)
    assert not frozen.shares_space
    assert frozen.phase in liquid_phases(simulation.plan)
