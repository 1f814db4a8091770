"""Rays through a liquid's density field and past what is opaque.

A ray leaps over blocks that are empty, or full, and over space where nothing opaque can be; near a
surface it goes in steps of less than a cell and finds the crossing by bisection.
"""

import numpy as np

from vgmpi.caching import cached
from vgmpi.studio.compiling import RAY
from vgmpi.studio.field import density
from vgmpi.studio.grid import trilinear_values
from vgmpi.studio.occlusion import clip, leap
from vgmpi.studio.surroundings import opaque_at

STEP = 0.8  # cells, at the surface
LONGER = 2.0  # shares of it, per density off the surface's
SMOOTH = 1.0  # cells: from which the normal of the surface is taken, at least
SECANTS = 6  # to find a crossing at most
NEAR = 1e-3  # of the density, to 1/2, that is a crossing
MOST_STEPS = 4000
LEFT, CROSSED, MET = 0, 1, 2  # how a way ends: nowhere, at the surface, at something opaque
VISIBLE = 2.5  # cells of the pyramid: how thick what is seen is at least


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
def absorb(medium, p, d, begin, end, share, scatters, depth, values):
    """Add the optical depth of a share of a ray between two ways [m] to depth (3,).

    scatters: share of what the liquid scatters that is lost too.
    """
    way = share * (end - begin)
    if medium.uniform:
        for m in range(3):
            depth[m] += way * (medium.mean[m] + scatters * medium.mean[7])
        return
    tint, middle = medium.tint, 0.5 * (begin + end)
    trilinear_values(
        tint.values,
        (p[0] + middle * d[0] - tint.lower[0]) / tint.cell,
        (p[1] + middle * d[1] - tint.lower[1]) / tint.cell,
        (p[2] + middle * d[2] - tint.lower[2]) / tint.cell,
        8,
        values,
    )
    for m in range(3):
        depth[m] += way * (values[m] + scatters * values[7])


@cached(**RAY)
def crossing(field, u, v, w, d0, d1, d2, a, b, inside):
    """Way [cells] between a and b at which a ray crosses the surface, just before it.

    u, v, w: grid coordinates of way 0. inside: whether it is in the liquid at a. By regula falsi
    (Illinois): where it does not end on the near side of the surface, a is returned.
    """
    sign = -1.0 if inside else 1.0
    fa = sign * (density(field, u + a * d0, v + a * d1, w + a * d2) - 0.5)
    fb = sign * (density(field, u + b * d0, v + b * d1, w + b * d2) - 0.5)
    if fa >= 0.0 or fb <= 0.0:
        return a
    for _ in range(SECANTS):
        t = (a * fb - b * fa) / (fb - fa)
        f = sign * (density(field, u + t * d0, v + t * d1, w + t * d2) - 0.5)
        if f > 0.0:
            b, fb, fa = t, f, 0.5 * fa
        else:
            a, fa, fb = t, f, 0.5 * fb
            if f > -NEAR:
                break
    return a


@cached(**RAY)
def first_hit(field, p0, p1, p2, d0, d1, d2, near, far):
    """Way [m] to where a ray from outside enters the liquid and whether through a wall; -1 for
    none."""
    begin, end = clip(field.box[:3], field.box[3:], p0, p1, p2, d0, d1, d2)
    end, begin = min(end, far), max(begin, near)
    if begin >= end:
        return -1.0, False
    c = 1.0 / field.cell
    # in grid coordinates
    u0, v0, w0 = (p0 - field.lower[0]) * c, (p1 - field.lower[1]) * c, (p2 - field.lower[2]) * c
    t, end = begin * c + 1e-6, end * c
    sure, first = t, True
    for _ in range(MOST_STEPS):
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
        rho = density(field, u, v, w)
        if rho > 0.5:
            if first:
                return t * field.cell, True
            t = crossing(field, u0, v0, w0, d0, d1, d2, sure, t, False)
            return t * field.cell, False
        sure, first = t, False
        if t >= end - 2e-6:
            return -1.0, False
        t += STEP * (1.0 + LONGER * abs(rho - 0.5))
    return -1.0, False


@cached(**RAY)
def _meet(stage, p, d, a, b, thick, place, out):
    """Way between a and b [m] at which a ray enters what is opaque; its light, into out (3,)."""
    for _ in range(4):
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
    return field.cell * crossing(
        field, (p[0] - field.lower[0]) * c, (p[1] - field.lower[1]) * c,
        (p[2] - field.lower[2]) * c, d[0], d[1], d[2], a * c, b * c, inside,
    )  # fmt: skip


@cached(**RAY)
def _ask_opaque(stage, p, d, t, clear, step, place, out):
    """Look for something opaque at a way t [m].

    Returns:
        whether it is met, the way there, up to where nothing is known to be, and the way at which
        to
        look again.
    """
    pyramid = stage.pyramid
    x, y, z = p[0] + t * d[0], p[1] + t * d[1], p[2] + t * d[2]
    free = leap(pyramid, x, y, z)
    if free > 0.0:
        return False, t, t + free, t + free + 0.25 * pyramid.cell
    thick = VISIBLE * pyramid.cell + 2.0 * step
    if opaque_at(stage, x, y, z, thick, place, out):
        return True, _meet(stage, p, d, clear, t, thick, place, out), clear, t
    return False, t, t, t + max(step, 0.5 * pyramid.cell)


