"""Rows of joints between free rigid bodies: J v = target at the bodies' places in a step.

A row prevents one relative motion at the point of its joint, or bounds it (limits, motors), or is a
spring. The targets bring a joint to where it should be at the end of the step: they contain the
curvature of the way there, by which pendulums keep their energy, and let out a part of the error.
Both bodies take a row's impulse at the same point, so momentum is exact.

References:
    Ryckaert, Ciccotti, Berendsen (1977): Numerical integration of the cartesian equations of motion
    of a system with constraints. J. Comput. Phys. 23. (the constraint holds at the end of a step)
    Newmark (1959): A method of computation for structural dynamics. ASCE J. Eng. Mech. 85.
    (springs, with beta = 1/4)
"""

from typing import NamedTuple

import numpy as np

from vgmpi.runtime.jit import array_function, device_function, kernel

from .surface_points import dot

HINGE, BALL, SLIDER, FIXED, SPRING = range(5)
CORRECTION_RATE = 0.2  # [-] part of a joint's error that is let out in a step
BETA = 0.25  # [-] of Newmark: springs neither gain nor lose energy, at any time step
POINT_ROWS = 3, 3, 2, 3, 0  # rows of each kind on the velocity of its point
TURN_ROWS = 2, 0, 3, 3, 0  # rows of each kind on the angular velocity


class JointTable(NamedTuple):
    """Joints of a scene, in the order of the groups of bodies that hang together."""

    kind: np.ndarray  # (n,)
    first: np.ndarray  # (n + 1,) first row of each joint, and the number of rows
    frames: np.ndarray  # (n, 2) frames of the two sides
    anchors: np.ndarray  # (n, 2, 3) [m] ends of the joint from the frames' origins at the start
    axes: np.ndarray  # (n, 3, 3) axis at the start, and two unit vectors at right angles to it
    motor: np.ndarray  # (n, 2) speed and largest torque or force; 0 without a motor
    limits: np.ndarray  # (n, 2) smallest and largest angle or displacement; infinite without
    spring: np.ndarray  # (n, 3) stiffness [N/m], damping [N s/m], length without force [m]


class Frames(NamedTuple):
    """Frames to which joints are attached: free bodies, colliders, and the world as the last."""

    x: np.ndarray  # (f, 3) [m] origins
    rotations: np.ndarray  # (f, 3, 3) from the start


class JointRows(NamedTuple):
    """Rows of all joints in a step."""

    bodies: np.ndarray  # (r, 2) free bodies of the two sides, -1: none
    jacobian: np.ndarray  # (r, 2, 6) on velocity and angular velocity of the two sides
    target: np.ndarray  # (r,) [m/s] or [rad/s]
    softness: np.ndarray  # (r,) velocity per impulse by which a spring yields
    low: np.ndarray  # (r,) bounds of the impulse
    high: np.ndarray  # (r,)
    impulse: np.ndarray  # (r,) [kg m/s] or [kg m2/s]


def joint_rows(n: int) -> JointRows:
    """Return a table of n rows."""
    numbers = (np.zeros(n) for _ in range(5))
    return JointRows(np.full((n, 2), -1), np.zeros((n, 2, 6)), *numbers)


@device_function
def _turned(frames, f, own, out):
    """Store a vector of a frame in the domain's axes."""
    for c in range(3):
        out[c] = dot(frames.rotations[f, c], own)


@device_function
def _place(frames, f, own, out):
    """Store the place of a point of a frame [m]."""
    for c in range(3):
        out[c] = frames.x[f, c] + dot(frames.rotations[f, c], own)


@array_function
def _relative_turn(frames, a, b, out):
    """Store the axial vector of the turn from frame b to a, shape (3,): sine times axis."""
    r = np.zeros((3, 3))
    for i in range(3):
        for k in range(3):
            r[i, k] = dot(frames.rotations[a, i], frames.rotations[b, k])
    out[0], out[1], out[2] = (
        0.5 * (r[2, 1] - r[1, 2]), 0.5 * (r[0, 2] - r[2, 0]), 0.5 * (r[1, 0] - r[0, 1])
    )  # fmt: skip
    return r[0, 0] + r[1, 1] + r[2, 2]


