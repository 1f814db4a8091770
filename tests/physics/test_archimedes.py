"""A block floats: its submerged fraction is its density over the water's (Archimedes).

It is twice as wide as high: one of .6 times the water's density floats upright where its width is
more than 1.2 of its height, b^2 / (12 s h) > (1 - s) h / 2; a cube turns on its edge. Tolerance:
.05. The block is dropped from half a draught too high and the level, told by the water's
topmost particles, read at rest. Contact lets surfaces rest at up to a quarter of a cell, so the
block displaces its own volume and a layer around it; a block that is W cells wide floats too high
by about 2 gap / W of its draught for each pair of sides in the water, and gap / height more. That
is what the last test holds, with the gap measured beside the faces
(tests/support/particle_surfaces.py). Slabs are 4
cells thick between slipping walls. Single precision; the water's viscosity only stops the bobbing.
"""

from typing import NamedTuple

import numpy as np
import pytest

from tests.support.particle_surfaces import standoff
from tests.support.simulate import advance, begin, by_id
from tests.support.validation_record import held

DX, SHARE = 0.01, 0.6
SCENE = """
[domain]
size = [{wide!r}, {deep!r}, {high!r}]
cell = 0.01
boundary.default = "slip"
[time]
end = 4
[accuracy]
pressure = "explicit"
precision = "single"
[material.wood]
kind = "elastic"
density = 600
youngs_modulus = 5e4
[material.water]
kind = "fluid"
max_depth = {depth!r}
viscosity = {viscosity}
[[object]]
name = "block"
material = "wood"
shape = {{ box = {block} }}
[[object]]
name = "pool"
material = "water"
[[object.shape.difference]]
box = [[0, 0, 0], [{wide!r}, {deep!r}, {depth!r}]]
[[object.shape.difference]]
box = {block}
"""


class Afloat(NamedTuple):
    submerged: float  # share of the block's height
    below: float  # gap under the block [cells]
    side_gap: float  # gap beside it [cells]
    drift: float  # of its height in the last quarter of the run, as a share of it


def begin_afloat(folder, edge, side, slab, drop, viscosity, rigid=False):
    """(simulation, what was built) of a block of `edge` cells and twice as wide, in a tank that
    leaves `side` cells beside it.
    """
    n, depth = 2 * edge + 2 * side, edge + 4
    low = depth - round(SHARE * edge) + drop
    deep, y0, y1 = (4, 0, 4) if slab else (n, side, side + 2 * edge)
    corners = [[side, y0, low], [side + 2 * edge, y1, low + edge]]
    text = SCENE.format(
        wide=round(n * DX, 6), deep=round(deep * DX, 6), high=round((depth + edge + drop) * DX, 6),
        depth=round(depth * DX, 6), block=[[round(c * DX, 6) for c in p] for p in corners],
        viscosity=viscosity,
    )  # fmt: skip
    if rigid:
        text = text.replace('material = "wood"', 'material = "wood"\nrigid = true')
    return begin(folder, text)


def float_up(folder, edge, side, slab, drop, end, viscosity=1.0):
    """How an elastic block floats."""
    simulation, made = begin_afloat(folder, edge, side, slab, drop, viscosity)
    block, rows = made.object == 0, []
    for time in end * (0.75 + np.arange(6) / 20):
        advance(simulation, time)
        x, J = by_id(simulation, "x", "J")
        rows.append(read(x, made.vol0 * J, block, edge, side, slab))
    return Afloat(*np.mean(rows, 0)[:3], float(np.ptp(np.array(rows)[:, 3])) / edge)


def read(x, volume, block, edge, side, slab):
    """(submerged share, gap below, gap beside [cells], height of the block [cells])."""
    level = level_of(x[~block], side)
    middle, bottom = x[block].mean(0), x[block, 2].min() - DX / 4
    # the lowest particles are the corners'; a block that floats level has them all there
    below = standoff(x, volume, block, middle[:2], min(edge / 4, 2) * DX, "lower", DX)
    one_side = x[:, 0] > middle[0]
    about = np.array([middle[1], (level + bottom) / 2])
    half = min((level - bottom) / 2 - 0.75 * DX, 2 * DX)
    turned = x[one_side][:, [1, 2, 0]]
    beside = standoff(turned, volume[one_side], ~block[one_side], about, half, "upper", DX)
    return (level - bottom) / (edge * DX), below, beside, middle[2] / DX


