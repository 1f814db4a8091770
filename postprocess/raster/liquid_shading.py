"""Shading of a liquid's front: reflection, refraction, absorption and its own color.

At each pixel of the front the ray to the eye is refracted (Snell) and reflected. Fresnel's
equations for unpolarized light give the fraction that comes from the environment. The rest comes
from the point where the refracted ray meets the background; on its path through the liquid it is
absorbed (Beer and Lambert) towards the color of the liquid's Gaussians, which also emit light of
their own according to their opacity.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.runtime.compile_cache import njit_cached

CLOSE = 0.5  # [pixels] tolerance of the pixel that a refracted ray hits
STEPS = 6  # [-] iterations in search of that pixel
EDGE = 0.25  # [spacings] thickness below which a liquid fades into its background
MIN_TONE = 0.02  # [-] least color channel, so that its light does not vanish at once
HIGHLIGHT_CUTOFF = 4.0  # [half widths] cutoff radius of the highlight
TONES = 256  # [-] entries of the table of logarithms, linear in between
_LOGS = np.log(np.maximum(np.arange(TONES + 2) / TONES, MIN_TONE)).astype(np.float32)


# parts of `shade` are inlined: one piece takes two thirds of the time
_inlined = njit_cached(nogil=True, error_model="numpy", inline="always")


class EnvironmentMap(NamedTuple):
    """Environment map of distant light.

    Attributes:
        picture: All directions, shape (rows, columns, 3): rows from straight up to straight down,
            columns from -x over -y, +x and +y.
    """

    picture: np.ndarray


class LiquidMedium(NamedTuple):
    """Optical properties of a liquid and its light.

    Attributes:
        index: Refractive index.
        clear: Path length after which white light has the liquid's color [m].
        light: Unit vector towards the light, shape (3,).
        highlight: Brightness of the reflected light source.
        rough: Half width of the highlight due to the surface's roughness [rad].
        shade: Fraction of the liquid's own light removed where it faces away from the light, 0..1.
    """

    index: float  # type: ignore[assignment]  # hides a method of tuple
    clear: float
    light: np.ndarray
    highlight: float
    rough: float
    shade: float = 0.0


def gradient(zenith, horizon, ground) -> EnvironmentMap:
    """Return an environment of three colors (3,): zenith, horizon and ground."""
    rows = 256
    up = np.cos((np.arange(rows) + 0.5) / rows * np.pi)[:, None]
    zenith, horizon, ground = (np.asarray(c, dtype=np.float64) for c in (zenith, horizon, ground))
    above = horizon + np.sqrt(np.maximum(up, 0)) * (zenith - horizon)
    below = horizon + np.minimum(1, 8 * np.maximum(-up, 0)) * (ground - horizon)
    return EnvironmentMap(
        np.ascontiguousarray(np.where(up > 0, above, below)[:, None, :], dtype=np.float32)
    )


@_inlined
def fresnel(cosine, index):
    """Return the reflectance for unpolarized light from outside.

    Args:
        cosine: Cosine of the angle of incidence.
        index: Refractive index of the liquid.
    """
    inner = np.sqrt(1.0 - (1.0 - cosine * cosine) / (index * index))
    across = (cosine - index * inner) / (cosine + index * inner)
    along = (inner - index * cosine) / (inner + index * cosine)
    return 0.5 * (across * across + along * along)


@_inlined
def _angle(cosine):
    """Return arccos to 7e-5 (Abramowitz and Stegun, 4.4.45)."""
    c = min(abs(cosine), 1.0)
    angle = np.sqrt(1.0 - c) * (1.5707288 + c * (-0.2121144 + c * (0.0742610 - 0.0187293 * c)))
    return angle if cosine >= 0.0 else np.pi - angle


@_inlined
def _lookup(sky, x, y, z, out):
    """Write the environment's color in a unit direction to out (3,)."""
    rows, columns = sky.shape[0], sky.shape[1]
    v = _angle(z) / np.pi * rows - 0.5
    u = (np.arctan2(y, x) / (2.0 * np.pi) + 0.5) * columns - 0.5 if columns > 1 else 0.0
    j, k = int(np.floor(v)), int(np.floor(u))
    fv, fu = v - j, u - k
    j0, j1 = min(max(j, 0), rows - 1), min(max(j + 1, 0), rows - 1)
    k0, k1 = k % columns, (k + 1) % columns
    for m in range(3):
        upper = sky[j0, k0, m] + fu * (sky[j0, k1, m] - sky[j0, k0, m])
        lower = sky[j1, k0, m] + fu * (sky[j1, k1, m] - sky[j1, k0, m])
        out[m] = upper + fv * (lower - upper)


