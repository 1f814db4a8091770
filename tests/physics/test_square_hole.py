"""Water that leaves a tank through a square hole with sharp edges in a thick floor.

Torricelli: Q = Cd A sqrt(2 g h), with Cd of .6 for a hole with sharp edges in a large tank (Brater
and King, Handbook of Hydraulics, 6th ed., table 4-3: .58 to .62). Tolerance: 10 %, as the hole is 8
cells wide. A quarter of the tank is computed, between two planes of symmetry; Cd of
both halves of the time agree within 2 %.
"""

import numpy as np
import pytest

from tests.support import draining_tank
from tests.support.draining_tank import DX
from tests.support.simulate import advance, begin, by_id
from tests.support.validation_record import held

G, FLOOR, HEAD, DISCHARGE = 9.8, 16, 28, 0.6
HOLE = """union = [
    {{ box = [[{half}, -0.1, {under}], [1, 1, {floor}]] }},
    {{ box = [[-0.1, {half}, {under}], [{half}, 1, {floor}]] }},
]"""


def discharge(folder, half: int) -> tuple[float, float]:
    """Cd of a hole of 2 half cells, and how much faster it is in the second half of the time."""
    text = draining_tank.text(
        HOLE, "single", 10, FLOOR, HEAD, wide=3 * half, deep=3 * half, half=half
    )
    simulation, made = begin(folder, text)
    times, above = np.linspace(0.15, 0.35, 9), []
    for time in times:
        advance(simulation, float(time))
        x, ids = by_id(simulation, "x", "id")
        above.append(made.vol0[ids][x[:, 2] > FLOOR * DX].sum())
    found = []
    for part in (slice(None), slice(5), slice(4, None)):
        level = np.mean(above[part]) / (3 * half * DX) ** 2
        flow = -np.polyfit(times[part], above[part], 1)[0]
        found.append(flow / (half * DX) ** 2 / np.sqrt(2 * G * level))
    return float(found[0]), float(found[2] / found[1])


@pytest.mark.parametrize("half", [4, pytest.param(6, marks=pytest.mark.slow)])
def test_discharge_of_a_square_hole(tmp_path, half):
    value, steady = discharge(tmp_path, half)
    held(
        f"Discharge coefficient, square hole of {2 * half} cells", value, DISCHARGE, 0.1,
        source="Brater and King 1976, table 4-3", note=f"tank of {6 * half} x {6 * half} cells",
    )  # fmt: skip
    assert abs(steady - 1.0) < 0.02
