"""Crowding of sand, snow and paste: how full nodes become where a column of them collapses.

Volume is not lost without being told as in a splashed liquid: these materials carry it with their
elastic strain. The fullness counts rest volumes, and rest volumes times J, which is the volume that
the material itself states: where both are above 1, particles overlap.
"""

import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tests.benchmarks.liquid_volume import COLUMN, TANK, nodal_fullness
from tests.support.simulate import advance, begin, by_id

DX = 0.02  # [m] cell size
SCENE = f"""
[domain]
size = {list(TANK)}
cell = {DX}
[time]
end = 1000
[material.heap]
{{material}}
[[object]]
name = "column"
material = "heap"
shape = {{{{ box = [[0, 0, 0], [{COLUMN[0]}, {TANK[1]}, {COLUMN[1]}]] }}}}
"""
MATERIALS = {
    "sand": 'kind = "sand"\nyoungs_modulus = "1 MPa"',
    "snow": 'kind = "snow"\nyoungs_modulus = "0.14 MPa"',
    "paste": 'kind = "paste"\nyield_stress = 20\nshear_modulus = 2000\nconsistency_index = 1\n'
             'tait_coefficient = "60 kPa"',
}  # fmt: skip
TIMES = 0.5, 1.0, 2.0, 4.0  # [s]
HEAD = """| material | time | fullest node | times J | 99 of 100 nodes below | nodes above 1.1 |
|---|---|---|---|---|---|"""


class Crowding(NamedTuple):
    """Fullness of the nodes of a heap."""

    time: float  # [s]
    fullest: float  # [-] largest fullness
    fullest_volume: float  # [-] largest fullness by present volumes
    quantile: float  # [-] fullness of the fullest hundredth of the nodes that are half full
    crowded: float  # [-] fraction of these nodes with a fullness above 1.1


def collapse(material: str) -> list[Crowding]:
    """Let a column of a material of MATERIALS collapse, and measure its nodes."""
    with tempfile.TemporaryDirectory() as folder:
        simulation, made = begin(Path(folder), SCENE.format(material=MATERIALS[material]))
    found, cells = [], simulation.plan.cells
    for time in TIMES:
        advance(simulation, time)
        x, J = by_id(simulation, "x", "J")
        fullness = nodal_fullness(x, made.vol0, cells, DX)
        present = nodal_fullness(x, made.vol0 * np.ravel(J), cells, DX)
        filled = fullness[fullness > 0.5]
        found.append(
            Crowding(
                time, float(fullness.max()), float(present.max()),
                float(np.quantile(filled, 0.99)), float((filled > 1.1).mean()),
            )
        )  # fmt: skip
    return found


def row(material: str, c: Crowding) -> str:
    """Return a row of the table."""
    return (
        f"| {material} | {c.time:g} s | {c.fullest:.2f} | {c.fullest_volume:.2f} |"
        f" {c.quantile:.2f} | {100 * c.crowded:.0f} % |"
    )