@_inlined
def _sample(picture, px, py, out):
    """Write a picture's color at a point [pixels], linear between centers, to out (3,)."""
    height, width = picture.shape[0], picture.shape[1]
    u, v = min(max(px - 0.5, 0.0), width - 1.0), min(max(py - 0.5, 0.0), height - 1.0)
    k, j = min(int(u), max(width - 2, 0)), min(int(v), max(height - 2, 0))
    fu, fv, k1, j1 = u - k, v - j, min(k + 1, width - 1), min(j + 1, height - 1)
    for m in range(3):
        upper = picture[j, k, m] + fu * (picture[j, k1, m] - picture[j, k, m])
        lower = picture[j1, k, m] + fu * (picture[j1, k1, m] - picture[j1, k, m])
        out[m] = upper + fv * (lower - upper)


@_inlined
def _slope(inv_depth, j, k, step_j, step_k, spacing):
    """Return the difference of inverse depth to a neighbor per pixel.

    The smaller one of both sides is taken, so that an edge does not bend what lies before it.
    """
    height, width = inv_depth.shape
    center = inv_depth[j, k]
    smallest, best = 0.0, np.inf
    for side in (-1, 1):
        a, b = j + side * step_j, k + side * step_k
        if 0 <= a < height and 0 <= b < width:
            slope = side * (inv_depth[a, b] - center)
            if abs(slope) < 4.0 * spacing * inv_depth[a, b] * center:
                if abs(slope) < best:
                    best, smallest = abs(slope), slope
    return smallest


@_inlined
def _normal(inv_depth, j, k, u, v, lens, spacing, out):
    """Write the unit normal towards the eye in camera axes at pixel (j, k) to out (3,).

    u, v: the pixel's point on the plane z = 1.
    """
    # the plane 1 / z = a u + b v + c with u = x / z is a x + b y + c z = 1
    a = _slope(inv_depth, j, k, 0, 1, spacing) * lens[0]
    b = _slope(inv_depth, j, k, 1, 0, spacing) * lens[1]
    c = inv_depth[j, k] - a * u - b * v
    size = 1.0 / np.sqrt(a * a + b * b + c * c)
    out[0], out[1], out[2] = -a * size, -b * size, -c * size


@_inlined
def _refracted_hit(start, ray, default_length, lens, background_depth, pixel):
    """Write the pixel at which a ray meets the background to pixel (2,).

    start, ray: origin [m] and direction (3,) in camera axes. default_length: path through the
    liquid [m], taken for an infinitely far background. background_depth: (height, width) [m].
    """
    height, width = background_depth.shape
    length = default_length
    for step in range(STEPS):
        z = max(start[2] + length * ray[2], lens[4])
        inverse_depth = 1.0 / z
        pixel[0] = lens[0] * (start[0] + length * ray[0]) * inverse_depth + lens[2]
        pixel[1] = lens[1] * (start[1] + length * ray[1]) * inverse_depth + lens[3]
        j = min(max(int(pixel[1]), 0), height - 1)
        k = min(max(int(pixel[0]), 0), width - 1)
        if not background_depth[j, k] < np.inf or ray[2] < 0.05:
            return
        missing = max((background_depth[j, k] - start[2]) / ray[2], 0.0) - length
        if abs(missing) * lens[0] < CLOSE * z:
            return
        length += missing if step == 0 else 0.7 * missing


@_inlined
def _reflected_light(mirrored, rotation, sky, medium, out):
    """Write the light along a reflected ray (3,) in camera axes to out (3,)."""
    x = rotation[0, 0] * mirrored[0] + rotation[1, 0] * mirrored[1] + rotation[2, 0] * mirrored[2]
    y = rotation[0, 1] * mirrored[0] + rotation[1, 1] * mirrored[1] + rotation[2, 1] * mirrored[2]
    z = rotation[0, 2] * mirrored[0] + rotation[1, 2] * mirrored[1] + rotation[2, 2] * mirrored[2]
    _lookup(sky, x, y, z, out)
    along = min(x * medium.light[0] + y * medium.light[1] + z * medium.light[2], 1.0)
    # 1 - a^2 / 2 is a lower bound of cos a
    if medium.highlight > 0.0 and along > 1.0 - 0.5 * (HIGHLIGHT_CUTOFF * medium.rough) ** 2:
        deviation = _angle(along) / medium.rough
        glint = medium.highlight * np.exp(-0.7 * deviation * deviation)
        for m in range(3):
            out[m] += glint


