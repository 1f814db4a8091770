"""Dam break: the front against the published MPS simulation and experiment.

Theory: Koshizuka & Oka 1996 (MPS and experiment), column of width L and height 2 L, t* = t sqrt(2 g
/ L), x* = front / L. Here 20 cells per column width, 4 cells deep between slip walls. The front is
the largest x that water at least dx / 2 deep reaches without a gap. Tolerance: rms < 0.05 over the
published MPS times.
"""

import numpy as np

from tests.simulate import advance, begin, by_id

MPS = np.array(
    [
        [0.591, 1.205],
        [0.958, 1.512],
        [1.381, 1.931],
        [1.858, 2.48],
        [2.278, 3.004],
        [2.604, 3.481],
        [2.752, 3.7],
    ]
)
EXPERIMENT = np.array(
    [
        [0.381, 1.111],
        [0.769, 1.252],
        [1.153, 1.505],
        [1.537, 1.892],
        [1.935, 2.241],
        [2.323, 2.615],
        [2.719, 3.003],
        [3.096, 3.624],
    ]
)
L, CELLS, GRAVITY = 0.146, 20, 9.81
DX = L / CELLS
SCENE = f"""
[domain]
size = [{90 * DX!r}, {4 * DX!r}, {50 * DX!r}]
cell = {DX!r}
gravity = [0, 0, {-GRAVITY}]
boundary = "slip"
[time]
end = 1
[material.water]
kind = "fluid"
bulk_modulus = 4e4
[[object]]
name = "column"
material = "water"
shape = {{ box = [[0, 0, 0], [{L!r}, {4 * DX!r}, {2 * L!r}]] }}
"""


def front(x, volume):
    """Largest x [m] connected to the west wall by water at least dx / 2 deep."""
    width = DX / 2
    held = np.bincount((x[:, 0] / width).astype(int), volume, minlength=200)
    dry = held / (width * 4 * DX) < DX / 2
    return np.argmax(dry) * width


def rms(series, times, fronts):
    return float(np.sqrt(np.mean((np.interp(series[:, 0], times, fronts) - series[:, 1]) ** 2)))


def test_front(tmp_path):
    simulation, made = begin(tmp_path, SCENE)
    unit = np.sqrt(L / (2 * GRAVITY))
    times, fronts = [0.0], [1.0]
    for k in range(1, 42):
        advance(simulation, 0.08 * k * unit)
        (x,) = by_id(simulation, "x")
        times.append(0.08 * k)
        fronts.append(front(x, made.vol0) / L)
    found, real = rms(MPS, times, fronts), rms(EXPERIMENT, times, fronts)
    print(f"dam break: rms {found:.4f} against MPS, {real:.4f} against the experiment")
    assert found < 0.05
