"""Background and light of the scene: shadows are part of the one and tell the other.

A shadow darkens what it falls on by one factor in all colors. Pixels that are darker than the lit
surroundings, in the same hue, and that touch an object are its shadow. Objects in the air throw
shadows that touch nothing: compact ones of their size count, too.

The objects stand in their places when the light is sought, so that every direction predicts where
on the floor they throw shadows. That direction is taken whose shadows are most like the darkening
of the floor in the photograph, by least squares. A wide light is the mean of narrow ones.
"""

import logging
from typing import Any, NamedTuple

import numpy as np
from scipy import ndimage

from vgmpi.gaussians.camera import Camera
from vgmpi.gaussians.cloud import GaussianCloud
from vgmpi.postprocess.studio import light_rig, tone_mapping

from .background_inpainting import inpaint_background, interpolate_background
from .body_sources import Guess
from .grabcut import MaskError
from .layout_config import LoadedLayout
from .photograph import Photograph

REDUCTION = 3  # [pixels] pixels of the photograph across a pixel of the search
DARKEST_LIGHT = 3e-4  # [-] linear light of a floor that is all but black
MAX_POINTS = 20_000  # upper limit of the points of all objects
MIN_SHADOW = 40  # [pixels of the search] smallest area of shadows from which a light is found
MIN_EXPLAINED = 0.4  # [-] least part of the darkening that the predicted shadows explain
ELEVATIONS = np.arange(20.0, 86.0, 10.0)  # [degrees] of the first search
AZIMUTHS = np.arange(0.0, 360.0, 10.0)  # [degrees] of the first search
STEPS = 5.0, 2.5, 1.0  # [degrees] of the refinements
WIDTHS = 0.02, 0.05, 0.1, 0.2, 0.35  # [-] half widths of the light (tangent) that are tried
WIDE_GAIN = 0.01  # [-] a wider light must explain so much more
# [-] height and width over which the lit surroundings are averaged, of the longer side: tables and
# floors change along the rows less than towards the horizon
REACH = (0.012, 0.15)
ITERATIONS = 6  # the surroundings are averaged this often without what is darker
DARKENING = 0.22  # [-] natural logarithm of the weakest darkening that counts
HUE_TOLERANCE = 0.2  # [-] by how much the logarithms of the three colors may differ
SMOOTHING = 1.5  # [pixels] smoothing of the grain
TOUCH = 4  # [pixels] a shadow begins at most this far from its object
PENUMBRA = 4  # [pixels] a shadow is widened by this
MAX_AREA = 1.5  # [-] darker regions that exceed all objects by this factor are no shadow
MIN_AIRBORNE_AREA = 0.1  # [-] area of the shadow of an object in the air, relative to the object
MIN_COMPACTNESS = 0.45  # [-] area of such a shadow relative to its box
log = logging.getLogger("vgmpi.tools.photo")
# [-] light on the floor under the usual light of the studio: by the key, and by the sky
KEY_LIGHT = float(np.mean(light_rig.KEY_COLOR))
SKY_LIGHT = float(0.5 * (0.93 * np.mean(light_rig.HORIZON) + 1.07 * np.mean(light_rig.ZENITH)))
FLOOR_LIGHT = 1.1  # [-] of both together, which is kept
DARKNESS = 0.55  # [-] part of it that shadows lack, where nothing else is known


class ShadowLight(NamedTuple):
    """Light of a photograph, in upright axes: x to the right, y away from the camera, z up."""

    direction: tuple[float, float, float]  # unit vector of travel
    width: float  # [-] half width (tangent)
    darkness: float  # [-] part of the light on the floor that the shadows lack
    explained: float  # [-] part of the darkening that the light explains


