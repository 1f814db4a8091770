"""Contact of free rigid bodies among each other, with colliders and with the walls of the domain.

Points of a body's surface meet the distance field of the other. Of the points of a pair at most
four count: the deepest, and those that span the largest area. By its normal and its curvature each
moves to where the surface faces the other one, so that a ball rolls as if it had all its points.
Their impulses are in contact_sweeps.py.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.kernels.colliders.sdf_sampling import distance_from_collider, sample_collider
from vgmpi.kernels.wall_boundary import OPEN, STICK
from vgmpi.runtime.jit import array_function, device_function, kernel

from .contact_search import points_close_to_collider, points_close_to_wall
from .surface_points import ALIGNED, dot, facing_point, turned_normal

POINTS = 4  # points of a pair that count
MARGIN_CELLS = 0.1  # [cells] gap up to which points may touch in a step
LEAST_SPACING_CELLS = 0.2  # [cells] between two points of a pair
GAP_TOLERANCE_CELLS = 0.02  # [cells] difference of gaps that does not count
NO_SLIP = 1e6  # [-] friction coefficient of stick walls


class ContactPoints(NamedTuple):
    """Points in contact in a step."""

    body: np.ndarray  # (n,) free body whose point it is
    other: np.ndarray  # (n,) free body that it touches, -1: a collider or a wall
    normal: np.ndarray  # (n, 3) out of the other
    place: np.ndarray  # (n, 3) [m]
    speed: np.ndarray  # (n, 3) [m/s] of a collider's surface
    gap: np.ndarray  # (n,) [m]
    friction: np.ndarray  # (n,) [-]
    bounce: np.ndarray  # (n,) [m/s] speed of rebound
    impulse: np.ndarray  # (n, 3) [kg m/s]


def contact_points(n: int) -> ContactPoints:
    """Return a table with room for n points."""
    return ContactPoints(
        np.zeros(n, np.int64), np.zeros(n, np.int64), np.zeros((n, 3)), np.zeros((n, 3)),
        np.zeros((n, 3)), np.zeros(n), np.zeros(n), np.zeros(n), np.zeros((n, 3)),
    )  # fmt: skip


class BodyTable(NamedTuple):
    """Free bodies as they are placed in a step."""

    rows: np.ndarray  # (m,) numbers of their colliders
    x: np.ndarray  # (m, 3) [m] centers
    rotations: np.ndarray  # (m, 3, 3) from the start
    radius: np.ndarray  # (m,) [m] largest distance of a point from the center
    friction: np.ndarray  # (m,) [-] Coulomb coefficients
    ignored: np.ndarray  # (m, colliders) pairs that joints keep from contact, (m, 0) without


@device_function
def _farthest(candidates, count, chosen, n, least_spacing):
    """Return the candidate that widens the chosen points most, -1 if none does.

    Args:
        candidates: Place and gap of each candidate, shape (m, 4).
        count: Number of candidates.
        chosen: Rows that are chosen, shape (POINTS,).
        n: Number of chosen rows.
        least_spacing: Spacing [m] below which a candidate is no other point.
    """
    best, row = least_spacing * least_spacing, -1
    for q in range(count):
        closest = np.inf
        for k in range(n):
            d = 0.0
            for c in range(3):
                d += (candidates[q, c] - candidates[chosen[k], c]) ** 2
            closest = min(closest, d)
        if closest > best * (1.0 + 1e-6):  # the first one of equals
            best, row = closest, q
    return row


@array_function
def _first_point(candidates, count, tolerance):
    """Return the outermost of the deepest candidates.

    Args:
        candidates: Place and gap of each candidate, shape (m, 4).
        count: Number of candidates.
        tolerance: Difference of gaps that does not count [m].
    """
    middle, deepest = np.zeros(3), np.inf
    for q in range(count):
        deepest = min(deepest, candidates[q, 3])
        for c in range(3):
            middle[c] += candidates[q, c] / count
    best, row = -1.0, 0
    for q in range(count):
        d = 0.0
        for c in range(3):
            d += (candidates[q, c] - middle[c]) ** 2
        if candidates[q, 3] <= deepest + tolerance and d > best * (1.0 + 1e-6):
            best, row = d, q
    return row


@array_function
def _store_points(
    points, total, body, other, candidates, normals, speeds, count, friction, least_spacing
):
    """Store the points of a pair that count; return the number of points total so far."""
    chosen = np.zeros(POINTS, np.int64)
    for k in range(min(POINTS, count)):
        if k == 0:
            row = _first_point(
                candidates, count, GAP_TOLERANCE_CELLS / LEAST_SPACING_CELLS * least_spacing
            )
        else:
            row = _farthest(candidates, count, chosen, k, least_spacing)
            if row < 0:
                break
        chosen[k] = row
        if total < len(points.gap):
            points.body[total], points.other[total] = body, other
            points.gap[total], points.friction[total] = candidates[row, 3], friction
            for c in range(3):
                points.place[total, c] = candidates[row, c]
                points.normal[total, c] = normals[row, c]
                points.speed[total, c] = speeds[row, c]
        total += 1
    return total


@kernel
def find_wall_contacts(surface, search, bodies, size, walls, reach, dx, points, total):
    """Find the points of free bodies that touch walls; return the number of points so far.

    Args:
        surface: SurfacePoints.
        search: ContactSearch.
        bodies: BodyTable.
        size: Size of the domain, shape (3,) [m].
        walls: Walls of the domain.
        reach: Gap up to which points may touch [m].
        dx: Cell size [m].
        points: ContactPoints (out).
        total: Number of points so far.
    """
    facing, own, row = np.zeros(3), np.zeros(3), np.zeros(3)
    x, rotations = bodies.x, bodies.rotations
    close_points = np.zeros(np.diff(surface.first).max(), np.int64)
    for k in range(len(x)):
        for a in range(3):
            for side in range(2):
                kind = walls.kinds_for_surfaces[a, side]
                sign, count, r = 1.0 - 2.0 * side, 0, rotations[k, a]
                start = sign * (x[k, a] - side * size[a])
                if kind == OPEN or start - bodies.radius[k] > reach + dx:
                    continue
                for c in range(3):
                    row[c] = sign * r[c]
                n = points_close_to_wall(search, k, row, start, reach, dx, close_points)
                if n == 0:
                    continue
                candidates, normals = np.zeros((n, 4)), np.zeros((n, 3))
                speeds = np.zeros((n, 3))
                for p in close_points[:n]:
                    gap = sign * (x[k, a] + dot(r, surface.place[p]) - side * size[a])
                    if gap > reach:
                        continue
                    for c in range(3):
                        facing[c] = -sign * r[c]
                    if not facing_point(surface, p, facing, dx, own):
                        continue
                    for c in range(3):
                        candidates[count, c] = x[k, c] + dot(rotations[k, c], own)
                        normals[count, c] = sign * (a == c)
                    candidates[count, 3] = sign * (candidates[count, a] - side * size[a])
                    count += 1
                mu = walls.friction[a, side]
                if kind == STICK:
                    mu = NO_SLIP
                total = _store_points(
                    points, total, k, -1, candidates, normals, speeds, count, mu,
                    LEAST_SPACING_CELLS * dx,
                )  # fmt: skip
    return total


@kernel
def find_body_contacts(
    surface, search, pairs, bodies, movers, dt, number_of, reach, dx, points, total
):  # fmt: skip
    """Find the points of free bodies that touch colliders or other free bodies.

    Args:
        surface, search, bodies, reach, dx, points, total: See `find_wall_contacts`.
        pairs: Pairs that may touch, of `find_pairs`.
        movers: Sampled colliders, SampledSdf.
        dt: Time step [s].
        number_of: Number of the free body of each collider, -1 if it is not free.
    """
    place, sample, speed = np.zeros(3), np.zeros(4), np.zeros(3)
    facing, own = np.zeros(3), np.zeros(3)
    x, rotations, friction = bodies.x, bodies.rotations, bodies.friction
    close_points = np.zeros(np.diff(surface.first).max(), np.int64)
    scratch = np.zeros(3), np.zeros(4), np.zeros(3), np.zeros(3)
    for pair in pairs:
        k, m = pair // len(number_of), pair % len(number_of)
        other, count = number_of[m], 0
        if _cannot_meet(bodies, k, m, other, reach):
            continue
        n = points_close_to_collider(search, bodies, k, movers, m, reach, dx, scratch, close_points)
        if n == 0:
            continue
        candidates, normals, speeds = np.zeros((n, 4)), np.zeros((n, 3)), np.zeros((n, 3))
        is_face = np.zeros(n, np.bool_)
        for p in close_points[:n]:
            for c in range(3):
                place[c] = x[k, c] + dot(rotations[k, c], surface.place[p])
            if distance_from_collider(movers, m, place, own, sample) > reach:
                continue
            if not sample_collider(movers, m, place, dt, sample, speed):
                continue
            for c in range(3):
                r = rotations[k]
                facing[c] = -(r[0, c] * sample[0] + r[1, c] * sample[1] + r[2, c] * sample[2])
            if not facing_point(surface, p, facing, dx, own):
                continue
            for c in range(3):
                place[c] = x[k, c] + dot(rotations[k, c], own)
            if not sample_collider(movers, m, place, dt, sample, speed):
                continue
            for c in range(3):
                candidates[count, c] = place[c]
                normals[count, c] = sample[c]
                speeds[count, c] = speed[c] if other < 0 else 0.0
            candidates[count, 3] = sample[3]
            is_face[count] = dot(facing, surface.normal[p]) > ALIGNED
            if is_face[count]:  # the own normal is exact, that of the other's lattice is not
                turned_normal(surface, p, own, rotations[k], normals[count])
            count += 1
        count = _drop_edges(candidates, normals, speeds, is_face, count, dx)
        mu = friction[k] if other < 0 else max(friction[k], friction[other])
        total = _store_points(
            points, total, k, other, candidates, normals, speeds, count, mu,
            LEAST_SPACING_CELLS * dx,
        )  # fmt: skip
    return total


@device_function
def _cannot_meet(bodies, k, m, other, reach):
    """Return whether a joint or their distance keeps body k and collider m from contact."""
    if bodies.ignored.size > 0 and bodies.ignored[k, m]:
        return True
    return other >= 0 and _are_apart(bodies, k, other, reach)


@device_function
def _are_apart(bodies, a, b, reach):
    """Return whether the spheres around two bodies are farther apart than the reach [m]."""
    d = 0.0
    for c in range(3):
        d += (bodies.x[a, c] - bodies.x[b, c]) ** 2
    return d > (bodies.radius[a] + bodies.radius[b] + reach) ** 2


@device_function
def _drop_edges(candidates, normals, speeds, is_face, count, dx):
    """Drop points at edges if two faces lie on each other; return the number of the others.

    The distance of a body has no normal at its edges.

    Args:
        candidates, normals, speeds: Candidates (in/out), shapes (m, 4), (m, 3), (m, 3).
        is_face: Whether the surfaces at each face each other, shape (m,).
        count: Number of candidates.
        dx: Cell size [m].
    """
    deepest, deepest_face, left = np.inf, np.inf, 0
    for q in range(count):
        deepest = min(deepest, candidates[q, 3])
        if is_face[q]:
            deepest_face = min(deepest_face, candidates[q, 3])
    if deepest_face > deepest + GAP_TOLERANCE_CELLS * dx:
        return count
    for q in range(count):
        if is_face[q]:
            for c in range(3):
                candidates[left, c] = candidates[q, c]
                normals[left, c], speeds[left, c] = normals[q, c], speeds[q, c]
            candidates[left, 3] = candidates[q, 3]
            left += 1
    return left
