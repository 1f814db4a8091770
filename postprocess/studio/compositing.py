"""Composition of the picture: opaque surfaces, the liquid, its drops, and adaptive antialiasing.

Every pixel of the liquid has one ray through its center. Where the first surface, its depth, its
normal or the light changes between neighbors, a pixel is drawn again with rays on a sheared lattice
and averaged in display values.

Depth of field is a gather over circles of confusion of the picture and its depths.
"""

import numpy as np

from vgmpi.runtime.compile_cache import njit_cached

from .compile_options import KERNEL, LEAF, RAY
from .liquid_radiance import direction, shade_ray
from .ray_marching import first_hit
from .spray_drops import shade_drop
from .tone_mapping import to_display

CONTRAST = 10 / 255  # [display values] difference of neighbors that refines a pixel
BEND = 0.90  # [-] cosine between neighbors' normals below which a pixel is refined
AGREE = 3 / 255  # [display values] spread of a pixel's first rays below which they suffice
SCRATCH = 72  # [numbers] scratch memory of a ray
TAPS = 48  # [samples] of a disc
MAX_RADIUS = 40.0  # [pixels] largest radius of a disc


@njit_cached(**RAY)
def _display_over(red, green, blue, through, flags):
    """Return display values of light over a background with transmittance `through`.

    flags: 1 for the tone curve, 2 for a transparent background: then the cover is encoded as if it
    were alone, times its opacity.
    """
    if not flags & 2:
        return to_display(red, green, blue, flags & 1)
    cover = 1.0 - through
    if cover < 1e-4:
        return 0.0, 0.0, 0.0
    red, green, blue = to_display(red / cover, green / cover, blue / cover, flags & 1)
    return red * cover, green * cover, blue * cover


@njit_cached(**LEAF)
def change_of_normal(hits, normals, j, k):
    """Return the largest change of the normal to a neighbor on the same surface, up to 0.8.

    Args:
        hits: Distances to the first surfaces, shape (height, width) [m].
        normals: Their normals, shape (height, width, 3).
        j, k: Row and column of the pixel.
    """
    distance, change = abs(hits[j, k]), 0.0
    height, width = hits.shape
    for side in range(4):
        a = j + (1 if side == 0 else -1 if side == 1 else 0)
        b = k + (1 if side == 2 else -1 if side == 3 else 0)
        if not (0 <= a < height and 0 <= b < width) or not abs(hits[a, b]) < 1e30:
            continue
        if abs(abs(hits[a, b]) - distance) > 0.02 * distance:
            continue
        u = normals[a, b, 0] - normals[j, k, 0]
        v = normals[a, b, 1] - normals[j, k, 1]
        w = normals[a, b, 2] - normals[j, k, 2]
        change = max(change, np.sqrt(u * u + v * v + w * w))
    return min(change, 0.8)


@njit_cached(**RAY)
def _ray(stage, drop_depth, drop_normal, hit, wall, pixel, blur, location, d, p, work, out):
    """Write light and transmittance along d (3,) at a painted pixel to out (8,).

    location: row, column and length of the ray per depth. hit: distance to the liquid, below 0 for
    none. Returns the depth along the ray.
    """
    view = stage.buffers
    j, k, size = location
    drop = drop_depth[j, k] * size
    opaque = view.depth[j, k] * size
    if drop < 1e6 and (hit < 0.0 or drop < hit) and drop < opaque:
        for m in range(3):
            p[m] = view.eye[m] + drop * d[m]
        shade_drop(stage, p, d, drop_normal[j, k], view.light[j, k], work, out)
        out[3] = 0.0
        return drop
    if hit >= 0.0:
        for m in range(3):
            p[m] = view.eye[m] + hit * d[m]
        shade_ray(stage, p, d, wall, pixel * hit, blur, work, out)
        return hit
    for m in range(3):
        out[m] = view.light[j, k, m]
    out[3] = -1.0
    return opaque


