"""Velocities and forces that a script gives to single particles between the steps of a run."""

from types import SimpleNamespace

import numpy as np
import pytest

import vgmpi
from tests.support import simulated_ranks
from vgmpi.kernels.step_records import StepSpan

DENSITY = 1100.0  # [kg/m3] of rubber
SCENE = """
[accuracy]
precision = "double"
[domain]
size = [0.32, 0.32, 0.48]
cell = 0.02
gravity = [0, 0, 0]
[time]
end = 0.02
frames = 2
[material.rubber]
kind = "elastic"
youngs_modulus = "0.1 MPa"
density = 1100
[[object]]
name = "low"
material = "rubber"
shape = { sphere = { center = [0.16, 0.16, 0.12], radius = 0.05 } }
[[object]]
name = "high"
material = "rubber"
shape = { sphere = { center = [0.16, 0.16, 0.26], radius = 0.05 } }
[[probe]]
name = "walls"
wall = "all"
sampling_interval = "4 ms"
"""


def scene(**changes):
    return vgmpi.load("a.toml", {k.replace("_", "."): v for k, v in changes.items()}, SCENE)


def momentum(run):
    arrays = run.arrays("velocity", "vol0")
    return (DENSITY * arrays["vol0"][:, None] * arrays["velocity"]).sum(0)


@pytest.mark.parametrize("engine", ["cpu", "numpy"])
def test_the_momentum_of_forces(engine):
    """Random forces on half of the particles, other ones in every step, some in two calls."""
    random, impulse, before = np.random.default_rng(0), np.zeros(3), 0.0
    one = scene(time_end=0.004 if engine == "numpy" else 0.02)
    with vgmpi.simulate(one, engine=engine) as sim:
        ids = random.permutation(len(sim.array("id")))[::2]
        forces = random.normal([0.01, 0.02, -0.03], 0.05, (len(ids), 3))
        sim.add_force(ids, forces)
        for _ in sim:
            impulse += forces.sum(0) * (sim.time - before)
            np.testing.assert_allclose(momentum(sim), impulse, 1e-12)
            before = sim.time
            forces = random.normal([0.01, 0.02, -0.03], 0.05, (len(ids), 3))
            sim.add_force(ids[:100], forces[:100] / 2)
            sim.add_force(ids, forces - np.pad(forces[:100] / 2, ((0, len(ids) - 100), (0, 0))))
    assert sim.code == 0 and np.abs(impulse).min() > 0.02
    walls = sim.probes["walls"][1:]
    assert max(abs(row[f"force_{a}"]) for row in walls for a in "xyz") < 1e-9 * impulse.max() / 4e-3


@pytest.mark.parametrize("precision", ["single", "double"])
def test_values_reach_their_particles(precision):
    """Ids in any order; particles that are not named keep what they have."""
    random = np.random.default_rng(0)
    with vgmpi.simulate(scene(accuracy_precision=precision)) as sim:
        total = len(sim.array("id"))
        ids, want = random.permutation(total)[:300], np.zeros((total, 3))
        want[ids] = random.normal(size=(300, 3))
        sim.set("velocity", ids, want[ids])
        real = np.float32 if precision == "single" else np.float64
        assert (sim.array("velocity") == want.astype(real)).all()
        gradient = np.zeros((total, 9))
        gradient[ids] = random.normal(size=(300, 9))
        sim.set("C", ids, gradient[ids])
        assert (sim.array("C") == gradient.astype(real)).all()
        changes = sim._changes()
        force = np.zeros((total, 3))
        force[ids] = random.normal(size=(300, 3))
        sim.add_force(ids, force[ids])
        changes.push_particles(StepSpan(1, 0.0, 1e-3, 1e-3))
        want += 1e-3 * force / (DENSITY * sim.array("vol0")[:, None])
        rounding = 3e-7 if precision == "single" else 1e-14
        np.testing.assert_allclose(sim.array("velocity"), want, rounding, rounding)


def test_a_force_acts_for_one_step():
    with vgmpi.simulate(scene()) as sim:
        ball = sim.ids("high")
        sim.add_force(ball, [0, 0, 1e-3])
        next(sim)
        given, dt = momentum(sim), sim.time
        assert given[2] == pytest.approx(1e-3 * len(ball) * dt, rel=1e-12)
        for _ in sim:
            pass
        np.testing.assert_allclose(momentum(sim), given, 1e-12, 1e-18)


