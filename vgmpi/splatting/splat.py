"""Draws Gaussians: EWA splatting, front to back, on one CPU core.

Conventions (those of gsplat, see docs/rendering.md): the projection is linearised with x/z and y/z
limited to the picture and 30 % around it; `lowpass` pixels^2 are added to the 2-D covariance; pixel
centres lie at +0.5; a Gaussian adds alpha = min(0.99, opacity e^-s) and is left out below
`alpha_min`; a pixel stops, for good, before the Gaussian that would bring its transmittance below
1e-4. `antialias` multiplies opacities by sqrt(det / det') so that the lowpass does not fatten
Gaussians smaller than a pixel.

project.py finds the ellipses on the picture and their order, paint.py draws them.
"""

from dataclasses import dataclass

import numpy as np

from vgmpi.splatting.camera import Camera
from vgmpi.splatting.paint import TILE, new_canvas, paint, picture
from vgmpi.splatting.project import by_depth, project

ALPHA_MIN = 1 / 255
ALPHA_MIN_RANGE = (1e-5, 0.5)  # e^-s is accurate on the part of its range that these need


@dataclass(frozen=True)
class Splats:
    """Gaussians ready to be drawn. x: (n, 3) [m]. cov: upper triangles (n, 6) [m2].

    opacity: (n,) in 0..1. color: as seen from the camera, (n, 3) >= 0.
    """

    x: np.ndarray
    cov: np.ndarray
    opacity: np.ndarray
    color: np.ndarray


def render(
    splats: Splats,
    camera: Camera,
    background: np.ndarray = (1.0, 1.0, 1.0),
    *,
    lowpass: float = 0.3,
    antialias: bool = False,
    alpha_min: float = ALPHA_MIN,
) -> tuple[np.ndarray, np.ndarray]:
    """Picture (height, width, 3) float32, not clamped, and transmittance (height, width) float32.

    background: one colour (3,) or a picture (height, width, 3).
    """
    if not ALPHA_MIN_RANGE[0] <= alpha_min <= ALPHA_MIN_RANGE[1]:
        raise ValueError(f"alpha_min is {alpha_min}: allowed is {ALPHA_MIN_RANGE}")
    shape = (camera.height, camera.width)
    ellipses, looks, bounds, depth = project(
        *(np.ascontiguousarray(getattr(splats, f)) for f in ("x", "cov", "opacity", "color")),
        np.ascontiguousarray(camera.world_to_camera, dtype=np.float64),
        np.array([camera.fx, camera.fy, camera.cx, camera.cy, camera.near], dtype=np.float64),
        *shape,
        float(lowpass),
        bool(antialias),
        float(alpha_min),
    )
    canvas = new_canvas(*shape)
    paint(by_depth(depth), ellipses, looks, bounds, canvas, -(-camera.width // TILE))
    image = np.empty((*shape, 3), dtype=np.float32)
    transmittance = np.empty(shape, dtype=np.float32)
    behind = np.broadcast_to(np.asarray(background, np.float32), image.shape)
    picture(canvas, behind, image, transmittance)
    return image, transmittance
