"""A cylinder that slides or rolls down an incline, held to Newton, Euler and Coulomb.

Theory: of a full cylinder, I = m R^2 / 2, on an incline with friction mu: while mu < tan(angle) / 3
it slides with a = g (sin - mu cos) and turns faster by 2 mu g cos / R, beyond that it rolls with
a = 2/3 g sin and v = omega R (Landau and Lifshitz, Mechanics, section 39). Gravity is tilted by
20 deg over a `separate` wall, the top of a box collider that lies between nodes (at 4.6 cells), or
the top of an elastic slab of 4 cells; a slice of 4 cells between slip walls. Rolling, what is
pressed ahead must give back behind all it took, and all points of contact brake or drive.
Tolerances: acceleration and v over omega R 3 %, spin 10 % of 8 cells and 5 % of 16. Single
precision.
"""

import pytest

from tests.support.rigid_kinematics import DX, ROLLS, SLIDES, exact, noted, rates, roll
from tests.support.validation_record import held

SHORT = ["wall", "collider", pytest.param("slab", marks=pytest.mark.slow)]


@pytest.mark.parametrize("on", SHORT)
def test_slides_and_turns(tmp_path, on):
    t, u, w = roll(tmp_path, 8, on, SLIDES)
    along, turn = rates(t, u, w)
    say, (a, alpha) = noted(8, t, u, w), exact(SLIDES, 8 * DX)
    held(f"cylinder sliding on a {on}: acceleration", along, a, 0.03, unit="m/s2", **say)
    held(f"cylinder sliding on a {on}: spin", turn, alpha, 0.1, unit="rad/s2", **say)


@pytest.mark.parametrize("on", SHORT)
def test_rolls(tmp_path, on):
    t, u, w = roll(tmp_path, 8, on, ROLLS)
    along, turn = rates(t, u, w)
    say, (a, alpha) = noted(8, t, u, w), exact(ROLLS, 8 * DX)
    held(f"cylinder rolling on a {on}: acceleration", along, a, 0.03, unit="m/s2", **say)
    held(f"cylinder rolling on a {on}: spin", turn, alpha, 0.1, unit="rad/s2", **say)
    ratio = u[-1] / (w[-1] * 8 * DX)
    held(f"cylinder rolling on a {on}: v over omega R", ratio, 1.0, 0.03, **say)


@pytest.mark.slow
@pytest.mark.parametrize("mu", [SLIDES, ROLLS])
def test_on_a_finer_grid(tmp_path, mu):
    """What slides is known to be turned too little still: by 6 % at 16 cells."""
    t, u, w = roll(tmp_path, 16, "wall", mu)
    along, turn = rates(t, u, w)
    say, (a, alpha) = noted(16, t, u, w), exact(mu, 16 * DX)
    way = "sliding" if mu == SLIDES else "rolling"
    held(f"cylinder {way} on a wall, 16 cells: acceleration", along, a, 0.03, unit="m/s2", **say)
    held(f"cylinder {way} on a wall, 16 cells: spin", turn, alpha, 0.05, unit="rad/s2", **say,
         expected=mu == ROLLS, deviation=True)  # fmt: skip