def test_a_thrown_body_flies_along_its_parabola():
    """A velocity is set in the middle of the run; the scheme's own sum is the parabola's."""
    v0, g = np.array([0.3, -0.2, 1.1]), np.array([0, 0, -9.8])
    with vgmpi.simulate(scene(domain_gravity=g.tolist(), time_end=0.05)) as sim:
        ball = sim.ids("high")
        for step in sim:
            if step == 4:
                break
        sim.set("velocity", ball, v0)
        assert (sim.array("velocity")[ball] == v0).all()
        start, begin, way, before = sim.array("positions")[ball], sim.time, np.zeros(3), sim.time
        for _ in sim:
            t, dt = sim.time - begin, sim.time - before
            way += dt * (v0 + g * t)
            before = sim.time
            state = sim.arrays("positions", "velocity")
            np.testing.assert_allclose(state["velocity"][ball], v0 + g * t + 0 * start, 1e-10)
            np.testing.assert_allclose(state["positions"][ball], start + way, 0, 1e-13)
            exact = v0 * t + g * t**2 / 2
            assert np.abs(way - exact).max() <= 9.8 * t * 1.05 * dt / 2
        assert sim.code == 0 and t > 0.04 and np.abs(way).min() > 5e-3
    walls = sim.probes["walls"]
    floor = [row["force_z"] for row in walls if row["time"] < 0.04]
    assert np.nanmax(np.abs(floor)) < 1e-8


def test_a_fast_body_makes_the_next_step_short():
    """Neither its path in a step nor the sums at the nodes leave their ranges."""
    with vgmpi.simulate(scene(time_end=0.003)) as sim:
        ball = sim.ids("low")
        next(sim)
        bound = sim.simulation.bound()
        sim.set("velocity", ball, [0, 30.0, 0])
        assert sim.simulation.bound() < bound / 3
        sim.set("velocity", ball, [0, 0, 30.0])
        given = momentum(sim)
        next(sim)
        np.testing.assert_allclose(momentum(sim), given, 1e-12, 1e-15)
        list(sim)
    assert sim.code == 0


def test_a_strong_force_makes_the_next_step_short():
    with vgmpi.simulate(scene(time_end=0.003)) as sim:
        ball, bound = sim.ids("low"), sim.simulation.bound()
        force = np.array([0, 0, 1e5]) * DENSITY * sim.array("vol0")[0]  # 1e5 m/s2
        sim.add_force(ball, force)
        assert sim.simulation.bound() < bound / 2
        next(sim)
        np.testing.assert_allclose(momentum(sim)[2], force[2] * len(ball) * sim.time, 1e-12)
        assert sim.time * sim.array("velocity").max() < 0.02
        list(sim)
    assert sim.code == 0


def steered(ranks):
    """Return the state after set and forces, with two bodies that collide, across the ranks."""
    with vgmpi.simulate(scene(time_end=0.03), ranks=ranks) as sim:
        low, high = sim.ids("low"), sim.ids("high")
        sim.set("velocity", high, [0.1, 0.05, -3.0])
        sim.set("C", low, [0, -20.0, 0, 20.0, 0, 0, 0, 0, 0])
        for step in sim:
            state = sim.arrays("positions", "velocity")
            pull = 0.3 * (0.16 - state["positions"][low]) - 0.001 * state["velocity"][low]
            sim.add_force(low, pull)
            if step == 20:
                sim.set("velocity", np.concatenate([high[::3], low[:5]]), [0.5, 0.5, 0.5])
    assert sim.code == 0
    return sim.arrays("positions", "velocity", "C", "F"), sim.time, sim.step


def test_the_bits_do_not_depend_on_the_ranks():
    (one, time, step), *_ = simulated_ranks.run(1, steered)
    assert np.abs(one["velocity"]).max() > 0.3
    for n in (2, 3, 4, 7):
        for other, *clock in simulated_ranks.run(n, steered):
            assert clock == [time, step]
            for name in one:
                assert (one[name] == other[name]).all(), (n, name)


