"""Loads: a free body obeys Newton's second law.

Number from outside: p(t) = integral of F dt, exact for any step; tolerance 1e-12 of it in double
precision (rounding of the sums), whatever the shape of the body and however the load is spread.
A pressure on a face of area A is a force p A (A of the block as built, from its particles).
"""

import numpy as np
import pytest

from tests.support.simulate import advance, begin, by_id, totals
from vgmpi.kernels.step_records import StepSpan
from vgmpi.scene.keyframes import mean_ramp_factor

BLOCK = """
[accuracy]
precision = "double"
transfer = "apic-corrected"
[domain]
size = [0.4, 0.4, 0.4]
cell = 0.02
gravity = [0, 0, GRAVITY]
RAMP
[time]
end = 0.02
frames = 2
cfl = 0.4
[material.rubber]
kind = "elastic"
youngs_modulus = 2e4
density = 1000
[material.light]
kind = "elastic"
youngs_modulus = 2e4
density = 500
[[object]]
name = "block"
material = "rubber"
shape = { box = [[0.14, 0.16, 0.16], [0.22, 0.24, 0.28]] }
[[object]]
name = "rider"
material = "light"
phase = "block"
shape = { box = [[0.22, 0.16, 0.16], [0.26, 0.24, 0.28]] }
"""
END = 0.02  # [s]
AREA, VOLUME = 0.08 * 0.08, 0.08 * 0.08 * 0.12  # of the block's top [m2] and of the block [m3]


def free(folder, loads, gravity=0.0, ramp="gravity_ramp_time = 0", transfer="apic-corrected"):
    text = BLOCK.replace("GRAVITY", str(gravity)).replace("RAMP", ramp)
    text = text.replace("apic-corrected", transfer)
    simulation, made = begin(folder, text + loads)
    advance(simulation, END)
    assert simulation.step > 15
    return simulation, totals(simulation)["momentum"]


CASES = {
    "force": ("force = [1, -2, 0.5]", (1, -2, 0.5)),
    "half": (
        "force = [3, 0, 0]\nregion = { box = [[0, 0, 0], [1, 1, 0.2]] }",
        (3, 0, 0),
    ),
    "pressure": ('pressure = "1 kPa"\nface = "top"', (0, 0, -1e3 * AREA)),
    "suction": ('pressure = "-1 kPa"\nface = "west"', (-1e3 * 0.08 * 0.12, 0, 0)),
    "acceleration": ("acceleration = [0, 3, 0]", (0, 3 * 1000 * VOLUME, 0)),
}


@pytest.mark.parametrize("case", CASES)
def test_momentum_is_force_times_time(tmp_path, case):
    says, force = CASES[case]
    _, momentum = free(tmp_path, f'[[load]]\nobject = "block"\n{says}\n')
    want = np.array(force) * END
    assert np.abs(momentum - want).max() < 1e-12 * np.abs(want).max()


def test_it_comes_and_goes(tmp_path):
    """A ramp of 10 ms from 2 ms on, ended at 16 ms: the load counts for 14 - 5 ms; another in pulse
    form is shorter than many steps together. Steps do not fall on these times."""
    loads = """
[[load]]
object = "block"
force = [4, 0, 0]
ramp_time = "10 ms"
start_time = "2 ms"
end_time = "16 ms"
[[load]]
object = ["block", "rider"]
force = [0, 0, 6]
start_time = "3.1 ms"
end_time = "3.2 ms"
"""
    _, momentum = free(tmp_path, loads)
    want = np.array([4 * (0.014 - 0.005), 0, 6 * 1e-4])
    assert np.abs(momentum - want).max() < 1e-12


@pytest.mark.parametrize("transfer", ["flip", "pic"])
def test_with_other_transfers(tmp_path, transfer):
    loads = '[[load]]\nobject = "block"\nforce = [1, 0, 0]\n'
    _, momentum = free(tmp_path, loads, transfer=transfer)
    assert np.abs(momentum - [END, 0, 0]).max() < 1e-12 * END


