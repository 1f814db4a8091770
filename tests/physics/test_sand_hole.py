"""Sand that leaves a bin through square holes with sharp edges in a thick floor.

Beverloo, Leniger, van de Velde (1961), Chem. Eng. Sci. 15, 260: the flow rate is proportional to
sqrt(g) (D - k d)^(5/2), whatever the depth of the sand; k d is the part of the opening that grains
at its edge do not use. In a continuum it is zero; in a simulation the cell takes the place of the
grain. Three holes of 8, 12 and 16 cells give it. Tolerances: k d at most 1 cell; both halves of the
time agree within 2 %. A quarter of the bin is computed, between two planes of symmetry.
"""

import numpy as np
import pytest

from tests.support.draining_tank import DX
from tests.support.simulate import advance, begin, by_id
from tests.support.validation_record import held

FLOOR, DEPTH, THICK = 16, 48, 3  # [cells]
HALVES = 4, 6, 8  # [cells] of the holes
TIMES = np.linspace(0.4, 0.7, 13)  # [s]
SCENE = """
[accuracy]
precision = "single"
transfer = "{transfer}"
[domain]
size = [{wide}, {wide}, {high}]
cell = 0.01
gravity = [0, 0, -9.8]
boundary = {{ default = "slip", bottom = "open" }}
[time]
end = 10
[material.sand]
kind = "sand"
friction_angle = "30 deg"
youngs_modulus = 2e5
[[object]]
name = "sand"
material = "sand"
shape = {{ box = [[0, 0, {floor}], [{wide}, {wide}, {top}]] }}
[[object]]
name = "plate"
role = "scenery"
collider = true
[object.shape]
union = [
    {{ box = [[{half}, -0.1, {under}], [1, 1, {floor}]] }},
    {{ box = [[-0.1, {half}, {under}], [{half}, 1, {floor}]] }},
]
"""


def flow_rate(folder, half: int, transfer: str = "apic-corrected") -> tuple[float, float]:
    """Rate [m3/s] through a quarter of a hole of 2 half cells, and second over first half of it."""
    cells = {
        "wide": 3 * half, "high": FLOOR + DEPTH + 4, "floor": FLOOR, "top": FLOOR + DEPTH,
        "under": FLOOR - THICK, "half": half,
    }  # fmt: skip
    lengths = {name: round(n * DX, 9) for name, n in cells.items()}
    text = SCENE.format(transfer=transfer, **lengths)
    simulation, made = begin(folder, text)
    above = []
    for time in TIMES:
        advance(simulation, float(time))
        x, ids = by_id(simulation, "x", "id")
        above.append(made.vol0[ids][x[:, 2] > FLOOR * DX].sum())
    halves = [-np.polyfit(TIMES[part], above[part], 1)[0] for part in (slice(7), slice(6, None))]
    return -float(np.polyfit(TIMES, above, 1)[0]), float(halves[1] / halves[0])


@pytest.fixture(scope="module")
def rates(tmp_path_factory):
    return np.array([flow_rate(tmp_path_factory.mktemp("hole"), half) for half in HALVES]).T


@pytest.mark.slow
@pytest.mark.xfail(
    strict=True,
    reason="1.5 cells; 1.4 without friction on the plate, 1.7 where contact ends half a cell"
    " closer to it, 2.8 with apic, 0.9 with aflip",
)
def test_rate_scales_as_beverloo_says(rates):
    check_opening("sand through square holes", rates[0], deviation=True)


@pytest.mark.slow
def test_rate_scales_so_where_motion_finer_than_the_grid_is_retained(tmp_path_factory):
    """What APIC takes from the motion at the edges of the hole is what narrows it."""
    folders = [tmp_path_factory.mktemp("hole") for _ in HALVES]
    rates = [flow_rate(f, half, "aflip")[0] for f, half in zip(folders, HALVES, strict=True)]
    check_opening("sand through square holes, aflip", np.array(rates))


def check_opening(name: str, rates: np.ndarray, **keys) -> None:
    """Hold the part of the opening that the edges take [cells] to 1, from rates of all holes."""
    slope, start = np.polyfit(2.0 * np.array(HALVES), rates**0.4, 1)
    held(
        f"{name}: opening that the edges take", float(-start / slope), 0.0, 1.0, kind="below",
        unit="cells", source="Beverloo et al. 1961",
        note="holes of 8, 12 and 16 cells, single precision", **keys,
    )  # fmt: skip


@pytest.mark.slow
def test_sand_flows_steadily(rates):
    assert np.abs(rates[1] - 1.0).max() < 0.02
