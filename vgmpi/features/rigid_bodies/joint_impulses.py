"""Impulses of joints: all joints of bodies that hang together are solved at once.

    (J A^-1 J^T + softness) l = target - J v

A is the inertia of the bodies, with that of the nodes that touch them where a flow does. Impulses
of limits and motors are bounded: rows change between bounded and free in a fixed order until all
bounds hold.

References:
    Judice, Pires (1994): A block principal pivoting algorithm for large-scale strictly monotone
    linear complementarity problems. Comput. Oper. Res. 21.
"""

import numpy as np

from vgmpi.runtime.jit import array_function, device_function, kernel

from .contact_sweeps import start_impulses, sweep_points
from .free_bodies import inverse_times
from .free_coupling import (
    condensed_matrix,
    factor_symmetric,
    solve_factored,
    solve_symmetric,
)
from .joint_rows import rate_of

REGULARIZATION = 1e-10  # [-] of the diagonal: rows of closed loops may repeat each other
BLOCK_CHANGES = 5  # times that all rows that break a bound change together; then the first alone
ROUNDING = 1e-12  # [-] part of the largest number that counts as 0
MAX_ROUNDS, SWEEPS_PER_ROUND = 12, 5  # of contacts, then joints
TOLERANCE = 1e-9  # [-] change of an impulse in a round, over the largest one, at which they end


@kernel
def invert_condensed(sums, quanta, mass, inertia, inverse):
    """Compute the inverse matrices of bodies with the nodes that touch them.

    Args:
        sums, quanta, mass, inertia: See `free_coupling.solve_velocities`.
        inverse: Inverse matrices (out), shape (m, 6, 6).
    """
    A, x = np.zeros((6, 6)), np.zeros(6)
    for k in range(len(mass)):
        for c in range(6):
            condensed_matrix(sums[k], quanta, mass[k], inertia[k], A)
            x[:] = 0.0
            x[c] = 1.0
            solve_symmetric(A, x)
            inverse[k, :, c] = x


@kernel
def invert_inertia(mass, inertia, inverse):
    """Compute the inverse matrices of bodies alone.

    Args:
        mass: Masses, shape (m,) [kg].
        inertia: Inertia tensors in the domain's axes, shape (m, 3, 3) [kg m2].
        inverse: Inverse matrices (out), shape (m, 6, 6).
    """
    unit = np.zeros(3)
    inverse[:] = 0.0
    for k in range(len(mass)):
        for c in range(3):
            inverse[k, c, c] = 1.0 / mass[k]
            unit[:] = 0.0
            unit[c] = 1.0
            inverse_times(inertia[k], unit, inverse[k, 3 + c, 3:])


@device_function
def _fill_matrix(rows, low, high, inverse, moved, matrix):
    """Compute A^-1 J^T of the rows low .. high, and the matrix J A^-1 J^T.

    Args:
        rows: JointRows.
        low, high: First row, and the row after the last one.
        inverse: Inverse matrices of the bodies, shape (m, 6, 6).
        moved: A^-1 J^T (out), shape (high - low, 2, 6).
        matrix: Matrix (out), shape (high - low, high - low).
    """
    for i in range(low, high):
        for s in range(2):
            k = rows.bodies[i, s]
            for a in range(6):
                moved[i - low, s, a] = 0.0
                if k >= 0:
                    for c in range(6):
                        moved[i - low, s, a] += inverse[k, a, c] * rows.jacobian[i, s, c]
    for i in range(low, high):
        for j in range(low, i + 1):
            total = 0.0
            for s in range(2):
                for t in range(2):
                    if rows.bodies[i, s] >= 0 and rows.bodies[i, s] == rows.bodies[j, t]:
                        for c in range(6):
                            total += moved[i - low, s, c] * rows.jacobian[j, t, c]
            matrix[i - low, j - low] = matrix[j - low, i - low] = total
    for i in range(high - low):
        matrix[i, i] *= 1.0 + REGULARIZATION


