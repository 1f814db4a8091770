"""Light that is painted on the colors of shapes and meshes."""

import numpy as np

LIGHT = np.array([0.36, -0.48, 0.80])  # [-] unit vector towards the painted light
MIN_SHADE = 1e-3  # [-] smallest factor of the light, so that colors can be divided by it


def apply_baked_shading(
    rgb: np.ndarray, normal: np.ndarray, amount: float
) -> tuple[np.ndarray, np.ndarray | None]:
    """Darken colors where the surface faces away from the light.

    Gaussians carry no lights: without this a plain body is a flat silhouette. A renderer that has
    lights divides by the factors.

    Args:
        rgb: Colors, shape (n, 3).
        normal: Outward unit normals, shape (n, 3).
        amount: Largest reduction, 0 to 1.

    Returns:
        Darkened colors (n, 3) and factors (n,), at least MIN_SHADE, or None if `amount` is 0.
    """
    facing = 0.5 + 0.5 * (normal * LIGHT).sum(axis=1)
    factor = 1.0 - amount * (1.0 - facing)
    shade = np.clip(factor, MIN_SHADE, 1.0).astype(np.float32) if amount else None
    return rgb * factor[:, None], shade


def facing_of_shade(shade: np.ndarray, amount: float) -> np.ndarray:
    """Return the cosines (n,) between outward normals and the light from the factors (n,).

    Args:
        shade: Factors of `apply_baked_shading`.
        amount: Largest reduction with which they were made, above 0.
    """
    return 1.0 - 2.0 * (1.0 - np.asarray(shade, dtype=np.float64)) / amount
