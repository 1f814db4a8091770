"""Pictures of what was made: the first frame, check.png, the objects alone."""

import numpy as np
from scipy import ndimage

from vgmpi.gaussians import sh as harmonics
from vgmpi.gaussians.cloud import Cloud
from vgmpi.splatting import splat
from vgmpi.splatting.camera import Camera
from vgmpi.splatting.decibels import decibels

CROP = 1.2  # of the longer side of an object's box: the square that generators are given


def frame(clouds: list[Cloud], camera: Camera, background: np.ndarray) -> np.ndarray:
    """Clouds before a background (height, width, 3) in 0..1, as the renderer draws them."""
    x = np.concatenate([one.x for one in clouds])
    splats = splat.Splats(
        x,
        np.concatenate([one.cov() for one in clouds]),
        np.concatenate([one.opacity for one in clouds]),
        np.concatenate([harmonics.evaluate(one.sh, one.x - camera.eye) for one in clouds]),
    )
    return np.clip(splat.render(splats, camera, background)[0], 0, 1)


def alike(drawn: np.ndarray, rgb: np.ndarray, mask: np.ndarray) -> float:
    """How much a frame (height, width, 3) in 0..1 looks like the photograph inside a mask [dB]."""
    return decibels((drawn[mask] - rgb[mask] / 255.0) ** 2)


def beside(rgb: np.ndarray, drawn: np.ndarray, masks: list[np.ndarray]) -> np.ndarray:
    """The photograph with the outlines that were found, beside the first frame, uint8."""
    left = rgb.copy()
    for mask in masks:
        left[mask ^ ndimage.binary_erosion(mask, iterations=1)] = (255, 0, 255)
    right = (255 * drawn + 0.5).astype(np.uint8)
    return np.concatenate([left, np.full((len(rgb), 6, 3), 255, np.uint8), right], axis=1)


def crop(rgb: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """An object alone (n, n, 4) uint8, in the middle of a square, transparent around it."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    middle = (rows[0] + rows[-1] + 1) // 2, (columns[0] + columns[-1] + 1) // 2
    side = int(np.ceil(CROP * max(np.ptp(rows), np.ptp(columns)) / 2)) + 1
    whole = np.dstack([rgb, np.where(mask, 255, 0).astype(np.uint8)])
    whole = np.pad(whole, ((side, side), (side, side), (0, 0)))
    part = whole[middle[0] : middle[0] + 2 * side, middle[1] : middle[1] + 2 * side].copy()
    part[part[..., 3] == 0] = 0
    return part
