"""Direction, width and strength of a photograph's light, from the shadows that objects throw.

The objects stand in their places when the light is sought, so that every direction predicts where
on the floor they throw shadows. That direction is taken whose shadows are most like the darkening
of the floor in the photograph, by least squares. A wide light is the mean of narrow ones.
"""

from typing import NamedTuple

import numpy as np
from scipy import ndimage

from vgmpi.gaussians.camera import Camera
from vgmpi.postprocess.studio import tone_mapping

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
