"""Light on what is opaque, worked out per pixel from painted albedo, normal, kind and depth.

Where the pixels of a block show the same surface, what hides light is asked once for all of them.
"""

import numpy as np

from vgmpi.caching import cached
from vgmpi.studio.compiling import RAY
from vgmpi.studio.ground import NONE, SHADOW, backdrop, ground_color, ground_light
from vgmpi.studio.lighting import ambient
from vgmpi.studio.liquid import direction
from vgmpi.studio.occlusion import EXTINCTION, cone
from vgmpi.studio.rays import liquid_depth, rho_at

WRAP = 0.12  # of the key around a body; more of sand and of snow
HAZE = 0.65, 0.6  # share of the sky's light under the liquid that it absorbs, and of how much
TURNED = 0.5  # share of the key that is lost to a shadow beside a liquid, by total reflection
BRIGHTEST = 1.15  # of a capture in the studio's light, against the light that it holds


@cached(nogil=True, error_model="numpy")
def shade_background(stage, picture, block):
    """Fill view.behind: ground, backdrop, or a picture with the shadow that falls on it.

    picture: (height, width, 3) linear background, (1, 1, 3) for the backdrop.
    block: pixels of a side that share their light.
    """
    view, plane = stage.buffers, stage.plane
    height, width = view.depth.shape
    d, light = np.empty(3), np.empty(3)
    taken = picture.shape[0] > 1
    for j0 in range(0, height, block):
        for k0 in range(0, width, block):
            j1, k1 = min(j0 + block, height), min(k0 + block, width)
            size = direction(view, 0.5 * (k0 + k1) / width, 0.5 * (j0 + j1) / height, d)
            down = -d[2]
            t = (view.eye[2] - plane.height) / down if down > 1e-6 else -1.0
            on = plane.kind != NONE and 0.0 < t <= 1e6
            x, y = view.eye[0] + t * d[0], view.eye[1] + t * d[1]
            covers = on and plane.kind != SHADOW
            if covers:
                wide = block * t / (view.lens[0] * down / size) if down > 1e-3 else 1e3
                ground_color(plane, x, y, wide, light)
            elif not taken:
                backdrop(plane, d[2], light)
            elif on:
                ground_light(plane, x, y, light)
                for m in range(3):
                    light[m] = min(light[m] / max(plane.far[m], 1e-6), 1.0)
            else:
                light[:] = 1.0
            for j in range(j0, j1):
                for k in range(k0, k1):
                    for m in range(3):
                        below = picture[j, k, m] if taken and not covers else 1.0
                        view.behind[j, k, m] = light[m] * below


@cached(nogil=True, error_model="numpy")
def tint_ground(stage):
    """Take from the ground's light what the liquid absorbs on the light's way to it."""
    plane, medium, rig = stage.plane, stage.medium, stage.rig
    depth, values, p = np.zeros(3), np.zeros(8), np.zeros(3)
    rows, columns = plane.light.shape[0], plane.light.shape[1]
    up, thick = max(rig.toward[2], 0.0), 10.0 * medium.field.cell
    for j in range(rows):
        for k in range(columns):
            x, y = (
                plane.lower[0] + (k + 0.5) * plane.texel,
                plane.lower[1] + (j + 0.5) * plane.texel,
            )
            p[0], p[1], p[2] = x, y, plane.height
            way = liquid_depth(medium, p, rig.toward, depth, values)
            if way <= 0.0:
                continue
            key = cone(
                stage.pyramid, x, y, plane.height, rig.toward[0], rig.toward[1], rig.toward[2],
                rig.width, 1.2 * stage.pyramid.cell, EXTINCTION,
            )  # fmt: skip
            # light that would leave through a side is mirrored there; a film lets it go on
            leaves = rho_at(medium.field, x, y, plane.height + 0.5 * medium.field.cell) < 0.5
            turned = TURNED * min(way / thick, 1.0) if leaves else 0.0
            for m in range(3):
                direct = rig.key[m] * up * key
                rest = plane.light[j, k, m] - direct
                passes = np.exp(-depth[m]) * (1.0 - turned)
                plane.light[j, k, m] = direct * passes + rest * (
                    1.0 - HAZE[0] + HAZE[0] * np.exp(-HAZE[1] * depth[m])
                )


