"""splat.render on a graphics card, by gsplat: asked for with backend="gsplat", needs CUDA.

The same pictures but for what gsplat has fixed: it cuts a Gaussian at alpha 1/255 and, by version,
at about three standard deviations, keeps at least 0 instead of 0.005 of an antialiased opacity, and
works in single precision. Only expected depths.
"""

import numpy as np

from vgmpi.splatting.camera import Camera

ALPHA_MIN = 1 / 255  # compiled into gsplat
_FULL = [0, 1, 2, 1, 3, 4, 2, 4, 5]  # a 3x3 tensor out of its upper triangle


class BackendError(Exception):
    """gsplat, torch or the graphics card is not there, or gsplat cannot do what is asked."""


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
    """Picture, transmittance and, if asked, expected depth; arguments as in splat.render.

    background: (height, width, 3). Raises BackendError.
    """
    torch, gsplat = _modules()
    if depth == "median":
        raise BackendError('backend "gsplat" draws no median depth: ask for "expected"')
    if alpha_min < 0.99 * ALPHA_MIN:
        raise BackendError(f'backend "gsplat" has alpha_min 1/255, {alpha_min:g} is asked for')

    def on_card(array: np.ndarray) -> object:
        return torch.as_tensor(np.ascontiguousarray(array, dtype=np.float32), device="cuda")

    lens = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    with torch.no_grad():
        colors, alphas, _ = gsplat.rasterization(
            means=on_card(splats.x),
            quats=None,  # covariances are given: what moves has been deformed
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
            backgrounds=None,  # of one colour only, and not with a depth: laid under it here
        )
        drawn, alpha = colors[0].cpu().numpy(), alphas[0, ..., 0].cpu().numpy()
    left = 1 - alpha
    image = drawn[..., :3] + left[..., None] * background
    if depth is None:
        return image, left
    return image, left, np.where(alpha > 0, drawn[..., 3], np.float32(np.inf))


def _modules() -> tuple:
    """torch and gsplat. Raises BackendError with one clear line."""
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