def test_the_mean_of_a_ramp():
    """Against a sum over fine steps, for pieces that lie in, across and beyond it."""

    def full(t):
        s = np.clip((t - 0.3) / 0.5, 0, 1)
        return np.where((t >= 0.3) & (t < 1.2), 0.5 - 0.5 * np.cos(np.pi * s), 0)

    for t0, t1 in ((0, 0.2), (0.1, 0.4), (0.35, 0.5), (0.6, 0.9), (0.85, 1.0), (1.1, 1.3)):
        t = t0 + (np.arange(200_000) + 0.5) / 200_000 * (t1 - t0)
        found = mean_ramp_factor(t0, t1, ramp=0.5, after=0.3, until=1.2)
        assert found == pytest.approx(full(t).mean(), abs=1e-5)
    assert mean_ramp_factor(0.85, 1.0, 0.5, 0.3) == 1.0 and mean_ramp_factor(2.0, 2.1, 0.0) == 1.0


def test_gravity_grows(tmp_path):
    """Half a cosine of 12 ms: as much as gravity 6 ms later."""
    simulation, momentum = free(tmp_path, "", gravity=-9.8, ramp="gravity_ramp_time = 0.012")
    mass = 1000 * VOLUME + 500 * VOLUME / 2
    want = -9.8 * mass * (END - 0.006)
    assert abs(momentum[2] - want) < 1e-12 * abs(want) and abs(momentum[:2]).max() < 1e-12
    (v,) = by_id(simulation, "v")
    assert np.ptp(v[:, 2]) < 1e-9


def test_shared_by_volume(tmp_path):
    """Two materials in one load: the first step gives the light one twice the speed."""
    text = BLOCK.replace("GRAVITY", "0").replace("RAMP", "")
    load = '[[load]]\nobject = ["block", "rider"]\nforce = [0, 0, 3]\n'
    simulation, _ = begin(tmp_path, text + load)
    simulation.features["loads"].push_particles(StepSpan(1, 0.0, 1e-3, 1e-3))
    v, thing = by_id(simulation, "v", "object")
    speeds = [np.unique(v[thing == k][:, 2]) for k in (0, 1)]
    assert [len(s) for s in speeds] == [1, 1]
    assert speeds[1][0] == pytest.approx(2 * speeds[0][0], rel=1e-14)
    assert speeds[0][0] == pytest.approx(1e-3 * 3 / (1.5 * VOLUME) / 1000, rel=1e-12)


def test_the_region_is_taken_at_the_start(tmp_path):
    """The layer at the top is pressed; it keeps the load after sorts."""
    text = BLOCK.replace("GRAVITY", "0").replace("RAMP", "")
    load = '[[load]]\nobject = "block"\npressure = "1 kPa"\nface = "top"\n'
    simulation, made = begin(tmp_path, text + load, velocity=lambda x: 0 * x + [1.5, 1.0, 0.5])

    def pressed():
        ids = [
            group.ids[at]
            for group, at in zip(
                simulation.groups, simulation.features["loads"].places[0], strict=True
            )
        ]
        return np.sort(np.concatenate(ids))

    top = np.flatnonzero((made.object == 0) & (made.x[:, 2] > 0.27))
    assert len(top) == 64 and (pressed() == top).all()
    sorts = simulation.sorts
    while simulation.sorts < sorts + 2:
        simulation.advance(simulation.bound())
    assert (pressed() == top).all()


def test_no_load_no_cost(tmp_path):
    simulation, _ = begin(tmp_path, BLOCK.replace("GRAVITY", "0").replace("RAMP", ""))
    assert "loads" not in simulation.features


def test_gravity_by_keyframes(tmp_path):
    """A body that falls freely has the integral of gravity times its mass, over any steps."""
    keys = (
        'gravity_keyframes = [{ time = "4 ms", gravity = [0, 0, -9.8] },'
        ' { time = "17 ms", gravity = [9.8, 0, 0] }]'
    )
    simulation, momentum = free(tmp_path, "", gravity=-9.8, ramp=keys)
    turn = 9.8 * 0.013 * 2 / np.pi  # a quarter of a turn in 13 ms
    want = np.array([turn + 9.8 * 0.003, 0.0, -turn - 9.8 * 0.004])
    mass = totals(simulation)["mass"]
    assert np.abs(momentum - mass * want).max() < 1e-12 * mass * 9.8 * END


