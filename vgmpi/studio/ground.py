"""The studio's ground and backdrop: a plane with faint joints, lit by a map, that fades far
away."""

from typing import NamedTuple

import numpy as np

from vgmpi.caching import cached
from vgmpi.studio.compiling import RAY
from vgmpi.studio.lighting import Rig, ambient, smooth
from vgmpi.studio.occlusion import EXTINCTION, Occlusion, cone

NONE, TILES, SQUARES, SHADOW = 0, 1, 2, 3  # kinds of ground
COLOR = (0.80, 0.79, 0.77)
BACKDROP = (0.90, 0.915, 0.93)
JOINT = 0.0009  # m, half width for tiles of 0.12 m
TEXELS = 240  # of its light along the longer side
AROUND = 0.35  # of the longer side of the domain, that its light is known around it


class Ground(NamedTuple):
    """Attributes:
    kind: NONE, TILES, SQUARES, or SHADOW: only its shadow is seen on the background.
    height: of the plane [m].
    light: (rows, columns, 3) light on it, along y and x.
    lower: (2,) corner of the light's map [m].
    texel: [m].
    far: (3,) light far away from everything.
    albedo, other: (3,) linear colors, of all and of every other square.
    tile: edge of tiles or squares [m], 0 for none.
    joint: half width of joints [m].
    middle: (2,) of the domain [m].
    fade: (2,) distances from the middle between which it fades into the backdrop [m].
    backdrop: (3,) linear color far away.
    lean: share by which the backdrop is darker straight up.
    """

    kind: int
    height: float
    light: np.ndarray
    lower: np.ndarray
    texel: float
    far: np.ndarray
    albedo: np.ndarray
    other: np.ndarray
    tile: float
    joint: float
    middle: np.ndarray
    fade: np.ndarray
    backdrop: np.ndarray
    lean: float


def ground(
    kind: int, height: float, low: np.ndarray, high: np.ndarray, pyramid: Occlusion, rig: Rig,
    albedo: np.ndarray, other: np.ndarray, tile: float, backdrop: np.ndarray, lean: float = 0.35,
    texels: int = TEXELS,
) -> Ground:  # fmt: skip
    """The ground with its light, but for what the liquid takes from it (`tint`).

    Args:
        kind: NONE, TILES, SQUARES or SHADOW.
        height: of the plane [m].
        low: (3,) lower corner of the domain [m].
        high: (3,) upper corner of the domain [m].
        pyramid: what hides light.
        rig: the lights.
        albedo: (3,) linear color.
        other: (3,) of every other square.
        tile: edge of tiles or squares [m].
        backdrop: (3,) linear color far away.
        lean: share by which the backdrop is darker straight up.
        texels: of the light along the longer side.
    """
    size = high[:2] - low[:2]
    longest = float(size.max())
    margin = AROUND * longest
    texel = (longest + 2 * margin) / texels
    lower = low[:2] - margin
    shape = tuple(np.maximum(((size + 2 * margin) / texel).astype(int), 2)[::-1])
    light = np.zeros((*shape, 3), np.float32)
    far = np.array([1.0, 1.0, 1.0])
    if kind != NONE:
        _light(light, pyramid, rig, height, lower, texel)
        far = rig.key * max(rig.toward[2], 0.0) + 0.5 * (rig.horizon + rig.zenith)
    middle = 0.5 * (low[:2] + high[:2])
    fade = np.array([1.2, 4.2]) * longest
    joint = JOINT * tile / 0.12
    return Ground(
        kind, height, light, lower, texel, far, np.asarray(albedo, float), np.asarray(other, float),
        tile, joint, middle, fade, np.asarray(backdrop, float), lean,
    )  # fmt: skip


def closed(plane: Ground) -> Ground:
    """The same, its light led over to that of far away at the map's rim, so that there is no
    seam."""
    light = plane.light
    rim = np.concatenate([light[0], light[-1], light[:, 0], light[:, -1]])
    far = np.percentile(rim, 90, axis=0) if plane.kind != NONE else plane.far
    rows, columns = np.indices(light.shape[:2])
    away = np.minimum(
        np.minimum(columns, light.shape[1] - 1 - columns),
        np.minimum(rows, light.shape[0] - 1 - rows),
    )
    inner = np.clip(away / (0.12 * min(light.shape[:2])), 0, 1)[..., None] ** 2
    led = (light * inner + far * (1 - inner)).astype(np.float32)
    return plane._replace(light=led, far=np.asarray(far, dtype=np.float64))


def since(plane: Ground, before: Ground) -> Ground:
    """The ground with the shadows that have come since another moment, and with no other.

    Args:
        plane: of now.
        before: of the other moment, with a map of the same shape.
    """
    part = np.minimum((plane.light / plane.far) / np.maximum(before.light / before.far, 1e-3), 1)
    return plane._replace(light=(part * plane.far).astype(np.float32))