def fit_light(
    points: np.ndarray, camera: Camera, rgb: np.ndarray, lit: np.ndarray, masks: list[np.ndarray]
) -> ShadowLight | None:
    """Return the light of a photograph, None if its shadows tell none.

    Args:
        points: Points on the objects above the floor z = 0, shape (n, 3) [m].
        camera: Camera of the photograph.
        rgb: Photograph, shape (height, width, 3) uint8.
        lit: The photograph without objects and shadows, shape (height, width, 3) uint8.
        masks: Objects, each (height, width) bool.
    """
    points = points[:: max(1, len(points) // MAX_POINTS)]
    search = _Search(points[points[:, 2] > 0], camera, rgb, lit, masks)
    if (search.darkening > 0.1).sum() < MIN_SHADOW:
        return None
    angles = [(a, e) for e in ELEVATIONS for a in AZIMUTHS]
    best = max(angles, key=lambda angle: search.fit(angle, 0.0)[0])
    for step in STEPS:
        offsets = step * np.arange(-2, 3)
        candidates = [(best[0] + a, min(best[1] + e, 89.0)) for e in offsets for a in offsets]
        best = max(candidates, key=lambda angle: search.fit(angle, 0.0)[0])
    width = WIDTHS[0]
    for wider in WIDTHS[1:]:
        if search.fit(best, wider)[0] > search.fit(best, width)[0] + WIDE_GAIN:
            width = wider
    explained, darkness = search.fit(best, width)
    if explained < MIN_EXPLAINED:
        return None
    x, y, z = (float(c) for c in direction(best))
    return ShadowLight((x, y, z), width, float(np.clip(darkness, 0.05, 0.95)), explained)


def direction(angle: tuple[float, float]) -> np.ndarray:
    """Return the unit vector of travel (3,) of azimuth and elevation [degrees].

    The azimuth is that of the shadows: 0 to the right, 90 away from the camera.
    """
    azimuth, elevation = np.radians(angle)
    level = np.cos(elevation)
    return np.array([level * np.cos(azimuth), level * np.sin(azimuth), -np.sin(elevation)])


class _Search:
    """Darkening of the floor in the photograph, and predictions of it.

    Args: those of fit_light.
    """

    def __init__(self, points, camera, rgb, lit, masks):
        self.points, self.camera = points, camera
        self.shape = (camera.height // REDUCTION, camera.width // REDUCTION)
        bright, dark = (
            tone_mapping.to_linear(_reduced(p.mean(axis=-1), self.shape) / 255) for p in (lit, rgb)
        )
        hidden = _reduced(np.logical_or.reduce(masks).astype(np.float64), self.shape) > 0
        up = camera.world_to_camera[:3, 2]
        row = (np.arange(self.shape[0]) + 0.5) * REDUCTION
        sinks = up[1] * (row - camera.cy) / camera.fy + up[2] < 0
        self.floor = sinks[:, None] & ~hidden
        darkening = 1 - dark / np.maximum(bright, DARKEST_LIGHT)
        self.darkening = np.where(self.floor, np.clip(darkening, 0, 1), 0.0)
        self.total = float((self.darkening**2).sum())

    def fit(self, angle: tuple[float, float], width: float) -> tuple[float, float]:
        """Return the explained part of the darkening and the darkness of a light."""
        shadow = np.where(self.floor, self._shadow(angle, width), 0.0)
        overlap, norm = float((shadow * self.darkening).sum()), float((shadow**2).sum())
        if norm == 0 or self.total == 0:
            return 0.0, 0.0
        return overlap**2 / (norm * self.total), overlap / norm

    def _shadow(self, angle: tuple[float, float], width: float) -> np.ndarray:
        """Return the shaded part of the light for each pixel of the search."""
        travel = direction(angle)
        if width == 0:
            return self._narrow_shadow(travel)
        across = np.cross(travel, (0.0, 1.0, 0.0) if abs(travel[1]) < 0.9 else (1.0, 0.0, 0.0))
        across /= np.linalg.norm(across)
        other = np.cross(travel, across)
        parts = []
        for radius, count in ((0.0, 1), (0.6, 6), (0.95, 8)):
            for turn in 2 * np.pi * np.arange(count) / count:
                offset = radius * width * (np.cos(turn) * across + np.sin(turn) * other)
                parts.append(self._narrow_shadow(travel + offset))
        return np.mean(parts, axis=0)

    def _narrow_shadow(self, travel: np.ndarray) -> np.ndarray:
        """Return 1 where a light without width is shaded, else 0, shape of the search."""
        if travel[2] > -0.02:
            return np.zeros(self.shape)
        on_floor = self.points - travel * (self.points[:, 2:] / travel[2])
        pixels, depth = self.camera.pixels(on_floor)
        pixels = pixels[depth > self.camera.near_plane]
        column, row = np.floor(pixels / REDUCTION).astype(int).T
        inside = (column >= 0) & (row >= 0) & (column < self.shape[1]) & (row < self.shape[0])
        hit = np.zeros(self.shape, bool)
        hit[row[inside], column[inside]] = True
        return ndimage.binary_closing(hit, iterations=2).astype(np.float64)


def _reduced(picture: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Return the means of a picture (height, width) over squares, of a shape (rows, columns)."""
    rows, columns = shape
    cut = picture[: rows * REDUCTION, : columns * REDUCTION]
    return cut.reshape(rows, REDUCTION, columns, REDUCTION).mean(axis=(1, 3))


def cast_shadows(rgb: np.ndarray, masks: list[np.ndarray], airborne: list[bool]) -> np.ndarray:
    """Return the pixels in the shadows of objects, (height, width) bool.

    Args:
        rgb: Photograph, shape (height, width, 3) uint8.
        masks: Objects, each (height, width) bool.
        airborne: Whether each object is in the air.
    """
    objects = np.logical_or.reduce(masks)
    log_color = np.log(rgb.astype(np.float64) + 2.0)
    smooth = ndimage.gaussian_filter(log_color, (SMOOTHING, SMOOTHING, 0))
    width = [part * max(objects.shape) for part in REACH]
    lit = ~ndimage.binary_dilation(objects, iterations=2)
    for _ in range(ITERATIONS):
        weight = ndimage.gaussian_filter(lit.astype(np.float64), width)
        mean = ndimage.gaussian_filter(lit[..., None] * smooth, (*width, 0))
        difference = smooth - mean / np.maximum(weight, 1e-9)[..., None]
        lit = lit & (difference.mean(axis=-1) > -DARKENING / 2)
    dark = difference.mean(axis=-1) < -DARKENING
    same_hue = np.ptp(difference, axis=-1) < HUE_TOLERANCE
    candidates = ndimage.binary_opening(dark & same_hue & ~objects, iterations=2)
    return _belonging(candidates, masks, airborne) & ~objects


def _belonging(candidates: np.ndarray, masks: list[np.ndarray], airborne: list[bool]) -> np.ndarray:
    """Return the regions that touch an object, or may be the shadow of one in the air."""
    label, count = ndimage.label(candidates)
    if not count:
        return candidates
    area = ndimage.sum_labels(candidates, label, np.arange(1, count + 1))
    touch = ndimage.binary_dilation(np.logical_or.reduce(masks), iterations=TOUCH)
    touching = np.isin(np.arange(1, count + 1), np.unique(label[touch & candidates]))
    sizes = [mask.sum() for mask, is_airborne in zip(masks, airborne) if is_airborne]
    boxes = [
        (rows.stop - rows.start) * (columns.stop - columns.start)
        for rows, columns in ndimage.find_objects(label)
    ]
    compact = area > MIN_COMPACTNESS * np.array(boxes)
    if sizes:
        touching |= compact & (area > MIN_AIRBORNE_AREA * min(sizes))
    touching &= area < MAX_AREA * sum(mask.sum() for mask in masks)
    shadow = np.isin(label, 1 + np.flatnonzero(touching))
    return ndimage.binary_dilation(shadow, iterations=PENUMBRA) if shadow.any() else shadow


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
    light = fit_light(points, camera, photo.rgb, lit, masks)
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