@njit_cached(**LEAF)
def _opaque_pixel(view, left, j, k, times, flags, out):
    """Write display values and transmittance of a pixel without the liquid to out (4,).

    Returns the mean depth [m], infinite for an empty pixel.
    """
    out[0] = out[1] = out[2] = out[3] = 0.0
    share, nearest, weight = 1.0 / (times * times), 0.0, 0.0
    r = g = b = 0.0
    first, before = view.light[j * times, k * times], np.float32(-1.0)
    for u in range(j * times, (j + 1) * times):
        for v in range(k * times, (k + 1) * times):
            light, through = view.light[u, v], left[u, v]
            # the background has the same light in all parts of a pixel
            if (
                through != before
                or light[0] != first[0]
                or light[1] != first[1]
                or light[2] != first[2]
            ):
                r, g, b = _display_over(light[0], light[1], light[2], through, flags)
                first, before = light, through
            out[0] += share * r
            out[1] += share * g
            out[2] += share * b
            out[3] += share * through
            if view.depth[u, v] < 1e6:
                nearest += (1.0 - through) * view.depth[u, v]
                weight += 1.0 - through
    return nearest / weight if weight > 0.0 else np.inf


@njit_cached(**LEAF)
def _has_drop(drop_depth, j, k, times):
    """Return whether a drop covers a part of a pixel."""
    for u in range(j * times, (j + 1) * times):
        for v in range(k * times, (k + 1) * times):
            if drop_depth[u, v] < 1e6:
                return True
    return False


@njit_cached(**KERNEL)
def compose(
    stage, left, drop_depth, drop_normal, hits, normals, pixel, flags, image, alpha, depth, keys
):
    """Draw every pixel once.

    Args:
        stage: The scene; its view is `times` as fine as the picture.
        left: Transmittance to the background, as fine as the view.
        drop_depth, drop_normal: Depths and normals of drops, as fine as the view.
        hits, normals: First surfaces (liquid_radiance.find_surface), as fine as the picture.
        pixel: Width of a pixel at a distance of 1 m [m].
        flags: See `_display_over`.
        image: (out) Display values, shape (height, width, 3).
        alpha: (out) Transmittance, shape (height, width).
        depth: (out) Depths, shape (height, width) [m].
        keys: (out) Fraction of the key light on the liquid, shape (height, width); -1 for none.
    """
    view = stage.buffers
    height, width = hits.shape
    times = view.depth.shape[0] // height
    d, p, work, out = np.empty(3), np.empty(3), np.empty(SCRATCH), np.empty(8)
    for j in range(height):
        for k in range(width):
            wet, is_drawn = abs(hits[j, k]) < 1e30, False
            out[7] = -1.0
            for m in range(3):
                out[4 + m] = normals[j, k, m]
            if wet or _has_drop(drop_depth, j, k, times):
                size = direction(view, (k + 0.5) / width, (j + 0.5) / height, d)
                u, v = j * times + times // 2, k * times + times // 2
                t = _ray(
                    stage, drop_depth, drop_normal, abs(hits[j, k]) if wet else -1.0,
                    hits[j, k] < 0.0, pixel, change_of_normal(hits, normals, j, k) if wet else 0.0,
                    (u, v, size), d, p, work, out,
                )  # fmt: skip
                is_drawn = out[3] >= 0.0
            if is_drawn:
                depth[j, k] = t / size
                red, green, blue = _display_over(out[0], out[1], out[2], out[3], flags)
                out[0], out[1], out[2] = red, green, blue
            else:
                depth[j, k] = _opaque_pixel(view, left, j, k, times, flags, out)
            image[j, k, 0], image[j, k, 1], image[j, k, 2] = out[0], out[1], out[2]
            alpha[j, k], keys[j, k] = out[3], out[7]