@cached(**RAY)
def light_at(stage, p, n, sand, liquid, key, sky, work):
    """Light on a surface at p (3,) with unit normal n (3,).

    Args:
        sand: share of sand, whose grains shade themselves less.
        liquid: whether there is any.
        key: (3,) out, the key's light that comes, before the cosine.
        sky: (3,) out, ambient light.
        work: (11,) scratch.

    Returns:
        what is open of the hemisphere, 0..1.
    """
    g, rig, pyramid = stage.pyramid.cell, stage.rig, stage.pyramid
    free = ambient(
        pyramid, rig, p[0] + 2.6 * g * n[0], p[1] + 2.6 * g * n[1], p[2] + 2.6 * g * n[2],
        n[0], n[1], n[2], stage.plane.height, 1.195 * g, sky,
    )  # fmt: skip
    a, b = g + 1.5 * g * (1.0 - 0.5 * sand), 0.75 * g * (1.0 - 0.5 * sand)
    comes = cone(
        pyramid, p[0] + a * n[0] + b * rig.toward[0], p[1] + a * n[1] + b * rig.toward[1],
        p[2] + a * n[2] + b * rig.toward[2], rig.toward[0], rig.toward[1], rig.toward[2],
        rig.width, g, EXTINCTION,
    )  # fmt: skip
    for m in range(3):
        key[m] = rig.key[m] * comes
    if liquid:
        depth, values = work[:3], work[3:]
        way = liquid_depth(stage.medium, p, rig.toward, depth, values)
        if way > 0.0:
            for m in range(3):
                key[m] *= np.exp(-depth[m])
                sky[m] *= 1.0 - HAZE[0] + HAZE[0] * np.exp(-HAZE[1] * depth[m])
    return free


@cached(**RAY)
def surface_light(rig, d, n, albedo, kind, gloss, captures, key, sky, free, out):
    """Light that a surface throws towards the eye, into out (3,).

    Args:
        rig: the lights.
        d: (3,) unit direction of the ray from the eye.
        n: (3,) unit normal.
        albedo: (3,) linear color.
        kind: (3,) shares of sand, of snow and of captures, whose color holds their light.
        gloss: share of what is smooth.
        captures: how much of the studio's light captures take, 0..1.
        key: (3,) light of the key that comes.
        sky: (3,) ambient light.
        free: what is open of the hemisphere.
    """
    sand, snow, captured = kind[0], kind[1], kind[2]
    cosine = n[0] * rig.toward[0] + n[1] * rig.toward[1] + n[2] * rig.toward[2]
    wrap = WRAP + 0.10 * sand + 0.38 * snow
    diffuse = max((cosine + wrap) / (1.0 + wrap), 0.0)

    if snow > 0.01:
        diffuse = diffuse ** (1.0 + 0.35 * snow)
        free = free ** (1.0 - 0.5 * snow)
    h0, h1, h2 = rig.toward[0] - d[0], rig.toward[1] - d[1], rig.toward[2] - d[2]
    size = 1.0 / np.sqrt(max(h0 * h0 + h1 * h1 + h2 * h2, 1e-12))
    half = max((n[0] * h0 + n[1] * h1 + n[2] * h2) * size, 0.0)
    facing = max(-(n[0] * d[0] + n[1] * d[1] + n[2] * d[2]), 0.0)
    spot = gloss * (0.35 * half**60 + 0.06 * half**8) if cosine > 0.0 else 0.0
    rim = gloss * (0.04 + 0.5 * (1.0 - facing) ** 5)

    for m in range(3):
        a = albedo[m]
        s = key[m]
        if snow > 0.01:  # light goes some way through snow
            s = rig.key[m] * (max(s / max(rig.key[m], 1e-9), 0.0)) ** (1.0 - 0.55 * snow)
        am = sky[m] / (1.0 - min(a, 0.95) * (1.0 - free) * 0.9)  # bounces in hollows
        new = a * (s * (diffuse + snow * 0.30 * max(-cosine, 0.0)) + am) + s * spot + am * rim
        if captured > 0.0:
            usual = rig.key[m] * max(rig.toward[2], 0.0) + rig.horizon[m]
            ratio = min((s * diffuse + am) / max(usual, 1e-6), BRIGHTEST)
            held = a * (1.0 + captures * (ratio - 1.0))
            new += min(captured, 1.0) * (held - new)
        out[m] = new


