"""A heap of sand that stands in a pool, submerged to half its height, slumps to its slope of rest.

Theory: volume. However the sand comes to lie, water of volume V and the grains below the surface
share the box of floor area A: A h = V + (1 - n) V_sand(z < h), h the level once water has drained
from the pores above it and flowed into those below. V_sand(z < h) is told by where the sand lies.
Tolerances: level within 5 % of h, by probes in the pool over the last 0.3 s; no cell fuller than
1.4 (grains and water over the cell, with the solver's weights at the nodes) and energy never above
that at the start, at all frames. Thin slab, one half of the heap: the other stands behind the wall.
"""

import numpy as np
import pytest

import vgmpi
from tests.benchmarks.liquid_volume import nodal_fullness
from tests.support.validation_record import held

ENERGIES = ("kinetic", "elastic", "potential")  # of the ledger
LONG, HIGH, DEPTH, SLOPE, POROSITY, END = 0.4, 0.1, 0.05, 0.4, 0.4, 1.2
SCENE = """
[domain]
size = [{size[0]!r}, {size[1]!r}, {size[2]!r}]
cell = {cell!r}
boundary.default = "slip"
gravity = [0, 0, -9.80665]
[time]
end = {end}
frames = 13
[accuracy]
pressure = "explicit"
precision = "single"
[material.water]
kind = "fluid"
tait_coefficient = 1e4
[material.grains]
kind = "sand"
porosity = {porosity}
youngs_modulus = 1.5e5
[[object]]
name = "heap"
material = "grains"
shape = {{ union = [{heap}] }}
[[object]]
name = "pool"
material = "water"
shape = {{ union = [{pool}] }}
[[object]]
name = "pores"
material = "water"
volume_fraction = {porosity}
shape = {{ union = [{pores}] }}
[[coupling]]
between = ["water", "grains"]
kind = "drag"
hydraulic_conductivity = 0.1
[[probe]]
name = "left"
sampling_rate = 100
surface_height = [{left!r}, {middle!r}]
[[probe]]
name = "right"
sampling_rate = 100
surface_height = [{right!r}, {middle!r}]
"""


def scene_text(cells):
    """The heap is a stair of one cell's height; its pores are full as high as the pool stands."""
    dx = LONG / cells
    heap, pool, pores = [], [], []
    for step in range(round(HIGH / dx)):
        low, up = step * dx, (step + 1) * dx
        foot = (HIGH - low) / SLOPE
        heap.append(box(0.0, foot, low, up, dx))
        if up < DEPTH + dx / 2:
            pool.append(box(foot, LONG, low, up, dx))
            pores.append(box(0.0, foot, low, up, dx))
    return SCENE.format(
        size=[LONG, 4 * dx, 0.15], cell=dx, end=END, porosity=POROSITY, heap=", ".join(heap),
        pool=", ".join(pool), pores=", ".join(pores), left=0.8 * LONG, right=0.9 * LONG,
        middle=2 * dx,
    )  # fmt: skip


def box(west, east, low, up, dx):
    corners = np.round([[west, 0, low], [east, 4 * dx, up]], 9)
    return f"{{ box = {corners.tolist()} }}"


def level_by_volume(water, z, grains, area):
    """h [m] of A h = V + grains below h; water [m3], grains (n,) [m3] at z (n,) [m]."""
    low, high = 0.0, 0.15
    for _ in range(50):
        h = 0.5 * (low + high)
        low, high = (h, high) if area * h - grains[z < h].sum() < water else (low, h)
    return h


def settle(folder, cells):
    """(times, levels) of both probes together, h by volume, largest fill and energy over that at
    the start at all frames."""
    fills, energies = [], []

    def look(run):
        found = run.arrays("positions", "vol0", "J", "object")
        sand = found["object"] == 0
        volume = found["vol0"] * np.where(sand, 1 - POROSITY, found["J"])
        plan = run.simulation.plan
        fills.append(float(nodal_fullness(found["positions"], volume, plan.cells, plan.dx).max()))
        energies.append(sum(r[f"{kind}_energy"] for r in run.ledger for kind in ENERGIES))

    scene = vgmpi.load(folder / "heap.toml", text=scene_text(cells))
    run = vgmpi.run(scene, on_frame=look)
    assert run.code == 0
    found = run.arrays("positions", "vol0", "object")
    sand, (x, vol0) = found["object"] == 0, (found["positions"], found["vol0"])
    area = LONG * 4 * LONG / cells
    h = level_by_volume(vol0[~sand].sum(), x[sand, 2], (1 - POROSITY) * vol0[sand], area)
    rows = [run.probes[name] for name in ("left", "right")]
    times = np.array([row["time"] for row in rows[0]])
    levels = np.mean([[row["surface_height"] for row in side] for side in rows], axis=0)
    print(f"{run.step} steps; sand {x[sand, 2].max():.4f} m high, fills {np.round(fills, 2)}")
    return times, levels, h, max(fills), np.array(energies) / energies[0]


def hold_level(found, cells):
    times, levels, h, _, energies = found
    note = f"{cells} cells along, single precision"
    source = "water and grains below the surface fill the box"
    held(
        f"heap in a pool, {cells} cells: level", float(levels[times > END - 0.3].mean()), h, 0.05,
        unit="m", source=source, note=note, axes=("time [s]", "level [m]"),
        curves={"solver": (times, levels), "by volume, settled": (times, np.full_like(times, h))},
    )  # fmt: skip
    held(
        f"heap in a pool, {cells} cells: energy over that at the start", float(energies[1:].max()),
        1.0, 1.0, kind="below", source="friction and drag dissipate", note=note,
    )  # fmt: skip
    assert energies[-1] < 0.95, "it did not slump"


def hold_fill(found, cells):
    held(f"heap in a pool, {cells} cells: fullest cell", found[3], 1.0, 1.4, kind="below",
         source="a cell holds a cell's volume", note="single precision, all frames")  # fmt: skip


@pytest.fixture(scope="module")
def coarse(tmp_path_factory):
    return settle(tmp_path_factory.mktemp("coarse"), 40)


@pytest.fixture(scope="module")
def fine(tmp_path_factory):
    return settle(tmp_path_factory.mktemp("fine"), 64)


@pytest.mark.slow
def test_half_submerged_heap(coarse):
    hold_level(coarse, 40)


@pytest.mark.slow
def test_half_submerged_heap_on_a_finer_grid(fine):
    hold_level(fine, 64)


@pytest.mark.slow
def test_no_cell_is_too_full(coarse):
    hold_fill(coarse, 40)


@pytest.mark.slow
def test_no_cell_is_too_full_on_a_finer_grid(fine):
    hold_fill(fine, 64)
