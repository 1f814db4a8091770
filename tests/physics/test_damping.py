"""Damping in proportion to mass (Rayleigh's alpha), by a load.

References: exp(-alpha t) for a free body, whatever the time step; the static elongation of a
hanging bar, rho g (L s - s^2 / 2) / E at the distance s from its upper end.
"""

import numpy as np
import pytest

from tests.physics.test_loads import BLOCK, END
from tests.support.simulate import advance, begin, by_id, totals
from tests.support.small_scenes import scene
from tests.support.validation_record import held
from vgmpi.runtime.config.schema import SceneError

ALPHA = 40.0  # [1/s]
LOAD = '[[load]]\nobject = ["block", "rider"]\ndamping = "40 1/s"\n'
BODIES = BLOCK.replace("GRAVITY", "0").replace("RAMP", "")


def moving(folder, load, cfl=0.4, transfer="apic-corrected", end=END):
    """Momentum and angular momentum about the center at the start and at the end."""
    text = BODIES.replace("cfl = 0.4", f"cfl = {cfl}").replace("apic-corrected", transfer)

    def turning(x):
        return np.cross([0.0, 6.0, 0.0], x - [0.2, 0.2, 0.22]) + [0.4, 0.3, -0.2]

    simulation, _ = begin(folder, text + load, velocity=turning)
    before = totals(simulation)
    advance(simulation, end)
    return before, totals(simulation), simulation


@pytest.mark.parametrize("transfer", ["apic-corrected", "apic", "flip", "pic"])
@pytest.mark.parametrize("cfl", [0.1, 0.4])
def test_a_free_body_slows_down_exponentially(tmp_path, transfer, cfl):
    before, after, _ = moving(tmp_path, LOAD, cfl, transfer)
    left = np.exp(-ALPHA * END)
    np.testing.assert_allclose(after["momentum"], left * before["momentum"], rtol=1e-11)


def test_a_turn_slows_down_as_well(tmp_path):
    """The angular momentum about the origin is that of the undamped body times the same factor, at
    the place of the body that it has gone to."""
    before, after, simulation = moving(tmp_path, LOAD, 0.1, end=0.002)
    left = np.exp(-ALPHA * simulation.time)
    np.testing.assert_allclose(after["angular"], left * before["angular"], rtol=1e-9)


def test_it_comes_and_goes(tmp_path):
    """From 3 to 11 ms; steps do not fall on these times."""
    load = LOAD + 'start_time = "3 ms"\nend_time = "11 ms"\n'
    before, after, _ = moving(tmp_path, load)
    left = np.exp(-ALPHA * 0.008)
    np.testing.assert_allclose(after["momentum"], left * before["momentum"], rtol=1e-11)


HANGING = """
[accuracy]
precision = "double"
[domain]
size = [0.16, 0.16, 0.48]
cell = 0.02
[time]
end = 1
[material.rubber]
kind = "elastic"
density = 1000
youngs_modulus = 3e5
poisson_ratio = 0
[[object]]
name = "bar"
material = "rubber"
shape = { box = [[0.04, 0.04, 0.06], [0.12, 0.12, 0.42]] }
pinned = { box = [[0.02, 0.02, 0.36], [0.14, 0.14, 0.44]] }
[[load]]
object = "bar"
damping = "90 1/s"
"""


def test_a_hanging_bar_comes_to_rest(tmp_path):
    """At its static elongation, within twice the time constant of its slowest vibration."""
    length, modulus, density, g = 0.3, 3e5, 1000.0, 9.8
    simulation, made = begin(tmp_path, HANGING)
    advance(simulation, 0.25)
    x, v = by_id(simulation, "x", "v")
    free = made.x[:, 2] < 0.36
    s = 0.36 - made.x[free, 2]
    sag = density * g * (length * s - 0.5 * s**2) / modulus
    down = made.x[free, 2] - x[free, 2]
    share = float((down * sag).sum() / (sag**2).sum())
    held("hanging bar at rest by damping: elongation over that by theory", share, 1.0, 0.03,
         source="rho g L^2 / (2 E)")  # fmt: skip
    assert np.abs(down - sag).max() < 0.05 * sag.max()
    assert np.abs(v).max() < 0.01 * np.sqrt(g * sag.max())


WRONG = [
    ("damping = -1", "load.0.damping: must be > 0 1/s"),
    ("damping = 0", "load.0.damping: must be > 0 1/s"),
    ('damping = "2 N s/m"', "load.0.damping: 'N s/m' does not measure a rate"),
    (
        "damping = 1\nforce = [1, 0, 0]",
        "load.0.damping: force and damping given at once: give exactly one",
    ),
    (
        'damping = 1\n[[probe]]\nname = "w"\nsampling_rate = 10\nwall = "all"',
        "probe.w.wall: is not for scenes with a load of damping: its force is no part of the",
    ),
]


@pytest.mark.parametrize(("text", "message"), WRONG)
def test_what_is_refused(tmp_path, text, message):
    with pytest.raises(SceneError) as error:
        scene(tmp_path, BODIES + f'[[load]]\nobject = "block"\n{text}\n')
    assert message in str(error.value)
