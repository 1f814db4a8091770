"""Crop of a capture to the part that a scene uses."""

from dataclasses import replace

import numpy as np
import scipy

from vgmpi.gaussians.cloud import GaussianCloud
from vgmpi.runtime.message_text import did_you_mean
from vgmpi.scene.captures import Select

from .placement import PlacementError

NEIGHBORS = 8
_VALUES_TOLD = 10  # values of a column that a message names


def crop(cloud: GaussianCloud, select: Select | None) -> GaussianCloud:
    """Return the Gaussians inside the selection, in the order and coordinates of the file.

    Columns of labels have served their purpose and are dropped.

    Raises:
        PlacementError: If the file has no such column of labels, or none of its values is selected.
    """
    labels = cloud.labels
    if labels:
        cloud = replace(cloud, labels={})
    if select is None:
        return cloud
    mask = cloud.opacity >= select.min_opacity
    if select.property is not None:
        mask &= _labeled(labels, select.property, select.values)
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


def _labeled(labels: dict[str, np.ndarray], name: str, values: tuple[int, ...]) -> np.ndarray:
    """Return the mask of Gaussians whose label is one of some values.

    Raises:
        PlacementError: If there is no such column, or it has none of the values.
    """
    if name not in labels:
        names = ", ".join(labels) if labels else "none"
        raise PlacementError(
            "select",
            f"property '{name}' is no column of integers of the file{did_you_mean(name, labels)};"
            f" known: {names}",
        )
    mask = np.isin(labels[name], np.asarray(values))
    if not mask.any():
        present = np.unique(labels[name])
        more = " ..." if len(present) > _VALUES_TOLD else ""
        some = ", ".join(map(str, present[:_VALUES_TOLD]))
        raise PlacementError(
            "select",
            f"no Gaussian has one of the values {', '.join(map(str, values))} of '{name}', which"
            f" has {len(present):,}: {some}{more}",
        )
    return mask