def level_of(x, side):
    """Level of the water [m], by its topmost particles at some distance from the block."""
    width = x[:, 0].max() + DX / 4
    x = x[np.minimum(x[:, 0], width - x[:, 0]) < (side - 3) * DX]
    column = np.floor(x[:, :2] / (DX / 2)).astype(int) @ [1000, 1]
    top = np.lexsort((x[:, 2], column))
    last = np.append(np.diff(column[top]) != 0, True)
    return x[top[last], 2].mean() + DX / 4


def hold(found, edge, slab, rests=True):
    held(
        f"Archimedes, {'slab' if slab else 'square plate'} of {edge} cells: motion that is left",
        found.drift, 0.0, 0.02, kind="below", unit="of its height", expected=rests,
        deviation=not rests, source="at rest", note="in the last quarter of the run",
    )  # fmt: skip
    held(
        f"Archimedes, {'slab' if slab else 'square plate'} of {edge} cells",
        found.submerged,
        SHARE,
        0.05,
        kind="absolute",
        source="submerged fraction = rho_s / rho_w",
        note=f"gaps {found.below:.2f} below, {found.side_gap:.2f} cells beside it",
    )


def test_slab_of_8_cells(tmp_path):
    hold(float_up(tmp_path, 8, 8, slab=True, drop=2, end=2.4, viscosity=4.0), 8, slab=True)


@pytest.mark.slow
@pytest.mark.parametrize("edge", [12, 20])
def test_slab(tmp_path, edge):
    found = float_up(tmp_path, edge, 8, slab=True, drop=edge // 4, end=2.4, viscosity=edge / 2)
    hold(found, edge, slab=True)


@pytest.mark.slow
def test_square_plate_of_8_cells(tmp_path):
    found = float_up(tmp_path, 8, 6, slab=False, drop=2, end=2.4)
    hold(found, 8, slab=False, rests=False)


@pytest.mark.slow
def test_small_plate(tmp_path):
    """6 cells: gaps displace, too; water runs under it, since contact fades a cell from it."""
    found = float_up(tmp_path, 6, 6, slab=False, drop=2, end=2.4, viscosity=3.0)
    swelled = SHARE * (12 / (12 + 2 * found.side_gap)) ** 2 - found.below / 6
    print(found)
    held(
        "Archimedes, square plate of 6 cells, gaps displace too",
        found.submerged,
        swelled,
        0.03,
        kind="absolute",
        source="(rho_s / rho_w) W^2 / (W + 2 gap)^2 - gap below / H",
        note=f"gaps {found.below:.2f} below, {found.side_gap:.2f} cells beside it; exact {SHARE}",
        expected=False,
        deviation=True,
    )


@pytest.mark.slow
@pytest.mark.parametrize("edge, side, slab", [(8, 8, True), (6, 6, False)])
def test_a_rigid_plate(tmp_path, edge, side, slab):
    """A rigid plate lies nearer to its draught than an elastic one: 0.1 cells were the goal."""
    simulation, _ = begin_afloat(tmp_path, edge, side, slab, 2, edge / 2, rigid=True)
    bodies, rows = simulation.features["rigid_bodies"].bodies, []
    for time in 2.4 * (0.75 + np.arange(6) / 20):
        advance(simulation, time)
        (x,) = by_id(simulation, "x")
        rows.append((level_of(x, side) - bodies.x[0, 2]) / (edge * DX) + 0.5)
    assert abs(bodies.q[0, 0]) > 0.9999, "it stays upright"
    share = float(np.mean(rows))
    held(
        f"Archimedes, rigid {'slab' if slab else 'square plate'} of {edge} cells", share, SHARE,
        0.1 / edge, kind="absolute", source="submerged fraction = rho_s / rho_w",
        expected=slab, deviation=not slab, note=f"error {edge * (share - SHARE):+.2f} cells",
    )  # fmt: skip