@_inlined
def _absorb(color, path, clear, bright):
    """Absorb light `color` (3,) on its path through the liquid and add the liquid's own light.

    path: (5,) sums of `liquid_thickness` at the pixel. Returns the transmittance.
    """
    path_length, transmittance = path[0], np.exp(-path[4])
    inverse_length, relative_length = np.float32(1.0) / path_length, np.float32(path_length / clear)
    for m in range(3):
        own = path[1 + m] * inverse_length
        tone = min(max(own, np.float32(0.0)), np.float32(1.0)) * np.float32(TONES)
        index = int(tone)
        log = _LOGS[index] + (tone - np.float32(index)) * (_LOGS[index + 1] - _LOGS[index])
        tint = np.exp(log * relative_length)
        color[m] = transmittance * tint * color[m] + (1.0 - transmittance) * bright * own
    return transmittance


@njit_cached(nogil=True, error_model="numpy")
def shade(
    inv_depth, paths, background, background_depth, lens, rotation, sky, medium, spacing, above,
    image, transmittance,
):  # fmt: skip
    """Draw a liquid over a picture and its transmittance.

    Args:
        inv_depth: Inverse depth of the front, shape (height, width) [1/m]; 0 for none.
        paths: Path sums, shape (height, width, 5), see `liquid_thickness`.
        background, background_depth: Picture and depth [m] behind the liquid.
        lens: fx, fy, cx, cy, near.
        rotation: World to camera, shape (3, 3).
        sky, medium: Environment picture and optical properties.
        spacing: Distance of particles [m].
        above: Height of the front above the surface [m].
        image, transmittance: (in/out) Shapes (height, width, 3) and (height, width).
    """
    height, width = transmittance.shape
    normal, start, ray, mirrored = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    pixel, color, sent, toward = np.empty(2), np.empty(3), np.empty(3), np.zeros(3)
    for m in range(3):
        for n in range(3):
            toward[m] += rotation[m, n] * medium.light[n]
    for j in range(height):
        for k in range(width):
            path_length = float(paths[j, k, 0])
            if inv_depth[j, k] == 0.0 or path_length <= 0.0:
                continue
            z = 1.0 / inv_depth[j, k]
            x, y = (k + 0.5 - lens[2]) / lens[0], (j + 0.5 - lens[3]) / lens[1]
            _normal(inv_depth, j, k, x, y, lens, spacing, normal)
            size = 1.0 / np.sqrt(x * x + y * y + 1.0)
            start[0], start[1], start[2] = x * z, y * z, z
            look = (x * size, y * size, size)
            facing = -(look[0] * normal[0] + look[1] * normal[1] + look[2] * normal[2])
            cosine = min(max(facing, 0.02), 1.0)
            inner = np.sqrt(1.0 - (1.0 - cosine * cosine) / (medium.index * medium.index))
            for m in range(3):
                mirrored[m] = look[m] + 2.0 * cosine * normal[m]
                ray[m] = look[m] / medium.index + (cosine / medium.index - inner) * normal[m]
                start[m] += above / cosine * look[m]
            _refracted_hit(start, ray, path_length, lens, background_depth, pixel)
            _sample(background, pixel[0], pixel[1], color)
            faces = normal[0] * toward[0] + normal[1] * toward[1] + normal[2] * toward[2]
            bright = 1.0 - 0.5 * medium.shade * (1.0 - faces)
            remaining = _absorb(color, paths[j, k], medium.clear, bright)
            _reflected_light(mirrored, rotation, sky, medium, sent)
            reflectance = fresnel(cosine, medium.index)
            edge = min(1.0, path_length / (EDGE * spacing))
            cover = edge * edge * (3.0 - 2.0 * edge)
            for m in range(3):
                light = reflectance * sent[m] + (1.0 - reflectance) * color[m]
                image[j, k, m] += cover * (light - image[j, k, m])
            transmittance[j, k] *= 1.0 - cover * (1.0 - (1.0 - reflectance) * remaining)