@njit_cached(nogil=True, error_model="numpy")
def rough_pixels(hits, normals, drop_depth, image, marked):
    """Mark the pixels between which surface or light changes.

    Args:
        hits, normals, drop_depth: See `compose`.
        image: Display values, shape (height, width, 3).
        marked: (out) Mask, shape (height, width).

    Returns:
        Number of marked pixels.
    """
    height, width = hits.shape
    times = drop_depth.shape[0] // height
    marked[:] = False
    for j in range(height):
        for k in range(width):
            distance = abs(hits[j, k])
            for side in range(2):
                a, b = (j + 1, k) if side == 0 else (j, k + 1)
                if a >= height or b >= width:
                    continue
                neighbor_distance = abs(hits[a, b])
                if not (distance < 1e30 or neighbor_distance < 1e30):
                    continue
                differs = (distance < 1e30) != (neighbor_distance < 1e30)
                if not differs:
                    dot = 0.0
                    for m in range(3):
                        dot += normals[j, k, m] * normals[a, b, m]
                    differs = dot < BEND or abs(distance - neighbor_distance) > 0.03 * distance
                if not differs:
                    for m in range(3):
                        if abs(image[j, k, m] - image[a, b, m]) > CONTRAST:
                            differs = True
                if differs:
                    marked[j, k] = True
                    marked[a, b] = True
            if _has_drop(drop_depth, j, k, times):
                marked[j, k] = True
    count = 0
    for j in range(height):
        for k in range(width):
            count += marked[j, k]
    return count


@njit_cached(**RAY)
def _sample(stage, left, drops, position, pixel, blur, flags, d, p, work, out):
    """Return display values and transmittance along the ray through a position in the picture.

    position: row and column in 0..1. drops: depth and normal of drops.
    """
    view = stage.buffers
    rows, columns = view.depth.shape
    y, x = position
    j, k = min(int(y * rows), rows - 1), min(int(x * columns), columns - 1)
    size = direction(view, x, y, d)
    hit, wall = first_hit(
        stage.medium.field, view.eye[0], view.eye[1], view.eye[2], d[0], d[1], d[2],
        view.lens[4], view.depth[j, k] * size,
    )  # fmt: skip
    out[4] = out[5] = out[6] = 0.0
    _ray(stage, *drops, hit, wall, pixel, blur, (j, k, size), d, p, work, out)
    if out[3] < 0.0:
        out[3] = left[j, k]
    red, green, blue = _display_over(out[0], out[1], out[2], out[3], flags)
    return red, green, blue, out[3]


@njit_cached(**LEAF)
def _shows_liquid(view, drop_depth, hits, j, k, d):
    """Return whether the central ray of a pixel meets the liquid first. d: scratch, shape (3,)."""
    height, width = hits.shape
    times = view.depth.shape[0] // height
    u, v = j * times + times // 2, k * times + times // 2
    size = direction(view, (k + 0.5) / width, (j + 0.5) / height, d)
    return drop_depth[u, v] > 1e6 and abs(hits[j, k]) < view.depth[u, v] * size


@njit_cached(**LEAF)
def _place_sample(j, k, a, b, samples, height, width):
    """Return the place (v, u) [-] of ray (a, b) of samples x samples in the pixel (j, k)."""
    v = (j + (a + (b + 0.5) / samples) / samples) / height
    return v, (k + (b + (a + 0.5) / samples) / samples) / width


