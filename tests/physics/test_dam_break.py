"""Dam break: the front against a published MPS simulation and experiments.

Theory: Koshizuka & Oka 1996 (MPS and experiment), Martin & Moyce 1952 (experiment, n2 = 2): column
of width L and height 2 L, t* = t sqrt(2 g / L), x* = front / L. Here 20 cells per column width, 4
cells deep between slip walls. The front is the largest x that water reaches without a gap, at
least three quarters of a layer of particles deep: a bound of a whole layer, dx / 2, would leave it
to rounding whether one layer counts. Tolerance: rms < 0.05 over the published MPS times.
"""

import numpy as np

from tests.support.simulate import advance, begin, by_id
from tests.support.validation_record import held

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
MARTIN_MOYCE = np.array(
    [[0.832, 1.217], [1.219, 1.474], [1.997, 2.292], [2.547, 2.995], [3.345, 4.134]]
)
L, CELLS, GRAVITY = 0.146, 20, 9.81
DX = L / CELLS
FRONT_DEPTH = 3 / 8  # [cells] least depth of water that counts as wet
SCENE = f"""
[accuracy]
pressure = "explicit"
precision = "double"
[domain]
size = [{90 * DX!r}, {4 * DX!r}, {50 * DX!r}]
cell = {DX!r}
gravity = [0, 0, {-GRAVITY}]
boundary = "slip"
[time]
end = 1
[material.water]
kind = "fluid"
tait_coefficient = 4e4
[[object]]
name = "column"
material = "water"
shape = {{ box = [[0, 0, 0], [{L!r}, {4 * DX!r}, {2 * L!r}]] }}
"""


def front(x, volume):
    """Largest x [m] connected to the west wall by water at least FRONT_DEPTH deep."""
    width = DX / 2
    filled = np.bincount((x[:, 0] / width).astype(int), volume, minlength=200)
    dry = filled / (width * 4 * DX) < FRONT_DEPTH * DX
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
    times, fronts = np.array(times), np.array(fronts)
    curves = {
        "ours": (times, fronts),
        "MPS, Koshizuka and Oka 1996": MPS.T,
        "their experiment": EXPERIMENT.T,
        "experiment, Martin and Moyce 1952": MARTIN_MOYCE[MARTIN_MOYCE[:, 0] < times[-1]].T,
    }
    say = {"kind": "below", "unit": "column widths, rms"}
    say |= {"note": f"{CELLS} cells per column width, no friction at walls"}
    axes = ("t sqrt(2 g / L)", "front / L")
    found, koshizuka = rms(MPS, times, fronts), "Koshizuka and Oka 1996, "
    more = {"source": koshizuka + "MPS", "curves": curves, "axes": axes}
    held("dam break: front, against MPS", found, 0.0, 0.05, **say, **more)
    # the experiment's floor holds the water back: every inviscid simulation is ahead of it
    real = rms(EXPERIMENT, times, fronts)
    more = {"source": koshizuka + "experiment", "expected": False}
    held("dam break: front, against the experiment", real, 0.0, 0.05, **say, **more)