@cached(**RAY)
def _ask_surface(medium, p, d, t, sure, inside, step):
    """Look for the liquid's surface at a way t [m].

    Returns:
        whether it is crossed, the way there, up to where it is known not to be, and the way at
        which
        to look again.
    """
    field = medium.field
    c = 1.0 / field.cell
    u = (p[0] + t * d[0] - field.lower[0]) * c
    v = (p[1] + t * d[1] - field.lower[1]) * c
    w = (p[2] + t * d[2] - field.lower[2]) * c
    way = brick_leap(field, u, v, w, d[0], d[1], d[2], inside) * field.cell
    if way > 0.0:
        if inside and not medium.uniform:
            way = min(way, 4.0 * medium.tint.cell)
        return False, t, t + way, t + way + 1e-4 * field.cell
    rho = density(field, u, v, w)
    if (rho > 0.5) != inside:
        return True, _cross(field, p, d, sure, t, inside), sure, t
    return False, t, t, t + step * (1.0 + LONGER * abs(rho - 0.5))


@cached(**RAY)
def follow(stage, p, d, inside, far, depth, work, out):
    """Follow a ray from p (3,) along d (3,), inside of the liquid or outside.

    p becomes where it ends. depth (3,): the optical depth of the way inside is added. work (11,):
    scratch. out (3,): light of what is met.

    Returns:
        how it ends (LEFT, CROSSED or MET), and the way [m].
    """
    medium, pyramid = stage.medium, stage.pyramid
    field, place, values = medium.field, work[:3], work[3:]
    step = STEP * field.cell
    begin, end = clip(field.box[:3], field.box[3:], p[0], p[1], p[2], d[0], d[1], d[2])
    if begin >= end:
        begin = end = 1e30
        if inside:
            return CROSSED, 0.0
    enters, leaves = clip(pyramid.lower, pyramid.upper, p[0], p[1], p[2], d[0], d[1], d[2])
    if d[2] < 0.0:
        far = min(far, (p[2] - stage.plane.height + 0.5 * step) / -d[2] + 1e-9)
    far, t = max(far, 0.0), 0.3 * field.cell
    # the ways at which to look for the surface, and for what is opaque
    surface = t if inside else max(begin, t)
    opaque = max(enters, t) if enters < leaves else 1e30
    sure, clear, counted, how = 0.0, 0.0, 0.0, LEFT
    for _ in range(MOST_STEPS):
        t = min(surface, opaque)
        if inside and t >= end:
            t, how = max(end, counted), CROSSED
            break
        if t >= far:
            t = far
            break
        if inside and not medium.uniform and t > counted + medium.tint.cell:
            absorb(medium, p, d, counted, t, 1.0, 0.0, depth, values)
            counted = t
        if t >= opaque:
            met, t, clear, opaque = _ask_opaque(stage, p, d, t, clear, step, place, out)
            if met:
                how = MET
                break
            if opaque >= leaves:
                opaque = 1e30
        if t >= surface:
            if t >= end:
                surface = 1e30
                continue
            crossed, t, sure, surface = _ask_surface(medium, p, d, t, sure, inside, step)
            if crossed:
                how = CROSSED
                break
    if inside and t > counted:
        absorb(medium, p, d, counted, t, 1.0, 0.0, depth, values)
    p[0], p[1], p[2] = p[0] + t * d[0], p[1] + t * d[1], p[2] + t * d[2]
    return how, t


@cached(**RAY)
def liquid_depth(medium, p, d, depth, values):
    """Optical depth of the liquid, with what it scatters, along a straight ray from p (3,) along
    d (3,), into depth (3,).

    values: (8,) scratch. Returns the way in the liquid [m].
    """
    field = medium.field
    depth[0] = depth[1] = depth[2] = 0.0
    begin, end = clip(field.box[:3], field.box[3:], p[0], p[1], p[2], d[0], d[1], d[2])
    t, total = begin + 0.05 * field.cell, 0.0
    c = 1.0 / field.cell
    for _ in range(MOST_STEPS):
        if t >= end:
            break
        u = (p[0] + t * d[0] - field.lower[0]) * c
        v = (p[1] + t * d[1] - field.lower[1]) * c
        w = (p[2] + t * d[2] - field.lower[2]) * c
        outside = brick_leap(field, u, v, w, d[0], d[1], d[2], False)
        if outside > 0.0:
            t += (outside + 1e-4) * field.cell
            continue
        way, share = brick_leap(field, u, v, w, d[0], d[1], d[2], True) * field.cell, 1.0
        if way <= 0.0:
            way = min(1.5 * field.cell, end - t)
            # the share of a step that is inside, linear in rho over a cell: no jumps
            h = 0.5 * way * c
            f = density(field, u + h * d[0], v + h * d[1], w + h * d[2])
            share = min(max(0.5 + 2.0 * (f - 0.5), 0.0), 1.0)
        way = min(way, end - t)
        if not medium.uniform:
            way = min(way, 4.0 * medium.tint.cell)
        if share > 0.0:
            absorb(medium, p, d, t, t + way, share, 1.0, depth, values)
            total += share * way
        t += way + 1e-6 * field.cell
    return total
