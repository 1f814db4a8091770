"""How a liquid with a surface looks: what it mirrors, what is seen through it, and its own colour.

At each pixel of its front the ray to the eye is refracted (Snell) and mirrored. As much as
Fresnel's equations for light without polarisation say comes from the surroundings; the rest from
where the refracted ray meets what lies behind, weakened on its way through the liquid (Beer and
Lambert) to the colour that its Gaussians have, which also give light of their own as they are
opaque.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.caching import cached

CLOSE = 0.5  # pixels: that near it is found
STEPS = 6  # in search of the place that a refracted ray meets
EDGE = 0.25  # spacings: a liquid less thick than this is drawn over what lies behind it in part
DARKEST = 0.02  # of a colour: light of it does not vanish on the way at once
SEEN = 4.0  # half widths of the highlight, beyond which it is not seen
TONES = 256  # colours whose logarithms are known; those between are not far from linear
_LOGS = np.log(np.maximum(np.arange(TONES + 2) / TONES, DARKEST)).astype(np.float32)


# of shade: in one piece it takes two thirds of the time
_part = cached(nogil=True, error_model="numpy", inline="always")


class Sky(NamedTuple):
    """Light from far away: a picture of all directions (rows, columns, 3), from straight up in the
    first row to straight down in the last, columns from -x over -y, +x and +y."""

    picture: np.ndarray


class Medium(NamedTuple):
    """index: of refraction. clear: way [m] after which white light has the liquid's colour.
    light: (3,) unit vector towards the light. highlight: how bright that is mirrored. rough: of the
    surface, the highlight's half width [rad]. shade: how much is taken of the liquid's own light
    where its surface is turned away, 0..1."""

    index: float
    clear: float
    light: np.ndarray
    highlight: float
    rough: float
    shade: float = 0.0


def gradient(zenith, horizon, ground) -> Sky:
    """Surroundings of three colours (3,): above, at the horizon and below it."""
    rows = 256
    up = np.cos((np.arange(rows) + 0.5) / rows * np.pi)[:, None]
    zenith, horizon, ground = (np.asarray(c, dtype=np.float64) for c in (zenith, horizon, ground))
    above = horizon + np.sqrt(np.maximum(up, 0)) * (zenith - horizon)
    below = horizon + np.minimum(1, 8 * np.maximum(-up, 0)) * (ground - horizon)
    return Sky(np.ascontiguousarray(np.where(up > 0, above, below)[:, None, :], dtype=np.float32))


@_part
def fresnel(cosine, index):
    """Share of light without polarisation that a surface mirrors, from outside, at an angle of
    incidence of this cosine."""
    inner = np.sqrt(1.0 - (1.0 - cosine * cosine) / (index * index))
    across = (cosine - index * inner) / (cosine + index * inner)
    along = (inner - index * cosine) / (inner + index * cosine)
    return 0.5 * (across * across + along * along)


@_part
def _angle(cosine):
    """arccos, to 7e-5 (Abramowitz and Stegun, 4.4.45)."""
    c = min(abs(cosine), 1.0)
    least = np.sqrt(1.0 - c) * (1.5707288 + c * (-0.2121144 + c * (0.0742610 - 0.0187293 * c)))
    return least if cosine >= 0.0 else np.pi - least


@_part
def _lookup(sky, x, y, z, out):
    """Colour of the surroundings in a direction (unit), into out (3,)."""
    rows, columns = sky.shape[0], sky.shape[1]
    v = _angle(z) / np.pi * rows - 0.5
    u = (np.arctan2(y, x) / (2.0 * np.pi) + 0.5) * columns - 0.5 if columns > 1 else 0.0
    j, k = int(np.floor(v)), int(np.floor(u))
    fv, fu = v - j, u - k
    j0, j1 = min(max(j, 0), rows - 1), min(max(j + 1, 0), rows - 1)
    k0, k1 = k % columns, (k + 1) % columns
    for m in range(3):
        one = sky[j0, k0, m] + fu * (sky[j0, k1, m] - sky[j0, k0, m])
        two = sky[j1, k0, m] + fu * (sky[j1, k1, m] - sky[j1, k0, m])
        out[m] = one + fv * (two - one)


@_part
def _sample(picture, px, py, out):
    """Colour of a picture at a point [pixels], linear between centres, into out (3,)."""
    height, width = picture.shape[0], picture.shape[1]
    u, v = min(max(px - 0.5, 0.0), width - 1.0), min(max(py - 0.5, 0.0), height - 1.0)
    k, j = min(int(u), max(width - 2, 0)), min(int(v), max(height - 2, 0))
    fu, fv, k1, j1 = u - k, v - j, min(k + 1, width - 1), min(j + 1, height - 1)
    for m in range(3):
        one = picture[j, k, m] + fu * (picture[j, k1, m] - picture[j, k, m])
        two = picture[j1, k, m] + fu * (picture[j1, k1, m] - picture[j1, k, m])
        out[m] = one + fv * (two - one)


@_part
def _slope(near, j, k, step_j, step_k, spacing):
    """Difference of near, 1 / depth, to a neighbour, per pixel: of the two sides the lesser one, so
    that an edge does not bend what lies before it."""
    height, width = near.shape
    here = near[j, k]
    found, best = 0.0, np.inf
    for side in (-1, 1):
        a, b = j + side * step_j, k + side * step_k
        if 0 <= a < height and 0 <= b < width:
            slope = side * (near[a, b] - here)
            if abs(slope) < 4.0 * spacing * near[a, b] * here:
                if abs(slope) < best:
                    best, found = abs(slope), slope
    return found


@_part
def _normal(near, j, k, u, v, lens, spacing, out):
    """Unit normal of the front towards the eye, in the camera's axes, into out (3,), at the point
    of a pixel on the plane z = 1."""
    # of the plane 1 / z = a u + b v + c, u = x / z: a x + b y + c z = 1
    a = _slope(near, j, k, 0, 1, spacing) * lens[0]
    b = _slope(near, j, k, 1, 0, spacing) * lens[1]
    c = near[j, k] - a * u - b * v
    size = 1.0 / np.sqrt(a * a + b * b + c * c)
    out[0], out[1], out[2] = -a * size, -b * size, -c * size


@_part
def _met(start, ray, way, lens, far, place):
    """Where a ray from `start` along `ray` meets what is `far` (height, width) [m], in pixels, into
    place (2,). way: through the liquid, for what is infinitely far."""
    height, width = far.shape
    length = way
    for step in range(STEPS):
        z = max(start[2] + length * ray[2], lens[4])
        near = 1.0 / z
        place[0] = lens[0] * (start[0] + length * ray[0]) * near + lens[2]
        place[1] = lens[1] * (start[1] + length * ray[1]) * near + lens[3]
        j = min(max(int(place[1]), 0), height - 1)
        k = min(max(int(place[0]), 0), width - 1)
        if not far[j, k] < np.inf or ray[2] < 0.05:
            return
        more = max((far[j, k] - start[2]) / ray[2], 0.0) - length
        if abs(more) * lens[0] < CLOSE * z:
            return
        length += more if step == 0 else 0.7 * more


@_part
def _lit(mirrored, turn, sky, medium, out):
    """Light that comes along a mirrored ray (3,) of the camera's axes, into out (3,)."""
    x = turn[0, 0] * mirrored[0] + turn[1, 0] * mirrored[1] + turn[2, 0] * mirrored[2]
    y = turn[0, 1] * mirrored[0] + turn[1, 1] * mirrored[1] + turn[2, 1] * mirrored[2]
    z = turn[0, 2] * mirrored[0] + turn[1, 2] * mirrored[1] + turn[2, 2] * mirrored[2]
    _lookup(sky, x, y, z, out)
    along = min(x * medium.light[0] + y * medium.light[1] + z * medium.light[2], 1.0)
    # 1 - a^2 / 2 is less than the cosine of a
    if medium.highlight > 0.0 and along > 1.0 - 0.5 * (SEEN * medium.rough) ** 2:
        off = _angle(along) / medium.rough
        glint = medium.highlight * np.exp(-0.7 * off * off)
        for m in range(3):
            out[m] += glint


