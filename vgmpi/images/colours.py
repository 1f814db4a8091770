"""A surface becomes Gaussians with the colours that the photograph shows where they are seen."""

import numpy as np
from scipy import ndimage

from vgmpi.gaussians.cloud import Cloud
from vgmpi.gaussians.sh import dc_from_rgb
from vgmpi.images.view import View
from vgmpi.prepare import mesh
from vgmpi.prepare.mesh import Mesh

MOST = 60_000  # Gaussians of a body
OPACITY = 0.95
EDGE = 2  # pixels along an outline that are half background


def gaussians(body: Mesh, rgb: np.ndarray, mask: np.ndarray, view: View, seed: int) -> Cloud:
    """Flat Gaussians over a body about the eye, a pixel apart as far as MOST are enough.

    Each has the colour of the pixel in which it would be seen, were nothing before it: so the back
    is a mirror of the front. rgb: (height, width, 3) uint8. seed: the same one gives the same bits.
    """
    pixel = 1 / view.focal
    corner = body.corners()
    cross = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    area = float(np.linalg.norm(cross, axis=1).sum() / 2)
    apart = max(pixel, np.sqrt(area / MOST))
    cloud = mesh.sample(body, 2 * apart, (0.5, 0.5, 0.5), OPACITY, [seed])
    at, _ = view.pixels(cloud.x)
    colour = look_up(own_colours(rgb, mask), at)
    sh = dc_from_rgb(colour)[:, None, :].astype(np.float32)
    return Cloud(cloud.x, cloud.quat, cloud.scale, cloud.opacity, sh)


def own_colours(rgb: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Colours 0..1 (height, width, 3) in which nothing of the background is left: everywhere that
    of the nearest pixel well inside the mask."""
    inner = mask
    for _ in range(EDGE):
        less = ndimage.binary_erosion(inner)
        inner = less if less.sum() > 0.3 * mask.sum() else inner
    near = ndimage.distance_transform_edt(~inner, return_distances=False, return_indices=True)
    return rgb[near[0], near[1]].astype(np.float64) / 255


def look_up(picture: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Values of a picture (height, width, 3) at places (n, 2) [pixels], (n, 3)."""
    where = np.nan_to_num(at[:, ::-1].T - 0.5)
    found = [
        ndimage.map_coordinates(picture[..., k], where, order=1, mode="nearest") for k in range(3)
    ]
    return np.clip(np.stack(found, axis=-1), 0, 1)
