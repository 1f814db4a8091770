"""Liquids of two densities in one velocity field keep their volume.

A column of water and one of twice its density fall into each other and sway. Theory: nothing is
compressed, whichever liquid is where; the level is corrected for what the kinetic energy lifts.
Tolerances: level 3 % after the splash, fullest cell 1.45."""

import numpy as np

from tests.benchmarks.liquid_volume import GRAVITY, TANK, nodal_fullness
from tests.support.simulate import advance, begin, by_id, totals
from tests.support.validation_record import held

SIZE, DX = TANK, 0.02
WIDTH, HEIGHT = 0.16, 0.32  # [m] of each column
LEVEL = 2 * WIDTH * HEIGHT / SIZE[0]
HEAD = f"""
[domain]
size = {list(SIZE)}
cell = {DX}
[time]
end = 100
[accuracy]
precision = "single"
volume_correction = "VOLUME"
pressure = "explicit"
[material.water]
kind = "fluid"
tait_coefficient = "60 kPa"
[material.brine]
kind = "fluid"
density = 2000
tait_coefficient = "60 kPa"
"""
BOX = """
[[object]]
name = "{0}"
material = "{0}"
shape = {{ box = [[{1}, 0, {2}], [{3}, 0.16, {4}]] }}
"""
COLUMNS = BOX.format("water", 0, 0, WIDTH, HEIGHT) + BOX.format("brine", 0.48, 0, 0.64, HEIGHT)
RESTS = 'initial_pressure = "hydrostatic"\nshape'
LAYERS = BOX.format("brine", 0, 0, 0.64, LEVEL / 2) + BOX.format("water", 0, LEVEL / 2, 0.64, LEVEL)
LAYERS = LAYERS.replace("shape", RESTS)
DENSITIES = np.array([1000.0, 2000.0])  # [kg/m3] of the columns


def splash(folder, correction, times):
    """Level over that at rest, fullest node, energy over that at the start; at times [s]."""
    text = HEAD.replace("VOLUME", correction) + COLUMNS
    simulation, made = begin(folder, text)
    plan, volume = simulation.plan, made.vol0
    mass = volume * DENSITIES[made.object]
    heights = LEVEL * np.array([0.75, 0.25])  # [m] of the centers of mass at rest
    at_rest = GRAVITY * (mass * heights[made.object]).sum()
    energy, rows = totals(simulation)["energy"], []
    for time in times:
        advance(simulation, float(time))
        x, v = by_id(simulation, "x", "v")
        lifted = 0.5 * (mass * (v**2).sum(1)).sum() / at_rest
        level = 2.0 * (volume * x[:, 2]).sum() / volume.sum() / LEVEL - lifted
        fullest = nodal_fullness(x, volume, plan.cells, plan.dx).max()
        rows.append((level, fullest, totals(simulation)["energy"] / energy))
    return np.array(rows)


def test_two_liquids_that_fall_into_each_other_keep_their_volume(tmp_path):
    say = {"source": "nothing is compressed", "note": "32 x 8 cells, densities 1:2"}
    level, fullest, energy = splash(tmp_path, "shifting", np.arange(0.25, 4.51, 0.25)).T
    name = "water and brine in one field, shifting"
    held(f"{name}: level, 3.5 to 4.5 s", level[13:].mean(), 1.0, 0.03, **say)
    held(f"{name}: fullest cell", fullest.max(), 1.0, 1.45, kind="below", **say)
    held(f"{name}: energy over the start", energy.max() - 1.0, 0.0, 5e-3, kind="below", **say)
    _, crowded, _ = splash(tmp_path, "none", [0.5]).T
    held(
        "water and brine in one field, no correction: fullest cell", crowded.max(), 1.0, 1.45,
        kind="below", expected=False, deviation=True, **say,
    )  # fmt: skip


def test_layers_at_rest_are_left_alone(tmp_path):
    """They sway a little, since the start is not exactly in balance, as without correction."""
    ends = []
    for correction in ("shifting", "none"):
        simulation, _ = begin(tmp_path, HEAD.replace("VOLUME", correction) + LAYERS)
        advance(simulation, 1.0)
        ends.append(by_id(simulation, "x")[0])
    difference = np.abs(ends[0] - ends[1]).max() / LEVEL
    held(
        "layers of brine and water at rest, shifting beside no correction: go", difference, 0.0,
        1e-4, kind="absolute", unit="of H", source="at rest", note="8 cells deep, 1 s",
    )  # fmt: skip


def test_drops_that_collide_keep_their_momentum(tmp_path):
    """Without gravity, away from walls, in double precision."""
    head = HEAD.replace("VOLUME", "shifting").replace("single", "double")
    head = head.replace("[time]", "gravity = [0, 0, 0]\n[time]", 1)
    ball = "shape = {{ sphere = {{ center = [{0}, 0.08, 0.2], radius = 0.05 }} }}\nvelocity = {1}\n"
    text = head + "".join(
        f'[[object]]\nname = "{name}"\nmaterial = "{name}"\n' + ball.format(x, velocity)
        for name, x, velocity in (("water", 0.26, [1.5, 0, 0.1]), ("brine", 0.38, [-1.5, 0, 0]))
    )
    simulation, made = begin(tmp_path, text)
    before, shifts = totals(simulation), simulation.features["shifting"].correction_interval
    scale = (made.vol0 * DENSITIES[made.object] * np.linalg.norm(made.v0, axis=1)).sum()
    fullest = 0.0
    while simulation.time < 0.05:
        advance(simulation, simulation.time + 0.005)
        (x,) = by_id(simulation, "x")
        fullest = max(fullest, nodal_fullness(x, made.vol0, simulation.plan.cells, DX).max())
    assert shifts and fullest > 1.02, "no particle was shifted"
    change = np.abs(totals(simulation)["momentum"] - before["momentum"]).max() / scale
    held(
        "drops of water and brine that collide: change of momentum", change, 0.0, 1e-12,
        kind="absolute", source="conservation", note="6 cells wide, double precision",
    )  # fmt: skip
