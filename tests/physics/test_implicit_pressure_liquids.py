"""An implicit pressure with several liquids: each has its own velocity, and one pressure moves all.

Theory: small waves on the interface of two liquids of depths h and H - h in a closed box have
omega^2 = g k (rho_2 - rho_1) / (rho_1 coth k (H - h) + rho_2 coth k h) (Lamb, Hydrodynamics, art.
231). Lock exchange: see test_lock_exchange.py.
"""

import numpy as np
import pytest

from tests.physics.test_lock_exchange import exchange
from tests.support.oscillation import period
from tests.support.simulate import advance, begin, by_id, totals

IMPLICIT = 'pressure = "implicit"'
LONG, HIGH, DX = 0.4, 0.4, 0.0125  # [m] half a wave, box, cell: 64 cells per wave
K, G = np.pi / LONG, 9.8
WAVE = """
[domain]
size = [{long!r}, {deep!r}, {high!r}]
cell = {dx!r}
[time]
end = 100
frames = 2
[accuracy]
precision = "double"
pressure = "implicit"
[material.light]
kind = "fluid"
density = {density}
max_speed = 1
[material.heavy]
kind = "fluid"
density = 1000
max_speed = 1
[[object]]
name = "heavy"
material = "heavy"
initial_pressure = "zero"
shape = {{ box = [[0, 0, 0], [{long!r}, {deep!r}, {half!r}]] }}
[[object]]
name = "light"
material = "light"
{phase}
initial_pressure = "zero"
shape = {{ box = [[0, 0, {half!r}], [{long!r}, {deep!r}, {high!r}]] }}
"""
DROPS = """
[domain]
size = [0.32, 0.24, 0.24]
cell = 0.02
gravity = [0, 0, 0]
[time]
end = 0.2
frames = 41
[accuracy]
precision = "double"
pressure = "implicit"
[material.water]
kind = "fluid"
[material.oil]
kind = "fluid"
density = 400
max_speed = 2
[[object]]
name = "slow"
material = "water"
shape = { sphere = { center = [0.19, 0.12, 0.12], radius = 0.05 } }
[[object]]
name = "fast"
material = "oil"
PHASE
velocity = [0.8, 0.1, 0]
shape = { box = [[0.06, 0.08, 0.08], [0.12, 0.16, 0.16]] }
"""
MIXING = """
[[coupling]]
kind = "mixing"
between = ["water", "oil"]
diffusivity = 1e-3
slip_relaxation_time = "10 ms"
"""


LAYERS = """
[domain]
size = [0.16, 0.08, 0.4]
cell = 0.02
[time]
end = 1
[accuracy]
pressure = "implicit"
[material.water]
kind = "fluid"
[material.oil]
kind = "fluid"
density = {density}
max_speed = 1
[[object]]
name = "water"
material = "water"
initial_pressure = "hydrostatic"
shape = {{ box = [[0, 0, 0], [{wide}, 0.08, 0.24]] }}
[[object]]
name = "oil"
material = "oil"
initial_pressure = "{initial}"
shape = {{ box = [[{side}, 0, {low}], [0.16, 0.08, {top}]] }}
"""


def interface_wave(x):
    """Velocity [m/s] of a wave that begins through a flat interface, at x (n, 3)."""
    z, half, v = x[:, 2], HIGH / 2, np.zeros_like(x)
    below = z < half
    depth = np.where(below, z, HIGH - z)
    sign = np.where(below, 1.0, -1.0)
    a = 0.06 / np.sinh(K * half)
    v[:, 0] = -a * sign * np.cosh(K * depth) * np.sin(K * x[:, 0])
    v[:, 2] = a * np.sinh(K * depth) * np.cos(K * x[:, 0])
    return v


@pytest.mark.parametrize(
    "phase, max_error",
    [('phase = "light"', 0.02), ("", 0.05)],
    ids=["apart", "one velocity"],
)
@pytest.mark.parametrize("density", [500, 1.25])
def test_a_wave_between_two_liquids(tmp_path, density, phase, max_error):
    """64 cells per wave. Liquids of one velocity do not slip past each other, as those of a wave do
    (explicit: 0.042 too)."""
    omega2 = G * K * (1000 - density) / (1000 + density) * np.tanh(K * HIGH / 2)
    expected = 2 * np.pi / np.sqrt(omega2)
    text = WAVE.format(
        long=LONG, high=HIGH, half=HIGH / 2, deep=4 * DX, dx=DX, density=density, phase=phase
    )
    simulation, made = begin(tmp_path, text, velocity=interface_wave)
    heavy = made.object == 0
    times, middle = [], []
    for k in range(1, 49):
        advance(simulation, k * expected / 40)
        (x,) = by_id(simulation, "x")
        times.append(simulation.time)
        middle.append(x[heavy, 0].mean() - LONG / 2)
    found = period(times, middle)
    print(f"1000 and {density} {phase}: period {found / expected:.4f} of theory")
    assert found == pytest.approx(expected, rel=max_error)


def test_both_fronts_of_a_lock_exchange(tmp_path):
    """Shin, Dalziel and Linden: 0.42 to 0.5 of sqrt(g' H); without losses 0.5, found to 0.01."""
    lower, upper, emptiest = exchange(tmp_path, "max_speed = 1", IMPLICIT)
    print(f"fronts {lower:.3f} and {upper:.3f}, emptiest node {emptiest:.2f}")
    assert 0.42 < lower < 0.51 and 0.42 < upper < 0.51
    assert emptiest > 0.5


@pytest.mark.parametrize("kind", ["one velocity", "apart", "mixing"])
def test_momentum_is_exact(tmp_path, kind):
    """A drop of oil meets one of water, far from walls; apart, each has its own velocity."""
    text = DROPS.replace("PHASE", 'phase = "oil"' if kind == "apart" else "")
    simulation, made = begin(tmp_path, text + (MIXING if kind == "mixing" else ""))
    before, oil = totals(simulation)["momentum"], made.object == 1
    assert by_id(simulation, "v")[0][~oil].max() == 0
    advance(simulation, 0.12)
    after = totals(simulation)["momentum"]
    assert simulation.step >= 10
    assert by_id(simulation, "v")[0][~oil, 0].mean() > 0.05
    assert np.abs(after - before).max() < 1e-12 * np.abs(before).max()


MIXED = {"density": 1000, "wide": 0.08, "side": 0.08, "low": 0, "top": 0.24,
         "initial": "hydrostatic"}  # fmt: skip
ABOVE = {"density": 1.25, "wide": 0.16, "side": 0, "low": 0.24, "top": 0.4, "initial": "zero"}


@pytest.mark.parametrize(
    "layers, coupling", [(MIXED, MIXING), (ABOVE, "")], ids=["fluids that mix", "air above water"]
)
def test_pressure_at_rest(tmp_path, layers, coupling):
    """That of the weight above, in all steps, whatever the stiffness of the lighter liquid."""
    simulation, _ = begin(tmp_path, LAYERS.format(**layers) + coupling)
    for step in range(8):
        simulation.advance(min(simulation.bound(), 0.01))
        x, pressure = by_id(simulation, "x", "pressure")
        lowest = x[:, 2] < 0.02
        assert pressure[lowest].mean() == pytest.approx(G * 1000 * 0.23, rel=0.03), step
