"""How bodies begin: waves of velocity, shares of space, pressure at rest."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.support.simulate import begin, by_id
from tests.support.small_scenes import scene
from vgmpi.io import initial_state
from vgmpi.preprocess.initial_conditions import initial_velocity, initial_velocity_gradient
from vgmpi.preprocess.scene_builder import build_scene

BOX = """
[domain]
size = [0.4, 0.2, 0.4]
cell = 0.02
[time]
end = 0.01
frames = 2
[accuracy]
precision = "PRECISION"
pressure = "explicit"
[material.water]
kind = "fluid"
tait_coefficient = 2e4
EXPONENT
[material.oil]
kind = "fluid"
density = 800
tait_coefficient = 2e4
[[object]]
name = "water"
material = "water"
shape = { box = [[0, 0, 0.1], [0.4, 0.2, 0.3]] }
"""


def made_of(folder, keys, exponent=""):
    return build_scene(scene(folder, text(exponent=exponent) + keys))


def text(precision="double", exponent=""):
    return BOX.replace("PRECISION", precision).replace("EXPONENT", exponent)


def test_waves(tmp_path):
    """Besides velocity and angular velocity; a phase angle of 90 deg is a cosine."""
    keys = """
velocity = [0, 1, 0]
velocity_mode = [
  { amplitude = [0, 0, "2 cm/s"], wave_vector = [15.7, 0, 3] },
  { amplitude = [0.5, 0, 0], wave_vector = [0, 0, 7], phase_angle = "90 deg" },
]
"""
    made = made_of(tmp_path, keys)
    x, _, z = made.x.T
    want = np.stack([0.5 * np.cos(7 * z), 1 + 0 * x, 0.02 * np.sin(15.7 * x + 3 * z)], 1)
    assert np.abs(made.v0 - want).max() < 1e-14
    one = made_of(tmp_path, "velocity_mode = { amplitude = [0, 1, 0], wave_vector = [1, 0, 0] }")
    assert np.abs(one.v0[:, 1] - np.sin(x)).max() < 1e-15


def test_two_fluids_share_their_space(tmp_path, caplog):
    keys = """volume_fraction = 0.25
