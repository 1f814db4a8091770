"""Light on opaque surfaces in tiles of pixel blocks, interpolated where it is even.

Light and occlusion vary over the cells of the pyramid, which are some blocks wide. In a square of
blocks that shows one smooth surface, light is evaluated at the corners and in the middle; where the
middle is what the corners interpolate to, the other blocks are interpolated, too. Otherwise the
square is halved, and at last all blocks are evaluated.
"""

import numpy as np

from vgmpi.runtime.compile_cache import njit_cached

from .compile_options import LEAF, RAY
from .cone_occlusion import EXTINCTION, clip, cone
from .density_field import density
from .light_rig import ambient
from .liquid_radiance import direction
from .ray_marching import ABSORBING, MAX_STEPS, absorb, brick_leap, inverse

TILE = 8  # [blocks] edge of a tile
LEAST = 4  # [blocks] edge of the smallest square with interpolated light
NUMBERS = 8  # of a block: depth, key (3), sky (3), openness
HAZE = 0.65, 0.6  # [-] fraction of sky light absorbed by the liquid, factor on its depth
CLOSE = 0.012  # [-] relative difference in the middle of a square up to which it is interpolated
SPREAD = 0.2  # [-] largest relative difference of its corners
ALIGNED = 0.98  # [-] cosine to the interpolated normal above which a surface is smooth


@njit_cached(**RAY)
def liquid_depth(medium, p, d, depth, values):
    """Write the liquid's optical depth, scattering included, along a straight ray to depth (3,).

    Args:
        medium, p, d: Liquid and ray.
        depth, values: (out) Optical depth, shape (3,), and scratch, shape (8,).

    Returns:
        Path length in the liquid [m].
    """
    field = medium.field
    depth[0] = depth[1] = depth[2] = 0.0
    begin, end = clip(field.box[:3], field.box[3:], p[0], p[1], p[2], d[0], d[1], d[2])
    t, total = begin + 0.05 * field.cell, 0.0
    c = 1.0 / field.cell
    r0, r1, r2 = inverse(d[0]), inverse(d[1]), inverse(d[2])
    for _ in range(MAX_STEPS):
        if t >= end:
            break
        u = (p[0] + t * d[0] - field.lower[0]) * c
        v = (p[1] + t * d[1] - field.lower[1]) * c
        w = (p[2] + t * d[2] - field.lower[2]) * c
        outside = brick_leap(field, u, v, w, r0, r1, r2, False)
        if outside > 0.0:
            t += (outside + 1e-4) * field.cell
            continue
        step, share = brick_leap(field, u, v, w, r0, r1, r2, True) * field.cell, 1.0
        if step <= 0.0:
            step = min(1.5 * field.cell, end - t)
            # the inner fraction of a step is linear in rho over a cell, without jumps
            h = 0.5 * step * c
            f = density(field, u + h * d[0], v + h * d[1], w + h * d[2])
            share = min(max(0.5 + 2.0 * (f - 0.5), 0.0), 1.0)
        step = min(step, end - t)
        if not medium.uniform:
            step = min(step, ABSORBING * medium.tint.cell)
        if share > 0.0:
            absorb(medium, p, d, t, t + step, share, 1.0, depth, values)
            total += share * step
        t += step + 1e-6 * field.cell
    return total


@njit_cached(**RAY)
def light_at(stage, p, n, sand, liquid, key, sky, work):
    """Evaluate the light on a surface at p (3,) with unit normal n (3,).

    Args:
        stage: The scene.
        p, n: Point [m] and unit normal, shape (3,).
        sand: Fraction of sand, whose grains shade themselves less.
        liquid: Whether there is any liquid.
        key: (out) Incoming light of the key before the cosine, shape (3,).
        sky: (out) Ambient light, shape (3,).
        work: Scratch, shape (11,).

    Returns:
        Open fraction of the hemisphere, 0..1.
    """
    g, rig, pyramid = stage.pyramid.cell, stage.rig, stage.pyramid
    openness = ambient(
        pyramid, rig, p[0] + 2.6 * g * n[0], p[1] + 2.6 * g * n[1], p[2] + 2.6 * g * n[2],
        n[0], n[1], n[2], 1.195 * g, sky,
    )  # fmt: skip
    a, b = g + 1.5 * g * (1.0 - 0.5 * sand), 0.75 * g * (1.0 - 0.5 * sand)
    visibility = cone(
        pyramid, p[0] + a * n[0] + b * rig.toward[0], p[1] + a * n[1] + b * rig.toward[1],
        p[2] + a * n[2] + b * rig.toward[2], rig.toward[0], rig.toward[1], rig.toward[2],
        rig.width, g, EXTINCTION,
    )  # fmt: skip
    for m in range(3):
        key[m] = rig.key[m] * visibility
    if liquid:
        depth, values = work[:3], work[3:]
        path_length = liquid_depth(stage.medium, p, rig.toward, depth, values)
        if path_length > 0.0:
            for m in range(3):
                key[m] *= np.exp(-depth[m])
                sky[m] *= 1.0 - HAZE[0] + HAZE[0] * np.exp(-HAZE[1] * depth[m])
    return openness


