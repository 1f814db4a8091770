"""Draws Gaussians: EWA splatting, front to back, on one CPU core.

Conventions (those of gsplat, see docs/rendering.md): the projection is linearised with x/z and y/z
limited to the picture and 30 % around it; `lowpass` pixels^2 are added to the 2-D covariance; pixel
centres lie at +0.5; a Gaussian adds alpha = min(0.99, opacity e^-s) and is left out below
`alpha_min`; a pixel stops, for good, before the Gaussian that would bring its transmittance below
1e-4. `antialias` multiplies opacities by sqrt(det / det') so that the lowpass does not fatten
Gaussians smaller than a pixel.

project.py finds the ellipses on the picture and their order, paint.py draws them.
"""

from dataclasses import dataclass, replace

import numpy as np

from vgmpi.splatting.camera import Camera
from vgmpi.splatting.paint import TILE, depths_of, new_canvas, paint, picture
from vgmpi.splatting.project import by_depth, project

ALPHA_MIN = 1 / 255
BYTES = 32  # of a pixel that is drawn, at least: canvas, picture and transmittance
DEPTHS = ("expected", "median")
BACKENDS = ("cpu", "gsplat")
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
    supersample: int = 1,
    depth: str | None = None,
    backend: str = "cpu",
) -> tuple[np.ndarray, ...]:
    """Picture (height, width, 3) float32, not clamped, and transmittance (height, width) float32.

    background: one colour (3,), a picture (height, width, 3), or one as fine as it is drawn.
    supersample: draw that many times as wide and high, and average. depth: "expected" (weighted by
    what each Gaussian adds) or "median" (of the Gaussian that brings the transmittance to a half or
    less): then a third array (height, width) float32 [m] along the camera's axis, infinite where
    there is none. backend: "cpu", or "gsplat" for a graphics card (gsplat_backend.py).
    """
    if not ALPHA_MIN_RANGE[0] <= alpha_min <= ALPHA_MIN_RANGE[1]:
        raise ValueError(f"alpha_min is {alpha_min}: allowed is {ALPHA_MIN_RANGE}")
    if depth not in (None, *DEPTHS) or backend not in BACKENDS or supersample < 1:
        raise ValueError(f"allowed: depth {DEPTHS}, backend {BACKENDS}, supersample from 1")
    fine = finer(camera, supersample)
    under = behind(background, camera, supersample)
    options = {"lowpass": lowpass, "antialias": antialias, "alpha_min": alpha_min, "depth": depth}
    if backend == "gsplat":
        from vgmpi.splatting import gsplat_backend  # asks for torch, which few have

        drawn = gsplat_backend.render(splats, fine, under, **options)
    else:
        drawn = _render(splats, fine, under, **options)
    return coarser(drawn, supersample)


def _render(splats, camera, background, *, lowpass, antialias, alpha_min, depth):
    """render() on the processor. background: (height, width, 3) float32."""
    shape = (camera.height, camera.width)
    ellipses, looks, bounds, z = project(
        *(np.ascontiguousarray(getattr(splats, f)) for f in ("x", "cov", "opacity", "color")),
        np.ascontiguousarray(camera.world_to_camera, dtype=np.float64),
        np.array([camera.fx, camera.fy, camera.cx, camera.cy, camera.near], dtype=np.float64),
        *shape,
        float(lowpass),
        bool(antialias),
        float(alpha_min),
    )
    order, nx = by_depth(z), -(-camera.width // TILE)
    canvas = new_canvas(*shape)
    paint(order, ellipses, looks, bounds, canvas, nx, False, None)
    image = np.empty((*shape, 3), dtype=np.float32)
    transmittance = np.empty(shape, dtype=np.float32)
    picture(canvas, background, image, transmittance)
    if depth is None:
        return image, transmittance
    # drawn a second time with depths for colours: so pictures alone pay nothing for it
    looks[:, 2] = z
    canvas = new_canvas(*shape)
    paint(order, ellipses, looks, bounds, canvas, nx, True, None)
    found = {kind: np.empty(shape, dtype=np.float32) for kind in DEPTHS}
    depths_of(canvas, found["expected"], found["median"])
    return image, transmittance, found[depth]


def finer(camera: Camera, times: int) -> Camera:
    """The same view in `times` as many pixels across and down."""
    size = {name: getattr(camera, name) * times for name in ("fx", "fy", "cx", "cy")}
    return replace(camera, **size, width=camera.width * times, height=camera.height * times)


def behind(background: np.ndarray, camera: Camera, times: int) -> np.ndarray:
    """The background as (times height, times width, 3) float32, copied only where it must be."""
    background = np.asarray(background, dtype=np.float32)
    shape = (camera.height * times, camera.width * times, 3)
    if background.shape == (camera.height, camera.width, 3) and times > 1:
        background = background.repeat(times, axis=0).repeat(times, axis=1)
    return np.broadcast_to(background, shape)


def coarser(drawn: tuple[np.ndarray, ...], times: int) -> tuple[np.ndarray, ...]:
    """Means over squares of `times` x `times` pixels; of depths, over what is not infinite.

    Depths are weighted by what is opaque there, so that a pixel at an edge keeps the nearer
    thing's.
    """
    if times == 1:
        return drawn
    image, left, *rest = drawn
    means = [
        _blocks(image, times).mean(axis=2),
        _blocks(left[..., None], times).mean(axis=2)[..., 0],
    ]
    for depth in rest:
        weight = np.where(np.isfinite(depth), 1 - left, 0)
        total = np.stack([weight * np.where(weight > 0, depth, 0), weight], axis=-1)
        total = _blocks(total, times).sum(axis=2)
        with np.errstate(divide="ignore", invalid="ignore"):
            means.append(np.where(total[..., 1] > 0, total[..., 0] / total[..., 1], np.inf))
    return tuple(mean.astype(np.float32) for mean in means)


def _blocks(a: np.ndarray, times: int) -> np.ndarray:
    """(H, W, c) as (H / times, W / times, times^2, c)."""
    height, width, channels = a.shape[0] // times, a.shape[1] // times, a.shape[2]
    parts = a.reshape(height, times, width, times, channels)
    return parts.swapaxes(1, 2).reshape(height, width, times * times, channels)