@array_function
def _solve_free(matrix, right, state, impulse):
    """Solve for the impulses of the rows that are at no bound.

    Args:
        matrix: Matrix, shape (n, n).
        right: Right-hand side, shape (n,).
        state: 0: free, else at a bound, shape (n,).
        impulse: Impulses, at their bounds where a row is not free (in/out), shape (n,).
    """
    n = len(right)
    free = np.flatnonzero(state == 0)
    part, x = np.zeros((len(free), len(free))), np.zeros(len(free))
    for a in range(len(free)):
        i = free[a]
        x[a] = right[i]
        for j in range(n):
            if state[j] != 0:
                x[a] -= matrix[i, j] * impulse[j]
        for c in range(len(free)):
            part[a, c] = matrix[i, free[c]]
    solve_symmetric(part, x)
    for a in range(len(free)):
        impulse[free[a]] = x[a]


@device_function
def _change_states(matrix, right, low, high, state, impulse, only_first):
    """Free rows that a bound holds wrongly and bound those beyond a bound; return their number.

    Args:
        matrix, right: The system, shapes (n, n) and (n,).
        low, high: Bounds, shape (n,).
        state: -1: at the lower bound, 1: at the upper one, 0: free (in/out), shape (n,).
        impulse: Impulses, shape (n,).
        only_first: Change the first such row only.
    """
    n, count, tiny, small = len(right), 0, 0.0, 0.0
    for i in range(n):
        tiny = max(tiny, ROUNDING * abs(impulse[i]))
        small = max(small, ROUNDING * abs(right[i]))
    for i in range(n):
        new = state[i]
        if state[i] == 0:
            if impulse[i] < low[i] - tiny:
                new = -1
            elif impulse[i] > high[i] + tiny:
                new = 1
        else:
            residual = -right[i]
            for j in range(n):
                residual += matrix[i, j] * impulse[j]
            if state[i] * residual > small:
                new = 0
        if new != state[i]:
            state[i] = new
            count += 1
            if only_first:
                break
    return count


@array_function
def _solve_bounded(matrix, right, low, high, impulse):
    """Solve a symmetric system whose unknowns are bounded.

    Args:
        matrix: Positive definite matrix, shape (n, n).
        right: Right-hand side, shape (n,).
        low, high: Bounds, shape (n,).
        impulse: Solution (out), shape (n,).
    """
    n = len(right)
    state = np.zeros(n, np.int64)
    for i in range(n):
        if low[i] == 0.0:  # a limit
            state[i] = -1
    for change in range(BLOCK_CHANGES + 10 * n):
        for i in range(n):
            if state[i] != 0:
                impulse[i] = low[i] if state[i] < 0 else high[i]
        _solve_free(matrix, right, state, impulse)
        only_first = change >= BLOCK_CHANGES
        if not _change_states(matrix, right, low, high, state, impulse, only_first):
            break
    for i in range(n):
        impulse[i] = min(max(impulse[i], low[i]), high[i])


@array_function
def _solve_rows(rows, groups, inverse, v):
    """Change impulses and velocities so that all rows hold; return the largest change and impulse.

    Args:
        rows: JointRows, whose impulses the velocities contain (in/out).
        groups: First row of each group of bodies that hang together, shape (g + 1,).
        inverse: Inverse matrices of the bodies, shape (m, 6, 6).
        v: Velocities and angular velocities (in/out), shape (m, 6).
    """
    max_change, max_impulse = 0.0, 0.0
    for g in range(len(groups) - 1):
        low, high = groups[g], groups[g + 1]
        n = high - low
        moved, matrix = np.zeros((n, 2, 6)), np.zeros((n, n))
        right, impulse = np.zeros(n), np.zeros(n)
        _fill_matrix(rows, low, high, inverse, moved, matrix)
        for i in range(n):
            q = low + i
            right[i] = rows.target[q] - rate_of(rows, q, v, rows.bodies[q, 0], rows.bodies[q, 1])
            for j in range(n):
                right[i] += matrix[i, j] * rows.impulse[low + j]
        for i in range(n):
            matrix[i, i] += rows.softness[low + i]
        _solve_bounded(matrix, right, rows.low[low:high], rows.high[low:high], impulse)
        for i in range(n):
            q = low + i
            change = impulse[i] - rows.impulse[q]
            rows.impulse[q] = impulse[i]
            max_change = max(max_change, abs(change))
            max_impulse = max(max_impulse, abs(impulse[i]))
            for s in range(2):
                k = rows.bodies[q, s]
                if k >= 0:
                    for c in range(6):
                        v[k, c] += moved[i, s, c] * change
    return max_change, max_impulse