@njit_cached(**LEAF)
def painted_normal(normal, cover, j, k, n):
    """Write the unit normal of a painted pixel to n.

    Args:
        normal: Painted normals, 0..1 for -1..1, shape (height, width, 3).
        cover: Opacity of the pixel.
        j, k: Row and column of the pixel.
        n: (out) Unit normal, shape (3,).
    """
    size = 0.0
    for m in range(3):
        n[m] = normal[j, k, m] / cover * 2.0 - 1.0
        size += n[m] * n[m]
    if size < 1e-9:  # surfaces without a normal face upwards
        n[0], n[1], n[2], size = 0.0, 0.0, 1.0, 1.0
    size = 1.0 / np.sqrt(size)
    for m in range(3):
        n[m] *= size


@njit_cached(**LEAF)
def _shared_depth(depth, normal, left, block, thickness, n, mean):
    """Return the depth of a block of pixels that shows one surface, or 0.

    block: first and last row, first and last column. thickness: of one surface [m]. n: (3,)
    scratch. mean: (3,) out, normal of the surface.
    """
    low, high, count = 1e30, 0.0, 0
    mean[0] = mean[1] = mean[2] = 0.0
    for j in range(block[0], block[1]):
        for k in range(block[2], block[3]):
            cover = 1.0 - left[j, k]
            if not (cover > 0.5 and depth[j, k] < 1e6):
                return 0.0
            count += 1
            low, high = min(low, depth[j, k]), max(high, depth[j, k])
            painted_normal(normal, cover, j, k, n)
            for m in range(3):
                mean[m] += n[m]
    size = np.sqrt(mean[0] ** 2 + mean[1] ** 2 + mean[2] ** 2)
    if high - low >= thickness or size <= 0.9 * count:
        return 0.0
    for m in range(3):
        mean[m] /= size
    return 0.5 * (low + high)


@njit_cached(**LEAF)
def _between(values, first, size, a, b, m):
    """Return number m of block a, b of a square between those of its corners.

    first, size: row and column of the first block, and blocks along a side.
    """
    j, k, last = first[0], first[1], size - 1
    u, v = (a - j) / last, (b - k) / last
    low = values[j, k, m] + v * (values[j, k + last, m] - values[j, k, m])
    high = values[j + last, k, m] + v * (values[j + last, k + last, m] - values[j + last, k, m])
    return low + u * (high - low)


@njit_cached(**LEAF)
def _is_smooth(lights, normals, sands, first, size, thickness):
    """Return whether a square of blocks shows one smooth surface.

    normals, sands: of the blocks, shapes (8, 8, 3) and (8, 8, 1).
    """
    for a in range(first[0], first[0] + size):
        for b in range(first[1], first[1] + size):
            if lights[a, b, 0] <= 0.0:
                return False
    for a in range(first[0], first[0] + size):
        for b in range(first[1], first[1] + size):
            if abs(lights[a, b, 0] - _between(lights, first, size, a, b, 0)) > thickness:
                return False
            if abs(sands[a, b, 0] - _between(sands, first, size, a, b, 0)) > 0.02:
                return False
            dot = square = 0.0
            for m in range(3):
                n = _between(normals, first, size, a, b, m)
                dot += n * normals[a, b, m]
                square += n * n
            if dot * dot < ALIGNED * ALIGNED * square or dot < 0.0:
                return False
    return True