@kernel
def find_errors(table, frames, errors, coordinate):
    """Compute the errors of joints, and the coordinates in which they move.

    Args:
        table: JointTable.
        frames: Frames.
        errors: Error of each row that prevents a motion (out), shape (r,) [m] or [rad].
        coordinate: Angle of a hinge within half a turn [rad], displacement of a slider, length of a
            spring [m] (out), shape (n,).
    """
    gap, end, u, w = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
    for j in range(len(table.kind)):
        kind, q = table.kind[j], table.first[j]
        a, b = table.frames[j, 0], table.frames[j, 1]
        _place(frames, a, table.anchors[j, 0], gap)
        _place(frames, b, table.anchors[j, 1], end)
        for c in range(3):
            gap[c] -= end[c]
        if kind == SPRING:
            coordinate[j] = np.sqrt(dot(gap, gap))
            continue
        if kind == SLIDER:
            for c in range(2):
                _turned(frames, b, table.axes[j, 1 + c], u)
                errors[q + c] = dot(u, gap)
            _turned(frames, b, table.axes[j, 0], u)
            coordinate[j] = dot(u, gap)
            q += 2
        else:
            for c in range(3):
                errors[q + c] = gap[c]
            q += 3
        if kind == HINGE:
            _turned(frames, b, table.axes[j, 0], w)
            trace = _relative_turn(frames, a, b, end)
            coordinate[j] = np.arctan2(dot(w, end), 0.5 * (trace - 1.0))
            _turned(frames, a, table.axes[j, 0], u)
            end[0], end[1], end[2] = (
                w[1] * u[2] - w[2] * u[1], w[2] * u[0] - w[0] * u[2], w[0] * u[1] - w[1] * u[0]
            )  # fmt: skip
            for c in range(2):
                _turned(frames, b, table.axes[j, 1 + c], u)
                errors[q + c] = dot(u, end)
        elif kind == SLIDER or kind == FIXED:
            _relative_turn(frames, a, b, end)
            for c in range(3):
                errors[q + c] = end[c]


@device_function
def _set_point_row(rows, q, frames, a, b, place, other_place, n):
    """Set a row on the velocity of a point along n.

    Args:
        rows: JointRows (in/out).
        q: Row.
        frames: Frames.
        a, b: The frames of the two sides.
        place, other_place: Where the impulse acts on each side, shape (3,) [m].
        n: Direction, shape (3,).
    """
    for s in range(2):
        f, sign = (a, 1.0) if s == 0 else (b, -1.0)
        p = place if s == 0 else other_place
        r0, r1, r2 = p[0] - frames.x[f, 0], p[1] - frames.x[f, 1], p[2] - frames.x[f, 2]
        row = rows.jacobian[q, s]
        for c in range(3):
            row[c] = sign * n[c]
        row[3] = sign * (r1 * n[2] - r2 * n[1])
        row[4] = sign * (r2 * n[0] - r0 * n[2])
        row[5] = sign * (r0 * n[1] - r1 * n[0])


@device_function
def _set_turn_row(rows, q, n):
    """Set a row on the angular velocity along n."""
    for s in range(2):
        for c in range(3):
            rows.jacobian[q, s, c] = 0.0
            rows.jacobian[q, s, 3 + c] = n[c] if s == 0 else -n[c]


@device_function
def rate_of(rows, q, v, a, b):
    """Return J v of a row.

    Args:
        rows: JointRows.
        q: Row.
        v: Velocities and angular velocities, shape (f, 6).
        a, b: Rows of the two sides in v, -1: none.
    """
    total = 0.0
    for c in range(6):
        if a >= 0:
            total += rows.jacobian[q, 0, c] * v[a, c]
        if b >= 0:
            total += rows.jacobian[q, 1, c] * v[b, c]
    return total


