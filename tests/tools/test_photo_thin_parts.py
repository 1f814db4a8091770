"""Thin parts of inflated bodies, such as legs and handles: as thick as they are wide."""

import numpy as np
import pytest

from vgmpi.tools.photo import mask_to_mesh
from vgmpi.tools.photo.photo_camera import View

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


def test_the_rim_of_a_large_body_is_its_outline_and_no_staircase():
    """A disc of 440 pixels, lattice points 4.4 apart: its rim lies INSET within, by a pixel."""
    y, x = np.mgrid[:900, :1000] + 0.5
    view = View(1000, 900, 40.0, 0.0)
    mesh = mask_to_mesh.inflated_surface(np.hypot(x - 500, y - 450) < 440, view)
    edges = np.sort(mesh.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    half = len(mesh.points) // 2
    used, count = np.unique(edges[(edges < half).all(1)], axis=0, return_counts=True)
    rim = np.unique(used[count == 1])  # edges of one triangle of the front
    pixels, _ = view.pixels(mesh.points[rim])
    away = np.hypot(*(pixels - (500, 450)).T) - 440
    print(f"{len(rim)} points, {away.min():.2f} to {away.max():.2f} pixels off the outline")
    assert len(rim) > 500 and np.abs(away + mask_to_mesh.INSET).max() < 1.0
    assert abs(away.mean() + mask_to_mesh.INSET) < 0.2
