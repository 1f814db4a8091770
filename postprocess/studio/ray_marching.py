"""Ray marching through a liquid's density field and past opaque surfaces.

A ray skips blocks that are empty, or full, and space without opaque surfaces; near a surface it
goes in steps of less than a cell and finds the crossing by regula falsi. Points p and directions d
are arrays (3,) or components p0, p1, p2 [m] and d0, d1, d2; grid coordinates u, v, w are in cells.
"""

import numpy as np

from vgmpi.runtime.compile_cache import njit_cached

from .compile_options import LEAF, RAY
from .cone_occlusion import clip, leap
from .density_field import density
from .environment_radiance import opaque_at
from .value_grid import trilinear_values

STEP = 0.8  # [cells] step at the surface
ABSORBING = 4.0  # [cells of the tint] longest part of a ray with one absorption
LONGER = 2.0  # [-] relative growth of the step per density difference to the surface
SMOOTH = 1.0  # [cells] least half width of the differences of a normal
SECANTS = 6  # [-] iterations in search of a crossing
CROSSING_TOLERANCE = 1e-3  # [-] tolerance of the density at a crossing
MAX_STEPS = 4000  # [-] of a ray
LEFT, CROSSED, MET = 0, 1, 2  # end of a ray: nowhere, at the surface, at an opaque surface
VISIBLE = 2.5  # [cells of the pyramid] least thickness of visible opaque surfaces


@njit_cached(**RAY)
def in_box(box, x, y, z):
    """Return whether a point lies in a box.

    Args:
        box, x, y, z: Corners, shape (6,) [m], and point [m].
    """
    return (
        x >= box[0] and y >= box[1] and z >= box[2] and x <= box[3] and y <= box[4] and z <= box[5]
    )


@njit_cached(**LEAF)
def inverse(d):
    """Return the inverse of a component of a direction, 0 for none."""
    return 1.0 / d if abs(d) > 1e-9 else 0.0


@njit_cached(**LEAF)
def brick_leap(field, u, v, w, r0, r1, r2, inside):
    """Return a distance along which a ray surely stays outside, or inside, of the liquid.

    Args:
        field, inside: The field, and whether the ray is in the liquid.
        u, v, w: Point of the ray.
        r0, r1, r2: Inverse components of its direction (`inverse`).

    Returns:
        Distance [cells], 0 near the surface.
    """
    n = field.bricks.shape
    if not (u >= 0.0 and v >= 0.0 and w >= 0.0):
        return 0.0
    i, j, k = int(u) >> 2, int(v) >> 2, int(w) >> 2
    if i >= n[0] or j >= n[1] or k >= n[2]:
        return 0.0
    clearance = int(field.bricks[i, j, k])
    if not inside:
        clearance = -clearance
    if clearance <= 0:
        return 0.0
    best = 1e9
    if r0 != 0.0:
        side = ((i + clearance) << 2) if r0 > 0.0 else ((i - clearance + 1) << 2)
        best = min(best, (side - u) * r0)
    if r1 != 0.0:
        side = ((j + clearance) << 2) if r1 > 0.0 else ((j - clearance + 1) << 2)
        best = min(best, (side - v) * r1)
    if r2 != 0.0:
        side = ((k + clearance) << 2) if r2 > 0.0 else ((k - clearance + 1) << 2)
        best = min(best, (side - w) * r2)
    return max(best, 0.0)


@njit_cached(**LEAF)
def rho_at(field, x, y, z):
    """Return the density at a point, 0 outside of the walls.

    Args:
        field, x, y, z: The field and the point [m].
    """
    if not in_box(field.box, x, y, z):
        return 0.0
    c = 1.0 / field.cell
    return density(
        field, (x - field.lower[0]) * c, (y - field.lower[1]) * c, (z - field.lower[2]) * c
    )


@njit_cached(**RAY)
def surface_normal(field, p, width, n):
    """Write the outward unit normal of the liquid to n.

    On a wall that cuts the interior it is the wall's normal, at the rim of both a blend.

    Args:
        field, p: The field and the point [m].
        width: Least half width of the differences [m].
        n: (out) Normal, shape (3,).
    """
    c = 1.0 / field.cell
    x, y, z = (p[0] - field.lower[0]) * c, (p[1] - field.lower[1]) * c, (p[2] - field.lower[2]) * c
    r = max(SMOOTH, width * c)
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


