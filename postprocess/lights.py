"""The studio's lights and ground of a render.toml."""

from pathlib import Path
from typing import Any

import numpy as np

from postprocess import video
from postprocess.settings import Settings
from postprocess.shapes import Domain
from vgmpi.studio import ground, lighting
from vgmpi.studio import tone as display

DIRECTION = (0.55, 0.35, -1.0)  # in which the key's light travels


def ground_of(chosen: Settings, domain: Domain, pyramid: Any, rig: lighting.Rig) -> ground.Ground:
    """The ground that is asked for, lit."""
    picture, asked = chosen.picture, chosen.picture.floor
    given = picture.background
    photograph = picture.on_photograph
    kind, height, tile = (
        ground.TILES,
        0.0,
        0.12 * max(float(np.max(domain.size[:2])), 1e-9),
    )
    color, other, back = ground.COLOR, ground.COLOR, ground.BACKDROP
    if photograph:
        kind = ground.SHADOW if asked is not None else ground.NONE
    elif given == "none":
        kind = ground.NONE
    lean = 0.5
    if given is not None and not photograph:
        back, lean = tuple(video.background(given, 1, 1, Path("."))), 0.0
    if asked is not None:
        height = asked.height
        plain = asked.kind == "plain" or (asked.kind is None and asked.colour is not None)
        if asked.kind == "none":
            kind = ground.NONE
        elif plain or asked.squares is not None:
            kind = ground.SQUARES if asked.squares is not None else ground.TILES
            color, other = asked.colour or (0.85, 0.85, 0.85), asked.other
            tile = asked.squares or 0.0
        else:
            color = asked.colour or color
        if asked.tiles is not None:
            tile = asked.tiles
    elif kind == ground.TILES:
        tile = 0.12 * _round(float(np.max(domain.size[:2])) / 0.96)
    back = display.scene_linear(np.array(back, dtype=np.float64), chosen.toned)
    return ground.ground(
        kind, height, domain.low, domain.high, pyramid, rig,
        display.to_linear(np.array(color)), display.to_linear(np.array(other)), tile, back, lean,
    )  # fmt: skip


def _round(x: float) -> float:
    """A power of two near to x, so that tiles look alike in scenes of all sizes."""
    return 2.0 ** round(np.log2(max(x, 1e-9)))


def rig_of(chosen: Settings, folder: Path) -> lighting.Rig:
    """The lights that are asked for. folder: of render.toml."""
    light, wet = chosen.light, chosen.liquid
    around, surroundings, picture = wet.surroundings, None, None
    if around.picture is not None:
        found = video.photograph("liquid.surroundings.picture", folder / around.picture)
        picture = display.to_linear(found)
    elif "surroundings" in wet.model_fields_set:
        colors = (around.zenith, around.horizon, around.ground)
        surroundings = tuple(display.to_linear(np.array(c)) for c in colors)
    direction = DIRECTION if light is None or light.direction is None else light.direction
    strength = {}
    if light is not None:
        strength = {"key": light.key, "sky": light.sky, "width": light.width}
    highlight = wet.highlight / 2.0
    return lighting.rig(
        direction, **strength, highlight=highlight, surroundings=surroundings, picture=picture
    )