@_part
def _weakened(color, through, clear, bright):
    """Light `color` (3,) after its way through the liquid, whose own light is as bright; what of it
    comes through."""
    way, passes = through[0], np.exp(-through[4])
    share, part = np.float32(1.0) / way, np.float32(way / clear)
    for m in range(3):
        own = through[1 + m] * share
        tone = min(max(own, np.float32(0.0)), np.float32(1.0)) * np.float32(TONES)
        at = int(tone)
        log = _LOGS[at] + (tone - np.float32(at)) * (_LOGS[at + 1] - _LOGS[at])
        tint = np.exp(log * part)
        color[m] = passes * tint * color[m] + (1.0 - passes) * bright * own
    return passes


@cached(nogil=True, error_model="numpy")
def shade(near, through, behind, far, lens, turn, sky, medium, spacing, above, image, left):
    """Draw a liquid over `image` (height, width, 3) and `left` (height, width), what comes through.

    near: 1 / depth [1/m] of its front, 0 where it is not; through: see vgmpi.splatting.front.
    behind, far: picture and depth [m] of what lies behind. lens: fx, fy, cx, cy, near. turn: (3, 3)
    from the world to the camera. spacing: of particles [m]. above: how much farther out than the
    surface the front is [m].
    """
    height, width = left.shape
    normal, start, ray, mirrored = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    place, color, sent, toward = np.empty(2), np.empty(3), np.empty(3), np.zeros(3)
    for m in range(3):
        for n in range(3):
            toward[m] += turn[m, n] * medium.light[n]
    for j in range(height):
        for k in range(width):
            way = float(through[j, k, 0])
            if near[j, k] == 0.0 or way <= 0.0:
                continue
            z = 1.0 / near[j, k]
            x, y = (k + 0.5 - lens[2]) / lens[0], (j + 0.5 - lens[3]) / lens[1]
            _normal(near, j, k, x, y, lens, spacing, normal)
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
            _met(start, ray, way, lens, far, place)
            _sample(behind, place[0], place[1], color)
            faces = normal[0] * toward[0] + normal[1] * toward[1] + normal[2] * toward[2]
            bright = 1.0 - 0.5 * medium.shade * (1.0 - faces)
            passes = _weakened(color, through[j, k], medium.clear, bright)
            _lit(mirrored, turn, sky, medium, sent)
            share = fresnel(cosine, medium.index)
            edge = min(1.0, way / (EDGE * spacing))
            cover = edge * edge * (3.0 - 2.0 * edge)
            for m in range(3):
                there = share * sent[m] + (1.0 - share) * color[m]
                image[j, k, m] += cover * (there - image[j, k, m])
            left[j, k] *= 1.0 - cover * (1.0 - (1.0 - share) * passes)
