"""Optical values of a liquid's particles for the studio: absorption, color, foam, scattering."""

import numpy as np

from ..studio import liquid_radiance
from ..studio.light_rig import Rig
from .render_config import Settings

SCATTERING = 1.5  # [1/m] scattering of a liquid with Gaussians of the usual opacity
USUAL_OPACITY = 0.05  # [-] opacity scale of a clear liquid
MAX_COEFFICIENT = 1e6  # [1/m] absorption and scattering


def optical_values(
    color: np.ndarray, is_captured: np.ndarray, opaqueness: np.ndarray, foam: np.ndarray,
    absorption_length: float, chosen: Settings, rig: Rig,
) -> np.ndarray:  # fmt: skip
    """Return the values (n, 9) of `Medium.tint` for each particle.

    Colors of captures contain a light. Before the photograph from which they were made they are
    shown as they are, as far as captures receive none of the studio's light. Elsewhere they are
    divided by a liquid's usual light to this part.

    Args:
        color: Linear colors, shape (n, 3).
        is_captured: Whether the colors are those of a capture, shape (n,).
        opaqueness: Opacity scale of the Gaussians, shape (n,).
        foam: Fraction of foam, shape (n,).
        absorption_length: Length after which white light has a liquid's color [m].
        chosen: Contents of render.toml.
        rig: Lights.
    """
    absorbs = -np.log(np.clip(color, 0.03, 0.97)) / absorption_length
    contained = np.where(is_captured, 1.0 - chosen.captures, 0.0)
    if chosen.picture.on_photograph:
        foam = foam * (1.0 - contained)  # it has the studio's light alone
    else:
        usual = liquid_radiance.DIRECT * rig.key + liquid_radiance.AMBIENT * rig.horizon
        captured = chosen.captures + (1.0 - chosen.captures) / np.maximum(usual, 0.1)
        color = color * np.where(is_captured[:, None], captured, 1.0)
        contained = np.zeros(len(color))
    scatters = _scattering(chosen.liquid.scattering_coefficient, opaqueness)
    values = np.column_stack([absorbs, color, foam, scatters])
    return np.column_stack([np.minimum(values, MAX_COEFFICIENT), contained])


def _scattering(coefficient: float | None, opaqueness: np.ndarray) -> np.ndarray:
    """Return scattering coefficients [1/m], which rise with the Gaussians' opacity."""
    if coefficient is not None:
        return np.full(len(opaqueness), float(coefficient))
    return SCATTERING * (np.maximum(opaqueness, 0.02) / USUAL_OPACITY) ** 2
