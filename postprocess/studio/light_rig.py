"""Lights of the studio: a distant key, a sky, bounce light of the ground, and reflections of these.

Everything is linear. The key is a soft box; ambient light is gathered by cones over the hemisphere,
each with its own transmittance and the sky's or the ground's color.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from vgmpi.runtime.compile_cache import njit_cached

from .compile_options import LEAF, RAY
from .cone_occlusion import wide_cone

KEY_COLOR = (1.0, 0.95, 0.88)
HORIZON, ZENITH = (0.80, 0.84, 0.90), (0.68, 0.80, 1.0)
BOUNCE = (0.66, 0.63, 0.58)
FILL = (-0.6, -0.5, 0.55)  # direction towards the dim soft box
KEY, SKY, WIDTH = 0.78, 0.58, 0.07


class Rig(NamedTuple):
    """Lights of the studio.

    Attributes:
        toward: Unit vector to the key, shape (3,).
        key: Light of the key on a surface that faces it, shape (3,).
        width: Half width of the key (tangent).
        horizon, zenith: Ambient light from there, shape (3,).
        bounce: Ambient light from below, shape (3,).
        mirror_horizon, mirror_zenith, mirror_ground: Light that smooth surfaces reflect from there,
            shape (3,).
        fill: Unit vector to a dim soft box in reflections, shape (3,).
        boxes: Brightness of the key's soft box, its core and the dim one, shape (3,).
        picture: Environment map to reflect instead, shape (rows, columns, 3); (1, 1, 3) for none.
    """

    toward: np.ndarray
    key: np.ndarray
    width: float
    horizon: np.ndarray
    zenith: np.ndarray
    bounce: np.ndarray
    mirror_horizon: np.ndarray
    mirror_zenith: np.ndarray
    mirror_ground: np.ndarray
    fill: np.ndarray
    boxes: np.ndarray
    picture: np.ndarray


def rig(
    direction: ArrayLike, key: float = KEY, sky: float = SKY, width: float = WIDTH,
    highlight: float = 1.0, surroundings: tuple | None = None, picture: np.ndarray | None = None,
) -> Rig:  # fmt: skip
    """Return the lights of the studio.

    Args:
        direction: Direction in which the key's light travels, shape (3,).
        key: Strength of the key; 1 makes a white surface white.
        sky: Mean strength of the ambient light.
        width: Half width of the key (tangent).
        highlight: Factor on the reflected soft boxes.
        surroundings: Linear colors of zenith, horizon and ground in reflections.
        picture: Linear environment map, reflected instead.
    """
    toward = -np.asarray(direction, dtype=np.float64)
    toward /= np.linalg.norm(toward)
    fill = np.array(FILL) / np.linalg.norm(FILL)
    strength = sky / SKY
    mirror = (
        np.array([0.16, 0.33, 0.62]) * 0.75 * strength,
        np.array([0.80, 0.86, 0.93]) * 0.85 * strength,
        np.array([0.46, 0.45, 0.43]) * strength,
    )
    zenith, horizon, ground = (np.asarray(c, dtype=np.float64) for c in surroundings or mirror)
    if picture is None:
        picture = np.zeros((1, 1, 3), np.float32)
    return Rig(
        toward, np.array(KEY_COLOR) * key, width, np.array(HORIZON) * 0.93 * sky,
        np.array(ZENITH) * 1.07 * sky, np.array(BOUNCE) * 0.72 * sky * (0.4 + 0.6 * key / KEY),
        horizon, zenith, ground, fill, np.array([2.2, 14.0, 0.55]) * highlight,
        np.ascontiguousarray(picture, dtype=np.float32),
    )  # fmt: skip


@njit_cached(**LEAF)
def smooth(a, b, x):
    """Return the Hermite step from 0 at a to 1 at b."""
    t = min(max((x - a) / (b - a), 0.0), 1.0)
    return t * t * (3.0 - 2.0 * t)


@njit_cached(**RAY)
def mirrored_sky(rig, d0, d1, d2, blur, out):
    """Write the light that a smooth surface reflects from a direction to out.

    Args:
        rig: The lights.
        d0, d1, d2: Unit direction.
        blur: Angle of the average, so that no glint is narrower than a pixel.
        out: (out) Light, shape (3,).
    """
    rows = rig.picture.shape[0]
    if rows > 1:
        _look_up(rig.picture, d0, d1, d2, out)
    else:
        t = max(d2, 0.0) ** 0.55
        for m in range(3):
            out[m] = rig.mirror_horizon[m] + t * (rig.mirror_zenith[m] - rig.mirror_horizon[m])
    c = d0 * rig.toward[0] + d1 * rig.toward[1] + d2 * rig.toward[2]
    # soft boxes keep their energy when blurred: wider ones are dimmer
    angle = np.arccos(min(max(c, -1.0), 1.0))
    key = rig.boxes[0] * _box(angle, 0.36, 0.09, blur) + rig.boxes[1] * _box(
        angle, 0.068, 0.016, blur
    )
    c = d0 * rig.fill[0] + d1 * rig.fill[1] + d2 * rig.fill[2]
    fill = rig.boxes[2] * _box(np.arccos(min(max(c, -1.0), 1.0)), 0.50, 0.13, blur)
    for m in range(3):
        out[m] += key * rig.key[m] + fill
    if d2 < 0.0 and rows == 1:
        g = min(1.0, -6.0 * d2)
        for m in range(3):
            out[m] += g * (rig.mirror_ground[m] - out[m])


@njit_cached(**RAY)
def _box(angle, radius, edge, blur):
    """Return the visible fraction of a soft box at an angle from its center."""
    width = edge + blur
    t = smooth(radius + width, radius - width, angle)
    return t * radius * radius / (radius * radius + 0.6 * blur * blur)


@njit_cached(**RAY)
def _look_up(picture, x, y, z, out):
    """Write the color of an environment map in a unit direction to out (3,)."""
    rows, columns = picture.shape[0], picture.shape[1]
    v = np.arccos(min(max(z, -1.0), 1.0)) / np.pi * rows - 0.5
    u = (np.arctan2(y, x) / (2.0 * np.pi) + 0.5) * columns - 0.5
    j, k = int(np.floor(v)), int(np.floor(u))
    fv, fu = v - j, u - k
    j0, j1 = min(max(j, 0), rows - 1), min(max(j + 1, 0), rows - 1)
    k0, k1 = k % columns, (k + 1) % columns
    for m in range(3):
        upper = picture[j0, k0, m] + fu * (picture[j0, k1, m] - picture[j0, k0, m])
        lower = picture[j1, k0, m] + fu * (picture[j1, k1, m] - picture[j1, k0, m])
        out[m] = upper + fv * (lower - upper)


# cones over a hemisphere: one around the normal and a ring, with cosine weights (fitted to the open
# fraction of floors beside walls, in corners, and of spheres)
RING = 8
_TILT, _UPRIGHT = np.radians(38.025), 0.11
CONES = np.array(
    [[0.0, 0.0, 1.0, _UPRIGHT]]
    + [
        [np.sin(_TILT) * np.cos(a), np.sin(_TILT) * np.sin(a), np.cos(_TILT), (1 - _UPRIGHT) / RING]
        for a in 2 * np.pi * (np.arange(RING) + 0.25) / RING
    ]
)
SPREAD = 0.4156  # half width of these cones (tangent)


@njit_cached(**RAY)
def ambient(pyramid, rig, x, y, z, n0, n1, n2, start, out):
    """Write the irradiance / pi of sky and ground on a surface to out.

    Args:
        pyramid: Occlusion pyramid.
        rig: The lights.
        x, y, z: Point [m].
        n0, n1, n2: Unit normal.
        start: Distance from which on objects occlude the sky [m].
        out: (out) Light, shape (3,).

    Returns:
        Open fraction of the hemisphere, 0..1.
    """
    if abs(n2) < 0.95:
        s = 1.0 / np.sqrt(n0 * n0 + n1 * n1)
        a0, a1, a2 = -n1 * s, n0 * s, 0.0
    else:
        s = 1.0 / np.sqrt(n1 * n1 + n2 * n2)
        a0, a1, a2 = 0.0, -n2 * s, n1 * s
    b0, b1, b2 = n1 * a2 - n2 * a1, n2 * a0 - n0 * a2, n0 * a1 - n1 * a0
    out[0] = out[1] = out[2] = 0.0
    openness = 0.0
    for c in range(len(CONES)):
        u, v, w, weight = CONES[c, 0], CONES[c, 1], CONES[c, 2], CONES[c, 3]
        d0, d1, d2 = u * a0 + v * b0 + w * n0, u * a1 + v * b1 + w * n1, u * a2 + v * b2 + w * n2
        transmittance = weight * wide_cone(pyramid, x, y, z, d0, d1, d2, SPREAD, start)
        t = smooth(-0.25, 0.25, d2)
        rise = max(d2, 0.0)
        for m in range(3):
            sky = rig.horizon[m] + rise * (rig.zenith[m] - rig.horizon[m])
            out[m] += transmittance * (t * sky + (1.0 - t) * rig.bounce[m])
        openness += transmittance
    return min(openness, 1.0)
