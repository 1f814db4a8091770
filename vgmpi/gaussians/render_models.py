"""Render models: the filter on the picture with which the Gaussians of a capture were trained.

A renderer adds a variance to each Gaussian on the picture, so that none falls between the pixels.
Antialiased training compensates it: opacities are multiplied by sqrt(det / det'). Files only say
whether a capture was trained so, and the program that writes this mark, Brush, trains as
Mip-Splatting. gsplat adds a larger variance and writes no mark.

References:
    Z. Yu, A. Chen, B. Huang, T. Sattler, A. Geiger. Mip-Splatting: alias-free 3D Gaussian
    splatting. 2024.
"""

from dataclasses import replace
from typing import Literal

from .cloud import GaussianCloud

RenderModel = Literal["classic", "antialiased", "mip"]
# [pixels^2] variance whose effect on the opacity is compensated; 0: nothing is compensated
COMPENSATED_LOWPASS: dict[RenderModel, float] = {"classic": 0.0, "antialiased": 0.3, "mip": 0.1}


def render_model(cloud: GaussianCloud) -> RenderModel:
    """Return the render model of a cloud."""
    if not cloud.is_antialiased:
        return "classic"
    return "mip" if cloud.lowpass < 0.2 else "antialiased"


def with_render_model(cloud: GaussianCloud, model: RenderModel) -> GaussianCloud:
    """Return the same Gaussians as trained by another render model."""
    lowpass = COMPENSATED_LOWPASS[model] or COMPENSATED_LOWPASS["mip"]
    return replace(cloud, is_antialiased=model != "classic", lowpass=lowpass)
