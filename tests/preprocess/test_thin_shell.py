"""Sides of plates, wherever they lie among the points of the lattice and at the domain."""

import numpy as np
import pytest

from vgmpi.preprocess.thin_shell import thin_shell

DX = 0.01
DOMAIN = np.zeros(3), np.array([16.0, 4.0, 12.0]) * DX


class Plate:
    """A box of any size; its distance is exact."""

    def __init__(self, low, high):
        self.low, self.high = np.asarray(low) * DX, np.asarray(high) * DX

    def ends(self):
        return self.low, self.high

    def distance(self, points):
        out = np.abs(points - (self.low + self.high) / 2) - (self.high - self.low) / 2
        return np.sqrt((np.maximum(out, 0.0) ** 2).sum(1)) + np.minimum(out.max(1), 0.0)


@pytest.mark.parametrize("thickness", [0.25, 0.5, 1.0, 2.0])
@pytest.mark.parametrize("middle", [8.0, 8.05, 8.125, 8.25, 8.3, 8.4999, 8.7])
def test_each_face_of_a_plate_is_a_side(middle, thickness):
    low, high = middle - thickness / 2, middle + thickness / 2
    shell = thin_shell(Plate((low, -40, -40), (high, 50, 50)), DX, DOMAIN)
    number = np.arange(shell.front.shape[0])
    x = shell.start[0] / DX + number / 2
    column = shell.front[:, 24, 24] / DX, shell.back[:, 24, 24] / DX
    is_left = x < low - 0.01
    is_right = x > high + 0.01
    a, b = (phi > 0.0 for phi in column)
    if a[is_right].all():
        a, b, column = b, a, column[::-1]
    assert a[is_left].all() and not a[is_right].any()
    assert b[is_right].all() and not b[is_left].any()
    assert np.allclose(column[0][is_left], (low - x)[is_left])
    assert np.allclose(column[1][is_right], (x - high)[is_right])


def test_a_plate_whose_other_face_is_far_outside_the_domain_has_one_side():
    shell = thin_shell(Plate((-40, -40, -8.3), (50, 50, -7.5)), DX, DOMAIN)
    above = shell.front[:, :, -1], shell.back[:, :, -1]
    assert (above[0] > 0).all() != (above[1] > 0).all()
