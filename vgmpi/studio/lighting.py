"""Light of the studio: a key from far away, a sky, what the ground throws back, and its mirror
image.

Everything is linear. The key is a soft box; ambient light is gathered by cones over the hemisphere,
each with its own transmittance and the sky's or the ground's color.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.caching import cached
from vgmpi.studio.compiling import RAY
from vgmpi.studio.occlusion import wide_cone

KEY_COLOR = (1.0, 0.95, 0.88)
HORIZON, ZENITH = (0.80, 0.84, 0.90), (0.68, 0.80, 1.0)
BOUNCE = (0.66, 0.63, 0.58)
FILL = (-0.6, -0.5, 0.55)  # towards the dim soft box
KEY, SKY, WIDTH = 0.78, 0.58, 0.07


class Rig(NamedTuple):
    """Attributes:
    toward: (3,) unit vector to the key.
    key: (3,) its light on a surface that faces it.
    width: its half width (tangent).
    horizon, zenith: (3,) ambient light from there.
    bounce: (3,) ambient light from below.
    mirror_horizon, mirror_zenith, mirror_ground: (3,) what smooth surfaces mirror from there.
    fill: (3,) unit vector to a dim soft box that they mirror.
    boxes: (3,) brightness of the key's soft box, its core and the dim one.
    picture: (rows, columns, 3) of all directions to mirror instead; (1, 1, 3) for none.
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
    direction: np.ndarray, key: float = KEY, sky: float = SKY, width: float = WIDTH,
    highlight: float = 1.0, surroundings: tuple | None = None, picture: np.ndarray | None = None,
) -> Rig:  # fmt: skip
    """The studio's lights.

    Args:
        direction: (3,) in which the key's light travels.
        key: its strength, 1 for what makes a white surface white.
        sky: mean strength of the ambient light.
        width: half width of the key (tangent).
        highlight: factor on the soft boxes that are mirrored.
        surroundings: linear colors of zenith, horizon and ground that are mirrored.
        picture: linear, of all directions, mirrored instead.
    """
    toward = -np.asarray(direction, dtype=np.float64)
    toward /= np.linalg.norm(toward)
    fill = np.array(FILL) / np.linalg.norm(FILL)
    share = sky / SKY
    mirror = (
        np.array([0.16, 0.33, 0.62]) * 0.75 * share,
        np.array([0.80, 0.86, 0.93]) * 0.85 * share,
        np.array([0.46, 0.45, 0.43]) * share,
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


@cached(**RAY)
def smooth(a, b, x):
    """Hermite step from 0 at a to 1 at b."""
    t = min(max((x - a) / (b - a), 0.0), 1.0)
    return t * t * (3.0 - 2.0 * t)


@cached(**RAY)
def mirrored_sky(rig, d0, d1, d2, blur, out):
    """Light that a smooth surface mirrors from a direction, into out (3,).

    blur: angle over which it is averaged, so that no glint is narrower than a pixel.
    """
    rows = rig.picture.shape[0]
    if rows > 1:
        _look_up(rig.picture, d0, d1, d2, out)
    else:
        t = max(d2, 0.0) ** 0.55
        for m in range(3):
            out[m] = rig.mirror_horizon[m] + t * (rig.mirror_zenith[m] - rig.mirror_horizon[m])
    c = d0 * rig.toward[0] + d1 * rig.toward[1] + d2 * rig.toward[2]
    # soft boxes; a blurred one is as much dimmer as it is wider
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


@cached(**RAY)
def _box(angle, radius, edge, blur):
    """Share of a soft box that is seen at an angle from its middle."""
    wide = edge + blur
    t = smooth(radius + wide, radius - wide, angle)
    return t * radius * radius / (radius * radius + 0.6 * blur * blur)


@cached(**RAY)
def _look_up(picture, x, y, z, out):
    rows, columns = picture.shape[0], picture.shape[1]
    v = np.arccos(min(max(z, -1.0), 1.0)) / np.pi * rows - 0.5
    u = (np.arctan2(y, x) / (2.0 * np.pi) + 0.5) * columns - 0.5
    j, k = int(np.floor(v)), int(np.floor(u))
    fv, fu = v - j, u - k
    j0, j1 = min(max(j, 0), rows - 1), min(max(j + 1, 0), rows - 1)
    k0, k1 = k % columns, (k + 1) % columns
    for m in range(3):
        one = picture[j0, k0, m] + fu * (picture[j0, k1, m] - picture[j0, k0, m])
        two = picture[j1, k0, m] + fu * (picture[j1, k1, m] - picture[j1, k0, m])
        out[m] = one + fv * (two - one)


# cones over a hemisphere: around the normal, and a ring; shares of its cosine-weighted light
# (found against the open share of floors beside walls, in corners, and of balls)
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


@cached(**RAY)
def ambient(pyramid, rig, x, y, z, n0, n1, n2, floor, start, out):
    """Irradiance / pi of sky and ground on a surface, into out (3,); returns what is open, 0..1.

    x, y, z: point [m]. n0, n1, n2: unit normal. floor: height of the ground [m]. start: way [m]
    from which on things hide the sky.
    """
    if abs(n2) < 0.95:
        s = 1.0 / np.sqrt(n0 * n0 + n1 * n1)
        a0, a1, a2 = -n1 * s, n0 * s, 0.0
    else:
        s = 1.0 / np.sqrt(n1 * n1 + n2 * n2)
        a0, a1, a2 = 0.0, -n2 * s, n1 * s
    b0, b1, b2 = n1 * a2 - n2 * a1, n2 * a0 - n0 * a2, n0 * a1 - n1 * a0
    out[0] = out[1] = out[2] = 0.0
    free = 0.0
    for c in range(len(CONES)):
        u, v, w, weight = CONES[c, 0], CONES[c, 1], CONES[c, 2], CONES[c, 3]
        d0, d1, d2 = u * a0 + v * b0 + w * n0, u * a1 + v * b1 + w * n1, u * a2 + v * b2 + w * n2
        passes = weight * wide_cone(pyramid, x, y, z, d0, d1, d2, SPREAD, start)
        t = smooth(-0.25, 0.25, d2)
        up = max(d2, 0.0)
        for m in range(3):
            sky = rig.horizon[m] + up * (rig.zenith[m] - rig.horizon[m])
            out[m] += passes * (t * sky + (1.0 - t) * rig.bounce[m])
        free += passes
    return min(free, 1.0)