@njit_cached(**LEAF)
def absorb(medium, p, d, begin, end, share, scatters, depth, values):
    """Add the optical depth of a part of a ray to depth (3,).

    Args:
        medium, p, d, begin, end: Liquid, ray and distances of the part [m].
        share: Fraction of the part in the liquid.
        scatters: Fraction of the scattering that counts as loss.
        depth, values: (in/out) Optical depth, shape (3,), and scratch, shape (8,).
    """
    path_length = share * (end - begin)
    if medium.uniform:
        for m in range(3):
            depth[m] += path_length * (medium.mean[m] + scatters * medium.mean[7])
        return
    tint, middle = medium.tint, 0.5 * (begin + end)
    c = 1.0 / tint.cell
    x = (p[0] + middle * d[0] - tint.lower[0]) * c
    y = (p[1] + middle * d[1] - tint.lower[1]) * c
    z = (p[2] + middle * d[2] - tint.lower[2]) * c
    if scatters == 0.0:  # the other channels are not needed
        trilinear_values(tint.values, x, y, z, 3, values)
        for m in range(3):
            depth[m] += path_length * values[m]
        return
    trilinear_values(tint.values, x, y, z, 8, values)
    for m in range(3):
        depth[m] += path_length * (values[m] + scatters * values[7])


@njit_cached(**RAY)
def crossing(field, u, v, w, d0, d1, d2, a, b, inside):
    """Return the distance at which a ray crosses the surface, just before it, by regula falsi.

    The method is the Illinois variant; a is returned if it does not end before the surface.

    Args:
        field, u, v, w, d0, d1, d2: The field and the ray in grid coordinates.
        a, b, inside: Bracket [cells], and whether the ray is in the liquid at a.
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
            if f > -CROSSING_TOLERANCE:
                break
    return a


@njit_cached(**RAY)
def first_hit(field, p0, p1, p2, d0, d1, d2, min_distance, max_distance):
    """Find the entry of a ray from outside into the liquid.

    Args:
        field, p0, p1, p2, d0, d1, d2: The field and the ray.
        min_distance, max_distance: Range of the search [m].

    Returns:
        Distance [m], -1 for none, and whether the ray enters through a wall.
    """
    begin, end = clip(field.box[:3], field.box[3:], p0, p1, p2, d0, d1, d2)
    end, begin = min(end, max_distance), max(begin, min_distance)
    if begin >= end:
        return -1.0, False
    c = 1.0 / field.cell
    # origin in grid coordinates
    u0, v0, w0 = (p0 - field.lower[0]) * c, (p1 - field.lower[1]) * c, (p2 - field.lower[2]) * c
    t, end = begin * c + 1e-6, end * c
    bracket, first = t, True
    r0, r1, r2 = inverse(d0), inverse(d1), inverse(d2)
    for _ in range(MAX_STEPS):
        if t >= end:
            if bracket >= end:
                return -1.0, False
            t = end - 1e-6  # the last step may end in the liquid
        u, v, w = u0 + t * d0, v0 + t * d1, w0 + t * d2
        skip = brick_leap(field, u, v, w, r0, r1, r2, False)
        if skip > 0.0:
            t += skip + 1e-4
            bracket, first = t, False
            continue
        rho = density(field, u, v, w)
        if rho > 0.5:
            if first:
                return t * field.cell, True
            t = crossing(field, u0, v0, w0, d0, d1, d2, bracket, t, False)
            return t * field.cell, False
        bracket, first = t, False
        if t >= end - 2e-6:
            return -1.0, False
        t += STEP * (1.0 + LONGER * abs(rho - 0.5))
    return -1.0, False


@njit_cached(**RAY)
def _opaque_hit(stage, p, d, a, b, thickness, pixel, out):
    """Return the distance in a..b [m] to an opaque surface, and write its light to out (3,)."""
    for _ in range(4):
        t = 0.5 * (a + b)
        if opaque_at(
            stage, p[0] + t * d[0], p[1] + t * d[1], p[2] + t * d[2], thickness, pixel, out
        ):
            b = t
        else:
            a = t
    opaque_at(stage, p[0] + b * d[0], p[1] + b * d[1], p[2] + b * d[2], thickness, pixel, out)
    return b


@njit_cached(**RAY)
def _liquid_crossing(field, p, d, a, b, inside):
    """Return the last distance in a..b [m] before a ray crosses the liquid's surface."""
    c = 1.0 / field.cell
    return field.cell * crossing(
        field, (p[0] - field.lower[0]) * c, (p[1] - field.lower[1]) * c,
        (p[2] - field.lower[2]) * c, d[0], d[1], d[2], a * c, b * c, inside,
    )  # fmt: skip