@cached(nogil=True, error_model="numpy")
def _light(light, pyramid, rig, height, lower, texel):
    color = np.zeros(3)
    for j in range(light.shape[0]):
        for k in range(light.shape[1]):
            x, y = lower[0] + (k + 0.5) * texel, lower[1] + (j + 0.5) * texel
            start = 1.2 * pyramid.cell
            ambient(pyramid, rig, x, y, height, 0.0, 0.0, 1.0, height, start, color)
            key = cone(
                pyramid, x, y, height, rig.toward[0], rig.toward[1], rig.toward[2], rig.width,
                start, EXTINCTION,
            )  # fmt: skip
            for m in range(3):
                light[j, k, m] = rig.key[m] * max(rig.toward[2], 0.0) * key + color[m]


@cached(**RAY)
def _hash(i, j):
    h = np.uint32(i * 374761393 + j * 668265263)
    h = (h ^ (h >> np.uint32(13))) * np.uint32(1274126177)
    return float((h ^ (h >> np.uint32(16))) & np.uint32(0xFFFFFF)) / 16777215.0


@cached(**RAY)
def _noise(x, y):
    i, j = int(np.floor(x)), int(np.floor(y))
    a, b = x - i, y - j
    a, b = a * a * (3 - 2 * a), b * b * (3 - 2 * b)
    u = _hash(i, j) + a * (_hash(i + 1, j) - _hash(i, j))
    v = _hash(i, j + 1) + a * (_hash(i + 1, j + 1) - _hash(i, j + 1))
    return u + b * (v - u)


@cached(**RAY)
def ground_light(plane, x, y, out):
    """Light on the ground at x, y [m], into out (3,)."""
    u, v = (x - plane.lower[0]) / plane.texel - 0.5, (y - plane.lower[1]) / plane.texel - 0.5
    rows, columns = plane.light.shape[0], plane.light.shape[1]
    if u >= 0 and v >= 0 and u < columns - 1 and v < rows - 1:
        k, j = int(u), int(v)
        a, b = u - k, v - j
        for m in range(3):
            one = plane.light[j, k, m] + a * (plane.light[j, k + 1, m] - plane.light[j, k, m])
            two = plane.light[j + 1, k, m] + a * (
                plane.light[j + 1, k + 1, m] - plane.light[j + 1, k, m]
            )
            out[m] = one + b * (two - one)
    else:
        for m in range(3):
            out[m] = plane.far[m]


@cached(**RAY)
def _line(at, side, half, wide):
    """Share of a pixel `wide` that a joint at multiples of `side` covers (box filter)."""
    f = abs(at / side - np.round(at / side)) * side
    low, high = max(f - 0.5 * wide, -half), min(f + 0.5 * wide, half)
    return max(high - low, 0.0) / wide


@cached(**RAY)
def ground_color(plane, x, y, wide, out):
    """Light that comes from the ground at x, y [m], into out (3,); wide: of a pixel there [m]."""
    ground_light(plane, x, y, out)
    if plane.kind == SQUARES:
        odd = float((int(np.floor(x / plane.tile)) + int(np.floor(y / plane.tile))) & 1)
        clear = min(max(2.0 - 2.0 * wide / plane.tile, 0.0), 1.0)
        share = 0.5 + clear * (odd - 0.5)
        for m in range(3):
            out[m] *= plane.albedo[m] + share * (plane.other[m] - plane.albedo[m])
    else:
        texture = 1.0
        if plane.tile > 0.0:
            w = max(wide, 1e-6)
            line = _line(x, plane.tile, plane.joint, w)
            line = max(line, _line(y, plane.tile, plane.joint, w))
            tile = _hash(int(np.floor(x / plane.tile)), int(np.floor(y / plane.tile))) - 0.5
            fine = 0.12 / plane.tile
            n = (
                0.5 * _noise(90.0 * x * fine, 90.0 * y * fine)
                + 0.5 * _noise(23.0 * x * fine, 23.0 * y * fine)
                - 0.5
            )
            n *= min(1.0, 0.004 / (w * fine))
            tile *= min(1.0, 0.2 * plane.tile / w)
            texture = (1.0 - 0.16 * line) * (1.0 + 0.05 * tile) * (1.0 + 0.05 * n)
        for m in range(3):
            out[m] *= plane.albedo[m] * texture
    r = np.sqrt((x - plane.middle[0]) ** 2 + (y - plane.middle[1]) ** 2)
    fade = smooth(plane.fade[0], plane.fade[1], r)
    if fade > 0.0:
        for m in range(3):
            out[m] += fade * (plane.backdrop[m] - out[m])


@cached(**RAY)
def backdrop(plane, up, out):
    """Light from behind everything in a direction whose unit vector rises by `up`, into out
    (3,)."""
    t = smooth(0.0, 0.6, up)
    for m in range(3):
        out[m] = plane.backdrop[m] * (1.0 - plane.lean * t)
