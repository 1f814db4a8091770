"""Rendering on a graphics card by gsplat, selected by backend="gsplat"; needs CUDA.

The pictures equal those of splat.render except for what is fixed in gsplat: it cuts a Gaussian at
alpha 1/255 and, by version, at about three standard deviations, keeps at least 0 instead of 0.005
of an antialiased opacity, and works in single precision. Median depths are not supported.
"""

import numpy as np

from vgmpi.gaussians.camera import Camera

ALPHA_MIN = 1 / 255  # [-] constant compiled into gsplat
_FULL = [0, 1, 2, 1, 3, 4, 2, 4, 5]  # entries of a 3x3 tensor in its upper triangle


class BackendError(Exception):
    """Missing gsplat, torch or graphics card, or a request that gsplat cannot serve."""


def render(
    splats,
    camera: Camera,
    background: np.ndarray,
    *,
    lowpass: float,
    antialias: bool,
    alpha_min: float,
    depth: str | None,
) -> tuple[np.ndarray, ...]:
    """Render Gaussians on a CUDA device with the options of splat.render.

    Args:
        splats, camera, lowpass, antialias: See splat.render.
        background: Picture behind the Gaussians, shape (height, width, 3).
        alpha_min: Cutoff of alpha; at least 1/255.
        depth: None or "expected".

    Returns:
        Picture, transmittance and, if requested, expected depth, as in splat.render.

    Raises:
        BackendError: If the backend is missing or an option is not supported.
    """
    torch, gsplat = _modules()
    if depth == "median":
        raise BackendError('backend "gsplat" draws no median depth: ask for "expected"')
    if alpha_min < 0.99 * ALPHA_MIN:
        raise BackendError(f'backend "gsplat" has alpha_min 1/255, {alpha_min:g} is asked for')

    def on_card(array: np.ndarray) -> object:
        """Copy an array to the CUDA device as float32."""
        return torch.as_tensor(np.ascontiguousarray(array, dtype=np.float32), device="cuda")

    lens = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    with torch.no_grad():
        colors, alphas, _ = gsplat.rasterization(
            means=on_card(splats.x),
            quats=None,  # deformed bodies have covariances only
            scales=None,
            covars=on_card(np.asarray(splats.cov)[:, _FULL].reshape(-1, 3, 3)),
            opacities=on_card(splats.opacity),
            colors=on_card(splats.color),
            viewmats=on_card(camera.world_to_camera[None]),
            Ks=on_card(lens[None]),
            width=camera.width,
            height=camera.height,
            near_plane=float(camera.near),
            eps2d=float(lowpass),
            rasterize_mode="antialiased" if antialias else "classic",
            render_mode="RGB" if depth is None else "RGB+ED",
            backgrounds=None,  # gsplat knows one color and no depth with it
        )
        drawn, alpha = colors[0].cpu().numpy(), alphas[0, ..., 0].cpu().numpy()
    transmittance = 1 - alpha
    image = drawn[..., :3] + transmittance[..., None] * background
    if depth is None:
        return image, transmittance
    return image, transmittance, np.where(alpha > 0, drawn[..., 3], np.float32(np.inf))


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