@njit_cached(**LEAF)
def _agrees(lights, first, size):
    """Return whether the light in the middle of a square is interpolated from its corners."""
    j, k, last = first[0], first[1], size - 1
    a, b = j + size // 2, k + size // 2
    for m in range(1, NUMBERS):
        value = lights[a, b, m]
        p, q = lights[j, k, m], lights[j, k + last, m]
        r, s = lights[j + last, k, m], lights[j + last, k + last, m]
        low, high = min(min(p, q), min(r, s)), max(max(p, q), max(r, s))
        if high - low > SPREAD * high:
            return False
        if abs(_between(lights, first, size, a, b, m) - value) > CLOSE * value:
            return False
    return True


@njit_cached(**RAY)
def _evaluate(stage, lights, normals, sands, is_known, a, b, corner, liquid, work):
    """Evaluate the light of block a, b unless it is known.

    corner: row and column of the tile's first pixel, pixels along a side of a block.
    """
    if is_known[a, b]:
        return
    view, p, d = stage.buffers, work[:3], work[3:6]
    height, width = view.depth.shape
    j0, k0 = corner[0] + a * corner[2], corner[1] + b * corner[2]
    j1, k1 = min(j0 + corner[2], height), min(k0 + corner[2], width)
    size = direction(view, 0.5 * (k0 + k1) / width, 0.5 * (j0 + j1) / height, d)
    light = lights[a, b]
    for m in range(3):
        p[m] = view.eye[m] + light[0] * size * d[m]
    light[7] = light_at(
        stage, p, normals[a, b], sands[a, b, 0], liquid, light[1:4], light[4:7], work[6:]
    )
    is_known[a, b] = True


@njit_cached(**RAY)
def light_tile(stage, painted, corner, thickness, liquid, tile, work):
    """Fill in the depth and the light of the blocks of a tile that show one surface each.

    Args:
        stage: The scene; its view holds depths.
        painted: Normals, kinds and transmittance, see deferred_shading.shade_opaque.
        corner: Row and column of the tile's first pixel, and pixels along a side of a block.
        thickness: Thickness of one surface [m].
        liquid: Whether there is any liquid.
        tile: (out) Numbers of the blocks, shape (8, 8, 8), with a depth of 0 where a block shows
            several surfaces; scratch of shapes (8, 8, 3), (8, 8, 1) and (8, 8).
        work: Scratch, shape (17,).
    """
    lights, normals, sands, is_known = tile
    normal, kinds, left = painted
    depth = stage.buffers.depth
    height, width = depth.shape
    any_shared = False
    for a in range(TILE):
        for b in range(TILE):
            j0, k0 = corner[0] + a * corner[2], corner[1] + b * corner[2]
            lights[a, b, 0] = 0.0
            if j0 < height and k0 < width:
                block = j0, min(j0 + corner[2], height), k0, min(k0 + corner[2], width)
                lights[a, b, 0] = _shared_depth(
                    depth, normal, left, block, thickness, work[:3], normals[a, b]
                )
                if lights[a, b, 0] > 0.0:
                    sands[a, b, 0] = kinds[j0, k0, 0]
            is_known[a, b] = lights[a, b, 0] <= 0.0
            any_shared |= not is_known[a, b]
    if not any_shared:
        return
    size = TILE
    while size >= LEAST:
        for part in range((TILE // size) ** 2):
            first = part // (TILE // size) * size, part % (TILE // size) * size
            _interpolate(stage, tile, first, size, corner, thickness, liquid, work)
        size //= 2
    for a in range(TILE):
        for b in range(TILE):
            _evaluate(stage, lights, normals, sands, is_known, a, b, corner, liquid, work)


@njit_cached(**RAY)
def _interpolate(stage, tile, first, size, corner, thickness, liquid, work):
    """Interpolate the light in a square of blocks, if it shows one smooth surface in even light."""
    lights, normals, sands, is_known = tile
    last = size - 1
    if is_known[first[0] + 1, first[1] + 1]:
        return
    if not _is_smooth(lights, normals, sands, first, size, thickness):
        return
    for n in range(5):
        a = size // 2 if n == 4 else last * (n >> 1)
        b = size // 2 if n == 4 else last * (n & 1)
        _evaluate(
            stage, lights, normals, sands, is_known, first[0] + a, first[1] + b, corner, liquid,
            work,
        )  # fmt: skip
    if not _agrees(lights, first, size):
        return
    for a in range(first[0], first[0] + size):
        for b in range(first[1], first[1] + size):
            if not is_known[a, b]:
                for m in range(1, NUMBERS):
                    lights[a, b, m] = _between(lights, first, size, a, b, m)
                is_known[a, b] = True
