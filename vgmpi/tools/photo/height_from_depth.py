"""Height of objects above the floor from a monocular depth map.

Depth models return 1 / depth up to a factor and an offset. The floor, whose depth follows from the
pitch of the camera, determines both; an object whose depth differs from the depth of a standing one
is in the air.
"""

from typing import NamedTuple

import numpy as np

from .photo_camera import View

DEPTH_TOLERANCE = 0.12  # [-] an object stands on the floor up to this relative difference of depths
MIN_FLOOR_PIXELS = 500  # [pixels] the fit needs at least this much visible floor
TRIMMED_FRACTION = (
    0.25  # [-] fraction of the floor pixels, the worst fitting ones, that the fit drops
)
FIT_ITERATIONS = 5  # the fit is repeated this often without its outliers


class GroundFit(NamedTuple):
    """Linear map between the model's nearness and 1 / depth.

    With depths in eye heights, 1 / depth = (nearness - offset) / factor.
    """

    factor: float
    offset: float

    def depth(self, nearness: float) -> float:
        """Return the depth in eye heights."""
        return self.factor / max(nearness - self.offset, 1e-6)


def fit_ground_depth(nearness: np.ndarray, masks: list[np.ndarray], view: View) -> GroundFit | None:
    """Fit the depth map to the floor.

    The floor is taken from the lower part of the picture between the objects; the fit discards
    outliers repeatedly.

    Args:
        nearness: Depth map of the model, 1 / depth up to a linear map, shape (height, width).
        masks: Objects, each (height, width) bool.
        view: Camera of the photograph.

    Returns:
        The fit, or None if too little of the floor is visible.
    """
    pixels = (np.indices((view.width, view.height)).T + 0.5).astype(np.float64)
    true = -view.rays(pixels)[..., 2]  # 1 / depth of the floor in heights of the eye
    free = ~np.logical_or.reduce(masks) if masks else np.ones(true.shape, dtype=bool)
    below = np.zeros(true.shape, dtype=bool)
    below[int(0.6 * view.height) :] = True
    use = free & below & (true > 0.05) & np.isfinite(nearness)
    x, y = true[use], nearness[use].astype(np.float64)
    if len(x) < MIN_FLOOR_PIXELS or np.ptp(x) < 1e-3:
        return None
    inliers = np.ones(len(x), dtype=bool)
    factor, offset = 1.0, 0.0
    for _ in range(FIT_ITERATIONS):
        factor, offset = np.polyfit(x[inliers], y[inliers], 1)
        residual = np.abs(y - factor * x - offset)
        inliers = residual <= np.quantile(residual, 1 - TRIMMED_FRACTION)
    return GroundFit(float(factor), float(offset)) if factor > 0 else None


def height_above_ground(
    nearness: np.ndarray, mask: np.ndarray, low: float, middle: float, fit: GroundFit
) -> tuple[float, float] | None:
    """Return the height of an object's lowest point above the floor, and its depth.

    Args:
        nearness: Depth map of the model, shape (height, width).
        mask: The object, shape (height, width) bool.
        low: Height of the body's lowest point relative to the eye, for a body about 1 away.
        middle: Depth of the front of the same body.
        fit: Fit of the depth map to the floor.

    Returns:
        Height and depth in eye heights, or None if the object stands on the floor.
    """
    depth = fit.depth(float(np.median(nearness[mask])))
    factor = depth / middle
    standing_factor = -1 / low if low < 0 else np.inf
    if abs(factor / standing_factor - 1) <= DEPTH_TOLERANCE or factor > standing_factor:
        return None
    return 1 + factor * low, depth
