"""Rasterizer of Gaussians: EWA splatting, front to back, on one CPU core.

Conventions (those of gsplat, docs/how-to/render.md): the projection is linearized with x/z and y/z
limited to the picture and 30 % around it; `lowpass` pixels^2 are added to the 2-D covariance; pixel
centers lie at +0.5; a Gaussian adds alpha = min(0.99, opacity e^-s) and is left out below
`alpha_min`; a pixel stops, for good, before the Gaussian that would bring its transmittance below
1e-4. Gaussians of antialiased training bring a lowpass of their own, and their opacities are
multiplied by sqrt(det / det') so that it does not fatten those smaller than a pixel. `antialias`
does so for all Gaussians or for none.

projection.py finds the ellipses on the picture and their order, tile_blend.py blends them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from vgmpi.gaussians.camera import Camera

from .projection import depth_order, project
from .tile_blend import TILE, blend_tiles, depths_of, new_canvas, picture

ALPHA_MIN = 1 / 255
LOWPASS = 0.3  # [pixels^2] variance that the first captures were trained with
BYTES = 32  # [bytes] memory of a drawn pixel, at least: canvas, picture and transmittance
DEPTHS = ("expected", "median")
BACKENDS = ("cpu", "gsplat")
ALPHA_MIN_RANGE = (1e-5, 0.5)  # [-] cutoffs for which e^-s is accurate


@dataclass(frozen=True)
class ProjectableGaussians:
    """Gaussians ready to be projected.

    Attributes:
        x: Centers, shape (n, 3) [m].
        cov: Upper triangles of the covariances, shape (n, 6) [m2].
        opacity: Opacities, shape (n,), 0..1.
        color: Colors as seen from the camera, shape (n, 3), >= 0.
        compensated_lowpass: Variance of the antialiased training of each, shape (n,) [pixels^2],
            see vgmpi.gaussians.capture_conventions; 0 for classic ones, None if all are.
    """

    x: np.ndarray
    cov: np.ndarray
    opacity: np.ndarray
    color: np.ndarray
    compensated_lowpass: np.ndarray | None = None


def join_gaussians(parts: Sequence[ProjectableGaussians]) -> ProjectableGaussians:
    """Return the Gaussians of all parts, one or more; those of a single part are not copied."""
    if len(parts) == 1:
        return parts[0]
    own = None
    if any(part.compensated_lowpass is not None for part in parts):
        own = np.concatenate(
            [
                np.zeros(len(p.x)) if p.compensated_lowpass is None else p.compensated_lowpass
                for p in parts
            ]
        )
    return ProjectableGaussians(
        np.concatenate([part.x for part in parts]),
        np.concatenate([part.cov for part in parts]),
        np.concatenate([part.opacity for part in parts]),
        np.concatenate([part.color for part in parts]),
        own,
    )


def resolve_lowpass(
    splats: ProjectableGaussians, lowpass: float | None, antialias: bool | None
) -> tuple[float, np.ndarray | None]:
    """Return the arguments `lowpass` and `compensated` of `project`; options as of `render`."""
    variance = LOWPASS if lowpass is None else float(lowpass)
    if antialias:
        return variance, np.full(len(splats.x), variance)
    own = None if antialias is False else splats.compensated_lowpass
    if own is None or not own.any():
        return variance, None
    if lowpass is not None:
        own = np.where(own > 0, variance, 0.0)
    return variance, np.ascontiguousarray(own, dtype=np.float64)


def project_splats(
    splats: ProjectableGaussians,
    camera: Camera,
    lowpass: float | None,
    antialias: bool | None,
    alpha_min: float,
    visible_ids: np.ndarray | None = None,
) -> tuple[np.ndarray, ...]:
    """Project Gaussians by `project`, with the options of `render`.

    Args:
        splats, camera: Gaussians and the camera of the picture.
        lowpass, antialias, alpha_min: As of `render`.
        visible_ids: (out) As of `project`.

    Returns:
        The arrays of `ProjectedGaussians` and the depths of the Gaussians in view [m].
    """
    arrays = (splats.x, splats.cov, splats.opacity, splats.color)
    x, cov, opacity, color = map(np.ascontiguousarray, arrays)
    return project(
        x, cov, opacity, color,
        np.ascontiguousarray(camera.world_to_camera, dtype=np.float64),
        np.array([camera.fx, camera.fy, camera.cx, camera.cy, camera.near_plane], dtype=np.float64),
        camera.height,
        camera.width,
        *resolve_lowpass(splats, lowpass, antialias),
        float(alpha_min),
        visible_ids,
    )  # fmt: skip


def render(
    splats: ProjectableGaussians,
    camera: Camera,
    background: ArrayLike = (1.0, 1.0, 1.0),
    *,
    lowpass: float | None = None,
    antialias: bool | None = None,
    alpha_min: float = ALPHA_MIN,
    supersample: int = 1,
    depth: str | None = None,
    backend: str = "cpu",
) -> tuple[np.ndarray, ...]:
    """Draw Gaussians over a background.

    Args:
        splats: The Gaussians.
        camera: Camera of the picture.
        background: One color, shape (3,), a picture, shape (height, width, 3), or a supersampled
            one.
        lowpass: Variance added to all 2-D covariances [pixels^2]; None: to those of antialiased
            training its own, to the others LOWPASS.
        antialias: Whether opacities are compensated for it; None: those of antialiased training.
        alpha_min: Cutoff of alpha, within ALPHA_MIN_RANGE.
        supersample: Factor of the resolution at which the picture is drawn and then averaged.
        depth: "expected" (weighted by each Gaussian's contribution), "median" (of the Gaussian that
            brings the transmittance to a half or less), or None.
        backend: "cpu", or "gsplat" for a graphics card (gsplat_backend.py).

    Returns:
        Picture, float32 (height, width, 3), not clamped, transmittance, float32 (height, width),
        and, if requested, depth along the camera's axis, float32 (height, width) [m], infinite
        where it is undefined.

    Raises:
        ValueError: If an option is out of range.
    """
    if not ALPHA_MIN_RANGE[0] <= alpha_min <= ALPHA_MIN_RANGE[1]:
        raise ValueError(f"alpha_min is {alpha_min}: allowed is {ALPHA_MIN_RANGE}")
    if depth not in (None, *DEPTHS) or backend not in BACKENDS or supersample < 1:
        raise ValueError(f"allowed: depth {DEPTHS}, backend {BACKENDS}, supersample from 1")
    fine = supersampled_camera(camera, supersample)
    under = background_image(background, camera, supersample)
    options: dict[str, Any] = {
        "lowpass": lowpass, "antialias": antialias, "alpha_min": alpha_min, "depth": depth,
    }  # fmt: skip
    if backend == "gsplat":
        from . import gsplat_backend  # needs torch, which is optional

        drawn = gsplat_backend.render(splats, fine, under, **options)
    else:
        drawn = _render(splats, fine, under, **options)
    return box_downsample(drawn, supersample)


def _render(splats, camera, background, *, lowpass, antialias, alpha_min, depth):
    """Draw on the processor; background: (height, width, 3) float32."""
    shape = (camera.height, camera.width)
    ellipses, looks, bounds, z = project_splats(splats, camera, lowpass, antialias, alpha_min)
    order, nx = depth_order(z), -(-camera.width // TILE)
    canvas = new_canvas(*shape)
    blend_tiles(order, ellipses, looks, bounds, canvas, nx, False, None, None)
    image = np.empty((*shape, 3), dtype=np.float32)
    transmittance = np.empty(shape, dtype=np.float32)
    picture(canvas, background, image, transmittance)
    if depth is None:
        return image, transmittance
    # a second pass draws depths for colors, so that pictures alone pay nothing for it
    looks[:, 2] = z
    canvas = new_canvas(*shape)
    blend_tiles(order, ellipses, looks, bounds, canvas, nx, True, None, None)
    depth_images = {kind: np.empty(shape, dtype=np.float32) for kind in DEPTHS}
    depths_of(canvas, depth_images["expected"], depth_images["median"])
    return image, transmittance, depth_images[depth]


def supersampled_camera(camera: Camera, times: int) -> Camera:
    """Return the camera with `times` as many pixels across and down."""
    size = {name: getattr(camera, name) * times for name in ("fx", "fy", "cx", "cy")}
    return replace(camera, **size, width=camera.width * times, height=camera.height * times)


def background_image(background: ArrayLike, camera: Camera, times: int) -> np.ndarray:
    """Return the background as (times height, times width, 3) float32, copied only if necessary."""
    background = np.asarray(background, dtype=np.float32)
    shape = (camera.height * times, camera.width * times, 3)
    if background.shape == (camera.height, camera.width, 3) and times > 1:
        background = background.repeat(times, axis=0).repeat(times, axis=1)
    return np.broadcast_to(background, shape)


def box_downsample(drawn: tuple[np.ndarray, ...], times: int) -> tuple[np.ndarray, ...]:
    """Return the means over squares of `times` x `times` pixels.

    Means of depths are taken over finite ones, weighted by opacity, so that a pixel at an edge
    keeps the depth of the nearer object.
    """
    if times == 1:
        return drawn
    image, transmittance, *depths = drawn
    means = [
        _blocks(image, times).mean(axis=2),
        _blocks(transmittance[..., None], times).mean(axis=2)[..., 0],
    ]
    for depth in depths:
        weight = np.where(np.isfinite(depth), 1 - transmittance, 0)
        total = np.stack([weight * np.where(weight > 0, depth, 0), weight], axis=-1)
        total = _blocks(total, times).sum(axis=2)
        with np.errstate(divide="ignore", invalid="ignore"):
            means.append(np.where(total[..., 1] > 0, total[..., 0] / total[..., 1], np.inf))
    return tuple(mean.astype(np.float32) for mean in means)


def _blocks(a: np.ndarray, times: int) -> np.ndarray:
    """Reshape (H, W, c) to (H / times, W / times, times^2, c)."""
    height, width, channels = a.shape[0] // times, a.shape[1] // times, a.shape[2]
    parts = a.reshape(height, times, width, times, channels)
    return parts.swapaxes(1, 2).reshape(height, width, times * times, channels)
