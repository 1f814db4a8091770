"""A piston that swings to and fro at the end of a tank makes waves.

Theory: small waves have omega^2 = g k tanh(k h), and those of a piston of stroke S, from end to
end, are high by H / S = 2 (cosh 2 k h - 1) / (sinh 2 k h + 2 k h), from trough to crest, beyond
what stays with the piston (Dean and Dalrymple 1991, Water Wave Mechanics for Engineers and
Scientists, section 6.2). The piston is a box collider that keyframes move along a sine, which grows
from 0 within a period. Heights of the surface, means over hats of two cells to each side, are taken
between 2 and 3 depths from the piston, in a period that begins two and a half after the first waves
have come there and ends before any comes back, and a sine of omega is fitted to each. Slab of 4
cells; water that its weight compresses by 1 % at the bottom. Waves are a tenth of the depth high.
Tolerance: 10 %. All are too low: what a piston displaces is right, but what it makes dies on the
way, the more the fewer cells a depth and a wave have (k h = 1.2: 22, 16, 10 % of 6, 8, 12 cells),
and more with 27 particles per cell than with 8 (6 cells: 26 for 22 %). Short waves in deep water
miss the tolerance.
"""

import numpy as np
import pytest

from tests.support.simulate import advance, begin, by_id
from tests.support.validation_record import held

G, H = 9.8, 0.1  # [m/s2], depth [m]
HEIGHT = 0.1  # of the waves over the depth
AT = 4  # cells from the wall behind the piston to its face at rest
SCENE = """
[domain]
size = [{long!r}, {wide!r}, {high!r}]
cell = {dx!r}
[time]
end = 100
[accuracy]
pressure = "explicit"
precision = "single"
[material.water]
kind = "fluid"
max_depth = 0.1
[[object]]
name = "water"
material = "water"
initial_pressure = "hydrostatic"
shape = {{ box = [[{face!r}, 0, 0], [{long!r}, {wide!r}, 0.1]] }}
[[object]]
name = "piston"
role = "scenery"
collider = true
shape = {{ box = [[{back!r}, {south!r}, -0.05], [{face!r}, {north!r}, {top!r}]] }}
motion = {{ keyframes = [{keys}] }}
"""


def theory(kh):
    """(omega [rad/s], fastest speed of anything in the waves [m/s], H / S)."""
    omega = np.sqrt(G * kh / H * np.tanh(kh))
    return omega, np.sqrt(G * H), 2 * (np.cosh(2 * kh) - 1) / (np.sinh(2 * kh) + 2 * kh)


def waves(folder, kh, cells):
    """(H / S, times (n,) [s], heights (n,) [m] above the water at rest 2.5 depths from the piston,
    stroke [m]). cells: of the depth."""
    omega, fast, share = theory(kh)
    dx, period, stroke = H / cells, 2 * np.pi / omega, HEIGHT * H / share
    # speed of the group of waves, at which their height travels
    group = 0.5 * (1 + 2 * kh / np.sinh(2 * kh)) * omega * H / kh
    ends = 2.5 * H / group + 3.5 * period
    face = AT * dx
    far = face + 0.5 * (fast * ends + 3 * H)
    keys = np.arange(1, int(np.ceil(32 * ends / period)) + 1) * period / 32
    moves = 0.5 * stroke * np.minimum(keys / period, 1.0) * np.sin(omega * keys)
    text = SCENE.format(
        long=round(float(np.ceil(far / dx / 4)) * 4 * dx, 9), wide=4 * dx, high=round(1.5 * H, 9),
        dx=dx, face=face, back=-4 * dx, south=-4 * dx, north=8 * dx, top=0.3,
        keys=", ".join(
            f"{{ time = {t:.9f}, translation = [{m:.9f}, 0, 0] }}"
            for t, m in zip(keys, moves, strict=True)
        ),
    )  # fmt: skip
    simulation, made = begin(folder, text)
    gauges = face + np.linspace(2 * H, 3 * H, 5)
    rows = []
    for time in np.linspace(0, ends, round(24 * ends / period) + 1)[1:]:
        advance(simulation, float(time))
        x = by_id(simulation, "x")[0][:, 0]
        rows.append([time, *(_level(x, made.vol0, gauge, dx) for gauge in gauges)])
    t, levels = np.array(rows)[:, 0], np.array(rows)[:, 1:]
    late = t > ends - period
    a = omega * t[late]
    sines = np.column_stack([np.ones_like(a), np.cos(a), np.sin(a)])
    found = np.linalg.lstsq(sines, levels[late], rcond=None)[0]
    k = kh / H
    blurs = np.sinc(k * dx / np.pi) ** 2  # what the hats leave of a wave
    high = 2 * np.hypot(found[1], found[2]) / blurs
    return high.mean() / stroke, t, levels[:, 2] - H, stroke


def _level(x, volume, gauge, dx):
    """Mean height [m] of the water round x = gauge, by a hat of 2 cells to each side."""
    hat = np.maximum(1 - np.abs(x - gauge) / (2 * dx), 0.0)
    return (hat * volume).sum() / (2 * dx * 4 * dx)


@pytest.mark.parametrize(
    "kh, cells, good",
    [
        (1.2, 6, False),
        pytest.param(0.7, 12, True, marks=pytest.mark.slow),
        pytest.param(1.2, 12, True, marks=pytest.mark.slow),
        pytest.param(2.0, 12, False, marks=pytest.mark.slow),
    ],
)
def test_height_over_stroke(tmp_path, kh, cells, good):
    found, t, level, stroke = waves(tmp_path, kh, cells)
    omega, _, share = theory(kh)
    swings = 0.5 * stroke * np.minimum(omega * t / (2 * np.pi), 1.0) * np.sin(omega * t)
    held(
        f"piston: height of waves over stroke, k h = {kh}, {cells} cells deep",
        found,
        share,
        0.1,
        source="Dean and Dalrymple 1991, section 6.2",
        note=f"{2 * np.pi / kh * cells:.0f} cells per wave",
        curves={
            "water, 2.5 depths away [m]": (t, level),
            "piston [m]": (t, swings),
        },
        axes=("time [s]", "height, way [m]"),
        expected=good,
        deviation=True,
    )
    assert 0.65 < found / share < 1.1
