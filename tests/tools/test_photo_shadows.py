"""Shadows of objects in a drawn photograph, whose table without objects is known."""

import numpy as np
import pytest
from scipy import ndimage

from tests.support import drawn_photograph
from vgmpi.tools.photo.photo_camera import View
from vgmpi.tools.photo.scene_light import cast_shadows

drawing = drawn_photograph.drawing
VIEW, EYE = View(360, 240, 40.0, 12.0), 0.26
THINGS = [
    drawing.Ball((-0.10, 0.58, 0.05), 0.05, (0.82, 0.22, 0.18)),
    drawing.Box((0.04, 0.51, 0.0), (0.14, 0.59, 0.055), (0.55, 0.25, 0.50)),
    drawing.Ball((-0.06, 0.52, 0.2), 0.03, (0.16, 0.42, 0.66)),
]


@pytest.fixture(scope="module")
def truth():
    """The photograph, the table alone, the objects, and the pixels in a shadow."""
    drawn = drawing.draw(THINGS, VIEW, EYE)
    bare = drawing.draw([], VIEW, EYE).rgb
    darker = ndimage.gaussian_filter(bare.astype(float) - drawn.rgb, (1, 1, 0)).mean(-1)
    return drawn, bare, (darker > 12) & ~np.logical_or.reduce(drawn.masks)


def test_shadows_are_found_and_little_else(truth):
    drawn, _, true = truth
    shadows = cast_shadows(drawn.rgb, drawn.masks, [False, False, True])
    found, other = (shadows & true).sum() / true.sum(), (shadows & ~true).sum() / true.sum()
    print(f"{100 * found:.0f} % of the pixels in shadows, and {100 * other:.0f} % besides")
    assert found > 0.7 and other < 0.5


def test_a_table_without_shadows_has_none(truth):
    """Masks on the bare table: its boards and the wall are no shadows."""
    drawn, bare, true = truth
    shadows = cast_shadows(bare, drawn.masks, [False, False, True])
    assert shadows.sum() < 0.05 * true.sum()
