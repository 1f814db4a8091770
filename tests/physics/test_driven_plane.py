"""A cylinder at rest is put on an incline that moves along itself, held to Newton, Euler, Coulomb.

Theory: friction turns the cylinder until it rolls on the plane, (v - drive) = omega R, and then it
is as on a plane at rest (Galilei): it rolls with a = 2/3 g sin where mu > tan(angle) / 3, else it
slides with a = g (sin - mu cos) and turns faster by 2 mu g cos / R (Bardenhagen, Brackbill, Sulsky
2000, Comput. Methods Appl. Mech. Eng. 187, 529: a cylinder on an incline, which slips or rolls). On
a plane driven downhill friction first drives what will slide, and turns about within .05 s. Gravity
is tilted by 20 deg over a box collider whose top lies between nodes, driven by .3 m/s;
tests/support/rigid_kinematics.py, tests/physics/test_roll.py. Tolerances: acceleration and v over
omega R 3 %, spin 10 %, of 8 cells in radius; 5 % of 16. Single precision.
"""

import pytest

from tests.support.rigid_kinematics import DX, ROLLS, SLIDES, exact, noted, rates, roll
from tests.support.validation_record import held

WAYS = {"uphill": -0.3, "downhill": 0.3}  # [m/s] of the plane
SHORT = ["uphill", pytest.param("downhill", marks=pytest.mark.slow)]


@pytest.mark.parametrize("way", SHORT)
def test_rolls(tmp_path, way):
    """Known to be wrong: downhill v / omega R swings between .95 and 1.1 to the end, and is 4.7 %
    too high in the mean of the last third."""
    _rolls(tmp_path, 8, way, 0.1, rolls=way != "downhill")


@pytest.mark.parametrize("way", SHORT)
def test_slides(tmp_path, way):
    _slides(tmp_path, 8, way, 0.1)


@pytest.mark.slow
def test_on_a_finer_grid(tmp_path):
    """Known to be wrong: it slips by 5 % still when it should roll, and by 8 % on a plane at rest,
    while it swings in itself; it is twice as soft for its size."""
    _rolls(tmp_path, 16, "uphill", 0.05, rolls=False)


def _rolls(folder, cells, way, off, rolls=True):
    t, u, w = roll(folder, cells, "collider", ROLLS, WAYS[way])
    along, turn = rates(t, u, w)
    say, (a, alpha) = noted(cells, t, u, w), exact(ROLLS, cells * DX)
    name = f"cylinder of {cells} cells rolling on a plane driven {way}"
    held(f"{name}: acceleration", along, a, 0.03, unit="m/s2", **say)
    held(f"{name}: spin", turn, alpha, off, unit="rad/s2", **say)
    ratio = (u[-8:].mean() - WAYS[way]) / (w[-8:].mean() * cells * DX)  # it swings in itself
    held(f"{name}: v over omega R", ratio, 1.0, 0.03, **say, expected=rolls, deviation=True)


def _slides(folder, cells, way, off):
    t, u, w = roll(folder, cells, "collider", SLIDES, WAYS[way])
    along, turn = rates(t, u, w)
    say, (a, alpha) = noted(cells, t, u, w), exact(SLIDES, cells * DX)
    name = f"cylinder of {cells} cells sliding on a plane driven {way}"
    held(f"{name}: acceleration", along, a, 0.03, unit="m/s2", **say)
    held(f"{name}: spin", turn, alpha, off, unit="rad/s2", **say)
