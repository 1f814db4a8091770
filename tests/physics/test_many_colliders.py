"""What moving colliders cost: 100 of them with 10,000 keyframes beside 100,000 particles.

The same pool with and without them in turn, by the processor's time of this process; the colliders
turn and rise above the water and touch nothing: their courses, poses and the blocks near them are
what is paid. Tolerance: a tenth of a step, by the median of the ratios of pairs.
"""

import time

import numpy as np
import pytest

from tests.support.simulate import begin
from tests.support.validation_record import held

POOL = """
[domain]
size = [0.96, 0.48, 0.48]
cell = 0.01
[time]
end = 20
[accuracy]
pressure = "explicit"
precision = "single"
[material.water]
kind = "fluid"
tait_coefficient = 2e4
[[object]]
name = "pool"
material = "water"
shape = { box = [[0, 0, 0], [0.96, 0.48, 0.03]] }
"""
ROUNDS, STEPS, MANY = 9, 12, 100


def colliders():
    text = ""
    for k in range(MANY):
        x, y = 0.05 + 0.09 * (k % 10), 0.03 + 0.044 * (k // 10)
        keys = ", ".join(
            f"{{ time = {0.2 * (i + 1):.1f}, angle = {0.1 * (i % 7):.1f},"
            f" translation = [0, 0, {0.01 * np.sin(i + k):.4f}] }}"
            for i in range(100)
        )
        text += (
            f'[[object]]\nname = "ball {k}"\nrole = "scenery"\ncollider = true\n'
            f"shape = {{ sphere = {{ center = [{x:.3f}, {y:.3f}, 0.3], radius = 0.02 }} }}\n"
            f"motion = {{ keyframes = [{keys}] }}\n"
        )
    return text


def steps(simulation):
    """Processor time [s] of some steps."""
    start = time.process_time()
    for _ in range(STEPS):
        simulation.advance(simulation.bound())
    return time.process_time() - start


@pytest.mark.slow
def test_a_hundred_cost_less_than_a_tenth_of_a_step(tmp_path):
    (tmp_path / "a").mkdir(), (tmp_path / "b").mkdir()
    pairs = [begin(tmp_path / "a", POOL), begin(tmp_path / "b", POOL + colliders())]
    (plain, made), (moved, _) = pairs
    steps(plain), steps(moved)
    ratios = [steps(moved) / steps(plain) for _ in range(ROUNDS)]
    assert len(made.x) > 100_000 and len(moved.movers.colliders) == MANY
    assert np.ptp(moved.movers.poses(moved.time)[:, 2, 3]) > 0, "they do not move"
    held(
        "100 moving colliders, 10,000 keyframes: time of a step over that without",
        float(np.median(ratios)),
        0.0,
        1.1,
        kind="below",
        source="measured in pairs",
        note=f"{len(made.x)} particles; {min(ratios):.3f} .. {max(ratios):.3f}",
    )
