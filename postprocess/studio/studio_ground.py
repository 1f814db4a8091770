"""Ground and backdrop of the studio: a plane with faint joints, a light map and a distant fade."""

from typing import NamedTuple

import numpy as np

from vgmpi.runtime.compile_cache import njit_cached

from .compile_options import KERNEL, RAY
from .cone_occlusion import EXTINCTION, Occlusion, cone
from .light_rig import Rig, ambient, smooth

NONE, TILES, SQUARES, SHADOW = 0, 1, 2, 3  # kinds of ground
COLOR = (0.80, 0.79, 0.77)
BACKDROP = (0.90, 0.915, 0.93)
JOINT = 0.0009  # [m] half width of joints for tiles of 0.12 m
TEXELS = 240  # [texels] of the light map along the longer side
MAP_MARGIN = 0.35  # [longer sides of the domain] margin of the light map around it


class Ground(NamedTuple):
    """Ground plane with its light map and the backdrop.

    Attributes:
        kind: NONE, TILES, SQUARES, or SHADOW: only its shadow shows on the background.
        height: Height of the plane [m].
        light: Light on it along y and x, shape (rows, columns, 3).
        lower: Corner of the light map, shape (2,) [m].
        texel: Side of a texel [m].
        far_light: Light far away from everything, shape (3,).
        albedo, other: Linear colors of all and of every other square, shape (3,).
        tile: Side of tiles or squares [m], 0 for none.
        joint: Half width of joints [m].
        middle: Center of the domain, shape (2,) [m].
        fade: Distances from the center between which the ground fades into the backdrop, (2,) [m].
        backdrop: Linear color far away, shape (3,).
        lean: Fraction by which the backdrop is darker straight up.
    """

    kind: int
    height: float
    light: np.ndarray
    lower: np.ndarray
    texel: float
    far_light: np.ndarray
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
    """Return the ground with its light, without absorption (deferred_shading.tint_ground).

    Args:
        kind: NONE, TILES, SQUARES or SHADOW.
        height: Height of the plane [m].
        low: Lower corner of the domain, shape (3,) [m].
        high: Upper corner of the domain, shape (3,) [m].
        pyramid: Occlusion pyramid.
        rig: The lights.
        albedo: Linear color, shape (3,).
        other: Linear color of every other square, shape (3,).
        tile: Side of tiles or squares [m].
        backdrop: Linear color far away, shape (3,).
        lean: Fraction by which the backdrop is darker straight up.
        texels: Texels of the light map along the longer side.
    """
    size = high[:2] - low[:2]
    longest = float(size.max())
    margin = MAP_MARGIN * longest
    texel = (longest + 2 * margin) / texels
    lower = low[:2] - margin
    shape = tuple(np.maximum(((size + 2 * margin) / texel).astype(int), 2)[::-1])
    light = np.zeros((*shape, 3), np.float32)
    distant = np.array([1.0, 1.0, 1.0])
    if kind != NONE:
        _light(light, pyramid, rig, height, lower, texel)
        distant = rig.key * max(rig.toward[2], 0.0) + 0.5 * (rig.horizon + rig.zenith)
    middle = 0.5 * (low[:2] + high[:2])
    fade = np.array([1.2, 4.2]) * longest
    joint = JOINT * tile / 0.12
    return Ground(
        kind, height, light, lower, texel, distant, np.asarray(albedo, float),
        np.asarray(other, float), tile, joint, middle, fade, np.asarray(backdrop, float), lean,
    )  # fmt: skip


def close_rim(plane: Ground) -> Ground:
    """Return the ground with its light blended to the far light at the map's rim."""
    light = plane.light
    rim = np.concatenate([light[0], light[-1], light[:, 0], light[:, -1]])
    far_light = np.percentile(rim, 90, axis=0) if plane.kind != NONE else plane.far_light
    rows, columns = np.indices(light.shape[:2])
    distance = np.minimum(
        np.minimum(columns, light.shape[1] - 1 - columns),
        np.minimum(rows, light.shape[0] - 1 - rows),
    )
    weight = np.clip(distance / (0.12 * min(light.shape[:2])), 0, 1)[..., None] ** 2
    blended = (light * weight + far_light * (1 - weight)).astype(np.float32)
    return plane._replace(light=blended, far_light=np.asarray(far_light, dtype=np.float64))


