"""Crop of a capture to the part that a scene uses."""

import numpy as np
import scipy

from vgmpi.gaussians.cloud import GaussianCloud
from vgmpi.scene.objects import Select

NEIGHBORS = 8


def crop(cloud: GaussianCloud, select: Select | None) -> GaussianCloud:
    """Return the Gaussians inside the selection, in the order and coordinates of the file."""
    if select is None:
        return cloud
    mask = cloud.opacity >= select.min_opacity
    if select.box is not None:
        low, high = np.asarray(select.box)
        mask &= ((cloud.x >= low) & (cloud.x <= high)).all(axis=1)
    if select.sphere is not None:
        offset = cloud.x - np.asarray(select.sphere.center)
        mask &= (offset**2).sum(axis=1) <= select.sphere.radius**2
    cloud = cloud.select(mask)
    if select.outlier_sigma > 0 and len(cloud) > NEIGHBORS:
        distance = (
            scipy.spatial.cKDTree(cloud.x).query(cloud.x, NEIGHBORS + 1)[0][:, 1:].mean(axis=1)
        )
        cloud = cloud.select(distance <= distance.mean() + select.outlier_sigma * distance.std())
    return cloud
