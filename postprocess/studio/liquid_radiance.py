"""Shading of the liquid by ray tracing: reflection, refraction, absorption and scattering.

At the first surface of a ray the fraction given by Fresnel's equations is reflected; the rest
continues through further surfaces, refracted by Snell's law or totally reflected, and is attenuated
by Beer and Lambert's law on its path through the liquid. Points, directions and normals are arrays
(3,).
"""

import numpy as np

from vgmpi.runtime.compile_cache import njit_cached

from .compile_options import KERNEL, LEAF, RAY
from .cone_occlusion import EXTINCTION, cone
from .environment_radiance import far_light
from .light_rig import mirrored_sky, smooth
from .ray_marching import CROSSED, LEFT, MET, first_hit, follow, surface_normal
from .ray_scene import CHANNELS
from .studio_ground import NONE, SHADOW, ground_color
from .value_grid import trilinear_values

SURFACES = 8  # [-] largest number of surfaces along a ray
MAX_REFLECTION_DISTANCE = 1.5  # [m] distance beyond which only sky and ground are reflected
FILM = 1.5  # [cells] thickness of an invisible air film between liquid and ground
FAINT = 0.03  # [-] reflectance up to which only sky and ground count (2 levels of error)
DIRECT, AMBIENT = 0.45, 0.9  # [-] fractions of key and sky that a white liquid scatters back
WHITE = 0.86  # [-] albedo of foam


@njit_cached(**RAY)
def fresnel(cosine, ratio):
    """Return the reflectance for unpolarized light, and the cosine of the refracted ray (-1: none).

    Args:
        cosine: Cosine of the angle of incidence.
        ratio: Refractive index behind the surface over that before it.
    """
    square = 1.0 - (1.0 - cosine * cosine) / (ratio * ratio)
    if square <= 0.0:
        return 1.0, -1.0
    inner = np.sqrt(square)
    across = (cosine - ratio * inner) / (cosine + ratio * inner)
    along = (inner - ratio * cosine) / (inner + ratio * cosine)
    return 0.5 * (across * across + along * along), inner


@njit_cached(**RAY)
def _mirrored(stage, p, r, blur, follows, work, out):
    """Write the light along the reflected ray r (3,) to p (3,) on the liquid to out (3,).

    follows: whether the ray is traced to the liquid and opaque surfaces.
    """
    q, depth = work[20:23], work[23:26]
    for m in range(3):
        q[m] = p[m]
        depth[m] = 0.0
    end = LEFT
    if follows:
        end, path_length = follow(
            stage, q, r, False, MAX_REFLECTION_DISTANCE, depth, work[:20], out
        )
    if end == MET:
        return
    if end == CROSSED:  # a second hit of the liquid shows its own color and the reflected sky
        medium = stage.medium
        values = work[3:12]
        look_up_tint(medium.tint, q, values)
        mirrored_sky(stage.rig, r[0], r[1], abs(r[2]), blur, out)
        for m in range(3):
            light = 0.3 * stage.rig.key[m] + 0.5 * stage.rig.horizon[m]
            sky = 0.35 * (1.0 - values[8]) * min(out[m], 1.0)
            out[m] = sky + (0.5 + 0.5 * values[8]) * own_light(values, m, light)
        return
    far_light(stage, p[0], p[1], p[2], r[0], r[1], r[2], False, blur, work[:3], out)


@njit_cached(**RAY)
def _scattered(rig, n, key, m):
    """Return the light of color channel m that a white liquid scatters back.

    It grows where the surface of normal n (3,) faces the key and the sky. key: visible fraction of
    the key.
    """
    facing = max(n[0] * rig.toward[0] + n[1] * rig.toward[1] + n[2] * rig.toward[2], 0.0)
    direct = DIRECT * rig.key[m] * (0.3 + 0.7 * key) * (0.5 + 1.1 * facing)
    return direct + AMBIENT * rig.horizon[m] * (0.78 + 0.22 * n[2])


@njit_cached(**RAY)
def own_light(values, m, light):
    """Return what an opaque liquid of values (9,) shows in channel m under a light."""
    contained = values[8]
    return values[3 + m] * (contained + (1.0 - contained) * light)