@njit_cached(**LEAF)
def _test_opaque(stage, p, d, t, clear, step, pixel, out):
    """Test for an opaque surface at the distance t [m].

    Returns:
        Whether it is hit, the distance, the bound of the space known to be empty, and the distance
        of the next test [m].
    """
    pyramid = stage.pyramid
    x, y, z = p[0] + t * d[0], p[1] + t * d[1], p[2] + t * d[2]
    skip = leap(pyramid, x, y, z)
    if skip > 0.0:
        return False, t, t + skip, t + skip + 0.25 * pyramid.cell
    thickness = VISIBLE * pyramid.cell + 2.0 * step
    if opaque_at(stage, x, y, z, thickness, pixel, out):
        return True, _opaque_hit(stage, p, d, clear, t, thickness, pixel, out), clear, t
    return False, t, t, t + max(step, 0.5 * pyramid.cell)


@njit_cached(**LEAF)
def _test_surface(medium, p, d, r, t, bracket, inside, step):
    """Test for the liquid's surface at the distance t [m]. r: inverse components of d.

    Returns:
        Whether it is crossed, the distance, the bound of the space known to be free of it, and the
        distance of the next test [m].
    """
    field = medium.field
    c = 1.0 / field.cell
    u = (p[0] + t * d[0] - field.lower[0]) * c
    v = (p[1] + t * d[1] - field.lower[1]) * c
    w = (p[2] + t * d[2] - field.lower[2]) * c
    skip = brick_leap(field, u, v, w, r[0], r[1], r[2], inside) * field.cell
    if skip > 0.0:
        if inside and not medium.uniform:
            skip = min(skip, ABSORBING * medium.tint.cell)
        return False, t, t + skip, t + skip + 1e-4 * field.cell
    rho = density(field, u, v, w)
    if (rho > 0.5) != inside:
        return True, _liquid_crossing(field, p, d, bracket, t, inside), bracket, t
    return False, t, t, t + step * (1.0 + LONGER * abs(rho - 0.5))


@njit_cached(**RAY)
def follow(stage, p, d, inside, max_distance, depth, work, out):
    """Follow a ray inside of the liquid or outside until it ends, and move p there.

    Args:
        stage, p, d: Scene, origin (in/out) [m] and direction.
        inside, max_distance: Whether the ray is in the liquid; end of the search [m].
        depth, work, out: Optical depth (in/out), scratch (11,), light of what is hit (out).

    Returns:
        The kind of end (LEFT, CROSSED or MET) and the distance [m].
    """
    medium, pyramid = stage.medium, stage.pyramid
    field, pixel, values = medium.field, work[:3], work[3:]
    step = STEP * field.cell
    begin, end = clip(field.box[:3], field.box[3:], p[0], p[1], p[2], d[0], d[1], d[2])
    if begin >= end:
        begin = end = 1e30
        if inside:
            return CROSSED, 0.0
    entry, exit_distance = clip(pyramid.lower, pyramid.upper, p[0], p[1], p[2], d[0], d[1], d[2])
    if d[2] < 0.0:
        max_distance = min(max_distance, (p[2] - stage.plane.height + 0.5 * step) / -d[2] + 1e-9)
    max_distance, t = max(max_distance, 0.0), 0.3 * field.cell
    # distances of the next tests for the liquid's surface and for opaque surfaces
    surface = t if inside else max(begin, t)
    opaque = max(entry, t) if entry < exit_distance else 1e30
    bracket, clear, counted, end_kind = 0.0, 0.0, 0.0, LEFT
    inverses = inverse(d[0]), inverse(d[1]), inverse(d[2])
    for _ in range(MAX_STEPS):
        t = min(surface, opaque)
        if inside and t >= end:
            t, end_kind = max(end, counted), CROSSED
            break
        if t >= max_distance:
            t = max_distance
            break
        if inside and not medium.uniform and t > counted + ABSORBING * medium.tint.cell:
            absorb(medium, p, d, counted, t, 1.0, 0.0, depth, values)
            counted = t
        if t >= opaque:
            met, t, clear, opaque = _test_opaque(stage, p, d, t, clear, step, pixel, out)
            if met:
                end_kind = MET
                break
            if opaque >= exit_distance:
                opaque = 1e30
        if t >= surface:
            if t >= end:
                surface = 1e30
                continue
            crossed, t, bracket, surface = _test_surface(
                medium, p, d, inverses, t, bracket, inside, step
            )
            if crossed:
                end_kind = CROSSED
                break
    if inside and t > counted:
        absorb(medium, p, d, counted, t, 1.0, 0.0, depth, values)
    p[0], p[1], p[2] = p[0] + t * d[0], p[1] + t * d[1], p[2] + t * d[2]
    return end_kind, t
