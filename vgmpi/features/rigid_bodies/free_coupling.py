"""Coupling of free rigid bodies with what flows: nodes next to a body and the body solved together.

A node that touches a body takes the impulse m (V_s - v_s) along the normal, if that pushes, and at
most friction times as much along the surface. V_s is the velocity of the body's surface there, v_s
that of the flow at the surface. A node farther than half a cell outside takes its part of the
traction of the pressure instead. The body's six velocities minimize the kinetic energy of all:

    (M + sum W) V = M V0 + sum W v_s - sum of tractions

which is stable for bodies of any mass. The body takes the negative sum of the nodes' impulses, so
momentum is exact, and the sums are whole numbers of quanta, so they have the same bits on any
ranks (docs/explanation/rigid-bodies.md). The quanta are for sums far larger than what touches a
body, so that what they leave of a term is summed too, in whole numbers of smaller quanta.

References:
    Batty, Bertails, Bridson (2007): A fast variational framework for accurate solid-fluid coupling.
    ACM Trans. Graph. 26 (3), 100.
"""

import numpy as np

from vgmpi.kernels.reproducible_sums import REMAINDER, add_in_quanta
from vgmpi.runtime.jit import always_inline, device_function, kernel

# 21 of a symmetric matrix, 6 of the right-hand side, nodes that changed their state, nodal mass
SUMS = 29
_LEVERS = (1, 2), (0, 2), (0, 1)  # components of a velocity that change with a turn about each axis


@always_inline
def _approach(contacts, q, v, u):
    """Store the velocity of the surface less that of the phase in u; return its normal part."""
    w, r, n = v[contacts.body[q]], contacts.foot[q], contacts.normal[q]
    u[0] = w[0] + w[4] * r[2] - w[5] * r[1] - contacts.velocity[q, 0]
    u[1] = w[1] + w[5] * r[0] - w[3] * r[2] - contacts.velocity[q, 1]
    u[2] = w[2] + w[3] * r[1] - w[4] * r[0] - contacts.velocity[q, 2]
    return u[0] * n[0] + u[1] * n[1] + u[2] * n[2]


@always_inline
def _sticking_fraction(contacts, q, u, normal_part):
    """Return the fraction of the slip that friction removes, -1 where the surfaces separate."""
    if contacts.friction[q] < 0.0:  # an attached node: both signs, all directions
        return 1.0
    if not normal_part > 0.0:
        return -1.0
    if contacts.friction[q] == 0.0:
        return 0.0
    n, squared = contacts.normal[q], 0.0
    for c in range(3):
        t = u[c] - normal_part * n[c]
        squared += t * t
    limit = contacts.friction[q] * normal_part
    return 1.0 if squared <= limit * limit else limit / np.sqrt(squared)


@always_inline
def _take_traction(contacts, q, push):
    """Store the impulse of the stress on a node, shape (3,); return whether there is one."""
    acts = contacts.pressed[q] > 0.0
    for c in range(3):
        push[c] = contacts.pressed[q] * contacts.normal[q, c]
        if len(contacts.drag) > 0:
            push[c] += contacts.drag[q, c]
            acts |= contacts.drag[q, c] != 0.0
    return acts


@always_inline
def _coupled_masses(contacts, q, fraction):
    """Return the masses that take the body's velocity along the normal and along the surface."""
    mass = contacts.mass[q]
    along, across = (mass, fraction * mass) if fraction >= 0.0 else (0.0, 0.0)
    if len(contacts.adhering) > 0:
        across = max(across, contacts.adhering[q])
    return along, across


@device_function
def _total(sums, place, quantum):
    """Return a sum of `add_in_quanta`."""
    return (sums[place, 0] + sums[place, 1] * REMAINDER) * quantum


@always_inline
def _add_traction(sums, per_quantum, push, r):
    """Add what a body gives for an impulse on a node to its right-hand side; push: (3,)."""
    term = (
        -push[0], -push[1], -push[2], r[2] * push[1] - r[1] * push[2],
        r[0] * push[2] - r[2] * push[0], r[1] * push[0] - r[0] * push[1],
    )  # fmt: skip
    for a in range(6):
        add_in_quanta(sums, 21 + a, term[a], per_quantum[21 + a])