[[object]]
name = "oil"
material = "oil"
volume_fraction = 0.75
shape = { box = [[0, 0, 0.1], [0.4, 0.2, 0.3]] }
"""
    made = made_of(tmp_path, keys)
    whole = np.bincount(made.object, made.vol0)
    assert whole == pytest.approx(0.4 * 0.2 * 0.2 * np.array([0.25, 0.75]), rel=1e-12)
    assert "overlap" not in caplog.text
    made_of(tmp_path, keys.replace("volume_fraction", "#"))
    assert "overlap" in caplog.text


def test_profile(tmp_path):
    """Straight lines between the points; no particle where the share is 0."""
    profile = 'axis = "x", positions = ["5 cm", "20 cm", 0.3], values = [0, 1, 0.5]'
    keys = f"volume_fraction_profile = {{ {profile} }}"
    made = made_of(tmp_path, keys)
    x = made.x[:, 0]
    want = np.where(x < 0.2, (x - 0.05) / 0.15, np.maximum(1 - 5 * (x - 0.2), 0.5))
    assert x.min() == pytest.approx(0.055)
    assert made.vol0 == pytest.approx(1e-6 * want, rel=1e-12)
    assert made.objects[0]["row_count"] == len(x) == len(made.opacity)


@pytest.mark.parametrize("exponent", ["", "tait_exponent = 1", "tait_exponent = 1.4"])
def test_pressure_at_rest(tmp_path, exponent):
    """dp/d(depth) = density g / J, integrated here by steps, with J of this p by the law."""
    made = made_of(tmp_path, 'initial_pressure = "hydrostatic"', exponent)
    J, depth = np.exp(made.theta0), 0.3 - made.x[:, 2]
    assert (made.vol0 * J) == pytest.approx(np.full(len(J), 1e-6), rel=1e-12)
    g = 7.0 if not exponent else float(exponent.split("=")[1])
    at, which = np.unique(np.round(depth, 9), return_inverse=True)
    solved = solve_ivp(
        lambda _, p: 9800 * (1 + p / 2e4) ** (1 / g), (0, 0.2), [0.0], t_eval=at, rtol=1e-10
    )
    assert 2e4 * (J**-g - 1) == pytest.approx(solved.y[0][which], rel=1e-5)
    assert J.min() < 0.995


@pytest.mark.parametrize("precision", ["single", "double"])
def test_it_gets_into_the_run(tmp_path, precision):
    simulation, made = begin(tmp_path, text(precision) + 'initial_pressure = "hydrostatic"')
    J, vol0 = by_id(simulation, "J", "vol0")
    tolerance = 1e-6 if precision == "single" else 1e-14
    assert np.abs(J - np.exp(made.theta0)).max() < tolerance and J.min() < 0.99
    assert np.abs(vol0 / made.vol0 - 1).max() < tolerance
    plain, _ = begin(tmp_path, text(precision))
    assert simulation.rate > plain.rate * (1 + 1e-3), "compressed water is stiffer"


def test_files_carry_it(tmp_path):
    """gaussians.h5 has theta0 only if something is compressed."""
    from vgmpi.parallel.communicator import SerialCommunicator
    from vgmpi.solver.initial_particles import prepare, write_initial_particles

    for key, there in (('initial_pressure = "hydrostatic"', True), ("", False)):
        known = scene(tmp_path, text() + key)
        write_initial_particles(
            known, prepare(known, SerialCommunicator(), tmp_path), SerialCommunicator(), tmp_path
        )
        rows = initial_state.read_slice(tmp_path / "gaussians.h5", 0, 10)
        assert ("theta0" in rows) == there
        if there:
            assert (rows["theta0"] == build_scene(known).theta0[:10]).all()


def test_the_gradient_of_what_turns_and_waves(tmp_path):
    """It is the field's own and gets into a run; without turning and waves there is none."""
    from vgmpi.parallel.communicator import SerialCommunicator
    from vgmpi.solver.run import prepared_run
    from vgmpi.solver.run_options import Options

    keys = "angular_velocity = [1, -2, 3]\n"
    keys += (
        "velocity_mode = { amplitude = [0.1, 0, 0.2], wave_vector = [9, 4, -7], phase_angle = 1 }\n"
    )
    keys += '[[object]]\nname = "oil"\nmaterial = "oil"\nvelocity = [1, 0, 0]\n'
    keys += "shape = { box = [[0, 0, 0.3], [0.4, 0.2, 0.4]] }\n"
    known = scene(tmp_path, text() + keys)
    made = build_scene(known)
    found = initial_velocity_gradient(known, made.x, made.object).reshape(-1, 3, 3)
    first = made.object == 0
    assert first.any() and not first.all() and not found[~first].any()
    x, volume = made.x[first], made.vol0[first]
    middle = (x * volume[:, None]).sum(0) / volume.sum()
    for b in range(3):
        moved = []
        for step in (1e-5, -1e-5):
            # its centre stays where it is: only the points at which the field is asked for move
            at = np.concatenate([x + step * np.eye(3)[b], middle[None]])
            weight = np.concatenate([np.zeros(len(x)), [1.0]])
            moved.append(initial_velocity(known.object[0], at, weight)[:-1])
        slope = (moved[0] - moved[1]) / 2e-5
        assert np.abs(found[first, :, b] - slope).max() < 1e-8
    with prepared_run(known, SerialCommunicator(), Options(None)) as run:
        (C,) = by_id(run.simulation, "C")
    assert np.abs(C - found.reshape(-1, 9)).max() < 1e-15
    assert (
        initial_velocity_gradient(
            scene(tmp_path, text() + "velocity = [1, 0, 0]"), x, made.object[first]
        )
        is None
    )
