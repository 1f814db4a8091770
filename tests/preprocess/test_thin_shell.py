"""Sides of plates, wherever they lie among the points of the lattice and at the domain."""

import numpy as np
import pytest

from vgmpi.features.thin_walls import shells as module
from vgmpi.features.thin_walls.shells import thin_shell

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


class PlateOnBlock(Plate):
    """A thin plate that stands on the end of a long thick block."""

    def __init__(self):
        self.block, self.plate = Plate((0, 0, 0), (80, 12, 8)), Plate((4, 0, 4), (5, 12, 20))
        self.low, self.high = self.block.low, np.array([80, 12, 20]) * DX

    def distance(self, points):
        return np.minimum(self.block.distance(points), self.plate.distance(points))


def test_only_the_thin_part_of_a_long_body_has_a_lattice(monkeypatch):
    part = thin_shell(PlateOnBlock(), DX)
    monkeypatch.setattr(module, "REACH_CELLS", 1e4)
    whole = thin_shell(PlateOnBlock(), DX)
    assert whole.front.shape[0] == 2 * (80 + 2 * 5) + 1
    assert part.front.shape[0] < whole.front.shape[0] / 2
    first = np.rint((part.start - whole.start) / (DX / 2)).astype(int)
    same = tuple(slice(a, a + n) for a, n in zip(first, part.front.shape, strict=True))
    is_free = np.maximum(whole.front, whole.back) > 0.0
    sided = is_free & ((whole.kinds == module.SIDED) | (whole.kinds == module.NEAR_EDGE))
    assert sided[same].sum() == sided.sum() > 0
    has_kind = whole.kinds[same] > 0
    assert (part.kinds[:-4] == whole.kinds[same][:-4]).all()
    for name in ("front", "back"):
        a, b = getattr(part, name), getattr(whole, name)[same]
        assert np.array_equal(a[has_kind], b[has_kind]), name