@cached(nogil=True, error_model="numpy")
def shade_opaque(stage, albedo, normal, kinds, left, block, liquid, captures):
    """Fill view.light with what is opaque over view.behind.

    Args:
        stage: what is there; its view holds depths and background.
        albedo: (height, width, 3) painted linear colors.
        normal: (height, width, 3) painted, 0..1 for -1..1.
        kinds: (height, width, 3) painted shares of sand, snow and captures.
        left: (height, width) what comes through.
        block: pixels of a side that share their light.
        liquid: whether there is any.
        captures: how much of the studio's light captures take, 0..1.
    """
    view, rig = stage.buffers, stage.rig
    height, width = view.depth.shape
    n, mean, p, d = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    key, sky, kind, color, out = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    work, thick, free = np.empty(11), 3.0 * stage.pyramid.cell, 1.0
    for j0 in range(0, height, block):
        for k0 in range(0, width, block):
            j1, k1 = min(j0 + block, height), min(k0 + block, width)
            z = _shared_depth(view.depth, normal, left, (j0, j1, k0, k1), thick, n, mean)
            shared = z > 0.0
            if shared:
                s = direction(view, 0.5 * (k0 + k1) / width, 0.5 * (j0 + j1) / height, d)
                for m in range(3):
                    p[m] = view.eye[m] + z * s * d[m]
                free = light_at(stage, p, mean, kinds[j0, k0, 0], liquid, key, sky, work)
            for j in range(j0, j1):
                for k in range(k0, k1):
                    through = left[j, k]
                    cover = 1.0 - through
                    for m in range(3):
                        view.light[j, k, m] = through * view.behind[j, k, m]
                    if cover < 0.003:
                        continue
                    s = direction(view, (k + 0.5) / width, (j + 0.5) / height, d)
                    _painted_normal(normal, cover, j, k, n)
                    for m in range(3):
                        kind[m] = kinds[j, k, m] / cover
                        color[m] = albedo[j, k, m] / cover
                    if not shared:
                        z = _depth_near(view.depth, j, k)
                        for m in range(3):
                            p[m] = view.eye[m] + z * s * d[m]
                        free = light_at(stage, p, n, kind[0], liquid, key, sky, work)
                    gloss = max(1.0 - kind[0] - kind[1] - kind[2], 0.0)
                    surface_light(rig, d, n, color, kind, gloss, captures, key, sky, free, out)
                    for m in range(3):
                        view.light[j, k, m] += cover * out[m]


@cached(**RAY)
def _shared_depth(depth, normal, left, block, thick, n, mean):
    """Depth of a block of pixels that shows one surface, 0 where it shows more; its normal into
    mean.

    block: first and last row, first and last column. thick: of one surface [m]. n: (3,) scratch.
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
            _painted_normal(normal, cover, j, k, n)
            for m in range(3):
                mean[m] += n[m]
    size = np.sqrt(mean[0] ** 2 + mean[1] ** 2 + mean[2] ** 2)
    if high - low >= thick or size <= 0.9 * count:
        return 0.0
    for m in range(3):
        mean[m] /= size
    return 0.5 * (low + high)


@cached(**RAY)
def _painted_normal(normal, cover, j, k, n):
    size = 0.0
    for m in range(3):
        n[m] = normal[j, k, m] / cover * 2.0 - 1.0
        size += n[m] * n[m]
    if size < 1e-9:  # what has none is seen from above
        n[0], n[1], n[2], size = 0.0, 0.0, 1.0, 1.0
    size = 1.0 / np.sqrt(size)
    for m in range(3):
        n[m] *= size


@cached(**RAY)
def _depth_near(depth, j, k):
    """Depth of a pixel, or of one near by where it is too thin to have one."""
    if depth[j, k] < 1e6:
        return depth[j, k]
    best = 0.0
    for a in range(-2, 3):
        for b in range(-2, 3):
            q, r = min(max(j + a, 0), depth.shape[0] - 1), min(max(k + b, 0), depth.shape[1] - 1)
            if depth[q, r] < 1e6:
                best = max(best, depth[q, r])
    return best if best > 0.0 else 1.0