def new_shadows(plane: Ground, before: Ground) -> Ground:
    """Return the ground with only those shadows that are new since another moment.

    Args:
        plane: Ground of the current moment.
        before: Ground of the other moment, with a light map of the same shape.
    """
    ratio = np.minimum(
        (plane.light / plane.far_light) / np.maximum(before.light / before.far_light, 1e-3), 1
    )
    return plane._replace(light=(ratio * plane.far_light).astype(np.float32))


@njit_cached(**KERNEL)
def _light(light, pyramid, rig, height, lower, texel):
    """Fill in the light map."""
    color = np.zeros(3)
    for j in range(light.shape[0]):
        for k in range(light.shape[1]):
            x, y = lower[0] + (k + 0.5) * texel, lower[1] + (j + 0.5) * texel
            start = 1.2 * pyramid.cell
            ambient(pyramid, rig, x, y, height, 0.0, 0.0, 1.0, start, color)
            key = cone(
                pyramid, x, y, height, rig.toward[0], rig.toward[1], rig.toward[2], rig.width,
                start, EXTINCTION,
            )  # fmt: skip
            for m in range(3):
                light[j, k, m] = rig.key[m] * max(rig.toward[2], 0.0) * key + color[m]


@njit_cached(**RAY)
def _hash(i, j):
    """Return a pseudo-random number in 0..1 of two integers."""
    h = np.uint32(i * 374761393 + j * 668265263)
    h = (h ^ (h >> np.uint32(13))) * np.uint32(1274126177)
    return float((h ^ (h >> np.uint32(16))) & np.uint32(0xFFFFFF)) / 16777215.0


@njit_cached(**RAY)
def _noise(x, y):
    """Return smooth value noise in 0..1 at a point."""
    i, j = int(np.floor(x)), int(np.floor(y))
    a, b = x - i, y - j
    a, b = a * a * (3 - 2 * a), b * b * (3 - 2 * b)
    u = _hash(i, j) + a * (_hash(i + 1, j) - _hash(i, j))
    v = _hash(i, j + 1) + a * (_hash(i + 1, j + 1) - _hash(i, j + 1))
    return u + b * (v - u)


@njit_cached(**RAY)
def ground_light(plane, x, y, out):
    """Write the light on the ground to out.

    Args:
        plane: The ground.
        x, y: Point [m].
        out: (out) Light, shape (3,).
    """
    u, v = (x - plane.lower[0]) / plane.texel - 0.5, (y - plane.lower[1]) / plane.texel - 0.5
    rows, columns = plane.light.shape[0], plane.light.shape[1]
    if u >= 0 and v >= 0 and u < columns - 1 and v < rows - 1:
        k, j = int(u), int(v)
        a, b = u - k, v - j
        for m in range(3):
            lower_row = plane.light[j, k, m] + a * (plane.light[j, k + 1, m] - plane.light[j, k, m])
            upper_row = plane.light[j + 1, k, m] + a * (
                plane.light[j + 1, k + 1, m] - plane.light[j + 1, k, m]
            )
            out[m] = lower_row + b * (upper_row - lower_row)
    else:
        for m in range(3):
            out[m] = plane.far_light[m]


@njit_cached(**RAY)
def _line(position, side, half, width):
    """Return the fraction of a pixel of `width` [m] that a joint at multiples of `side` covers."""
    f = abs(position / side - np.round(position / side)) * side
    low, high = max(f - 0.5 * width, -half), min(f + 0.5 * width, half)
    return max(high - low, 0.0) / width


@njit_cached(**RAY)
def ground_color(plane, x, y, width, out):
    """Write the light that comes from the ground to out.

    Args:
        plane: The ground.
        x, y: Point [m].
        width: Width of a pixel at the point [m].
        out: (out) Light, shape (3,).
    """
    ground_light(plane, x, y, out)
    if plane.kind == SQUARES:
        odd = float((int(np.floor(x / plane.tile)) + int(np.floor(y / plane.tile))) & 1)
        contrast = min(max(2.0 - 2.0 * width / plane.tile, 0.0), 1.0)
        fraction = 0.5 + contrast * (odd - 0.5)
        for m in range(3):
            out[m] *= plane.albedo[m] + fraction * (plane.other[m] - plane.albedo[m])
    else:
        texture = 1.0
        if plane.tile > 0.0:
            w = max(width, 1e-6)
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


@njit_cached(**RAY)
def backdrop(plane, up, out):
    """Write the backdrop's light in a direction whose unit vector rises by `up` to out (3,)."""
    t = smooth(0.0, 0.6, up)
    for m in range(3):
        out[m] = plane.backdrop[m] * (1.0 - plane.lean * t)
