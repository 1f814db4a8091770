"""The time left, as a pure function of when steps end: on machines that are busy, runs that change
their pace, and steps that grow shorter.
"""

import numpy as np
import pytest

from tests.support.small_scenes import scene
from vgmpi.planning.plan import make_plan
from vgmpi.solver.diagnostics.eta import RemainingTimeEstimator, work_of


def follow(took, dt, end=None, left=None):
    """What is said after every step but the first, relative to what it then took: (n - 1,).
    took: wall time of each step (n,) [s]; dt: simulated (n,) [s]."""
    left = left or RemainingTimeEstimator()
    wall, time = np.cumsum(took), np.cumsum(dt)
    said = []
    for w, t in zip(wall, time, strict=True):
        left.step(w, t)
        said.append(left.eta(time[-1]))
    assert np.isnan(said[0])
    truth = wall[-1] - wall
    return np.array(said)[1:-1] / truth[1:-1], wall[1:-1] / wall[-1]


def within(found, share, since, until=0.97):
    """Whether all that is said between two parts of a run's wall time is right to `share`. The last
    seconds of a run are noise."""
    ratio, at = found
    ratio = ratio[(at > since) & (at < until)]
    print(f"{ratio.min():.3f} .. {ratio.max():.3f}")
    return bool((abs(ratio - 1) < share).all())


def test_even_steps_are_told_exactly():
    assert within(follow(np.full(500, 0.2), np.full(500, 0.01)), 1e-9, 0.0, 1.0)


@pytest.mark.parametrize("seed", range(5))
def test_on_a_busy_machine_it_is_right_after_a_tenth(seed):
    """Every step takes another time, by half; and for a second or so at a time, a third of all, the
    machine computes something else as well."""
    random, n = np.random.default_rng(seed), 20_000
    took = 0.02 * random.lognormal(sigma=0.5, size=n)
    busy, turns = np.zeros(n, bool), random.uniform(size=n)
    for k in range(1, n):
        busy[k] = busy[k - 1] ^ (turns[k] < (1 / 25 if busy[k - 1] else 1 / 50))
    assert 0.2 < busy.mean() < 0.5
    assert within(follow(took * (1 + busy), np.full(n, 1e-3)), 0.15, 0.1)


def test_a_slow_first_step_is_no_measure():
    """A minute of compiling before the first step ends, and another in it."""
    took = np.full(3000, 0.05)
    took[0] = 60.0
    assert within(follow(took, np.full(3000, 1e-3)), 0.01, 0.0)


def test_one_step_that_was_held_up_does_not_stand_for_all():
    """A minute in the middle of a run of ten, as where a laptop sleeps: what is said soon forgets
    it."""
    took = np.full(12_000, 0.05)
    took[6000] = 60.0
    ratio, _ = follow(took, np.full(12_000, 1e-3))
    assert ratio[6000:].max() < 2.0
    assert abs(ratio[6000 + 3600 :] - 1).max() < 0.15  # three minutes later


@pytest.mark.parametrize("factor", [3.0, 1 / 3])
def test_a_change_of_speed_is_followed(factor):
    """At a third of the steps; seen when two thirds of what comes then have passed."""
    took = np.full(12_000, 0.03)
    took[4000:] *= factor
    found = follow(took, np.full(12_000, 1e-3))
    since = took[:4000].sum() + took[4000:].sum() / 1.5
    assert within(found, 0.15, since / took.sum())


def test_shorter_steps_are_counted_at_once():
    """The time step falls to a third in the middle: as many more are to come."""
    dt = np.full(4000, 1e-3)
    dt[2000:] /= 3.0
    ratio, _ = follow(np.full(4000, 0.05), dt)
    assert abs(ratio[2300:-50] - 1).max() < 0.15


def test_frames_that_take_long_to_write_are_in_it():
    """Each takes as long as 20 of the 100 steps between two of them."""
    took = np.full(5000, 0.05)
    took[::100] += 1.0
    assert within(follow(took, np.full(5000, 1e-3)), 0.15, 0.1, 0.95)


def test_before_there_is_a_step_nothing_is_said():
    left = RemainingTimeEstimator()
    assert np.isnan(left.eta(1.0))
    left.step(0.0, 0.1)
    assert np.isnan(left.eta(1.0))
    left.step(1.0, 0.2)
    assert left.eta(1.0) == pytest.approx(8.0)
    assert left.eta(0.2) == left.eta(0.1) == 0.0


JET = """
[accuracy]
pressure = "explicit"
precision = "double"
[domain]
size = [0.2, 0.2, 0.4]
cell = 0.01
[time]
end = 1
[material.water]
kind = "fluid"
[[object]]
name = "pool"
material = "water"
shape = { box = [[0, 0, 0], [0.2, 0.2, 0.01]] }
[[inlet]]
name = "jet"
material = "water"
disc = { center = [0.1, 0.1, 0.3], radius = 0.03 }
direction = [0, 0, -1]
speed = 1
"""


def test_what_is_still_to_come_is_counted(tmp_path):
    """A jet into a shallow pool: steps take as long as there are particles."""
    loaded = scene(tmp_path, JET)
    plan = make_plan(loaded, [3200, 40_000], [0.0004, 0.005], False)
    work = work_of(plan)
    assert work(0.0) < work(0.5) < work(0.99) <= plan.particles
    dt = np.full(4000, 1.0 / 4000)
    took = 1e-5 * np.array([work(t) for t in np.cumsum(dt)])
    assert within(follow(took, dt, left=RemainingTimeEstimator(work)), 0.02, 0.02)
    assert not within(follow(took, dt), 0.15, 0.1)
    assert work_of(make_plan(scene(tmp_path, JET + '[[outlet]]\nname = "drain"\n'
        'shape = { box = [[0, 0, 0], [0.05, 0.05, 0.05]] }\n'), [3200, 40_000], [0.0004, 0.005],
        False))(0.7) == 1.0  # fmt: skip


def test_what_is_known_of_steps_to_come_counts():
    """From the middle on steps cost twice as much, and there are three times as many: nothing that
    the first half shows."""
    took = np.concatenate([np.full(1000, 0.1), np.full(3000, 0.2)])
    dt = np.concatenate([np.full(1000, 3e-3), np.full(3000, 1e-3)])
    known = RemainingTimeEstimator(
        lambda time: 1.0 + (time > 3.0), lambda time: 5.0 * (1.0 + 2.0 * (time > 3.0))
    )
    assert within(follow(took, dt, left=known), 0.06, 0.02)
    assert not within(follow(took, dt), 0.5, 0.02)
