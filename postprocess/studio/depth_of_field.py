"""Depth of field from a picture and its depths: a gather over circles of confusion."""

import numpy as np

from vgmpi.runtime.compile_cache import njit_cached

TAPS = 48  # [samples] of a disc
MAX_RADIUS = 40.0  # [pixels] largest radius of a disc


def _disc() -> np.ndarray:
    """Return evenly spread points of the unit disc (TAPS, 2), on a golden spiral."""
    turn = np.arange(TAPS) * np.pi * (3 - np.sqrt(5))
    r = np.sqrt((np.arange(TAPS) + 0.5) / TAPS)
    return np.stack([r * np.cos(turn), r * np.sin(turn)], axis=1)


_DISC = _disc()


def defocus(
    image: np.ndarray,
    left: np.ndarray,
    depth: np.ndarray,
    focal: float,
    aperture: float,
    focus: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Blur a picture and its transmittance by the distance from the plane in focus.

    Args:
        image: Picture, shape (height, width, 3).
        left: Transmittance, shape (height, width).
        depth: Depths, shape (height, width) [m], infinite for none.
        focal: Focal length [pixels].
        aperture: Radius of the lens [m].
        focus: Depth of the plane in focus [m].

    Returns:
        Blurred picture and transmittance.
    """
    finite_depth = np.where(np.isfinite(depth), np.maximum(depth, 1e-6), 1e6)
    radius = np.minimum(focal * aperture * np.abs(1 / finite_depth - 1 / focus), MAX_RADIUS)
    stacked = np.concatenate([image, left[..., None]], axis=2).astype(np.float32)
    out = np.empty_like(stacked)
    _gather(
        stacked,
        finite_depth.astype(np.float32),
        radius.astype(np.float32),
        float(radius.max()),
        _DISC,
        out,
    )
    return np.ascontiguousarray(out[..., :3]), np.ascontiguousarray(out[..., 3])


@njit_cached(nogil=True, error_model="numpy")
def _gather(image, depth, radius, widest, disc, out):
    """Average the four channels of an image over the circles of confusion."""
    height, width = depth.shape
    sums = np.empty(4)
    for j in range(height):
        for k in range(width):
            reach = radius[j, k]
            # nearer and more blurred pixels extend over sharp edges
            for a in range(-1, 2):
                for b in range(-1, 2):
                    q = min(max(j + int(a * 0.5 * widest), 0), height - 1)
                    r = min(max(k + int(b * 0.5 * widest), 0), width - 1)
                    if depth[q, r] < depth[j, k]:
                        reach = max(reach, radius[q, r])
            if reach < 0.5:
                for m in range(4):
                    out[j, k, m] = image[j, k, m]
                continue
            center_weight = 1.0 / max(radius[j, k] * radius[j, k], 0.25)
            total = center_weight
            for m in range(4):
                sums[m] = center_weight * image[j, k, m]
            for tap in range(len(disc)):
                x, y = k + 0.5 + reach * disc[tap, 0], j + 0.5 + reach * disc[tap, 1]
                q, r = int(np.floor(y)), int(np.floor(x))
                if not (0 <= q < height and 0 <= r < width):
                    continue
                distance = reach * np.sqrt(disc[tap, 0] ** 2 + disc[tap, 1] ** 2)
                size = (
                    radius[q, r] if depth[q, r] < depth[j, k] else min(radius[q, r], radius[j, k])
                )
                w = min(max(size - distance + 0.5, 0.0), 1.0) * reach * reach / len(disc)
                w /= max(size * size, 0.25)
                total += w
                for m in range(4):
                    sums[m] += w * image[q, r, m]
            for m in range(4):
                out[j, k, m] = sums[m] / total