@njit_cached(**KERNEL)
def refine(
    stage,
    left,
    drop_depth,
    drop_normal,
    hits,
    normals,
    marked,
    samples,
    pixel,
    flags,
    drawn,
):
    """Draw the marked pixels again with samples x samples rays each.

    The rays of a lattice's diagonal are first; where they agree they are enough. If there is a
    central ray, it is that of `compose`.

    Args:
        stage, left, drop_depth, drop_normal, hits, normals, pixel, flags: See `compose`.
        marked: Mask of the pixels, shape (height, width).
        samples: Rays along a pixel's side.
        drawn: Image, alpha and keys of `compose`, the first two (in/out).
    """
    image, alpha, keys = drawn
    height, width = hits.shape
    d, p, work, out = np.empty(3), np.empty(3), np.empty(SCRATCH), np.empty(8)
    total, low, high = np.empty(4), np.empty(4), np.empty(4)
    drops = drop_depth, drop_normal
    for j in range(height):
        for k in range(width):
            if not marked[j, k]:
                continue
            blur = change_of_normal(hits, normals, j, k) if abs(hits[j, k]) < 1e30 else 0.3
            total[:], low[:], high[:] = 0.0, 1e9, -1e9
            out[7], count = keys[j, k], 0  # all rays of a pixel share the key light
            is_central = keys[j, k] >= 0.0 and _shows_liquid(
                stage.buffers, drop_depth, hits, j, k, d
            )
            for n in range(samples * samples):
                a, b = n % samples, (n + n // samples) % samples
                if n == samples and max(
                    high[0] - low[0], high[1] - low[1], high[2] - low[2], high[3] - low[3]
                ) < AGREE:  # fmt: skip
                    break
                if is_central and 2 * a + 1 == samples and a == b:
                    values = image[j, k, 0], image[j, k, 1], image[j, k, 2], alpha[j, k]
                else:
                    place = _place_sample(j, k, a, b, samples, height, width)
                    values = _sample(stage, left, drops, place, pixel, blur, flags, d, p, work, out)
                for m in range(4):
                    total[m] += values[m]
                    low[m], high[m] = min(low[m], values[m]), max(high[m], values[m])
                count += 1
            for m in range(3):
                image[j, k, m] = total[m] / count
            alpha[j, k] = total[3] / count


def _disc() -> np.ndarray:
    """Return evenly spread points of the unit disc (TAPS, 2), on a golden spiral."""
    turn = np.arange(TAPS) * np.pi * (3 - np.sqrt(5))
    r = np.sqrt((np.arange(TAPS) + 0.5) / TAPS)
    return np.stack([r * np.cos(turn), r * np.sin(turn)], axis=1)


_DISC = _disc()


def defocus(
    image: np.ndarray,
    left: np.ndarray,
    depth: np.ndarray,
    focal: float,
    aperture: float,
    focus: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Blur a picture and its transmittance by the distance from the plane in focus.

    Args:
        image: Picture, shape (height, width, 3).
        left: Transmittance, shape (height, width).
        depth: Depths, shape (height, width) [m], infinite for none.
        focal: Focal length [pixels].
        aperture: Radius of the lens [m].
        focus: Depth of the plane in focus [m].

    Returns:
        Blurred picture and transmittance.
    """
    finite_depth = np.where(np.isfinite(depth), np.maximum(depth, 1e-6), 1e6)
    radius = np.minimum(focal * aperture * np.abs(1 / finite_depth - 1 / focus), MAX_RADIUS)
    stacked = np.concatenate([image, left[..., None]], axis=2).astype(np.float32)
    out = np.empty_like(stacked)
    _gather(
        stacked,
        finite_depth.astype(np.float32),
        radius.astype(np.float32),
        float(radius.max()),
        _DISC,
        out,
    )
    return np.ascontiguousarray(out[..., :3]), np.ascontiguousarray(out[..., 3])


@njit_cached(nogil=True, error_model="numpy")
def _gather(image, depth, radius, widest, disc, out):
    """Average the four channels of an image over the circles of confusion."""
    height, width = depth.shape
    sums = np.empty(4)
    for j in range(height):
        for k in range(width):
            reach = radius[j, k]
            # nearer and more blurred pixels extend over sharp edges
            for a in range(-1, 2):
                for b in range(-1, 2):
                    q = min(max(j + int(a * 0.5 * widest), 0), height - 1)
                    r = min(max(k + int(b * 0.5 * widest), 0), width - 1)
                    if depth[q, r] < depth[j, k]:
                        reach = max(reach, radius[q, r])
            if reach < 0.5:
                for m in range(4):
                    out[j, k, m] = image[j, k, m]
                continue
            center_weight = 1.0 / max(radius[j, k] * radius[j, k], 0.25)
            total = center_weight
            for m in range(4):
                sums[m] = center_weight * image[j, k, m]
            for tap in range(len(disc)):
                x, y = k + 0.5 + reach * disc[tap, 0], j + 0.5 + reach * disc[tap, 1]
                q, r = int(np.floor(y)), int(np.floor(x))
                if not (0 <= q < height and 0 <= r < width):
                    continue
                distance = reach * np.sqrt(disc[tap, 0] ** 2 + disc[tap, 1] ** 2)
                size = (
                    radius[q, r] if depth[q, r] < depth[j, k] else min(radius[q, r], radius[j, k])
                )
                w = min(max(size - distance + 0.5, 0.0), 1.0) * reach * reach / len(disc)
                w /= max(size * size, 0.25)
                total += w
                for m in range(4):
                    sums[m] += w * image[q, r, m]
            for m in range(4):
                out[j, k, m] = sums[m] / total
