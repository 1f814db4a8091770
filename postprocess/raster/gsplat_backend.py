"""Rendering on a graphics card by gsplat, selected by backend="gsplat"; needs CUDA.

The pictures equal those of rasterize.render except for what is fixed in gsplat: it cuts a Gaussian
at alpha 1/255 and, by version, at about three standard deviations, keeps at least 0 instead of
0.005 of an antialiased opacity, and works in single precision. Median depths are not supported,
nor Gaussians of several lowpasses in one picture.
"""

import functools

import numpy as np

from vgmpi.gaussians.camera import Camera

from .projection import project
from .rasterize import resolve_lowpass

ALPHA_MIN = 1 / 255  # [-] constant compiled into gsplat
_FULL = [0, 1, 2, 1, 3, 4, 2, 4, 5]  # entries of a 3x3 tensor in its upper triangle


class BackendError(Exception):
    """Missing gsplat, torch or graphics card, or a request that gsplat cannot serve."""


def render(
    splats,
    camera: Camera,
    background: np.ndarray,
    *,
    lowpass: float | None,
    antialias: bool | None,
    alpha_min: float,
    depth: str | None,
) -> tuple[np.ndarray, ...]:
    """Render Gaussians on a CUDA device with the options of rasterize.render.

    Args:
        splats, camera, lowpass, antialias: See rasterize.render.
        background: Picture behind the Gaussians, shape (height, width, 3).
        alpha_min: Cutoff of alpha; at least 1/255.
        depth: None or "expected".

    Returns:
        Picture, transmittance and, if requested, expected depth, as in rasterize.render.

    Raises:
        BackendError: If the backend is missing or an option is not supported.
    """
    torch, gsplat = _modules()
    if depth == "median":
        raise BackendError('backend "gsplat" draws no median depth: ask for "expected"')
    if alpha_min < 0.99 * ALPHA_MIN:
        raise BackendError(f'backend "gsplat" has alpha_min 1/255, {alpha_min:g} is asked for')

    variance, opacity, rasterize_mode = _filter(splats, camera, lowpass, antialias)

    on_card = functools.partial(_on_card, torch)
    lens = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    with torch.no_grad():
        colors, alphas, _ = gsplat.rasterization(
            means=on_card(splats.x),
            quats=None,  # deformed bodies have covariances only
            scales=None,
            covars=on_card(np.asarray(splats.cov)[:, _FULL].reshape(-1, 3, 3)),
            opacities=on_card(opacity),
            colors=on_card(splats.color),
            viewmats=on_card(camera.world_to_camera[None]),
            Ks=on_card(lens[None]),
            width=camera.width,
            height=camera.height,
            near_plane=float(camera.near_plane),
            eps2d=variance,
            rasterize_mode=rasterize_mode,
            render_mode="RGB" if depth is None else "RGB+ED",
            backgrounds=None,  # gsplat knows one color and no depth with it
        )
        drawn, alpha = colors[0].cpu().numpy(), alphas[0, ..., 0].cpu().numpy()
    transmittance = 1 - alpha
    image = drawn[..., :3] + transmittance[..., None] * background
    if depth is None:
        return image, transmittance
    return image, transmittance, np.where(alpha > 0, drawn[..., 3], np.float32(np.inf))


def _on_card(torch, array: np.ndarray) -> object:
    """Copy an array to the CUDA device as float32."""
    return torch.as_tensor(np.ascontiguousarray(array, dtype=np.float32), device="cuda")


def _filter(splats, camera: Camera, lowpass, antialias) -> tuple[float, np.ndarray, str]:
    """Return variance [pixels^2], opacities (n,) and mode for gsplat, which has one for all.

    Where only some Gaussians are compensated, their opacities are reduced here.

    Raises:
        BackendError: If they have several variances.
    """
    variance, compensated = resolve_lowpass(splats, lowpass, antialias)
    if compensated is None:
        return variance, splats.opacity, "classic"
    if (compensated == compensated[0]).all():
        return float(compensated[0]), splats.opacity, "antialiased"
    if (compensated[compensated > 0] != variance).any():
        text = "set lowpass, or antialias, for all"
        raise BackendError(f'backend "gsplat" adds one lowpass to all Gaussians: {text}')
    visible_ids = np.empty(len(splats.x), np.int64)
    lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy, camera.near_plane], np.float64)
    _, looks, _, depth = project(
        np.ascontiguousarray(splats.x),
        np.ascontiguousarray(splats.cov),
        np.ascontiguousarray(splats.opacity),
        np.ascontiguousarray(splats.color),
        np.ascontiguousarray(camera.world_to_camera, dtype=np.float64),
        lens,
        camera.height,
        camera.width,
        variance,
        compensated,
        ALPHA_MIN,
        visible_ids,
    )
    opacity = np.zeros(len(splats.x), np.float32)  # what is not in view is not drawn
    opacity[visible_ids[: len(depth)]] = looks[:, 0]
    return variance, opacity, "classic"


def _modules() -> tuple:
    """Import torch and gsplat.

    Raises:
        BackendError: With one line that says what is missing.
    """
    try:
        import torch
    except ImportError:
        raise BackendError(
            'backend "gsplat" needs torch with CUDA: pip install "vgmpi[gpu-render]"'
        ) from None
    try:
        import gsplat
    except ImportError:
        raise BackendError(
            'backend "gsplat" needs gsplat: pip install "vgmpi[gpu-render]"'
        ) from None
    if not torch.cuda.is_available():
        raise BackendError('backend "gsplat" needs a CUDA graphics card: torch finds none')
    return torch, gsplat
