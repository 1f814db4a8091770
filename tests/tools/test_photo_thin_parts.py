"""Thin parts of inflated bodies, such as legs and handles: as thick as they are wide."""

import numpy as np
import pytest

from vgmpi.tools.photo import mask_to_mesh

Y, X = np.mgrid[:160, :200] + 0.5
DISC = (X - 70) ** 2 + (Y - 80) ** 2 < 50**2
LEG = (X > 100) & (X < 190) & (abs(Y - 80) < 8)


def volume(half):
    return 2 * float(half.sum())


def test_a_rod_has_the_volume_of_a_cylinder():
    """The film alone has 1.41 of it."""
    rod = (X > 10) & (X < 190) & (abs(Y - 80) < 10)
    middle = slice(60, 140)
    true = np.pi * 10**2 * 80
    film, round_ = (
        volume(half[:, middle])
        for half in (mask_to_mesh.poisson_height(rod), mask_to_mesh.inflated_height(rod, True))
    )
    print(f"film {film / true:.3f}, round sections {round_ / true:.3f}")
    assert film / true > 1.35 and round_ == pytest.approx(true, rel=0.03)


def test_a_ring_has_the_volume_of_a_torus():
    away = np.hypot(X - 100, Y - 80)
    half = mask_to_mesh.inflated_height(abs(away - 50) < 12, True)
    true = 2 * np.pi**2 * 50 * 12**2
    print(f"{volume(half) / true:.3f}")
    assert volume(half) == pytest.approx(true, rel=0.03)


def test_a_disc_stays_a_ball():
    disc = (X - 100) ** 2 + (Y - 80) ** 2 < 60**2
    for is_thin in (False, True):
        half = mask_to_mesh.inflated_height(disc, is_thin)
        print(is_thin, volume(half) / (4 / 3 * np.pi * 60**3))
        assert volume(half) == pytest.approx(4 / 3 * np.pi * 60**3, rel=0.03)


def test_a_leg_is_as_thick_as_wide_and_its_body_is_not_changed():
    half = mask_to_mesh.inflated_height(DISC | LEG)
    film = mask_to_mesh.poisson_height(DISC | LEG)
    leg = half[:, 145:180].max(axis=0)
    print(f"leg: {leg.mean() / 8:.3f} of its half width, film {film[:, 145:180].max() / 8:.3f}")
    assert leg == pytest.approx(np.full(35, 8.0), rel=0.06)
    assert film[:, 145:180].max() > 1.35 * 8
    assert (half[:, :100] == film[:, :100])[DISC[:, :100]].mean() > 0.99
