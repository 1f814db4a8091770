"""What objects hid in a photograph is filled: the truth is met, seam and texture hardly show."""

import numpy as np
import pytest
from scipy import ndimage

from tests.support import drawn_photograph
from tests.support.picture_noise import psnr
from vgmpi.tools.photo.background_inpainting import (
    _fill_along_lines,
    inpaint_background,
    seam_contrast,
    visibility,
)

cv2 = pytest.importorskip("cv2", reason="no OpenCV: pip install 'vgmpi[images]'")


def psnr_in(gap, picture, truth):
    """Peak signal to noise ratio in a gap [dB]."""
    return psnr(picture[gap], truth[gap], 255)


def ellipse(shape, center, axes):
    y, x = np.mgrid[0 : shape[0], 0 : shape[1]]
    return ((x - center[0]) / axes[0]) ** 2 + ((y - center[1]) / axes[1]) ** 2 < 1


def tiles() -> np.ndarray:
    """A floor of tiles with joints, 200 x 260, with some noise."""
    y, x = np.mgrid[0:200, 0:260]
    joint = (x % 26 < 3) | (y % 26 < 3)
    shade = np.where(joint, 90, 180) + np.random.default_rng(2).integers(-5, 6, (200, 260))
    return np.repeat(shade[..., None], 3, axis=2).astype(np.uint8)


def widened(gap):
    return ndimage.binary_dilation(gap, iterations=3)


def test_behind_drawn_things_the_truth_is_met():
    """A plain table before a wall: 24 dB are asked for, and no seam."""
    truth = drawn_photograph.drawing.draw([], drawn_photograph.VIEW, drawn_photograph.EYE).rgb
    photo = drawn_photograph.three()
    filled = inpaint_background(photo.rgb, list(photo.masks))
    # the things' shadows remain beside them
    gap = np.logical_or.reduce(list(photo.masks))
    noise = psnr_in(widened(gap), inpaint_background(truth, [gap]), truth)
    print(f"behind drawn things {noise:.1f} dB")
    assert noise > 32
    assert seam_contrast(filled, widened(gap)) < 1.2


def test_a_gap_at_the_rim_of_a_picture_and_one_that_fills_it_nearly():
    truth = tiles()
    corner = ellipse(truth.shape, (0, 0), (60, 50))
    assert psnr_in(widened(corner), inpaint_background(truth, [corner]), truth) > 15
    most = np.ones(truth.shape[:2], bool)
    most[:6], most[:, :6] = False, False
    filled = inpaint_background(truth, [most])
    assert filled.shape == truth.shape and (filled[:2] == truth[:2]).all()


def test_it_is_the_same_every_time():
    truth = tiles()
    gap = ellipse(truth.shape, (90, 90), (30, 30))
    one, other = inpaint_background(truth, [gap]), inpaint_background(truth, [gap])
    assert (one == other).all()


def test_the_table_under_the_espresso_cup():
    """No truth is known: the fill resembles the table more than lines or OpenCV's do."""
    data = pytest.importorskip("skimage.data", reason="scikit-image is absent")
    rgb = np.ascontiguousarray(data.coffee())
    cup = ellipse(rgb.shape, (277, 213), (212, 200))
    gap = widened(cup)
    telea = cv2.inpaint(rgb, gap.astype(np.uint8), 4, cv2.INPAINT_TELEA)
    filled = inpaint_background(rgb, [cup])
    assert seam_contrast(filled, gap) < 1.2
    detail = [np.diff(p.astype(float), axis=0)[gap[1:]].std() for p in (filled, telea, rgb)]
    around = np.diff(rgb.astype(float), axis=0)[~gap[1:]].std()
    assert detail[0] > 2 * detail[1], (detail, around)
    assert visibility(filled, gap) < 0.8 * visibility(_fill_along_lines(rgb, [cup])[1], gap)