@array_function
def _set_directions(table, j, frames, rows):
    """Set what the rows of a joint act on; return the row after those that prevent a motion."""
    kind, q, n = table.kind[j], table.first[j], np.zeros(3)
    a, b = table.frames[j, 0], table.frames[j, 1]
    place, axes = np.zeros(3), np.zeros((3, 3))
    _place(frames, a, table.anchors[j, 0], place)
    for c in range(3):
        _turned(frames, b, table.axes[j, c], axes[c])
    for c in range(POINT_ROWS[kind]):
        for k in range(3):
            n[k] = axes[1 + c, k] if kind == SLIDER else 1.0 * (k == c)
        _set_point_row(rows, q, frames, a, b, place, place, n)
        q += 1
    for c in range(TURN_ROWS[kind]):
        for k in range(3):
            n[k] = axes[1 + c, k] if kind == HINGE else 1.0 * (k == c)
        _set_turn_row(rows, q, n)
        q += 1
    for row in range(q, table.first[j + 1]):
        if kind == HINGE:
            _set_turn_row(rows, row, axes[0])
        elif kind == SLIDER:
            _set_point_row(rows, row, frames, a, b, place, place, axes[0])
    return q


@device_function
def _set_limit_row(table, j, rows, q, coordinate, dt):
    """Set the row of the limit that is nearer to a joint's coordinate."""
    low, high = table.limits[j, 0], table.limits[j, 1]
    is_low = coordinate - low <= high - coordinate
    gap = coordinate - low if is_low else high - coordinate
    if not is_low:
        for s in range(2):
            for c in range(6):
                rows.jacobian[q, s, c] *= -1.0
    rows.target[q] = -gap / dt if gap > 0.0 else -CORRECTION_RATE * gap / dt
    rows.low[q], rows.high[q] = 0.0, np.inf


@array_function
def _set_spring_row(table, j, frames, rows, length, v, dt):
    """Set the row of a spring: its force holds at the middle of the step, that of its damper after.

    Args:
        table: JointTable.
        j: Joint.
        frames: Frames.
        rows: JointRows (in/out).
        length: Length of the spring [m].
        v: Velocities of the frames before the step, shape (f, 6).
        dt: Time step [s].
    """
    q, n, place, end = table.first[j], np.zeros(3), np.zeros(3), np.zeros(3)
    a, b = table.frames[j, 0], table.frames[j, 1]
    _place(frames, a, table.anchors[j, 0], place)
    _place(frames, b, table.anchors[j, 1], end)
    if length > 0.0:
        for c in range(3):
            n[c] = (place[c] - end[c]) / length
    _set_point_row(rows, q, frames, a, b, place, end, n)
    k, damping, length0 = table.spring[j]
    inertial = BETA * k * dt * dt
    rows.softness[q] = 1.0 / (inertial + damping * dt)
    impulse = inertial * rate_of(rows, q, v, a, b) - dt * k * (length - length0)
    rows.target[q] = rows.softness[q] * impulse


@kernel
def set_rows(table, frames, errors, errors_after, coordinate, v, free, dt, rows):
    """Set the rows of all joints for a step.

    Args:
        table: JointTable.
        frames: Frames at the beginning of the step.
        errors: Errors then, shape (r,).
        errors_after: Errors after the step if the frames kept their velocities, shape (r,).
        coordinate: Angles, displacements and lengths, shape (n,).
        v: Velocities of the frames before the step, shape (f, 6).
        free: Number of free bodies, which are the first frames.
        dt: Time step [s].
        rows: JointRows (out).
    """
    for j in range(len(table.kind)):
        a, b = table.frames[j, 0], table.frames[j, 1]
        end = _set_directions(table, j, frames, rows)
        for q in range(table.first[j], table.first[j + 1]):
            rows.softness[q], rows.low[q], rows.high[q] = 0.0, -np.inf, np.inf
            rows.impulse[q] = 0.0
        if table.kind[j] == SPRING:
            _set_spring_row(table, j, frames, rows, coordinate[j], v, dt)
        for q in range(table.first[j], end):
            curved = errors_after[q] - errors[q] - dt * rate_of(rows, q, v, a, b)
            rows.target[q] = -(CORRECTION_RATE * errors[q] + curved) / dt
        if table.motor[j, 1] > 0.0:
            rows.target[end] = table.motor[j, 0]
            rows.low[end], rows.high[end] = -dt * table.motor[j, 1], dt * table.motor[j, 1]
            end += 1
        if table.limits[j, 0] > -np.inf:
            _set_limit_row(table, j, rows, end, coordinate[j], dt)
        for q in range(table.first[j], table.first[j + 1]):
            rows.target[q] -= rate_of(rows, q, v, a if a >= free else -1, b if b >= free else -1)
            rows.bodies[q, 0] = a if a < free else -1
            rows.bodies[q, 1] = b if b < free else -1
