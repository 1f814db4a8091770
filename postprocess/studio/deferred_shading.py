"""Deferred shading of opaque surfaces from painted albedo, normal, material kind and depth.

Where the pixels of a block show the same surface, they share their light, which is interpolated
between blocks where it is even (tile_light.py).
"""

import numpy as np

from vgmpi.runtime.compile_cache import njit_cached

from .compile_options import KERNEL, LEAF, RAY
from .cone_occlusion import EXTINCTION, cone
from .liquid_radiance import direction
from .ray_marching import rho_at
from .studio_ground import NONE, SHADOW, backdrop, ground_color, ground_light
from .tile_light import HAZE, NUMBERS, TILE, light_at, light_tile, liquid_depth, painted_normal

WRAP = 0.12  # [-] wrap lighting of the key; more on sand and snow
TURNED = 0.5  # [-] fraction of the key lost beside a liquid by total reflection
ALIKE = 0.9  # [-] cosine between normals of a block above which pixels share their light
BRIGHTEST = 1.15  # [-] largest factor of the studio's light on a captured color


@njit_cached(**KERNEL)
def shade_background(stage, picture, block):
    """Fill in view.background: ground, backdrop, or a picture with the shadow on it.

    Args:
        stage: The scene.
        picture: Linear background, shape (height, width, 3); (1, 1, 3) for the backdrop.
        block: Side of the pixel blocks that share their light [pixels].
    """
    view, plane = stage.buffers, stage.plane
    height, width = view.depth.shape
    d, light = np.empty(3), np.empty(3)
    has_picture = picture.shape[0] > 1
    for j0 in range(0, height, block):
        for k0 in range(0, width, block):
            j1, k1 = min(j0 + block, height), min(k0 + block, width)
            size = direction(view, 0.5 * (k0 + k1) / width, 0.5 * (j0 + j1) / height, d)
            down = -d[2]
            t = (view.eye[2] - plane.height) / down if down > 1e-6 else -1.0
            hits_ground = plane.kind != NONE and 0.0 < t <= 1e6
            x, y = view.eye[0] + t * d[0], view.eye[1] + t * d[1]
            covers = hits_ground and plane.kind != SHADOW
            if covers:
                footprint = block * t / (view.lens[0] * down / size) if down > 1e-3 else 1e3
                ground_color(plane, x, y, footprint, light)
            elif not has_picture:
                backdrop(plane, d[2], light)
            elif hits_ground:
                ground_light(plane, x, y, light)
                for m in range(3):
                    light[m] = min(light[m] / max(plane.far_light[m], 1e-6), 1.0)
            else:
                light[:] = 1.0
            for j in range(j0, j1):
                for k in range(k0, k1):
                    for m in range(3):
                        below = picture[j, k, m] if has_picture and not covers else 1.0
                        view.background[j, k, m] = light[m] * below


@njit_cached(**KERNEL)
def tint_ground(stage):
    """Attenuate the ground's light by the liquid's absorption on its way to the ground."""
    plane, medium, rig = stage.plane, stage.medium, stage.rig
    depth, values, p = np.zeros(3), np.zeros(8), np.zeros(3)
    rows, columns = plane.light.shape[0], plane.light.shape[1]
    up, thickness = max(rig.toward[2], 0.0), 10.0 * medium.field.cell
    for j in range(rows):
        for k in range(columns):
            x, y = (
                plane.lower[0] + (k + 0.5) * plane.texel,
                plane.lower[1] + (j + 0.5) * plane.texel,
            )
            p[0], p[1], p[2] = x, y, plane.height
            path_length = liquid_depth(medium, p, rig.toward, depth, values)
            if path_length <= 0.0:
                continue
            key = cone(
                stage.pyramid, x, y, plane.height, rig.toward[0], rig.toward[1], rig.toward[2],
                rig.width, 1.2 * stage.pyramid.cell, EXTINCTION,
            )  # fmt: skip
            # light that would leave through a side is totally reflected; a film transmits it
            leaves = rho_at(medium.field, x, y, plane.height + 0.5 * medium.field.cell) < 0.5
            reflected = TURNED * min(path_length / thickness, 1.0) if leaves else 0.0
            for m in range(3):
                direct = rig.key[m] * up * key
                ambient_light = plane.light[j, k, m] - direct
                passes = np.exp(-depth[m]) * (1.0 - reflected)
                plane.light[j, k, m] = direct * passes + ambient_light * (
                    1.0 - HAZE[0] + HAZE[0] * np.exp(-HAZE[1] * depth[m])
                )


