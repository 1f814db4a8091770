"""Impulses of rigid bodies that touch, by sweeps over their points in a fixed order.

References:
    Catto (2005): Iterative dynamics with temporal coherence. Game Developers Conference.
"""

import numpy as np

from vgmpi.runtime.jit import array_function, device_function, kernel

from .free_bodies import inverse_times
from .surface_points import quadratic_form

MAX_SWEEPS = 50
TOLERANCE = 1e-9  # [-] change of an impulse in a sweep, over the largest one, at which sweeps end
RELEASE_RATE = 0.05  # [-] part of an overlap that is let out in a step
LEAST_SPREAD = 1e-3  # [-] keeps the root of two equal mobilities away from rounding errors
REBOUND_SPEED = 0.02  # [m/s] approach above which bodies rebound


@device_function
def _velocity_at(v, k, x, place, out, sign):
    """Add sign times the velocity of a body's point to `out`, shape (3,)."""
    a, b, c = place[0] - x[k, 0], place[1] - x[k, 1], place[2] - x[k, 2]
    w = v[k]
    out[0] += sign * (w[0] + w[4] * c - w[5] * b)
    out[1] += sign * (w[1] + w[5] * a - w[3] * c)
    out[2] += sign * (w[2] + w[3] * b - w[4] * a)


@device_function
def _add_mobility(k, x, place, mass, inertia, turn, w, out):
    """Add a point's change of velocity per impulse to `out`, shape (3, 3); turn, w: scratch."""
    r0, r1, r2 = place[0] - x[k, 0], place[1] - x[k, 1], place[2] - x[k, 2]
    for c in range(3):
        turn[0] = (r1 if c == 2 else 0.0) - (r2 if c == 1 else 0.0)
        turn[1] = (r2 if c == 0 else 0.0) - (r0 if c == 2 else 0.0)
        turn[2] = (r0 if c == 1 else 0.0) - (r1 if c == 0 else 0.0)
        inverse_times(inertia[k], turn, w)
        out[0, c] += w[1] * r2 - w[2] * r1
        out[1, c] += w[2] * r0 - w[0] * r2
        out[2, c] += w[0] * r1 - w[1] * r0
        out[c, c] += 1.0 / mass[k]


@device_function
def _push(v, k, x, place, mass, inertia, turn, w, impulse, sign):
    """Change the velocities of a body by an impulse at a point; turn, w: scratch."""
    r0, r1, r2 = place[0] - x[k, 0], place[1] - x[k, 1], place[2] - x[k, 2]
    turn[0] = r1 * impulse[2] - r2 * impulse[1]
    turn[1] = r2 * impulse[0] - r0 * impulse[2]
    turn[2] = r0 * impulse[1] - r1 * impulse[0]
    inverse_times(inertia[k], turn, w)
    for c in range(3):
        v[k, c] += sign * impulse[c] / mass[k]
        v[k, 3 + c] += sign * w[c]


@kernel
def solve_contacts(
    count, points, before_count, points_before, spacing, x, v, mass, inertia, restitution, dt
):
    """Find the impulses at the points by sweeps, and change the bodies' velocities.

    Args:
        count: Number of points.
        points: ContactPoints; their impulses are set (in/out).
        before_count, points_before: Those of the last step, from whose impulses the sweeps start.
        spacing: Distance [m] up to which a point of the last step is the same one.
        x: Centers, shape (m, 3) [m].
        v: Velocities and angular velocities (in/out), shape (m, 6).
        mass: Masses, shape (m,) [kg].
        inertia: Inertia tensors in the domain's axes, shape (m, 3, 3) [kg m2].
        restitution: Coefficients of restitution of the bodies, shape (m,).
        dt: Time step [s].
    """
    u, turn, w = np.zeros(3), np.zeros(3), np.zeros(3)
    mobility = np.zeros((count, 3, 3))
    start_impulses(
        count, points, before_count, points_before, spacing, x, v, mass, inertia, restitution, dt,
        mobility,
    )  # fmt: skip
    for _ in range(MAX_SWEEPS):
        max_change, max_impulse = sweep_points(
            count, points, mobility, x, v, mass, inertia, dt, u, turn, w
        )
        if max_change <= TOLERANCE * max_impulse:
            break


@array_function
def start_impulses(
    count, points, before_count, points_before, spacing, x, v, mass, inertia, restitution, dt,
    mobility,
):  # fmt: skip
    """Give the points the impulses of the last step, and find rebounds and mobilities.

    Args:
        count, points, before_count, points_before, spacing, x, v, mass, inertia, restitution, dt:
            See `solve_contacts`.
        mobility: Change of the velocity at each point per impulse (out), shape (count, 3, 3).
    """
    u, turn, w = np.zeros(3), np.zeros(3), np.zeros(3)
    heads, following = _chain_by_body(before_count, points_before, len(mass))
    for q in range(count):
        a, b, n = points.body[q], points.other[q], points.normal[q]
        _slip_at(points, q, v, x, u)
        normal_part = u[0] * n[0] + u[1] * n[1] + u[2] * n[2]
        e = restitution[a] if b < 0 else max(restitution[a], restitution[b])
        touches = points.gap[q] + dt * normal_part < 0.0
        points.bounce[q] = 0.0
        if normal_part < -REBOUND_SPEED and touches:
            points.bounce[q] = -e * normal_part
        _take_impulse(points, q, heads, following, points_before, spacing)
        _add_mobility(a, x, points.place[q], mass, inertia, turn, w, mobility[q])
        if b >= 0:
            _add_mobility(b, x, points.place[q], mass, inertia, turn, w, mobility[q])
    for q in range(count):
        _push_both(points, q, points.impulse[q], x, v, mass, inertia, turn, w)