@njit_cached(**RAY)
def shade_ray(stage, p, d, wall, pixel, blur, work, out):
    """Write the light of the liquid along a ray that enters it to out.

    Args:
        stage, work: The scene and scratch, shape (72,).
        p, d: Point of entry [m] and direction of the ray, shape (3,).
        wall: Whether the ray enters through a wall.
        pixel, blur: Width of a pixel at the point [m], and change of the normal over it.
        out: (in/out) Light, transmittance to the background, unit normal, 0 where it is not known
            yet, and the visible fraction of the key, below 0 where it is not, shape (8,).
    """
    medium, rig = stage.medium, stage.rig
    n, r, t = work[26:29], work[29:32], work[32:35]
    col, depth, own = work[35:38], work[38:41], work[60:69]
    for m in range(3):
        n[m] = out[4 + m]
    if n[0] == 0.0 and n[1] == 0.0 and n[2] == 0.0:
        surface_normal(medium.field, p, 0.6 * pixel, n)
    cosine = min(max(-(d[0] * n[0] + d[1] * n[1] + d[2] * n[2]), 0.02), 1.0)
    reflectance, inner = fresnel(cosine, medium.index)
    for m in range(3):
        r[m] = d[m] + 2.0 * cosine * n[m]
        t[m] = d[m] / medium.index + (cosine / medium.index - inner) * n[m]
        out[4 + m] = n[m]
    _unit(t)
    _unit(r)
    q = work[51:54]
    for m in range(3):
        q[m] = p[m] - 1.5 * medium.field.cell * n[m]
        depth[m] = 0.0
    look_up_tint(medium.tint, q, own)
    # a color that contains its light contains what is mirrored and seen through it, too
    reflectance *= 1.0 - own[8]
    mirrored = work[48:51]
    _mirrored(stage, p, r, 2.0 * blur, reflectance > FAINT, work, mirrored)
    for m in range(3):
        q[m] = p[m]
    path = medium.min_path if wall else 0.0
    for m in range(3):
        depth[m] = own[m] * path
    fraction, through, further = _through(stage, q, t, blur, depth, work, col)
    path += further
    if out[7] < 0.0:
        out[7] = cone(
            stage.pyramid, p[0], p[1], p[2], rig.toward[0], rig.toward[1], rig.toward[2], rig.width,
            2.0 * stage.pyramid.cell, EXTINCTION,
        )  # fmt: skip
    key = out[7]
    glow = 1.0 - (1.0 - own[8]) * np.exp(-own[7] * path)
    for m in range(3):
        inside = own_light(own, m, _scattered(rig, n, key, m))
        incoming = fraction * col[m] + (1.0 - fraction) * rig.horizon[m]
        light = np.exp(-depth[m]) * (1.0 - glow) * incoming + glow * inside
        out[m] = reflectance * mirrored[m] + (1.0 - reflectance) * light
    clear = np.exp(-(depth[0] + depth[1] + depth[2]) / 3.0)
    out[3] = (1.0 - reflectance) * fraction * (1.0 - glow) * clear * through
    if medium.foam > 0.0 and own[6] > 0.01:
        cover = medium.foam * smooth(0.12, 0.9, own[6]) * min(1.0, path / (6.0 * medium.field.cell))
        _cover_with_foam(rig, n, key, cover, out)


@njit_cached(**RAY)
def look_up_tint(tint, q, values):
    """Write the mean values of the liquid's particles around q (3,) to values (9,)."""
    c = 1.0 / tint.cell
    trilinear_values(
        tint.values, (q[0] - tint.lower[0]) * c, (q[1] - tint.lower[1]) * c,
        (q[2] - tint.lower[2]) * c, CHANNELS, values,
    )  # fmt: skip


@njit_cached(**RAY)
def _cover_with_foam(rig, n, key, cover, out):
    """Blend foam of normal n (3,) over light out (3,) and transmittance out[3]."""
    facing = 0.5 + 0.5 * (n[0] * rig.toward[0] + n[1] * rig.toward[1] + n[2] * rig.toward[2])
    for m in range(3):
        white = WHITE * (rig.key[m] * facing * (0.25 + 0.75 * key) + 0.8 * rig.horizon[m])
        out[m] += cover * (white - out[m])
    out[3] *= 1.0 - cover


@njit_cached(**RAY)
def _unit(v):
    """Normalize v (3,) in place."""
    size = 1.0 / np.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    v[0] *= size
    v[1] *= size
    v[2] *= size


