"""Water at rest stays at rest: pressure over depth, and the height of its centre of mass.

Theory: p = rho g (H - z). The compression under its own weight at the bottom, rho g H / K with K
the bulk modulus, is .15 % here (`max_depth`, `max_compression`): p differs from this line by less
than .1 % of rho g H, and the centre of mass of a column that begins uncompressed sinks by a third
of the compression, .05 % of H. Tolerances: .1 % of H for the centre of mass, 1 % of rho g H for p.
"""

import numpy as np
import pytest

import vgmpi
from tests.support.validation_record import held

H, CELLS, WEIGHT = 0.16, 16, 1000 * 9.8 * 0.16  # WEIGHT: rho g H [Pa]
HEIGHTS = (0.125, 0.375, 0.625, 0.875)  # of the probes [H]
SCENE = """
[domain]
size = [0.04, 0.04, 0.2]
cell = 0.01
gravity = [0, 0, -9.8]
{ramp}
[time]
end = {end}
frames = 41
[accuracy]
pressure = "explicit"
precision = "{precision}"
[material.water]
kind = "fluid"
density = 1000
max_depth = 0.16
max_compression = 0.0015
[[object]]
name = "water"
material = "water"
initial_pressure = "{initial_pressure}"
shape = {{ box = [[0, 0, 0], [0.04, 0.04, 0.16]] }}
"""
PROBE = """
[[probe]]
name = "{name}"
sampling_rate = 100
pressure = [0.02, 0.02, {z}]
"""


@pytest.mark.parametrize(
    "initial_pressure, end, precision",
    [
        ("hydrostatic", 1.0, "single"),
        ("zero", 1.0, "single"),
        pytest.param("hydrostatic", 10.0, "double", marks=pytest.mark.slow),
    ],
)
def test_at_rest(tmp_path, initial_pressure, end, precision):
    """initial_pressure "zero": gravity grows over .3 s instead, and the column settles."""
    ramp = "gravity_ramp_time = 0.3" if initial_pressure == "zero" else ""
    text = SCENE.format(ramp=ramp, end=end, precision=precision, initial_pressure=initial_pressure)
    text += "".join(PROBE.format(name=f"p{k}", z=z * H) for k, z in enumerate(HEIGHTS))
    middle = []
    scene = vgmpi.load(tmp_path / "rest.toml", text=text)
    run = vgmpi.run(scene, on_frame=lambda now: middle.append(now.array("positions")[:, 2].mean()))
    assert run.code == 0 and len(middle) == 41
    start = "begun compressed" if initial_pressure == "hydrostatic" else "begun uncompressed"
    title = f"water at rest for {end:.0f} s, {start}"
    note = f"{CELLS} cells, {precision} precision, rho g H / K = 0.15 %"
    drift = np.abs(np.array(middle) / H - middle[0] / H)
    say = {"kind": "below", "unit": "of H", "source": "at rest", "note": note}
    held(f"{title}: drift of the centre of mass", float(drift.max()), 0.0, 1e-3, **say)
    rows = [[r for r in run.probes[f"p{k}"] if r["time"] > end / 2] for k in range(4)]
    found = np.array([np.mean([r["pressure"] for r in late]) for late in rows]) / WEIGHT
    want = 1 - np.array(HEIGHTS)
    curves = {"probes": (HEIGHTS, found), "exact": ([0, 1], [1, 0])}
    say |= {"unit": "of rho g H", "source": "p = rho g (H - z)", "curves": curves}
    say["axes"] = ("z / H", "p / (rho g H)")
    held(f"{title}: pressure", float(np.abs(found - want).max()), 0.0, 0.01, **say)
