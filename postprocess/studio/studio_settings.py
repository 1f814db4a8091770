"""Lights, ground and optical values of liquids in the studio, from a render.toml."""

from pathlib import Path
from typing import Any

import numpy as np

from ..frames import image_io
from ..frames.render_config import Settings
from . import light_rig, liquid_radiance, studio_ground, tone_mapping
from .studio_bodies import Domain

DIRECTION = (0.55, 0.35, -1.0)  # travel direction of the key light
SCATTERING = 1.5  # [1/m] scattering of a liquid with Gaussians of the usual opacity
USUAL_OPACITY = 0.05  # [-] opacity scale of a clear liquid
MAX_COEFFICIENT = 1e6  # [1/m] absorption and scattering


def ground_of(
    chosen: Settings, domain: Domain, pyramid: Any, rig: light_rig.Rig
) -> studio_ground.Ground:
    """Return the ground of the settings, with its lighting.

    Args:
        chosen: Contents of render.toml.
        domain: Domain of the run.
        pyramid: Occlusion pyramid of the frame.
        rig: Lights.
    """
    picture, floor = chosen.picture, chosen.picture.floor
    background_value = picture.background
    photograph = picture.on_photograph
    kind, height, tile = (
        studio_ground.TILES,
        0.0,
        0.12 * max(float(np.max(domain.size[:2])), 1e-9),
    )
    color, other, back = studio_ground.COLOR, studio_ground.COLOR, studio_ground.BACKDROP
    if photograph:
        kind = studio_ground.SHADOW if floor is not None else studio_ground.NONE
    elif background_value == "none":
        kind = studio_ground.NONE
    lean = 0.5
    if background_value is not None and not photograph:
        back, lean = tuple(image_io.background(background_value, 1, 1, Path("."))), 0.0
    if floor is not None:
        height = floor.height
        is_plain = floor.kind == "plain" or (floor.kind is None and floor.color is not None)
        if floor.kind == "none":
            kind = studio_ground.NONE
        elif is_plain or floor.checker_size is not None:
            kind = studio_ground.SQUARES if floor.checker_size is not None else studio_ground.TILES
            color, other = floor.color or (0.85, 0.85, 0.85), floor.checker_color
            tile = floor.checker_size or 0.0
        else:
            color = floor.color or color
        if floor.tile_size is not None:
            tile = floor.tile_size
    elif kind == studio_ground.TILES:
        tile = 0.12 * _round(float(np.max(domain.size[:2])) / 0.96)
    backdrop = tone_mapping.scene_linear(np.array(back, dtype=np.float64), chosen.toned)
    return studio_ground.ground(
        kind, height, domain.low, domain.high, pyramid, rig,
        tone_mapping.to_linear(np.array(color)), tone_mapping.to_linear(np.array(other)), tile,
        backdrop, lean,
    )  # fmt: skip


def _round(x: float) -> float:
    """Return a power of two near x, so that tiles look similar in scenes of all sizes."""
    return 2.0 ** round(np.log2(max(x, 1e-9)))


def rig_of(chosen: Settings, folder: Path) -> light_rig.Rig:
    """Return the lights of the settings. folder: folder of render.toml."""
    light, liquid_settings = chosen.light, chosen.liquid
    environment, surroundings, picture = liquid_settings.environment, None, None
    if environment.picture is not None:
        photograph = image_io.photograph("liquid.environment.picture", folder / environment.picture)
        picture = tone_mapping.to_linear(photograph)
    elif "environment" in liquid_settings.model_fields_set:
        colors = (environment.zenith, environment.horizon, environment.ground)
        surroundings = tuple(tone_mapping.to_linear(np.array(c)) for c in colors)
    direction = DIRECTION if light is None or light.direction is None else light.direction
    strength = {}
    if light is not None:
        strength = {"key": light.key, "sky": light.sky, "width": light.width}
    highlight = liquid_settings.highlight / 2.0
    return light_rig.rig(
        direction, **strength, highlight=highlight, surroundings=surroundings, picture=picture
    )


def optical_values(
    color: np.ndarray, is_captured: np.ndarray, opaqueness: np.ndarray, foam: np.ndarray,
    absorption_length: float, chosen: Settings, rig: light_rig.Rig,
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
