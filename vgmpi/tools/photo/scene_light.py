"""Background and light of the scene: shadows are part of the one and tell the other."""

import logging
from typing import Any

import numpy as np

from vgmpi.gaussians.camera import Camera
from vgmpi.gaussians.cloud import GaussianCloud
from vgmpi.postprocess.studio import light_rig

from . import light_from_shadows
from .background_inpainting import inpaint_background, interpolate_background
from .body_sources import Guess
from .cast_shadows import cast_shadows
from .grabcut import MaskError
from .layout_config import LoadedLayout
from .light_from_shadows import ShadowLight
from .photograph import Photograph

log = logging.getLogger("vgmpi.tools.photo")

# [-] light on the floor under the usual light of the studio: by the key, and by the sky
KEY_LIGHT = float(np.mean(light_rig.KEY_COLOR))
SKY_LIGHT = float(0.5 * (0.93 * np.mean(light_rig.HORIZON) + 1.07 * np.mean(light_rig.ZENITH)))
FLOOR_LIGHT = 1.1  # [-] of both together, which is kept
DARKNESS = 0.55  # [-] part of it that shadows lack, where nothing else is known


def background_and_light(
    loaded: LoadedLayout,
    photo: Photograph,
    masks: list[np.ndarray],
    clouds: list[GaussianCloud],
    camera: Camera,
    guesses: list[Guess],
) -> tuple[np.ndarray, ShadowLight | None]:
    """Return the photograph without objects, and its light, None if nothing tells it.

    Args:
        loaded: Layout, which may give the light and may ask for a background without shadows.
        photo: Photograph.
        masks: Objects, each (height, width) bool.
        clouds: Bodies in their places above the floor z = 0.
        camera: Camera of the photograph.
        guesses: Guesses, to which the light is appended (in/out).
    """
    layout = loaded.layout
    airborne = [isinstance(obj.support, float) and obj.support > 0 for obj in layout.object]
    is_removed = layout.scene.shadows == "remove"
    light = _light_of_layout(loaded)
    if light is not None and not is_removed:
        return inpaint_background(photo.rgb, masks), light
    shadows = cast_shadows(photo.rgb, masks, airborne)
    if light is None and shadows.any():
        light = _fitted_light(photo, [*masks, shadows], masks, clouds, camera, guesses)
    if not is_removed:
        return inpaint_background(photo.rgb, masks), light
    log.info("shadows: %d pixels are removed with the objects", shadows.sum())
    return inpaint_background(photo.rgb, [*masks, shadows]), light


def render_keys(light: ShadowLight | None) -> dict[str, Any]:
    """Return the table [light] of render.toml, empty if no light is known.

    The floor is as bright as under the usual light.
    """
    if light is None:
        return {}
    key = light.darkness * FLOOR_LIGHT / (KEY_LIGHT * max(-light.direction[2], 0.15))
    sky = (1 - light.darkness) * FLOOR_LIGHT / SKY_LIGHT
    return {
        "direction": [round(c, 4) for c in light.direction],
        "width": light.width,
        "key": round(key, 3),
        "sky": round(sky, 3),
    }


def _light_of_layout(loaded: LoadedLayout) -> ShadowLight | None:
    """Return the light of the layout, None if it gives no direction."""
    table = loaded.layout.light
    if table.direction is None:
        return None
    length = float(np.linalg.norm(table.direction))
    x, y, z = (c / length for c in table.direction)
    width = light_rig.WIDTH if table.width is None else table.width
    darkness = DARKNESS if table.darkness is None else table.darkness
    return ShadowLight((x, y, z), width, darkness, 1.0)


def _fitted_light(
    photo: Photograph, removed: list[np.ndarray], masks: list[np.ndarray],
    clouds: list[GaussianCloud], camera: Camera, guesses: list[Guess],
) -> ShadowLight | None:  # fmt: skip
    """Return the light that the shadows of the photograph tell, and append it to the guesses.

    Args:
        photo: Photograph.
        removed: Objects and shadows, each (height, width) bool.
        masks: Objects, each (height, width) bool.
        clouds: Bodies in their places.
        camera: Camera of the photograph.
        guesses: Guesses (in/out).
    """
    try:
        lit = interpolate_background(photo.rgb, removed)
    except MaskError:  # nothing is left beside objects and shadows
        return None
    points = np.concatenate([cloud.x for cloud in clouds])
    light = light_from_shadows.fit_light(points, camera, photo.rgb, lit, masks)
    if light is None:
        log.info("light: the shadows tell no direction: the studio's usual light")
        return None
    share = f"explains {100 * light.explained:.0f} % of the shadows"
    vector = [round(c, 3) for c in light.direction]
    guesses += [
        (("light", "direction"), vector, f"right, away from the camera, up; {share}"),
        (("light", "width"), light.width, "tangent of its half width, from their rims"),
        (("light", "darkness"), round(light.darkness, 3), "part of the light that they lack"),
    ]
    log.info("light: travels along %s, half width %g, which %s", vector, light.width, share)
    return light