@kernel
def solve_joints(rows, groups, inverse, v):
    """Find the impulses of joints, and change the bodies' velocities.

    Args:
        rows, groups, inverse, v: See `_solve_rows`.
    """
    _solve_rows(rows, groups, inverse, v)


def join_blocks(inverse: np.ndarray) -> np.ndarray:
    """Return the matrix (6 m, 6 m) of the inverse matrices (m, 6, 6) of bodies."""
    m = len(inverse)
    out = np.zeros((m, 6, m, 6))
    out[np.arange(m), :, np.arange(m)] = inverse
    return out.reshape(6 * m, 6 * m)


@kernel
def reduce_mobility(rows, groups, inverse, matrix):
    """Subtract the answer of the rows that are at no bound from the mobility of bodies.

    Args:
        rows, groups, inverse: See `_solve_rows`.
        matrix: Mobility of the bodies, that without joints at first (in/out), shape (6 m, 6 m).
    """
    for g in range(len(groups) - 1):
        low, high = groups[g], groups[g + 1]
        n = high - low
        moved, full = np.zeros((n, 2, 6)), np.zeros((n, n))
        _fill_matrix(rows, low, high, inverse, moved, full)
        free = np.zeros(n, np.int64)
        count = 0
        for i in range(n):
            q = low + i
            full[i, i] += rows.softness[q]
            if rows.low[q] < rows.impulse[q] < rows.high[q]:
                free[count] = i
                count += 1
        part, impulse = np.zeros((count, count)), np.zeros(count)
        for a in range(count):
            for c in range(count):
                part[a, c] = full[free[a], free[c]]
        factor_symmetric(part)
        for k in range(len(inverse)):
            for c in range(6):
                touches = False
                for a in range(count):
                    impulse[a] = 0.0
                    for s in range(2):
                        if rows.bodies[low + free[a], s] == k:
                            impulse[a] -= moved[free[a], s, c]
                            touches = True
                if not touches:
                    continue
                solve_factored(part, impulse)
                for a in range(count):
                    for s in range(2):
                        body = rows.bodies[low + free[a], s]
                        if body >= 0:
                            for d in range(6):
                                matrix[6 * body + d, 6 * k + c] += moved[free[a], s, d] * impulse[a]


@kernel
def add_impulses(rows, momentum, spin):
    """Give the bodies the impulses of the rows.

    Args:
        rows: JointRows.
        momentum, spin: Momenta [kg m/s] and angular momenta [kg m2/s] (in/out), shape (m, 3) each.
    """
    for q in range(len(rows.impulse)):
        for s in range(2):
            k = rows.bodies[q, s]
            if k >= 0:
                for c in range(3):
                    momentum[k, c] += rows.jacobian[q, s, c] * rows.impulse[q]
                    spin[k, c] += rows.jacobian[q, s, 3 + c] * rows.impulse[q]


@kernel
def solve_contacts_and_joints(
    count, points, before_count, points_before, spacing, x, v, mass, inertia, restitution, dt,
    joints,
):  # fmt: skip
    """Find the impulses at points in contact and of joints in turn.

    Args:
        count, points, before_count, points_before, spacing, x, v, mass, inertia, restitution, dt:
            See `contact_sweeps.solve_contacts`.
        joints: Rows, their groups, and the inverse matrices of the bodies, see `_solve_rows`.
    """
    rows, groups, inverse = joints
    u, turn, w = np.zeros(3), np.zeros(3), np.zeros(3)
    mobility = np.zeros((count, 3, 3))
    start_impulses(
        count, points, before_count, points_before, spacing, x, v, mass, inertia, restitution, dt,
        mobility,
    )  # fmt: skip
    for _ in range(MAX_ROUNDS):
        for _ in range(SWEEPS_PER_ROUND):
            swept, max_swept = sweep_points(
                count, points, mobility, x, v, mass, inertia, dt, u, turn, w
            )
            if swept <= TOLERANCE * max_swept:
                break
        change, max_impulse = _solve_rows(rows, groups, inverse, v)
        if change <= TOLERANCE * max_impulse:
            break
