"""Water that has splashed fills as much space as before.

A column collapses in a closed tank and sways: after some seconds its lower half has the density
that it had at the start. Particles that carry their volume as the grid expanded along their way
crowd once they are in disorder: that is shown beside (`accuracy.volume_correction = "none"`). At
rest, in the rows in which it was filled, holding the volume changes nothing. Tolerance: 4 %, of
which 1 % is what the fastest motion may compress; level 5 % as air is shut in by the splash."""

import numpy as np
import pytest

from tests.benchmarks.liquid_volume import dam_break, nodal_fullness
from tests.benchmarks.poured_level import column_levels
from tests.support.simulate import advance, begin, by_id, totals
from tests.support.validation_record import held

LONG, DEEP, DX = 0.32, 0.08, 0.02
COLUMN = 0.16, 0.2  # [m] wide and high
LEVEL = COLUMN[0] * COLUMN[1] / LONG
SCENE = f"""
[domain]
size = [{LONG}, {DEEP}, 0.32]
cell = {DX}
[time]
end = 100
[accuracy]
precision = "single"
volume_correction = "VOLUME"
pressure = "explicit"
[material.water]
kind = "fluid"
max_speed = 2
[[object]]
name = "column"
material = "water"
SHAPE
"""
FALLS = f"shape = {{ box = [[0, 0, 0], [{COLUMN[0]}, {DEEP}, {COLUMN[1]}]] }}"
RESTS = (
    f'initial_pressure = "hydrostatic"\nshape = {{ box = [[0, 0, 0], [{LONG}, {DEEP}, {LEVEL}]] }}'
)


def crowded(folder, volume):
    """Density of the lower half over that at the start, mean from 3 to 5 s."""
    simulation, made = begin(folder, SCENE.replace("VOLUME", volume).replace("SHAPE", FALLS))
    found = []
    for time in np.arange(3.0, 5.01, 0.1):
        advance(simulation, time)
        low = by_id(simulation, "x")[0][:, 2] < LEVEL / 2
        found.append(made.vol0[low].sum() / (LONG * DEEP * LEVEL / 2))
    return np.mean(found)


def test_water_that_splashed_keeps_its_volume(tmp_path):
    say = {"source": "nothing is compressed", "note": "16 x 4 cells, 5 cells deep in the end"}
    for volume, right in (("shifting", True), ("density", True), ("none", False)):
        name = f"water that has splashed, volume correction {volume}: density of the lower half"
        found = crowded(tmp_path, volume)
        held(name, found, 1.0, 0.04, expected=right, deviation=True, **say)


def test_a_broken_dam_keeps_its_level_and_no_cell_is_crowded():
    """Shifted particles: level, lowest layer of cells, fullest cell and energy up to 5 s."""
    samples = dam_break("shifting", 32, 5.0).samples
    late = [s for s in samples if s.time >= 3.0 - 1e-6]
    say = {"source": "nothing is compressed", "note": "32 x 8 cells, 5 cells deep, 3 to 5 s"}
    names = ("level", "lowest", "lower_half")
    for name, tolerance in zip(names, (0.05, 0.05, 0.03), strict=True):
        value = np.mean([getattr(s, name) for s in late])
        held(f"broken dam, shifting: {name}", value, 1.0, tolerance, **say)
    fullest = max(s.fullest for s in samples)
    held("broken dam, shifting: fullest cell", fullest, 1.0, 1.4, kind="below", **say)
    gain = max(s.energy for s in samples) / samples[0].energy - 1.0
    held("broken dam, shifting: energy over the start", gain, 0.0, 5e-3, kind="below", **say)


@pytest.mark.parametrize("engine", ["cpu", "numpy"])
def test_particles_that_crowd_on_walls_leave_them(tmp_path, engine):
    """Eight particles put into a corner of the tank: images at the walls cancel what else would
    push them apart."""
    text = SCENE.replace("VOLUME", "shifting").replace("SHAPE", RESTS)
    simulation, _ = begin(tmp_path, text, engine=engine)
    (ids,), (x,) = by_id(simulation, "id"), by_id(simulation, "x")
    corner = ids[(x < DX).all(1)]
    assert len(corner) == 8
    group = simulation.groups[0]
    index = group.index()
    chosen = index[np.isin(group.ids[index], corner)]
    group.xi[:, chosen] = -(3 << group.bits) // 2  # the corner, 1.5 cells from the block's middle
    (x,) = by_id(simulation, "x")
    assert np.abs(x[corner]).max() < 1e-6
    distances = []
    for _ in range(30):
        advance(simulation, simulation.time + simulation.bound())
        (x,) = by_id(simulation, "x")
        distances.append(x[corner].min() / DX)
    assert distances[-1] > 0.02, "they lie on the walls"