@array_function
def sweep_points(count, points, mobility, x, v, mass, inertia, dt, u, turn, w):
    """Change the impulses of all points once, in order; return the largest change and impulse.

    Args:
        count, points, x, v, mass, inertia, dt: See `solve_contacts`.
        mobility: Change of the velocity at each point per impulse, shape (count, 3, 3).
        u, turn, w: Scratch, shape (3,) each.
    """
    change, max_change, max_impulse = np.zeros(3), 0.0, 0.0
    for q in range(count):
        _slip_at(points, q, v, x, u)
        _change_impulse(points, q, u, mobility[q], dt, change)
        for c in range(3):
            max_change = max(max_change, abs(change[c]))
            max_impulse = max(max_impulse, abs(points.impulse[q, c]))
        _push_both(points, q, change, x, v, mass, inertia, turn, w)
    return max_change, max_impulse


@device_function
def _push_both(points, q, impulse, x, v, mass, inertia, turn, w):
    """Change the velocities of the bodies that meet at a point by an impulse there."""
    a, b = points.body[q], points.other[q]
    _push(v, a, x, points.place[q], mass, inertia, turn, w, impulse, 1.0)
    if b >= 0:
        _push(v, b, x, points.place[q], mass, inertia, turn, w, impulse, -1.0)


@device_function
def _tangential_mobility(mobility, n, normal_mobility):
    """Return the largest change of the tangential velocity per tangential impulse [1/kg].

    A body turns under tangential impulses: that of a ball is 3.5 times its normal mobility, and
    sweeps with the latter would not converge.

    Args:
        mobility: Change of the velocity per impulse, shape (3, 3).
        n: Normal, shape (3,).
        normal_mobility: n . mobility . n.
    """
    trace, squares = 0.0, normal_mobility * normal_mobility
    for a in range(3):
        row = mobility[a, 0] * n[0] + mobility[a, 1] * n[1] + mobility[a, 2] * n[2]
        trace += mobility[a, a]
        squares -= 2.0 * row * row
        for b in range(3):
            squares += mobility[a, b] * mobility[a, b]
    mean = 0.5 * (trace - normal_mobility)  # of two eigenvalues, whose squares have the sum above
    spread = max(0.5 * squares - mean * mean, 0.0)
    return mean + np.sqrt(spread + (LEAST_SPREAD * mean) ** 2)


@device_function
def _change_impulse(points, q, u, mobility, dt, change):
    """Change the impulse at a point so that its surfaces move as they may.

    Args:
        points: ContactPoints (in/out).
        q: Number of the point.
        u: Velocity of one surface less that of the other, shape (3,) [m/s].
        mobility: Change of u per impulse, shape (3, 3) [1/kg].
        dt: Time step [s].
        change: Change of the impulse (out), shape (3,) [kg m/s].
    """
    n, impulse, gap = points.normal[q], points.impulse[q], points.gap[q]
    separation = -gap / dt if gap > 0.0 else -RELEASE_RATE * gap / dt
    if points.bounce[q] > 0.0:
        separation = max(separation, points.bounce[q])
    normal_mobility = quadratic_form(mobility, n)
    pushed = impulse[0] * n[0] + impulse[1] * n[1] + impulse[2] * n[2]
    normal_part = u[0] * n[0] + u[1] * n[1] + u[2] * n[2]
    tangential_mobility = _tangential_mobility(mobility, n, normal_mobility)
    pressed = max(pushed + (separation - normal_part) / normal_mobility, 0.0)
    size = 0.0
    for c in range(3):
        slip = u[c] - normal_part * n[c]
        change[c] = impulse[c] - pushed * n[c] - slip / tangential_mobility
        size += change[c] * change[c]
    limit, size = points.friction[q] * pressed, np.sqrt(size)
    scale = limit / size if size > limit else 1.0
    for c in range(3):
        total = scale * change[c] + pressed * n[c]
        change[c] = total - impulse[c]
        impulse[c] = total


@array_function
def _chain_by_body(count, points, bodies):
    """Return the first point of each body, and the next one of the same body for each point.

    Args:
        count: Number of points.
        points: ContactPoints.
        bodies: Number of bodies.

    Returns:
        Numbers of points, -1 if there is none, shapes (bodies,) and (count,).
    """
    heads, following = np.full(bodies, -1), np.full(count, -1)
    for p in range(count - 1, -1, -1):
        following[p] = heads[points.body[p]]
        heads[points.body[p]] = p
    return heads, following


@device_function
def _take_impulse(points, q, heads, following, points_before, spacing):
    """Take the impulse that a point had in the last step, 0 if it is new.

    Args:
        points: ContactPoints (in/out).
        q: Number of the point.
        heads, following: Points of the last step by body, of `_chain_by_body`.
        points_before: ContactPoints of the last step.
        spacing: Distance [m] up to which a point of the last step is the same one.
    """
    points.impulse[q] = 0.0
    p = heads[points.body[q]]
    while p >= 0:
        d = np.inf
        if points_before.other[p] == points.other[q]:
            d = 0.0
            for c in range(3):
                d += (points_before.place[p, c] - points.place[q, c]) ** 2
        if d < spacing * spacing:
            for c in range(3):
                points.impulse[q, c] = points_before.impulse[p, c]
            return
        p = following[p]


@device_function
def _slip_at(points, q, v, x, u):
    """Store the velocity of a body's point less that of what it touches in u, shape (3,)."""
    for c in range(3):
        u[c] = -points.speed[q, c]
    _velocity_at(v, points.body[q], x, points.place[q], u, 1.0)
    if points.other[q] >= 0:
        _velocity_at(v, points.other[q], x, points.place[q], u, -1.0)