@njit_cached(**LEAF)
def surface_light(rig, d, n, albedo, kind, gloss, captures, key, sky, openness, out):
    """Write the light that a surface reflects towards the eye to out (3,).

    Args:
        rig: The lights.
        d: Unit direction of the ray from the eye, shape (3,).
        n: Unit normal, shape (3,).
        albedo: Linear color, shape (3,).
        kind: Fractions of sand, snow and captures, whose color includes their light, shape (3,).
        gloss: Fraction of smooth material.
        captures: Strength of the studio's light on captures, 0..1.
        key: Incoming light of the key, shape (3,).
        sky: Ambient light, shape (3,).
        openness: Open fraction of the hemisphere.
        out: (out) Light, shape (3,).
    """
    sand, snow, captured = kind[0], kind[1], kind[2]
    cosine = n[0] * rig.toward[0] + n[1] * rig.toward[1] + n[2] * rig.toward[2]
    wrapping = WRAP + 0.10 * sand + 0.38 * snow
    diffuse = max((cosine + wrapping) / (1.0 + wrapping), 0.0)

    if snow > 0.01:
        diffuse = diffuse ** (1.0 + 0.35 * snow)
        openness = openness ** (1.0 - 0.5 * snow)
    h0, h1, h2 = rig.toward[0] - d[0], rig.toward[1] - d[1], rig.toward[2] - d[2]
    size = 1.0 / np.sqrt(max(h0 * h0 + h1 * h1 + h2 * h2, 1e-12))
    half = max((n[0] * h0 + n[1] * h1 + n[2] * h2) * size, 0.0)
    facing = max(-(n[0] * d[0] + n[1] * d[1] + n[2] * d[2]), 0.0)
    specular = gloss * (0.35 * half**60 + 0.06 * half**8) if cosine > 0.0 else 0.0
    fresnel_rim = gloss * (0.04 + 0.5 * (1.0 - facing) ** 5)

    for m in range(3):
        a = albedo[m]
        s = key[m]
        if snow > 0.01:  # light scatters some distance through snow
            s = rig.key[m] * (max(s / max(rig.key[m], 1e-9), 0.0)) ** (1.0 - 0.55 * snow)
        am = sky[m] / (1.0 - min(a, 0.95) * (1.0 - openness) * 0.9)  # interreflection in hollows
        new = (
            a * (s * (diffuse + snow * 0.30 * max(-cosine, 0.0)) + am)
            + s * specular
            + am * fresnel_rim
        )
        if captured > 0.0:
            usual = rig.key[m] * max(rig.toward[2], 0.0) + rig.horizon[m]
            ratio = min((s * diffuse + am) / max(usual, 1e-6), BRIGHTEST)
            captured_light = a * (1.0 + captures * (ratio - 1.0))
            new += min(captured, 1.0) * (captured_light - new)
        out[m] = new


@njit_cached(**KERNEL)
def shade_opaque(stage, albedo, normal, kinds, left, block, liquid, captures):
    """Fill in view.light with opaque surfaces over view.background.

    Args:
        stage: The scene; its view holds depths and background.
        albedo: Painted linear colors, shape (height, width, 3).
        normal: Painted normals, 0..1 for -1..1, shape (height, width, 3).
        kinds: Painted fractions of sand, snow and captures, shape (height, width, 3).
        left: Transmittance, shape (height, width).
        block: Side of the pixel blocks that share their light [pixels].
        liquid: Whether there is any liquid.
        captures: Strength of the studio's light on captures, 0..1.
    """
    height, width = stage.buffers.depth.shape
    tile = (
        np.empty((TILE, TILE, NUMBERS)), np.empty((TILE, TILE, 3)), np.empty((TILE, TILE, 1)),
        np.empty((TILE, TILE), np.bool_),
    )  # fmt: skip
    surface, surfaces = np.empty((6, 3)), np.empty((4, 12))
    work, thick = np.empty(17), 3.0 * stage.pyramid.cell
    painted = albedo, normal, kinds, left
    for j0 in range(0, height, TILE * block):
        for k0 in range(0, width, TILE * block):
            light_tile(stage, painted[1:], (j0, k0, block), thick, liquid, tile, work)
            for a in range(TILE):
                for b in range(TILE):
                    corner = j0 + a * block, k0 + b * block, block
                    _shade_block(
                        stage, painted, corner, tile[0][a, b], thick, liquid, captures, surface,
                        surfaces, work,
                    )  # fmt: skip