@pytest.mark.parametrize("volume", ["shifting", "density"])
@pytest.mark.parametrize("precision", ["single", "double"])
def test_water_at_rest_stays(tmp_path, precision, volume):
    """For 1 s, with the pressure that its weight asks for."""
    text = SCENE.replace("VOLUME", volume).replace("SHAPE", RESTS).replace("single", precision)
    simulation, _ = begin(tmp_path, text)
    x, v, J = by_id(simulation, "x", "v", "J")
    advance(simulation, 1.0)
    there, moves, after = by_id(simulation, "x", "v", "J")
    say = {"kind": "absolute", "source": "at rest", "note": f"5 cells deep, {precision}"}
    sunk = np.abs((there - x)[:, 2]).max() / LEVEL
    held(
        f"water at rest, volume correction {volume}, {precision}: goes",
        sunk,
        0.0,
        2e-3,
        unit="of H",
        **say,
    )
    off = np.abs(after - J).max() / np.abs(J - 1).max()
    held(f"water at rest, volume correction {volume}, {precision}: pressure", off, 0.0, 0.03, **say)
    assert np.abs(moves).max() < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("dilatation, holds", [("particles", True), ("cells", False)])
def test_a_disturbed_pool_comes_to_rest(tmp_path, dilatation, holds):
    """Particles displaced by up to half their spacing, after 4 s."""
    text = SCENE.replace("VOLUME", "shifting").replace("SHAPE", RESTS)
    text = text.replace(f"cell = {DX}", f"cell = {DX / 2}")
    text = text.replace("[material.water]", f'dilatation = "{dilatation}"\n[material.water]')
    simulation, _ = begin(tmp_path, text)
    group, random = simulation.groups[0], np.random.default_rng(1)
    displaced = random.uniform(-0.25, 0.25, (3, len(group.ids))) * 2.0**group.bits
    group.xi[:, group.index()] += displaced[:, group.index()].astype(group.xi.dtype)
    simulation.sort()
    start = totals(simulation)["energy"]
    advance(simulation, 4.0)
    (v,) = by_id(simulation, "v")
    say = {"source": "at rest", "note": "32 x 8 cells, 10 cells deep, displaced, 4 s"}
    name = f"disturbed pool, dilatation by {dilatation}"
    speed = np.sqrt((v**2).sum(1).mean() / (9.80665 * LEVEL))
    held(f"{name}: rms speed over sqrt(g H)", speed, 0.0, 3e-3, kind="below",
         expected=holds, deviation=not holds, **say)  # fmt: skip
    if holds:
        gain = totals(simulation)["energy"] / start - 1.0
        held(f"{name}: energy over the start", gain, 0.0, 1e-3, kind="below", **say)


@pytest.mark.parametrize("height", [5.0, 5.3, 5.75])
def test_a_level_is_where_cells_are_half_full(height):
    """Of a pool with a slanted half: `python -m tests.benchmarks poured` measures by it."""
    cells, dx, fine = (16, 8, 16), 0.02, 0.25
    x, y, z = (np.arange(fine / 2, n, fine) for n in (*cells[:2], 12))
    points = np.stack(np.meshgrid(x, y, z, indexing="ij"), -1).reshape(-1, 3)
    surface = height + np.maximum(points[:, 0] - 8, 0.0) / 4
    share = np.clip((surface - points[:, 2]) / fine + 0.5, 0.0, 1.0)
    points, share = points[share > 0], share[share > 0]
    fullness = nodal_fullness(points * dx, share * (fine * dx) ** 3, cells, dx)
    level = column_levels(fullness, dx) / dx
    assert level[2:-2, 2:-2] == pytest.approx(
        np.broadcast_to(height + np.maximum(np.arange(2, 15) - 8, 0.0)[:, None] / 4, (13, 5)),
        abs=0.1,
    )
    assert (column_levels(0.0 * fullness, dx) == 0).all()
