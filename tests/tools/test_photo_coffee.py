"""A well-known photograph: the espresso cup of scikit-image, cut out by a box and by points.

The reference was drawn by hand: the ellipses of saucer and rim, and the handle of the spoon.
"""

import numpy as np
import pytest

from vgmpi.tools.photo import grabcut

cv2 = pytest.importorskip("cv2", reason="no OpenCV: pip install 'vgmpi[images]'")
data = pytest.importorskip(
    "skimage.data", reason="scikit-image, which has the photograph, is absent"
)
SAUCER = ((277.06, 221.23), (335.67, 404.27), 94.756)  # center, axes [pixels], angle [degrees]
RIM = ((289.05, 114.23), (195.61, 238.54), 92.966)
SPOON = np.array([(396, 72), (402, 67), (412, 66), (424, 72), (420, 90), (412, 112), (400, 112)])
BOX = grabcut.Box(72, 12, 486, 393)
ON = [(290, 50), (120, 250), (225, 280), (300, 265), (360, 290), (410, 80)]
OUT = [(40, 350), (540, 200), (60, 100), (460, 60), (95, 325), (450, 345)]
SHADOWS = [(120, 360), (430, 375), (200, 392), (70, 280)]


@pytest.fixture(scope="module")
def coffee() -> np.ndarray:
    return np.ascontiguousarray(data.coffee())


@pytest.fixture(scope="module")
def reference(coffee) -> np.ndarray:
    drawn = np.zeros(coffee.shape[:2], np.uint8)
    cv2.ellipse(drawn, SAUCER, 1, -1)
    cv2.ellipse(drawn, RIM, 1, -1)
    cv2.fillPoly(drawn, [SPOON.astype(np.int32)], 1)
    return drawn > 0


def cut(rgb, box, on=(), out=()):
    points = [(float(x), float(y), True) for x, y in on]
    points += [(float(x), float(y), False) for x, y in out]
    mask = grabcut.segment_box(rgb, box, points)
    broken = [point for point in points if mask[int(point[1]), int(point[0])] != point[2]]
    assert broken == []
    return mask


@pytest.mark.parametrize("on, out", [((), ()), (ON, ()), (ON, OUT)])
def test_the_whole_cup_with_its_saucer(coffee, reference, on, out):
    share = grabcut.iou(cut(coffee, BOX, on, out), reference)
    print(f"{len(on)} points on it, {len(out)} outside: intersection over union {share:.3f}")
    assert share > 0.97


def test_a_wide_box_needs_points_in_the_shadows(coffee, reference):
    """The saucer's shadow has no color of the table: points say that it is none of the cup."""
    wide = grabcut.Box(50, 5, 520, 400)
    alone, pointed = (
        grabcut.iou(cut(coffee, wide, *points), reference) for points in ((), (ON, OUT + SHADOWS))
    )
    print(f"a wide box {alone:.3f}, with points in the shadows {pointed:.3f}")
    assert 0.85 < alone < 0.93 < pointed


def test_the_warnings_tell_half_a_cup(coffee):
    """The white inside alone, which is what a box around all of it gave once."""
    hsv = cv2.cvtColor(coffee, cv2.COLOR_RGB2HSV)
    white = (hsv[..., 1] < 110) & (hsv[..., 2] > 150)
    white[200:], white[:, :170], white[:, 400:] = False, False, False
    told = grabcut.mask_warnings(coffee, grabcut.largest_component(white), BOX)
    assert any("of its box: if parts are missing" in line for line in told)
    assert grabcut.mask_warnings(coffee, cut(coffee, BOX), BOX) == []
