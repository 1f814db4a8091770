"""Very slow motion in single precision: nothing stagnates.

Theory: a free body moves by v t, and a body strained at a rate keeps the strain rate times t. With
positions and F stored as plain single floats an increment below half a unit in the last place is
lost at every step.
Tolerance: 1 % of the distance and of the strain.
"""

import numpy as np
import pytest

from tests.support.simulate import begin, by_id

SCENE = """
[domain]
size = [0.24, 0.24, 0.24]
cell = 0.02
gravity = [0, 0, 0]
[time]
end = 1
[accuracy]
precision = "single"
[material.rubber]
kind = "elastic"
youngs_modulus = 1e3
[material.water]
kind = "fluid"
tait_coefficient = 1e2
[[object]]
name = "cube"
material = "MATERIAL"
shape = { box = [[0.1, 0.1, 0.1], [0.14, 0.14, 0.14]] }
"""
DT = 1e-5


@pytest.mark.parametrize("material", ["rubber", "water"])
@pytest.mark.parametrize(
    "speed, steps",
    [
        (1e-4, 5_000),
        (1e-7, 40_000),  # a step moves it by 0.03 of the smallest difference of positions
        pytest.param(1e-4, 100_000, marks=pytest.mark.slow),
        pytest.param(1e-7, 100_000, marks=pytest.mark.slow),
    ],
)
def test_a_slow_body_moves_by_the_right_distance(tmp_path, material, speed, steps):
    text = SCENE.replace("MATERIAL", material)
    velocity = speed * np.array([1.0, -0.7, 0.4])
    simulation, made = begin(tmp_path, text, velocity=lambda x: np.tile(velocity, (len(x), 1)))
    (before,) = by_id(simulation, "x")
    for _ in range(steps):
        simulation.advance(DT)
    (after,) = by_id(simulation, "x")
    share = (after - before).mean(0) / (velocity * steps * DT)
    print(f"{material} at {speed:g} m/s, {steps} steps: {share} of the way")
    assert np.abs(share - 1).max() < 0.01


@pytest.mark.parametrize("rate", [1e-3])
def test_a_slow_strain_adds_up(tmp_path, rate):
    """Inertia alone: so soft and short that stress has no time to answer."""
    text = SCENE.replace("MATERIAL", "rubber").replace("1e3", "1e-3")
    middle, steps = np.array([0.12, 0.12, 0.12]), 5_000

    def stretch(x):
        v = np.zeros_like(x)
        v[:, 0] = rate * (x[:, 0] - middle[0])
        return v

    simulation, _ = begin(tmp_path, text, velocity=stretch)
    group = simulation.groups[0]
    at = group.index()
    group.f[3, at] = rate  # the affine part of the same motion
    for _ in range(steps):
        simulation.advance(DT)
    strain = group.f[13, group.index()].mean()
    share = strain / (rate * steps * DT)
    print(f"strain rate {rate:g} /s, {steps} steps of {DT:g} s: {share:.5f} of the strain")
    assert abs(share - 1) < 0.01
