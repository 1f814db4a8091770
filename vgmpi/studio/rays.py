"""Rays through a liquid's density field and past what is opaque.

A ray leaps over blocks that are empty, or full, and over space where nothing opaque can be; near a
surface it goes in steps of less than a cell and finds the crossing by bisection.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.caching import cached
from vgmpi.studio.compiling import RAY
from vgmpi.studio.field import Field, density
from vgmpi.studio.ground import SHADOW, Ground, NONE, backdrop, ground_color
from vgmpi.studio.grid import Grid, trilinear_values
from vgmpi.studio.lighting import Rig, mirrored_sky
from vgmpi.studio.occlusion import SOLID, TINT, Occlusion, clip, leap, level_value

STEP = 0.8  # cells
SMOOTH = 1.0  # cells: from which the normal of the surface is taken, at least
BISECTIONS = 6
MOST_STEPS = 4000
LEFT, CROSSED, MET = 0, 1, 2  # how a way ends: nowhere, at the surface, at something opaque
VISIBLE = 2.5  # cells of the pyramid: how thick what is seen is at least


class View(NamedTuple):
    """What the camera sees without the liquid, as fine as it is painted.

    Attributes:
        light: (height, width, 3) linear, of what is opaque over ground and background.
        depth: (height, width) of what is opaque [m], infinite for none.
        behind: (height, width, 3) linear, ground and background alone.
        pose: (4, 4) from the world to the camera.
        lens: fx, fy, cx, cy, near.
        eye: (3,) [m].
        picture: whether the background is a picture or clear, and is seen where nothing is.
    """

    light: np.ndarray
    depth: np.ndarray
    behind: np.ndarray
    pose: np.ndarray
    lens: np.ndarray
    eye: np.ndarray
    picture: bool


class Medium(NamedTuple):
    """The liquid.

    Attributes:
        field: its density.
        tint: grid of (absorption [1/m] x 3, color x 3, foam, scattering [1/m]).
        index: of refraction.
        least: way through it that is seen behind a wall [m].
        uniform: whether it has one color.
        foam: most that foam covers, 0..1.
        mean: (8,) mean of tint.
    """

    field: Field
    tint: Grid
    index: float
    least: float
    uniform: bool
    foam: float
    mean: np.ndarray


class Stage(NamedTuple):
    """All that a ray can meet."""

    medium: Medium
    pyramid: Occlusion
    rig: Rig
    plane: Ground
    buffers: View


@cached(**RAY)
def in_box(box, x, y, z):
    """Whether a point lies in a box (6,)."""
    return (
        x >= box[0] and y >= box[1] and z >= box[2] and x <= box[3] and y <= box[4] and z <= box[5]
    )


@cached(**RAY)
def brick_leap(field, u, v, w, d0, d1, d2, inside):
    """Way [cells] from grid coordinates for which a ray stays outside, or inside, of the liquid for
    sure; 0 near its surface."""
    n = field.bricks.shape
    if not (u >= 0.0 and v >= 0.0 and w >= 0.0):
        return 0.0
    i, j, k = int(u) >> 2, int(v) >> 2, int(w) >> 2
    if i >= n[0] or j >= n[1] or k >= n[2]:
        return 0.0
    away = int(field.bricks[i, j, k])
    if not inside:
        away = -away
    if away <= 0:
        return 0.0
    best = 1e9
    if abs(d0) > 1e-9:
        side = ((i + away) << 2) if d0 > 0.0 else ((i - away + 1) << 2)
        best = min(best, (side - u) / d0)
    if abs(d1) > 1e-9:
        side = ((j + away) << 2) if d1 > 0.0 else ((j - away + 1) << 2)
        best = min(best, (side - v) / d1)
    if abs(d2) > 1e-9:
        side = ((k + away) << 2) if d2 > 0.0 else ((k - away + 1) << 2)
        best = min(best, (side - w) / d2)
    return max(best, 0.0)


@cached(**RAY)
def rho_at(field, x, y, z):
    """Density at a point [m], 0 outside of the walls."""
    if not in_box(field.box, x, y, z):
        return 0.0
    c = 1.0 / field.cell
    return density(
        field, (x - field.lower[0]) * c, (y - field.lower[1]) * c, (z - field.lower[2]) * c
    )


@cached(**RAY)
def surface_normal(field, p, wide, n):
    """Outward unit normal of the liquid at p (3,), over `wide` [m] at least, into n (3,).

    On a wall deep inside it is the wall's, at the rim of both in between.
    """
    c = 1.0 / field.cell
    x, y, z = (p[0] - field.lower[0]) * c, (p[1] - field.lower[1]) * c, (p[2] - field.lower[2]) * c
    r = max(SMOOTH, wide * c)
    n[0] = density(field, x - r, y, z) - density(field, x + r, y, z)
    n[1] = density(field, x, y - r, z) - density(field, x, y + r, z)
    n[2] = density(field, x, y, z - r) - density(field, x, y, z + r)
    size = n[0] * n[0] + n[1] * n[1] + n[2] * n[2]
    if size > 1e-12:
        size = 1.0 / np.sqrt(size)
        n[0] *= size
        n[1] *= size
        n[2] *= size
    best, axis, sign = 1e9, 0, 0.0
    for m in range(3):
        if p[m] - field.box[m] < best:
            best, axis, sign = p[m] - field.box[m], m, -1.0
        if field.box[3 + m] - p[m] < best:
            best, axis, sign = field.box[3 + m] - p[m], m, 1.0
    if best < 0.02 * field.cell:
        t = min(max((density(field, x, y, z) - 0.5) * 4.0, 0.0), 1.0)
        t = t * t * (3.0 - 2.0 * t)
        for m in range(3):
            n[m] *= 1.0 - t
        n[axis] += sign * t
        size = n[0] * n[0] + n[1] * n[1] + n[2] * n[2]
        size = 1.0 / np.sqrt(max(size, 1e-12))
        for m in range(3):
            n[m] *= size


@cached(**RAY)
def project(view, x, y, z, out):
    """Pixel and depth of a point, into out (3,); whether it lies before the camera."""
    w = view.pose
    depth = w[2, 0] * x + w[2, 1] * y + w[2, 2] * z + w[2, 3]
    if depth < view.lens[4]:
        return False
    out[0] = (
        view.lens[0] * (w[0, 0] * x + w[0, 1] * y + w[0, 2] * z + w[0, 3]) / depth + view.lens[2]
    )
    out[1] = (
        view.lens[1] * (w[1, 0] * x + w[1, 1] * y + w[1, 2] * z + w[1, 3]) / depth + view.lens[3]
    )
    out[2] = depth
    return True


@cached(**RAY)
def _blend(light, depth, u, v, near, thick, out):
    """Light between the pixels that show the same thing, into out (3,)."""
    u, v = u - 0.5, v - 0.5
    k0, j0 = int(np.floor(u)), int(np.floor(v))
    fu, fv, total = u - k0, v - j0, 0.0
    out[0] = out[1] = out[2] = 0.0
    for b in range(2):
        for a in range(2):
            j, k = min(max(j0 + b, 0), depth.shape[0] - 1), min(max(k0 + a, 0), depth.shape[1] - 1)
            if abs(depth[j, k] - near) < thick or (near > 1e30 and depth[j, k] > 1e30):
                w = abs(1.0 - b - fv) * abs(1.0 - a - fu) + 1e-6
                total += w
                for m in range(3):
                    out[m] += w * light[j, k, m]
    if total > 0.0:
        for m in range(3):
            out[m] /= total


@cached(**RAY)
def opaque_at(stage, x, y, z, thick, place, out):
    """Whether a point lies in something opaque; its light, into out (3,).

    What the camera sees is taken from its picture, the rest from the colors of the pyramid.
    """
    view, pyramid = stage.buffers, stage.pyramid
    on = project(view, x, y, z, place)
    k, j = int(np.floor(place[0])), int(np.floor(place[1]))
    if on and 0 <= j < view.depth.shape[0] and 0 <= k < view.depth.shape[1]:
        near = view.depth[j, k]
        if place[2] <= near:
            return False
        if place[2] < near + thick:
            _blend(view.light, view.depth, place[0], place[1], near, thick, out)
            return True
    if level_value(pyramid, 0, x, y, z) < SOLID:
        return False
    size = TINT * pyramid.cell
    trilinear_values(
        pyramid.color,
        (x - pyramid.lower[0]) / size,
        (y - pyramid.lower[1]) / size,
        (z - pyramid.lower[2]) / size,
        out,
    )
    # its light is guessed: half of the key, most of the sky
    e = pyramid.cell
    g = level_value(pyramid, 1, x, y, z - 3 * e) - level_value(pyramid, 1, x, y, z + 3 * e)
    up = 0.5 + 0.5 * min(max(g, -1.0), 1.0)
    for m in range(3):
        out[m] *= (
            (0.25 + 0.5 * up) * stage.rig.key[m]
            + stage.rig.bounce[m]
            + up * (stage.rig.zenith[m] - stage.rig.bounce[m])
        )
    return True


@cached(**RAY)
def far_light(stage, x, y, z, d0, d1, d2, straight, blur, place, out):
    """Light from ground, sky and background along a ray that meets nothing else, into out (3,).

    straight: whether the ray goes on away from the camera, so that it sees the backdrop and not the
    soft boxes.
    """
    plane, view = stage.plane, stage.buffers
    if d2 < -1e-3 and plane.kind != NONE and z > plane.height - 4.0 * stage.pyramid.cell:
        t = max(z - plane.height, 0.0) / -d2
        if plane.kind != SHADOW:
            ground_color(plane, x + t * d0, y + t * d1, 0.002 + 0.002 * t, out)
            return
        if _seen_behind(view, x + t * d0, y + t * d1, plane.height, place, out):
            return
    if straight and view.picture:
        t = 2.0 * stage.pyramid.cell * 100.0
        if _seen_behind(view, x + t * d0, y + t * d1, z + t * d2, place, out):
            return
    if straight:
        backdrop(plane, d2, out)
    else:
        mirrored_sky(stage.rig, d0, d1, d2, blur, out)


@cached(**RAY)
def _seen_behind(view, x, y, z, place, out):
    """Light of the background's picture where a point is seen; whether it is in the picture."""
    if not project(view, x, y, z, place):
        return False
    rows, columns = view.behind.shape[0], view.behind.shape[1]
    u, v = (
        min(max(place[0] - 0.5, 0.0), columns - 1.001),
        min(max(place[1] - 0.5, 0.0), rows - 1.001),
    )
    k, j = int(u), int(v)
    a, b = u - k, v - j
    k1, j1 = min(k + 1, columns - 1), min(j + 1, rows - 1)
    for m in range(3):
        one = view.behind[j, k, m] + a * (view.behind[j, k1, m] - view.behind[j, k, m])
        two = view.behind[j1, k, m] + a * (view.behind[j1, k1, m] - view.behind[j1, k, m])
        out[m] = one + b * (two - one)
    return True


