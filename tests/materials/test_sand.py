"""Sand against numbers from outside: friction angle, tension, cycles of opening, Klar's mapping."""

import numpy as np
import pytest

from tests.support.plastic_step import EVERY_ENGINE, driven, plain, strained
from vgmpi.materials.drucker_prager import Sand

PRESS = -1e-5 * np.eye(3)
AXIS = 1e-5 * np.diag([0.5, 0.5, -1.0])


def sand(**keys):
    return Sand(kind="sand", **keys)


@EVERY_ENGINE
@pytest.mark.parametrize("degrees", [25, 32, 40])
def test_triaxial_compression_ends_at_the_friction_angle(engine, real, degrees):
    """Mohr-Coulomb: the greatest over the least principal stress is tan^2(45 deg + phi / 2)."""
    table = sand(friction_angle=f"{degrees} deg", friction_angle_test="triaxial")
    tau = driven(table, engine, real, [(PRESS, 100), (AXIS, 400)])[7:13]
    assert tau[0] == pytest.approx(tau[1], rel=1e-4)
    assert tau[2] / tau[0] == pytest.approx(np.tan(np.radians(45 + degrees / 2)) ** 2, rel=1e-3)


@EVERY_ENGINE
def test_plane_strain_meets_it_too(engine, real):
    """Sheared between walls at constant volume: (s1 - s3) / (s1 + s3) = sin phi."""
    table = sand(friction_angle="30 deg", friction_angle_test="plane-strain")
    tau = driven(table, engine, real, [(PRESS, 100), (1e-5 * np.diag([1.0, 0, -1]), 400)])[7:13]
    assert (tau[2] - tau[0]) / (tau[2] + tau[0]) == pytest.approx(0.5, rel=1e-3)


@EVERY_ENGINE
@pytest.mark.parametrize("degrees", [22, 31])
def test_sand_that_slides_over_itself_meets_the_slope(engine, real, degrees):
    """In simple shear shear stress over pressure is tan(slope), as in a layer that flows downhill;
    with the angle of plane strain it is the sine (Davis 1968).
    """
    slide = 5e-5 * np.outer([1.0, 0, 0], [0, 0, 1])
    for test, law in (("slope", np.tan), ("plane-strain", np.sin)):
        table = sand(friction_angle=f"{degrees} deg", friction_angle_test=test)
        tau = driven(table, engine, real, [(PRESS, 20), (slide, 1000)])[7:13]
        assert tau[4] / -tau[2] == pytest.approx(law(np.radians(degrees)), rel=2e-3)


@EVERY_ENGINE
def test_on_the_cone_the_volume_is_kept(engine, real):
    before = driven(sand(), engine, real, [(PRESS, 100)])
    after = driven(sand(), engine, real, [(PRESS, 100), (AXIS, 400)])
    assert after[13] == pytest.approx(before[13], abs=1e-6)
    assert after[6] == 0.0


@EVERY_ENGINE
def test_pulled_apart_it_carries_nothing(engine, real):
    table = sand()
    out = driven(table, engine, real, [(PRESS, 10), (np.diag([1e-4, 0, 0]), 50)])
    assert np.abs(out[7:13]).max() <= 1e-6 * table.youngs_modulus * 1e-4
    assert out[6] == pytest.approx(50e-4 - 30e-5, rel=2e-2)


@EVERY_ENGINE
def test_opened_volume_closes_before_stress_returns(engine, real):
    """A cycle of opening and closing ends with the stress it began with, no sooner."""
    begin = driven(sand(), engine, real, [(PRESS, 100)])
    there = [(PRESS, 100), (-10 * PRESS, 100)]
    almost = driven(sand(), engine, real, [*there, (10 * PRESS, 89)])
    back = driven(sand(), engine, real, [*there, (10 * PRESS, 100)])
    assert begin[7] < 0 and almost[7] == pytest.approx(0, abs=1e-6 * abs(begin[7]))
    assert almost[6] > 0 and back[6] == 0
    assert back[7:10] == pytest.approx(begin[7:10], rel=2e-3)  # of 1 % opened and closed in steps
    assert back[13] == pytest.approx(begin[13], abs=2e-3 * 3e-3)


@EVERY_ENGINE
def test_cohesion_bears_tension_up_to_the_tip(engine, real):
    """Mohr-Coulomb: c / tan(phi) from all sides."""
    table = sand(cohesion=1000.0, friction_angle="30 deg")
    out = driven(table, engine, real, [(-PRESS, 500)])
    assert out[7:10] == pytest.approx(1000 * np.sqrt(3), rel=1e-4)
    assert out[6] > 0


def test_the_bulk_weighs_less_than_its_grains():
    table = sand(density=2500.0, porosity=0.4)
    assert table.bulk_density == table.law().density == pytest.approx(1500.0)
    assert table.solid_share == pytest.approx(0.6)


def logarithm(b):
    """ln b / 2 and its eigenvectors by numpy; b (n, 3, 3)."""
    d, q = np.linalg.eigh(b)
    return 0.5 * np.log(d), q


def square(rows):
    """Six rows (6, n) -> (n, 3, 3)."""
    return rows[[0, 3, 4, 3, 1, 5, 4, 5, 2]].T.reshape(-1, 3, 3)


def test_it_is_the_return_mapping_of_klar():
    """Written anew with numpy's matrices, case by case."""
    f, table = strained(500, -3, -1), sand(friction_angle_test="triaxial")
    f[6] = np.abs(f[6])
    law, dt, unity = table.law(), 0.3, np.eye(3)
    sine = np.sin(table.friction_angle)
    alpha = np.sqrt(2 / 3) * 2 * sine / (3 - sine)
    move = unity + dt * f[7:].T.reshape(-1, 3, 3)
    e, q = logarithm(move @ (square(f[:6]) + unity) @ move.transpose(0, 2, 1))
    opened = f[6] + e.sum(1)
    shifted = e + f[6][:, None] / 3
    seen = {"open": 0, "yields": 0, "elastic": 0}
    for n, s in enumerate(shifted):
        trace = s.sum()
        deviator = s - trace / 3
        size = np.sqrt((deviator**2).sum())
        excess = size + (3 * law.lam + 2 * law.mu) / (2 * law.mu) * trace * alpha
        if trace >= 0:
            shifted[n], case = 0.0, "open"
        elif excess > 0:
            shifted[n], case = s - excess * deviator / size, "yields"
        else:
            case = "elastic"
        seen[case] += 1
    assert min(seen.values()) > 20, seen
    got = np.array(plain(law, f, dt))
    b = np.einsum("nij,nj,nkj->nik", q, np.exp(2 * shifted), q)
    tau = 2 * law.mu * shifted + law.lam * shifted.sum(1, keepdims=True)
    tau = np.einsum("nij,nj,nkj->nik", q, tau, q)
    assert np.abs(square(got[:6]) + unity - b).max() < 1e-13
    assert np.abs(got[6] - (opened - shifted.sum(1))).max() < 1e-13
    assert np.abs(square(got[7:13]) - tau).max() < 1e-12 * law.lam
    assert np.allclose(got[13], np.exp(shifted.sum(1)), rtol=1e-13)