WRONG = [
    ("velocity", [5000], [0, 0, 1], r"there is no particle 5000; their ids are 0 to \d+"),
    ("velocity", [-1], [0, 0, 1], "there is no particle -1; their"),
    ("velocity", [0.5], [0, 0, 1], r"ids must be whole numbers, shape \(n,\); got float64 of"),
    ("velocity", [True, False], [0, 0, 1], "ids must be whole numbers"),
    ("velocity", [3, 4, 3], [0, 0, 1], "particle 3 is given twice"),
    ("velocity", [3, 4], [[0, 0, 1]] * 3, r"values must have the shape \(2, 3\) or \(3,\); got"),
    ("velocity", [3, 4], "fast", r"values must be numbers of shape \(2, 3\) or \(3,\)"),
    ("velocity", [3, 4], [[0, 0, 1], [0, np.nan, 0]], r"must be finite; that of particle 4 is \[0"),
    ("velocity", [3, 4], [np.inf, 0, 0], "must be finite; that of particle 3 is"),
    ("C", [3, 4], [0, 0, 1], r"values must have the shape \(2, 9\) or \(9,\)"),
    ("positions", [3, 4], [0, 0, 1], "set positions: only velocity and C can be set"),
]  # fmt: skip


def test_what_is_wrong_is_one_line_on_all_ranks():
    def refused(ranks):
        messages = []
        with vgmpi.simulate(scene(), ranks=ranks) as sim:
            for name, ids, values, message in WRONG:
                with pytest.raises(ValueError, match=message) as caught:
                    sim.set(name, ids, values)
                messages.append(str(caught.value))
            with pytest.raises(ValueError, match="add_force: particle 3 is given twice"):
                sim.add_force([3, 3], [0, 0, 1])
            with pytest.raises(ValueError, match="all ranks must give the same ids and values"):
                sim.add_force([3], [0, 0, float(ranks.rank)])
            one_is_wrong = [0, 0, np.nan if ranks.rank else 0.0]
            with pytest.raises(ValueError, match="another rank gives|must be finite"):
                sim.add_force([3], one_is_wrong)
            sim.add_force([], np.zeros((0, 3)))
            sim.set("velocity", [], [0, 0, 0])
            next(sim)
            assert not sim.array("velocity").any()
        assert not any("\n" in message for message in messages)
        return messages

    first, other = simulated_ranks.run(2, refused)
    assert first == other


HELD = """
[[object]]
name = "plate"
material = "rubber"
shape = { box = [[0.1, 0.1, 0.36], [0.2, 0.2, 0.4]] }
motion = { velocity = [0, 0, 0.1] }
[[inlet]]
name = "tap"
material = "water"
disc = { center = [0.06, 0.06, 0.42], radius = 0.02 }
direction = [0, 0, -1]
speed = 1.0
end_time = 1.0
[material.water]
kind = "fluid"
"""


def test_particles_that_are_held_or_absent():
    """A value that the next step would overwrite is an error."""
    one = vgmpi.load("a.toml", text=SCENE.partition("[[probe]]")[0] + HELD)
    with vgmpi.simulate(one) as sim:
        for name in ("plate", "tap"):
            held = sim.ids(name)
            assert len(held)
            message = f"particle {held[-1]} moves as prescribed: by a motion, a pin or an inlet"
            with pytest.raises(ValueError, match=message):
                sim.set("velocity", held[-1:], [0, 0, 1])
            with pytest.raises(ValueError, match=message):
                sim.add_force(held[-1:], [0, 0, 1])
        with pytest.raises(ValueError, match=r"set velocity: particle \d+ is not in the domain at"):
            sim.set("velocity", [sim.simulation.plan.particles - 1], [0, 0, 1])
        with pytest.raises(KeyError, match=r"no object 'plat' \(did you mean 'plate'\?\); there"):
            sim.ids("plat")


def test_a_card_refuses():
    """Before anything is looked at: the runner is none."""
    options = SimpleNamespace(engine="cuda")
    run = vgmpi.Run(SimpleNamespace(options=options, simulation=None, steps=lambda: iter(())))
    for change in (
        lambda: run.set("velocity", [0], [0, 0, 0]),
        lambda: run.add_force([0], [0] * 3),
    ):
        with pytest.raises(ValueError, match="engine cuda sets no velocities and adds no forces; "):
            change()


def test_a_run_that_nobody_steers_has_none_of_it():
    run = vgmpi.run(scene(time_end=0.001))
    assert "particle_changes" not in run.simulation.features
