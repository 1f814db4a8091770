"""The liquid's own picture: what its surface mirrors, what is seen through it, its own light.

At the first surface of a ray the share that Fresnel's equations say is mirrored; the rest goes on
through as many surfaces as there are, refracted by Snell's law or totally reflected, and loses
light by Beer and Lambert's law on its way through the liquid.
"""

import numpy as np

from vgmpi.caching import cached
from vgmpi.studio.compiling import RAY
from vgmpi.studio.grid import trilinear_values
from vgmpi.studio.ground import NONE, SHADOW, ground_color
from vgmpi.studio.lighting import mirrored_sky, smooth
from vgmpi.studio.occlusion import EXTINCTION, cone
from vgmpi.studio.rays import CROSSED, LEFT, MET, first_hit, follow, surface_normal
from vgmpi.studio.surroundings import far_light

SURFACES = 8  # that a ray meets at most
AROUND = 1.5  # m beyond which nothing is mirrored but sky and ground
FILM = 1.5  # cells: of air between liquid and ground that is not seen
FAINT = 0.03  # share up to which only sky and ground are mirrored: the rest is 2 levels at most
DIRECT, AMBIENT = 0.45, 0.9  # shares of the key and of the sky that a white liquid scatters back
WHITE = 0.86  # albedo of foam


@cached(**RAY)
def fresnel(cosine, ratio):
    """Share of unpolarized light that is mirrored, and the cosine of the refracted ray (-1: none).

    cosine: of the angle of incidence. ratio: index behind the surface over that before it.
    """
    square = 1.0 - (1.0 - cosine * cosine) / (ratio * ratio)
    if square <= 0.0:
        return 1.0, -1.0
    inner = np.sqrt(square)
    across = (cosine - ratio * inner) / (cosine + ratio * inner)
    along = (inner - ratio * cosine) / (inner + ratio * cosine)
    return 0.5 * (across * across + along * along), inner


@cached(**RAY)
def _mirrored(stage, p, r, blur, follows, work, out):
    """Light that comes along the mirrored ray r (3,) to p (3,) on the liquid, into out (3,).

    follows: whether liquid and opaque things are looked for.
    """
    q, depth = work[20:23], work[23:26]
    for m in range(3):
        q[m] = p[m]
        depth[m] = 0.0
    end = LEFT
    if follows:
        end, way = follow(stage, q, r, False, AROUND, depth, work[:20], out)
    if end == MET:
        return
    if end == CROSSED:  # the liquid again: its own color, and the sky that it mirrors
        medium = stage.medium
        values = work[3:11]
        look_up_tint(medium.tint, q, values)
        mirrored_sky(stage.rig, r[0], r[1], abs(r[2]), blur, out)
        for m in range(3):
            own = values[3 + m] * (0.3 * stage.rig.key[m] + 0.5 * stage.rig.horizon[m])
            out[m] = 0.35 * min(out[m], 1.0) + 0.5 * own
        return
    far_light(stage, p[0], p[1], p[2], r[0], r[1], r[2], False, blur, work[:3], out)


@cached(**RAY)
def _scattered(rig, n, key, m):
    """Light of color m that a white liquid scatters back below a surface of normal n (3,): more
    where it faces the key and the sky. key: share of the key that comes."""
    facing = max(n[0] * rig.toward[0] + n[1] * rig.toward[1] + n[2] * rig.toward[2], 0.0)
    direct = DIRECT * rig.key[m] * (0.3 + 0.7 * key) * (0.5 + 1.1 * facing)
    return direct + AMBIENT * rig.horizon[m] * (0.78 + 0.22 * n[2])


@cached(**RAY)
def shade_ray(stage, p, d, wall, pixel, blur, work, out):
    """Light of the liquid along a ray that enters it at p (3,) with direction d (3,).

    Args:
        wall: whether it enters through a wall.
        pixel: width of a pixel there [m].
        blur: change of the normal over a pixel.
        work: (72,) scratch.
        out: (8,) light, what comes through from behind the picture, the unit normal, and the share
            of the key's light that comes, below 0 where it is not known yet.
    """
    medium, rig = stage.medium, stage.rig
    n, r, t, col, depth, own = (
        work[26:29],
        work[29:32],
        work[32:35],
        work[35:38],
        work[38:41],
        work[60:68],
    )
    surface_normal(medium.field, p, 0.6 * pixel, n)
    cosine = min(max(-(d[0] * n[0] + d[1] * n[1] + d[2] * n[2]), 0.02), 1.0)
    share, inner = fresnel(cosine, medium.index)
    for m in range(3):
        r[m] = d[m] + 2.0 * cosine * n[m]
        t[m] = d[m] / medium.index + (cosine / medium.index - inner) * n[m]
        out[4 + m] = n[m]
    _unit(t)
    _unit(r)
    mirrored = work[48:51]
    _mirrored(stage, p, r, 2.0 * blur, share > FAINT, work, mirrored)
    q = work[51:54]
    for m in range(3):
        q[m] = p[m] - 1.5 * medium.field.cell * n[m]
        depth[m] = 0.0
    look_up_tint(medium.tint, q, own)
    for m in range(3):
        q[m] = p[m]
    way = medium.least if wall else 0.0
    for m in range(3):
        depth[m] = own[m] * way
    passes, through, more = _through(stage, q, t, blur, depth, work, col)
    way += more
    if out[7] < 0.0:
        out[7] = cone(
            stage.pyramid, p[0], p[1], p[2], rig.toward[0], rig.toward[1], rig.toward[2], rig.width,
            2.0 * stage.pyramid.cell, EXTINCTION,
        )  # fmt: skip
    key = out[7]
    glow = 1.0 - np.exp(-own[7] * way)
    for m in range(3):
        inside = own[3 + m] * _scattered(rig, n, key, m)
        met = passes * col[m] + (1.0 - passes) * rig.horizon[m]
        light = np.exp(-depth[m]) * (1.0 - glow) * met + glow * inside
        out[m] = share * mirrored[m] + (1.0 - share) * light
    clear = np.exp(-(depth[0] + depth[1] + depth[2]) / 3.0)
    out[3] = (1.0 - share) * passes * (1.0 - glow) * clear * through
    if medium.foam > 0.0 and own[6] > 0.01:
        cover = medium.foam * smooth(0.12, 0.9, own[6]) * min(1.0, way / (6.0 * medium.field.cell))
        _cover_with_foam(rig, n, key, cover, out)