@cached(**RAY)
def absorb(medium, x, y, z, way, depth, values):
    """Add the optical depth of a way [m] around a point to depth (3,)."""
    if medium.uniform:
        for m in range(3):
            depth[m] += way * medium.mean[m]
        return
    tint = medium.tint
    trilinear_values(
        tint.values,
        (x - tint.lower[0]) / tint.cell,
        (y - tint.lower[1]) / tint.cell,
        (z - tint.lower[2]) / tint.cell,
        values,
    )
    for m in range(3):
        depth[m] += way * values[m]


@cached(**RAY)
def first_hit(field, p0, p1, p2, d0, d1, d2, near, far):
    """Way [m] to where a ray from outside enters the liquid and whether through a wall; -1 for none."""
    begin, end = clip(field.box[:3], field.box[3:], p0, p1, p2, d0, d1, d2)
    end, begin = min(end, far), max(begin, near)
    if begin >= end:
        return -1.0, False
    c = 1.0 / field.cell
    # in grid coordinates
    u0, v0, w0 = (p0 - field.lower[0]) * c, (p1 - field.lower[1]) * c, (p2 - field.lower[2]) * c
    t, end = begin * c + 1e-6, end * c
    sure, first = t, True
    for n in range(MOST_STEPS):
        if t >= end:
            if sure >= end:
                return -1.0, False
            t = end - 1e-6  # the last step may end inside
        u, v, w = u0 + t * d0, v0 + t * d1, w0 + t * d2
        way = brick_leap(field, u, v, w, d0, d1, d2, False)
        if way > 0.0:
            t += way + 1e-4
            sure, first = t, False
            continue
        if density(field, u, v, w) > 0.5:
            if first:
                return t * field.cell, True
            a, b = sure, t
            for turn in range(BISECTIONS):
                t = 0.5 * (a + b)
                if density(field, u0 + t * d0, v0 + t * d1, w0 + t * d2) > 0.5:
                    b = t
                else:
                    a = t
            return 0.5 * (a + b) * field.cell, False
        sure, first = t, False
        if t >= end - 2e-6:
            return -1.0, False
        t += STEP
    return -1.0, False


