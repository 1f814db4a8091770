"""Numbers of a scene found again from an honest reference (tests/benchmarks/recovery.py): cells
half as large, another seed, the other precision, 5 % noise, and of pictures a camera that is off by
a pixel; from starts 5 to 10 times off, within 40 runs.

Tolerance: 5 %, and the interval of 95 % holds the truth. Misses are in
docs/how-to/fit-parameters.md: the friction angle of sand by its pictures, 9 % off, whose interval
holds it.
"""

import shutil
from pathlib import Path

import pytest

from tests.benchmarks.recovery import CASES, honest, recover
from vgmpi.scene.loader import load
from vgmpi.tools.fit import __main__ as fit

EXAMPLE = Path(__file__).parents[2] / "runs" / "consolidation"


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_it_is_found_again(tmp_path, name):
    case = CASES[name]
    found = recover(case, tmp_path, honest(case, tmp_path), 0)
    if name != "friction angle, seen":
        assert found.value == pytest.approx(case.true, rel=0.05)
    assert found.covers(case.true) and found.runs <= 40


@pytest.mark.slow
@pytest.mark.parametrize("name", ["stiffness", "viscosity", "friction, seen"])
def test_intervals_hold_the_truth(tmp_path, name):
    """In 9 of 10 repeats with other noise."""
    case = CASES[name]
    told = honest(case, tmp_path)
    found = [recover(case, tmp_path, told, seed) for seed in range(10)]
    assert sum(one.covers(case.true) for one in found) >= 9
    assert all(abs(one.value / case.true - 1) < 0.05 for one in found)


@pytest.mark.slow
def test_terzaghis_curve_tells_the_permeability(tmp_path):
    """The published curve (Terzaghi 1925) as the target: 1 cm/s, by which its times were made."""
    for path in EXAMPLE.glob("*.*"):
        shutil.copy(path, tmp_path)
    files = [str(tmp_path / name) for name in ("scene.toml", "fit.toml")]
    assert fit.main([*files, "-o", str(tmp_path / "fit")]) == 0
    (pair,) = load(tmp_path / "fit" / "fitted.toml").coupling
    assert pair.hydraulic_conductivity == pytest.approx(1e-2, rel=0.05)