@cached(**RAY)
def look_up_tint(tint, q, values):
    """What the liquid's particles are like around q (3,), into values (8,)."""
    trilinear_values(
        tint.values, (q[0] - tint.lower[0]) / tint.cell, (q[1] - tint.lower[1]) / tint.cell,
        (q[2] - tint.lower[2]) / tint.cell, 8, values,
    )  # fmt: skip


@cached(**RAY)
def _cover_with_foam(rig, n, key, cover, out):
    """Lay foam over light out (3,) and what comes through out[3]; n (3,): the surface's normal."""
    facing = 0.5 + 0.5 * (n[0] * rig.toward[0] + n[1] * rig.toward[1] + n[2] * rig.toward[2])
    for m in range(3):
        white = WHITE * (rig.key[m] * facing * (0.25 + 0.75 * key) + 0.8 * rig.horizon[m])
        out[m] += cover * (white - out[m])
    out[3] *= 1.0 - cover


@cached(**RAY)
def _unit(v):
    size = 1.0 / np.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    v[0] *= size
    v[1] *= size
    v[2] *= size


@cached(**RAY)
def _on_ground(stage, q):
    """Whether a point at the lower wall lies on the ground, or a film of air above it."""
    plane, field = stage.plane, stage.medium.field
    low = q[2] - field.box[2] < FILM * field.cell
    return low and plane.kind != NONE and abs(field.box[2] - plane.height) < 0.5 * field.cell


@cached(**RAY)
def _through(stage, q, t, blur, depth, work, out):
    """Follow the refracted ray t (3,) from q (3,) inside of the liquid until it ends.

    Returns:
        share of its light that surfaces let pass, whether it ends at the background, and the way
        in the liquid [m]. out (3,): the light that it meets.
    """
    medium = stage.medium
    n, air = work[54:57], work[57:60]
    passes, total, inside, straight = 1.0, 0.0, True, True
    for _ in range(SURFACES):
        end, way = follow(stage, q, t, inside, 1e3, depth if inside else air, work[:20], out)
        if inside:
            total += way
        if end == MET:
            return passes, 0.0, total
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
            return passes, 0.0, total
        surface_normal(medium.field, q, 0.0, n)
        if not inside:  # against the way
            n[0], n[1], n[2] = -n[0], -n[1], -n[2]
        cosine = t[0] * n[0] + t[1] * n[1] + t[2] * n[2]
        if cosine < 0.02:
            cosine = 0.02
        ratio = 1.0 / medium.index if inside else medium.index
        share, inner = fresnel(cosine, ratio)
        if inner < 0.0:
            for m in range(3):
                t[m] -= 2.0 * cosine * n[m]
            straight = False
        else:
            for m in range(3):
                t[m] = t[m] / ratio + (inner - cosine / ratio) * n[m]
            passes *= 1.0 - share
            inside = not inside
        _unit(t)
    far_light(stage, q[0], q[1], q[2], t[0], t[1], t[2], True, blur, work[:3], out)
    return passes, 1.0 if straight and stage.plane.kind == NONE else 0.0, total


@cached(nogil=True, error_model="numpy")
def find_surface(stage, near, hits, normals, reach):
    """First surfaces of the pixels' middle rays.

    Args:
        stage: what is there.
        near: (height, width) depth [m] before which the liquid is not hidden.
        hits: (height, width) out: way along the ray [m], infinite for none; below 0 through a wall.
        normals: (height, width, 3) out.
        reach: [m] of a pixel at a way of 1 m.
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
                view.lens[4], near[j, k] * size,
            )  # fmt: skip
            if t < 0.0:
                continue
            for m in range(3):
                p[m] = view.eye[m] + t * d[m]
            surface_normal(field, p, 0.6 * reach * t, n)
            hits[j, k] = -t if wall else t
            for m in range(3):
                normals[j, k, m] = n[m]


@cached(**RAY)
def direction(view, u, v, d):
    """Unit direction of the ray at a place 0..1 of the picture, into d (3,); its length per
    depth."""
    rows, columns = view.depth.shape
    a = (u * columns - view.lens[2]) / view.lens[0]
    b = (v * rows - view.lens[3]) / view.lens[1]
    for m in range(3):
        d[m] = view.pose[0, m] * a + view.pose[1, m] * b + view.pose[2, m]
    size = np.sqrt(a * a + b * b + 1.0)
    for m in range(3):
        d[m] /= size
    return size