@kernel
def sum_contacts(count, contacts, v, quanta, sums):
    """Add the matrices and right-hand sides of the touching nodes to the sums of their bodies.

    Args:
        count: Number of rows of `contacts`.
        contacts: NodeContacts; their sticking fractions follow from `v` (in/out).
        v: Velocities and angular velocities of the bodies, shape (m, 6).
        quanta: Quanta of the sums, shape (29,).
        sums: Whole numbers of quanta and of remainders, shape (m, 29, 2) int64 (in/out).
    """
    u, g, h = np.zeros(3), np.zeros((3, 6)), np.zeros((3, 6))
    g[0, 0] = g[1, 1] = g[2, 2] = 1.0
    per_quantum = 1.0 / quanta  # exact: powers of two
    for q in range(count):
        fraction = _sticking_fraction(contacts, q, u, _approach(contacts, q, v, u))
        was = contacts.stick[q]
        contacts.stick[q] = fraction
        if contacts.counts[q] == 0:
            continue
        k, n, r = contacts.body[q], contacts.normal[q], contacts.foot[q]
        sums[k, 28, 0] += np.int64(np.ceil(contacts.nodal_mass[q] * per_quantum[28]))
        if _take_traction(contacts, q, u):
            _add_traction(sums[k], per_quantum, u, r)
        sums[k, 27, 0] += abs(was - fraction) > 1e-3
        along_mass, across_mass = _coupled_masses(contacts, q, fraction)
        if along_mass == 0.0 and across_mass == 0.0:
            continue
        g[0, 4], g[0, 5] = r[2], -r[1]
        g[1, 5], g[1, 3] = r[0], -r[2]
        g[2, 3], g[2, 4] = r[1], -r[0]
        for c in range(6):
            along = n[0] * g[0, c] + n[1] * g[1, c] + n[2] * g[2, c]
            for a in range(3):
                h[a, c] = along_mass * along * n[a] + across_mass * (g[a, c] - along * n[a])
        place = 0
        for a in range(6):
            for c in range(a, 6):
                if a < 3:
                    term = h[a, c]
                else:
                    i, j = _LEVERS[a - 3]
                    term = g[i, a] * h[i, c] + g[j, a] * h[j, c]
                add_in_quanta(sums[k], place, term, per_quantum[place])
                place += 1
        s = contacts.velocity[q]
        for a in range(6):
            term = h[0, a] * s[0] + h[1, a] * s[1] + h[2, a] * s[2]
            add_in_quanta(sums[k], 21 + a, term, per_quantum[21 + a])


@kernel
def solve_velocities(sums, quanta, mass, inertia, before, v):
    """Solve for the velocities of the bodies with the nodes that touch them.

    Args:
        sums: Whole numbers of quanta and of remainders over all ranks, shape (m, 29, 2).
        quanta: Quanta of the sums, shape (29,).
        mass: Masses, shape (m,) [kg].
        inertia: Inertia tensors in the domain's axes, shape (m, 3, 3) [kg m2].
        before: Velocities without the nodes, shape (m, 6).
        v: Velocities (out), shape (m, 6).
    """
    A, x = np.zeros((6, 6)), np.zeros(6)
    for k in range(len(mass)):
        condensed_matrix(sums[k], quanta, mass[k], inertia[k], A)
        for a in range(3):
            x[a] = _total(sums[k], 21 + a, quanta[21 + a]) + mass[k] * before[k, a]
            x[3 + a] = _total(sums[k], 24 + a, quanta[24 + a])
            for c in range(3):
                x[3 + a] += inertia[k, a, c] * before[k, 3 + c]
        solve_symmetric(A, x)
        for a in range(6):
            v[k, a] = x[a]


@kernel
def read_sums(sums, quanta, matrix, vector):
    """Compute the matrix and the right-hand side of the nodes that touch bodies, without these.

    Args:
        sums: Whole numbers of quanta and of remainders over all ranks, shape (m, 29, 2).
        quanta: Quanta of the sums, shape (29,).
        matrix: Matrix of all bodies (out), shape (6 m, 6 m), 0 at the start.
        vector: Right-hand side (out), shape (6 m,).
    """
    for k in range(len(sums)):
        own = matrix[6 * k : 6 * k + 6, 6 * k : 6 * k + 6]
        condensed_matrix(sums[k], quanta, 0.0, np.zeros((3, 3)), own)
        for a in range(6):
            vector[6 * k + a] = _total(sums[k], 21 + a, quanta[21 + a])


