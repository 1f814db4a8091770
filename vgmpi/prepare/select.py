"""Which part of a capture a scene takes."""

import numpy as np
from scipy.spatial import cKDTree

from vgmpi.gaussians.cloud import Cloud
from vgmpi.scene.objects import Select

NEIGHBOURS = 8


def selected(cloud: Cloud, select: Select | None) -> Cloud:
    """The Gaussians inside the selection, in the order of the file; coordinates of the file."""
    if select is None:
        return cloud
    keep = cloud.opacity >= select.min_opacity
    if select.box is not None:
        low, high = np.asarray(select.box)
        keep &= ((cloud.x >= low) & (cloud.x <= high)).all(axis=1)
    if select.sphere is not None:
        away = cloud.x - np.asarray(select.sphere.center)
        keep &= (away**2).sum(axis=1) <= select.sphere.radius**2
    cloud = cloud.select(keep)
    if select.outliers > 0 and len(cloud) > NEIGHBOURS:
        near = cKDTree(cloud.x).query(cloud.x, NEIGHBOURS + 1)[0][:, 1:].mean(axis=1)
        cloud = cloud.select(near <= near.mean() + select.outliers * near.std())
    return cloud
