"""Which objects stand on the floor and which are in the air, by a picture of depths.

Models tell 1 / depth up to a factor and an offset; the floor, whose depths are known from the
camera's pitch, tells both.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.images.view import View

SAME = 0.12  # relative difference of depths up to which an object stands on the floor
FEWEST = 500  # pixels of the floor
TRIM = 0.25  # of the floor's pixels, those that fit the worst, which are left out
ROUNDS = 5


class Fit(NamedTuple):
    """1 / depth in heights of the eye is (nearness - offset) / factor."""

    factor: float
    offset: float

    def depth(self, nearness: float) -> float:
        """In heights of the eye."""
        return self.factor / max(nearness - self.offset, 1e-6)


def floor_fit(nearness: np.ndarray, masks: list[np.ndarray], view: View) -> Fit | None:
    """The fit to the floor, which is seen in the lower part of the picture between the objects;
    None where too little of it is seen. nearness: (height, width)."""
    at = (np.indices((view.width, view.height)).T + 0.5).astype(np.float64)
    true = -view.rays(at)[..., 2]  # 1 / depth of the floor in heights of the eye
    free = ~np.logical_or.reduce(masks) if masks else np.ones(true.shape, dtype=bool)
    below = np.zeros(true.shape, dtype=bool)
    below[int(0.6 * view.height) :] = True
    use = free & below & (true > 0.05) & np.isfinite(nearness)
    x, y = true[use], nearness[use].astype(np.float64)
    if len(x) < FEWEST or np.ptp(x) < 1e-3:
        return None
    kept = np.ones(len(x), dtype=bool)
    factor, offset = 1.0, 0.0
    for _ in range(ROUNDS):
        factor, offset = np.polyfit(x[kept], y[kept], 1)
        off = np.abs(y - factor * x - offset)
        kept = off <= np.quantile(off, 1 - TRIM)
    return Fit(float(factor), float(offset)) if factor > 0 else None


def lift(
    nearness: np.ndarray, mask: np.ndarray, low: float, middle: float, fit: Fit
) -> tuple[float, float] | None:
    """How high above the floor an object's lowest point is, in heights of the eye, and how far it
    is; None where it stands.

    low: height of its lowest point about the eye, middle: depth of its front, both for a body that
    is about 1 away.
    """
    far = fit.depth(float(np.median(nearness[mask])))
    factor = far / middle
    stands = -1 / low if low < 0 else np.inf
    if abs(factor / stands - 1) <= SAME or factor > stands:
        return None
    return 1 + factor * low, far