@device_function
def condensed_matrix(sums, quanta, mass, inertia, out):
    """Compute the matrix of a body with the nodes that touch it.

    Args:
        sums: Whole numbers of quanta and of remainders of the body, shape (29, 2).
        quanta: Quanta of the sums, shape (29,).
        mass: Mass [kg].
        inertia: Inertia tensor in the domain's axes, shape (3, 3) [kg m2].
        out: Matrix (out), shape (6, 6).
    """
    place = 0
    for a in range(6):
        for c in range(a, 6):
            out[a, c] = out[c, a] = _total(sums, place, quanta[place])
            place += 1
    for a in range(3):
        out[a, a] += mass
        for c in range(3):
            out[3 + a, 3 + c] += inertia[a, c]


@device_function
def solve_symmetric(A, x):
    """Solve A y = x in place for a symmetric positive definite matrix, by L D L^T.

    Args:
        A: Matrix, shape (n, n); its lower half is overwritten.
        x: Right-hand side, then the solution, shape (n,).
    """
    factor_symmetric(A)
    solve_factored(A, x)


@device_function
def factor_symmetric(A):
    """Replace the lower half of a symmetric positive definite matrix (n, n) by its L and D."""
    size = len(A)
    for c in range(size):
        for j in range(c):
            A[c, c] -= A[c, j] * A[c, j] * A[j, j]
        for a in range(c + 1, size):
            for j in range(c):
                A[a, c] -= A[a, j] * A[c, j] * A[j, j]
            A[a, c] /= A[c, c]


@device_function
def solve_factored(A, x):
    """Solve A y = x in place, A of `factor_symmetric`, shape (n, n)."""
    size = len(x)
    for a in range(size):
        for j in range(a):
            x[a] -= A[a, j] * x[j]
    for a in range(size):
        x[a] /= A[a, a]
    for a in range(size - 1, -1, -1):
        for j in range(a + 1, size):
            x[a] -= A[j, a] * x[j]


@kernel
def apply_impulses(count, contacts, v, velocities, quanta, impulses):
    """Give the touching nodes their impulses, and sum these with their moments.

    Args:
        count: Number of rows of `contacts`.
        contacts: NodeContacts.
        v: Velocities of the bodies, shape (m, 6).
        velocities: Nodal velocities and masses, shape (node blocks, 256) (in/out).
        quanta: Quanta of an impulse and of a moment, shape (2,).
        impulses: Impulses on the nodes and their moments about the bodies' centers in whole numbers
            of quanta and of remainders, shape (m, 6, 2) int64 (in/out).
    """
    u, push = np.zeros(3), np.zeros(3)
    for q in range(count):
        normal_part = _approach(contacts, q, v, u)
        fraction = _sticking_fraction(contacts, q, u, normal_part)
        n, r, o = contacts.normal[q], contacts.arm[q], contacts.offset[q]
        along_mass, across_mass = _coupled_masses(contacts, q, fraction)
        if not _take_traction(contacts, q, push) and along_mass == 0.0 and across_mass == 0.0:
            continue
        row, column = o // 256, o % 256
        mass = float(velocities[row, column + 3])
        for c in range(3):
            along = normal_part * n[c]
            change = push[c] + along_mass * along + across_mass * (u[c] - along)
            change /= mass
            before = velocities[row, column + c]
            velocities[row, column + c] = before + change
            # what the node really got, as its number rounds
            push[c] = mass * (float(velocities[row, column + c]) - float(before))
        if contacts.counts[q] == 0:
            continue
        k = contacts.body[q]
        moment = (
            r[1] * push[2] - r[2] * push[1],
            r[2] * push[0] - r[0] * push[2],
            r[0] * push[1] - r[1] * push[0],
        )
        for c in range(3):
            add_in_quanta(impulses[k], c, push[c], 1.0 / quanta[0])
            add_in_quanta(impulses[k], 3 + c, moment[c], 1.0 / quanta[1])