@njit_cached(**RAY)
def _on_ground(stage, q):
    """Return whether a point at the lower wall touches the ground, or an air film above it."""
    plane, field = stage.plane, stage.medium.field
    low = q[2] - field.box[2] < FILM * field.cell
    return low and plane.kind != NONE and abs(field.box[2] - plane.height) < 0.5 * field.cell


@njit_cached(**RAY)
def _through(stage, q, t, blur, depth, work, out):
    """Follow the refracted ray t (3,) from q (3,) in the liquid; write its light to out (3,).

    Returns:
        Fraction of its light that surfaces transmit, whether it ends at the background, and the
        path length in the liquid [m].
    """
    medium = stage.medium
    n, air = work[54:57], work[57:60]
    fraction, total, inside, is_straight = 1.0, 0.0, True, True
    for _ in range(SURFACES):
        end, path_length = follow(
            stage, q, t, inside, 1e3, depth if inside else air, work[:20], out
        )
        if inside:
            total += path_length
        if end == MET:
            return fraction, 0.0, total
        if end == LEFT:
            break
        if inside and _on_ground(stage, q):
            plane = stage.plane
            if plane.kind == SHADOW:
                far_light(
                    stage, q[0], q[1], plane.height, 0.0, 0.0, -1.0, True, blur, work[:3], out
                )
            else:
                ground_color(plane, q[0], q[1], 0.002, out)
            return fraction, 0.0, total
        surface_normal(medium.field, q, 0.0, n)
        if not inside:  # against the ray
            n[0], n[1], n[2] = -n[0], -n[1], -n[2]
        cosine = t[0] * n[0] + t[1] * n[1] + t[2] * n[2]
        if cosine < 0.02:
            cosine = 0.02
        ratio = 1.0 / medium.index if inside else medium.index
        reflectance, inner = fresnel(cosine, ratio)
        if inner < 0.0:
            for m in range(3):
                t[m] -= 2.0 * cosine * n[m]
            is_straight = False
        else:
            for m in range(3):
                t[m] = t[m] / ratio + (inner - cosine / ratio) * n[m]
            fraction *= 1.0 - reflectance
            inside = not inside
        _unit(t)
    far_light(stage, q[0], q[1], q[2], t[0], t[1], t[2], True, blur, work[:3], out)
    return fraction, 1.0 if is_straight and stage.plane.kind == NONE else 0.0, total


@njit_cached(**KERNEL)
def find_surface(stage, opaque_depth, hits, normals, pixel):
    """Find the first surfaces of the pixels' central rays.

    Args:
        stage: The scene.
        opaque_depth: Depth before which the liquid is visible, shape (height, width) [m].
        hits: (out) Distances along the rays, shape (height, width) [m]; infinite for none, below 0
            through a wall.
        normals: (out) Unit normals, shape (height, width, 3).
        pixel: Width of a pixel at a distance of 1 m [m].
    """
    view, field = stage.buffers, stage.medium.field
    height, width = hits.shape
    d, p, n = np.empty(3), np.empty(3), np.empty(3)
    for j in range(height):
        for k in range(width):
            hits[j, k] = np.inf
            size = direction(view, (k + 0.5) / width, (j + 0.5) / height, d)
            t, wall = first_hit(
                field, view.eye[0], view.eye[1], view.eye[2], d[0], d[1], d[2],
                view.lens[4], opaque_depth[j, k] * size,
            )  # fmt: skip
            if t < 0.0:
                continue
            for m in range(3):
                p[m] = view.eye[m] + t * d[m]
            surface_normal(field, p, 0.6 * pixel * t, n)
            hits[j, k] = -t if wall else t
            for m in range(3):
                normals[j, k, m] = n[m]


@njit_cached(**LEAF)
def direction(view, u, v, d):
    """Write the unit direction of a pixel's ray to d.

    Args:
        view: The view.
        u, v: Column and row in the picture, 0..1.
        d: (out) Unit direction, shape (3,).

    Returns:
        Length of the ray per depth.
    """
    rows, columns = view.depth.shape
    a = (u * columns - view.lens[2]) / view.lens[0]
    b = (v * rows - view.lens[3]) / view.lens[1]
    for m in range(3):
        d[m] = view.pose[0, m] * a + view.pose[1, m] * b + view.pose[2, m]
    size = np.sqrt(a * a + b * b + 1.0)
    for m in range(3):
        d[m] /= size
    return size