@cached(**RAY)
def _meet(stage, p, d, a, b, thick, place, out):
    """Way between a and b [m] at which a ray enters what is opaque; its light, into out (3,)."""
    for turn in range(4):
        t = 0.5 * (a + b)
        if opaque_at(stage, p[0] + t * d[0], p[1] + t * d[1], p[2] + t * d[2], thick, place, out):
            b = t
        else:
            a = t
    opaque_at(stage, p[0] + b * d[0], p[1] + b * d[1], p[2] + b * d[2], thick, place, out)
    return b


@cached(**RAY)
def _cross(field, p, d, a, b, inside):
    """Last way between a and b [m] at which a ray is still inside, or outside, of the liquid."""
    c = 1.0 / field.cell
    for turn in range(BISECTIONS):
        t = 0.5 * (a + b)
        f = density(
            field, (p[0] + t * d[0] - field.lower[0]) * c, (p[1] + t * d[1] - field.lower[1]) * c,
            (p[2] + t * d[2] - field.lower[2]) * c,
        )  # fmt: skip
        if (f > 0.5) == inside:
            a = t
        else:
            b = t
    return a


@cached(**RAY)
def follow(stage, p, d, inside, far, depth, work, out):
    """Follow a ray from p (3,) along d (3,), inside of the liquid or outside.

    p becomes where it ends. depth (3,): the optical depth of the way inside is added. work (11,):
    scratch. out (3,): light of what is met.

    Returns:
        how it ends (LEFT, CROSSED or MET), and the way [m].
    """
    medium, pyramid = stage.medium, stage.pyramid
    field = medium.field
    place, values = work[:3], work[3:]
    step, c = STEP * field.cell, 1.0 / field.cell
    thick = VISIBLE * pyramid.cell + 2.0 * step
    begin, end = clip(field.box[:3], field.box[3:], p[0], p[1], p[2], d[0], d[1], d[2])
    if begin >= end:
        begin = end = 1e30
        if inside:
            return CROSSED, 0.0
    enters, leaves = clip(pyramid.lower, pyramid.upper, p[0], p[1], p[2], d[0], d[1], d[2])
    if d[2] < 0.0:
        far = min(far, (p[2] - stage.plane.height + 0.5 * step) / -d[2] + 1e-9)
    far = max(far, 0.0)
    t = 0.3 * field.cell
    # until where is known what is there: of the surface, and of what is opaque
    surface, opaque = max(begin, t) if not inside else t, max(enters, t)
    if enters >= leaves:
        opaque = 1e30
    sure, clear, counted, end_kind = 0.0, 0.0, 0.0, LEFT
    for n in range(MOST_STEPS):
        t = min(surface, opaque)
        if inside and t >= end:
            t, end_kind = max(end, counted), CROSSED
            break
        if t >= far:
            t = far
            break
        x, y, z = p[0] + t * d[0], p[1] + t * d[1], p[2] + t * d[2]
        if inside and not medium.uniform and t > counted:
            half = 0.5 * (t - counted)
            absorb(
                medium,
                x - half * d[0],
                y - half * d[1],
                z - half * d[2],
                t - counted,
                depth,
                values,
            )
            counted = t
        if t >= opaque:
            free = leap(pyramid, x, y, z)
            if free > 0.0:
                opaque = t + free + 0.25 * pyramid.cell
                clear = t + free
            else:
                if opaque_at(stage, x, y, z, thick, place, out):
                    t, end_kind = _meet(stage, p, d, clear, t, thick, place, out), MET
                    break
                clear = t
                opaque = t + max(step, 0.5 * pyramid.cell)
            if opaque >= leaves:
                opaque = 1e30
        if t >= surface:
            if t >= end:
                surface = 1e30
                continue
            u, v, w = (x - field.lower[0]) * c, (y - field.lower[1]) * c, (z - field.lower[2]) * c
            way = brick_leap(field, u, v, w, d[0], d[1], d[2], inside)
            if way > 0.0:
                way = way * field.cell
                if inside and not medium.uniform:
                    way = min(way, 4.0 * medium.tint.cell)
                surface = t + way + 1e-4 * field.cell
                sure = t + way
            else:
                if (density(field, u, v, w) > 0.5) != inside:
                    t, end_kind = _cross(field, p, d, sure, t, inside), CROSSED
                    break
                sure = t
                surface = t + step
    if inside and t > counted:
        half = t - 0.5 * (t - counted)
        absorb(
            medium,
            p[0] + half * d[0],
            p[1] + half * d[1],
            p[2] + half * d[2],
            t - counted,
            depth,
            values,
        )
    p[0], p[1], p[2] = p[0] + t * d[0], p[1] + t * d[1], p[2] + t * d[2]
    return end_kind, t


