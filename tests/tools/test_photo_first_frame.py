"""The first frame is the photograph: also its details, and where a body is not quite its mask."""

import re

import numpy as np
import pytest

from tests.support import drawn_photograph
from vgmpi.tools.photo import gaussian_colors, mask_to_mesh, preview
from vgmpi.tools.photo.__main__ import main
from vgmpi.tools.photo.photo_camera import View

WIDTH, HEIGHT = 200, 160
STEEP = View(WIDTH, HEIGHT, 30.0, 60.0)
y, x = np.mgrid[0:HEIGHT, 0:WIDTH] + 0.5
DISC = np.hypot(x - 100, y - 80) < 50
INNER = np.hypot(x - 100, y - 80) < 44
BACKGROUND = np.full((HEIGHT, WIDTH, 3), 120, np.uint8)
CAMERA = STEEP.camera(np.zeros(3), 0.01)


@pytest.fixture(scope="module")
def stripes():
    """A photograph of a disc with stripes of a period of 6 pixels, and the cloud of its body."""
    bright = (140 + 80 * np.sin(2 * np.pi * x / 6))[..., None].repeat(3, axis=-1)
    rgb = np.where(DISC[..., None], bright, BACKGROUND).astype(np.uint8)
    body = mask_to_mesh.body(DISC, STEEP, "inflate")
    return rgb, gaussian_colors.gaussians(body, rgb, DISC, STEEP, seed=1)


def agreement(cloud, rgb, mask=INNER):
    return preview.psnr_in_mask(preview.frame([cloud], CAMERA, BACKGROUND / 255), rgb, mask)


def test_gaussians_are_as_wide_as_pixels_for_a_camera_that_looks_down(stripes):
    """A body 1 m away on level ground is further away along the axis of such a camera."""
    _, cloud = stripes
    depth = cloud.x @ STEEP.forward
    across = STEEP.rotation()[:2]
    cov = np.einsum("ai,nij,aj->na", across, matrices(cloud), across)
    width = np.sqrt(cov.mean(axis=1)) * STEEP.focal / depth
    front = depth < np.median(depth)
    print(f"{np.median(width[front]):.2f} pixels, {len(cloud)} Gaussians, {DISC.sum()} pixels")
    assert 0.4 < np.median(width[front]) < 0.8
    assert 2 * DISC.sum() < len(cloud) < 3 * DISC.sum()  # front and back, and what is at a slant


def matrices(cloud):
    rows = cloud.cov()[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]]
    return rows.reshape(-1, 3, 3)


def test_correction_sharpens_details(stripes):
    rgb, cloud = stripes
    (corrected,) = gaussian_colors.correct_colors([cloud], [DISC], CAMERA, rgb, BACKGROUND)
    before, after = agreement(cloud, rgb), agreement(corrected, rgb)
    print(f"{before:.1f} dB, corrected {after:.1f} dB")
    assert after > before + 4


def test_bodies_without_a_mask_and_hidden_ones_keep_their_colors(stripes):
    rgb, cloud = stripes
    (same,) = gaussian_colors.correct_colors([cloud], [None], CAMERA, rgb, BACKGROUND)
    assert (same.sh == cloud.sh).all()
    (corrected,) = gaussian_colors.correct_colors([cloud], [DISC], CAMERA, rgb, BACKGROUND)
    depth = cloud.x @ STEEP.forward
    changed = (corrected.sh != cloud.sh).any(axis=(1, 2))
    middle = np.linalg.norm(STEEP.pixels(cloud.x)[0] - (100, 80), axis=1) < 30
    front = depth < np.median(depth)
    assert changed[front & middle].mean() > 0.9 and changed[~front & middle].mean() < 0.01


def test_the_log_tells_the_whole_picture(tmp_path, capfd):
    pytest.importorskip("cv2", reason="no OpenCV: pip install 'vgmpi[images]'")
    photo, layout = drawn_photograph.put(tmp_path)
    assert main([str(photo), str(layout), "-o", str(tmp_path / "out")]) == 0
    (total,) = re.findall(r"picture: the first frame agrees .* ([\d.]+) dB", capfd.readouterr().out)
    print(f"{total} dB")
    assert float(total) > 37
