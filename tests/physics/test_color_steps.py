"""Colors through the grid with every step, `color_transfer = "step"`.

The paper's transfer S once a step, (S c)_p = sum_i w_ip c_i with c_i = sum_p w_ip V_p c_p / sum_p
w_ip V_p:

- one step equals the transfer of vgmpi/gaussians/color_diffusion.py at the places before the step,
over
  all fluids of a phase and over fluids that mix; to 1e-12 of the range of colors in double
  precision;
- sum_p V_p c_p is kept by it to rounding, and equal colors stay equal in every bit;
- an edge between two colors at rest spreads with D = dx^2 / (4 dt): after N steps its profile is
  that of the error function with a variance of N dx^2 / 2; rms of the difference at most .01.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import erf

from tests.support import simulate
from tests.support.simulate import begin, by_id
from tests.support.validation_record import held
from vgmpi.features.color_transfer.plan import coefficient_ranges
from vgmpi.gaussians.color_diffusion import Transfer
from vgmpi.preprocess.scene_builder import build_scene
from vgmpi.solver.restart.state_io import frame_rows

PAPER = "VersaGauss, transfer of colors"
SCENE = """
[accuracy]
pressure = "explicit"
precision = "double"
[domain]
size = ["12 cm", "6 cm", "8 cm"]
cell = "1 cm"
boundary = "slip"
[time]
end = "0.1 s"
frames = 2
[appearance]
color_transfer = "step"
MORE
[material.water]
kind = "fluid"
tait_coefficient = "20 kPa"
[material.milk]
kind = "fluid"
tait_coefficient = "20 kPa"
viscosity = 0.01
[material.toy]
kind = "elastic"
density = 700
youngs_modulus = "20 kPa"
poisson_ratio = 0.3
[[coupling]]
kind = "mixing"
between = ["water", "milk"]
slip_relaxation_time = 0.01
[[object]]
name = "left"
material = "water"
color = "#ff2010"
shape = { box = [[0, 0, 0], ["5 cm", "6 cm", "4 cm"]] }
velocity = [0.5, 0, 0]
[[object]]
name = "right"
material = "water"
color = "#1020ff"
shape = { box = [["5 cm", 0, 0], ["9 cm", "6 cm", "4 cm"]] }
[[object]]
name = "jug"
material = "milk"
color = "#f0f0e0"
shape = { box = [["9 cm", 0, 0], ["12 cm", "6 cm", "4 cm"]] }
[[object]]
name = "toy"
material = "toy"
color = "#20ff20"
shape = { box = [["2 cm", "1 cm", "4.5 cm"], ["6 cm", "5 cm", "7 cm"]] }
"""


def colors(simulation):
    """Of every particle by its id, (n, 3 K)."""
    ids, rows = frame_rows(simulation, ())
    out = np.empty_like(rows["color_sh"])
    out[ids] = rows["color_sh"]
    return out


def exact(simulation):
    """The same in all digits, (n, 3), with nan where none travel."""
    out = np.full((simulation.plan.particles, 3), np.nan)
    for group in simulation.groups:
        at = group.index()
        if "color" in group.plan.channels:
            first = group.plan.channels["color"].first
            least = simulation.features["color_transfer"].exchange.minimum[group.plan.phase, 0]
            out[group.ids[at]] = group.f[first : first + 3, at].T + least
    return out


@pytest.mark.parametrize("threads", [1, 2])
def test_a_step_is_one_transfer_among_fluids_that_mix(threads, tmp_path):
    text = SCENE.replace("MORE", "").replace("[accuracy]", '[accuracy]\nvolume_correction = "none"')
    simulation, _ = begin(tmp_path, text, threads=threads)  # shifts would move before they color
    wet = np.flatnonzero(~np.isnan(colors(simulation)[:, 0]))
    worst = 0.0
    for step in range(30):
        if step in (10, 20):
            simulation.sort()
        before = exact(simulation)
        x, volume, J = by_id(simulation, "x", "vol0", "J")
        simulation.advance(simulation.bound())
        after = exact(simulation)
        now = (volume * J)[wet]
        want = Transfer(x[wet], now, simulation.plan.dx).smoothed(before[wet])
        worst = max(worst, np.abs(after[wet] - want).max())
        kept = np.abs(now @ after[wet] - now @ before[wet]) / (now @ np.abs(before[wet]))
        worst = max(worst, kept.max())
        assert np.abs(after - before)[wet].max() > 0.01
    assert len(simulation.groups[0].code) >= 8 and simulation.sorts >= 3
    held("color by steps: one beside the transfer", worst, 0, 1e-12, kind="absolute", source=PAPER)
    assert np.isnan(exact(simulation)[np.setdiff1d(np.arange(len(x)), wet)]).all()


def test_an_edge_spreads_by_a_quarter_of_a_cell_squared_per_step(tmp_path):
    text = SCENE.replace("MORE", "").replace("velocity = [0.5, 0, 0]", "")
    text = text.replace('boundary = "slip"', 'boundary = "slip"\ngravity = [0, 0, 0]')
    text = text.replace('"12 cm", "6 cm"', '"40 cm", "6 cm"').replace('"milk"]', '"milk"]', 1)
    text = text.replace('["5 cm", "6 cm", "4 cm"]', '["20 cm", "6 cm", "4 cm"]')
    text = text.replace('["5 cm", 0, 0], ["9 cm"', '["20 cm", 0, 0], ["40 cm"')
    text = text[: text.index('[[object]]\nname = "jug"')]
    text = text[: text.index("[[coupling]]")] + text[text.index("[[object]]") :]
    simulation, made = begin(tmp_path, text)
    first = exact(simulation)
    steps = 20
    for _ in range(steps):
        simulation.advance(simulation.bound())
    blue = exact(simulation)[:, 2]
    got = (blue - np.nanmin(first[:, 2])) / np.nanmax(first[:, 2] - np.nanmin(first[:, 2]))
    spread = np.sqrt(steps * simulation.plan.dx**2 / 2)
    want = 0.5 * (1 + erf((made.x[:, 0] - 0.20) / (np.sqrt(2) * spread)))
    inside = (np.abs(made.x[:, 0] - 0.20) < 0.12) & ~np.isnan(blue)
    found = np.sqrt(((got - want)[inside] ** 2).mean())
    held(
        "color by steps: an edge, rms", found, 0, 0.01, kind="absolute",
        source="error function of variance N dx^2 / 2", note="20 steps at rest, 10 cells each side",
    )  # fmt: skip


def test_equal_colors_are_not_carried_and_cost_nothing(tmp_path):
    text = SCENE.replace("MORE", "")
    for old in ("#1020ff", "#f0f0e0"):
        text = text.replace(old, "#ff2010")
    simulation, _ = begin(tmp_path, text)
    off, _ = begin(tmp_path, text.replace('"step"', '"off"'))
    assert "color_transfer" not in simulation.features
    assert "color_sh" not in frame_rows(simulation, ())[1]
    assert simulation.plan.bytes() == off.plan.bytes()
    assert [g.channels for g in simulation.groups] == [g.channels for g in off.groups]
    assert not any(name.startswith("color") for name in simulation.engine.layers)


def test_equal_parts_of_colors_stay_equal_in_every_bit(tmp_path):
    """Equal red and green, unequal blue."""
    text = SCENE.replace("MORE", "")
    text = text.replace("#1020ff", "#ff20ff").replace("#f0f0e0", "#ff2080")
    simulation, _ = begin(tmp_path, text)
    first = exact(simulation)
    toy = np.isnan(first[:, 0])
    for _ in range(20):
        simulation.advance(simulation.bound())
    last = exact(simulation)
    assert np.array_equal(first[~toy, :2], last[~toy, :2])
    assert np.abs(first - last)[~toy, 2].max() > 0.1


def test_higher_degrees_travel_with_fluids_alone(tmp_path, monkeypatch):
    def colored(scene):
        made = build_scene(scene)
        sh = np.random.default_rng(3).uniform(-1, 1, (len(made.x), 4, 3)).astype(np.float32)
        ranges = coefficient_ranges(len(made.objects), made.object, sh)
        return replace(made, sh=sh, features=made.features | {"color_transfer": ranges})

    monkeypatch.setattr(simulate, "build_scene", colored)
    text = SCENE.replace("MORE", 'color_sh_degree = 1\ncolor_objects = ["left", "jug", "toy"]')
    simulation, made = begin(tmp_path, text)
    x, volume, J = by_id(simulation, "x", "vol0", "J")
    simulation.advance(simulation.bound())
    got = colors(simulation)
    toy = made.object == 3
    for rows, count in ((~toy, 12), (toy, 3)):
        before = made.sh.reshape(len(x), 12)[rows, :count]
        want = Transfer(x[rows], (volume * J)[rows], simulation.plan.dx).smoothed(before)
        np.testing.assert_allclose(got[rows, :count], want, rtol=0, atol=1e-6)
        assert np.isnan(got[rows, count:]).all() and np.abs(want - before).max() > 0.1


@pytest.mark.parametrize("unit", ["cm", "um"])
def test_no_color_leaves_the_range_of_the_others(unit, tmp_path):
    """In single precision, with cells of a centimetre and of a micrometre."""
    text = SCENE.replace("double", "single").replace("MORE", "").replace(" cm", f" {unit}")
    if unit == "um":  # as fast, in cells
        text = text.replace("20 kPa", "2 Pa").replace("velocity = [0.5", "velocity = [0.005")
    simulation, _ = begin(tmp_path, text)
    first = exact(simulation)
    for _ in range(60):
        simulation.advance(simulation.bound())
    last = exact(simulation)
    assert np.array_equal(np.isnan(first), np.isnan(last))
    span = np.nanmax(first, 0) - np.nanmin(first, 0)
    assert (np.nanmin(last, 0) >= np.nanmin(first, 0) - 1e-6 * span).all()
    assert (np.nanmax(last, 0) <= np.nanmax(first, 0) + 1e-6 * span).all()
    assert np.nanmax(np.abs(last - first)) > 0.5