@cached(**RAY)
def liquid_depth(medium, p0, p1, p2, d0, d1, d2, depth, values):
    """Optical depth of the liquid along a straight ray, into depth (3,); the way in it [m]."""
    field = medium.field
    depth[0] = depth[1] = depth[2] = 0.0
    begin, end = clip(field.box[:3], field.box[3:], p0, p1, p2, d0, d1, d2)
    t, total = begin + 0.05 * field.cell, 0.0
    if begin >= end:
        return 0.0
    c = 1.0 / field.cell
    step = 1.5 * field.cell
    for n in range(MOST_STEPS):
        if t >= end:
            break
        u = (p0 + t * d0 - field.lower[0]) * c
        v = (p1 + t * d1 - field.lower[1]) * c
        w = (p2 + t * d2 - field.lower[2]) * c
        out = brick_leap(field, u, v, w, d0, d1, d2, False)
        if out > 0.0:
            t += (out + 1e-4) * field.cell
            continue
        way, share = brick_leap(field, u, v, w, d0, d1, d2, True) * field.cell, 1.0
        if way <= 0.0:
            way = min(step, end - t)
            # the share of a step that is inside, linear in rho over a cell: no jumps
            mid = t + 0.5 * way
            f = density(
                field, (p0 + mid * d0 - field.lower[0]) * c, (p1 + mid * d1 - field.lower[1]) * c,
                (p2 + mid * d2 - field.lower[2]) * c,
            )  # fmt: skip
            share = min(max(0.5 + 2.0 * (f - 0.5), 0.0), 1.0)
        way = min(way, end - t)
        if not medium.uniform:
            way = min(way, 4.0 * medium.tint.cell)
        if share > 0.0:
            mid = t + 0.5 * way
            absorb(medium, p0 + mid * d0, p1 + mid * d1, p2 + mid * d2, share * way, depth, values)
            total += share * way
        t += way + 1e-6 * field.cell
    return total