@njit_cached(**RAY)
def _shade_block(
    stage, painted, corner, light, thickness, liquid, captures, surface, surfaces, work
):
    """Shade the pixels of a block.

    painted, liquid, captures: see `shade_opaque`. corner: first row and column, pixels along a
    side. light, thickness: see `light_tile`. surface, surfaces, work: scratch of shapes (6, 3),
    (4, 12) and (17,).
    """
    albedo, normal, kinds, left = painted
    view, rig, count = stage.buffers, stage.rig, 0
    height, width = view.depth.shape
    n, p, d, kind, color, out = (
        surface[0], surface[1], surface[2], surface[3], surface[4], surface[5],
    )  # fmt: skip
    for j in range(corner[0], min(corner[0] + corner[2], height)):
        for k in range(corner[1], min(corner[1] + corner[2], width)):
            through = left[j, k]
            cover = 1.0 - through
            for m in range(3):
                view.light[j, k, m] = through * view.background[j, k, m]
            if cover < 0.003:
                continue
            s = direction(view, (k + 0.5) / width, (j + 0.5) / height, d)
            painted_normal(normal, cover, j, k, n)
            for m in range(3):
                kind[m] = kinds[j, k, m] / cover
                color[m] = albedo[j, k, m] / cover
            own = light
            if light[0] <= 0.0:
                z = _depth_near(view.depth, j, k)
                slot = _like_surface(surfaces, count, z, n, kind[0], thickness)
                own = surfaces[slot]
                if slot == count:
                    count = min(count + 1, len(surfaces) - 1)
                    for m in range(3):
                        p[m] = view.eye[m] + z * s * d[m]
                        own[8 + m] = n[m]
                    own[0], own[11] = z, kind[0]
                    own[7] = light_at(stage, p, n, kind[0], liquid, own[1:4], own[4:7], work)
            gloss = max(1.0 - kind[0] - kind[1] - kind[2], 0.0)
            surface_light(rig, d, n, color, kind, gloss, captures, own[1:4], own[4:7], own[7], out)
            for m in range(3):
                view.light[j, k, m] += cover * out[m]


@njit_cached(**LEAF)
def _like_surface(surfaces, count, z, n, sand, thickness):
    """Return which surface of a block, whose light is evaluated, a pixel shows; `count` for none.

    surfaces: depth, light (7), normal (3) and fraction of sand of each. z, n, sand: of the pixel.
    """
    for q in range(count):
        dot = n[0] * surfaces[q, 8] + n[1] * surfaces[q, 9] + n[2] * surfaces[q, 10]
        if (
            abs(z - surfaces[q, 0]) < thickness
            and dot > ALIKE
            and abs(sand - surfaces[q, 11]) < 0.1
        ):
            return q
    return count


@njit_cached(**RAY)
def _depth_near(depth, j, k):
    """Return the depth of a pixel, or of a close one where it is too thin to have a depth."""
    if depth[j, k] < 1e6:
        return depth[j, k]
    best = 0.0
    for a in range(-2, 3):
        for b in range(-2, 3):
            q, r = min(max(j + a, 0), depth.shape[0] - 1), min(max(k + b, 0), depth.shape[1] - 1)
            if depth[q, r] < 1e6:
                best = max(best, depth[q, r])
    return best if best > 0.0 else 1.0