AT_ONCE = {
    "impulse": ("impulse = [1e-3, -2e-3, 5e-4]", (1e-3, -2e-3, 5e-4)),
    "delta_velocity": ("delta_velocity = [0, 0.3, 0]", (0, 0.3 * 1000 * VOLUME, 0)),
}


@pytest.mark.parametrize("start_time", ["0 s", "5.1 ms"])
@pytest.mark.parametrize("case", AT_ONCE)
def test_what_is_given_at_once(tmp_path, case, start_time):
    """Once, in the step of its time, whatever the steps."""
    says, want = AT_ONCE[case]
    load = f'[[load]]\nobject = "block"\n{says}\nstart_time = "{start_time}"\n'
    _, momentum = free(tmp_path, load)
    assert np.abs(momentum - want).max() < 1e-12 * np.abs(want).max()


def test_it_is_given_once_where_a_frame_ends_a_step(tmp_path):
    """Its time is that of many frames that end a step; the time is met to the last bit."""
    text = BLOCK.replace("GRAVITY", "0").replace("RAMP", "")
    given = ""
    ends = [0.1 * k / 30 for k in range(1, 6)]
    for end in ends:
        given += f'[[load]]\nobject = "block"\ndelta_velocity = [0.1, 0, 0]\nstart_time = {end!r}\n'
    simulation, _ = begin(tmp_path, text + given)
    for k, end in enumerate(ends):
        before = totals(simulation)["momentum"][0]
        assert before == pytest.approx(0.1 * k * 1000 * VOLUME, rel=1e-12, abs=1e-15)
        advance(simulation, end)
        simulation.advance(1e-6)


@pytest.mark.parametrize("transfer", ["apic-corrected", "flip"])
def test_a_change_of_spin(tmp_path, transfer):
    """A body at rest gets w about its centre: no momentum, and I w of angular momentum, of which
    the particles of APIC have a part each, dx2 / 2 of their mass."""
    load = '[[load]]\nobject = ["block", "rider"]\ndelta_angular_velocity = [0, 0, 3]\n'
    load += 'start_time = "2 ms"\n'
    text = BLOCK.replace("GRAVITY", "0").replace("RAMP", "")
    simulation, made = begin(tmp_path, text.replace("apic-corrected", transfer) + load)
    mass = made.vol0 * np.array([1000.0, 500.0])[made.object]
    r = made.x - (mass[:, None] * made.x).sum(0) / mass.sum()
    if transfer == "flip":
        simulation.features["loads"].push_particles(StepSpan(3, 0.002, 0.003, 0.001))
        v, C = by_id(simulation, "v", "C")
        assert np.abs(v - np.cross([0, 0, 3], r)).max() < 1e-13 and not C.any()
        return
    advance(simulation, 0.0021)
    got, inertia = totals(simulation), (mass * (r[:, 0] ** 2 + r[:, 1] ** 2 + 0.02**2 / 2)).sum()
    assert np.abs(got["momentum"]).max() < 1e-14
    assert got["angular"] == pytest.approx([0, 0, 3 * inertia], rel=1e-10, abs=1e-12)


def test_steps_know_of_a_kick(tmp_path):
    """4 m/s within one step, in cells of 2 cm: no step but that one is shorter, and nothing blows
    up."""
    text = BLOCK.replace("GRAVITY", "0").replace("RAMP", "")
    load = '[[load]]\nobject = "block"\ndelta_velocity = [4, 0, 0]\nstart_time = "2 ms"\n'
    simulation, _ = begin(tmp_path, text + load)
    free = simulation.bound()
    assert simulation.bound() == free and free < 0.002
    while simulation.time + free < 0.002:
        simulation.advance(free)
    assert simulation.bound() < 0.4 * 0.02 / 4 < free + 0.4 * 0.02 / 4
    advance(simulation, 0.01)
