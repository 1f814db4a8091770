"""Sweeps over the nodes of a solid: (M + K)^-1 of impulses, with light nodes in tow.

With the masses M of heavy nodes and of what follows them, a sweep is

    w = (1 - s) w + s (T M^-1 T^T + Q D Q^T) (r - K w)

where Q moves a light node and what it follows apart, without momentum: what is at rest has no force
at any node.
The factors s are the inverse roots of a Chebyshev polynomial of which one root is 1: the first
sweep takes s = 1, and the others do not change momentum.
"""

from vgmpi.kernels.grid.cell_stiffness import multiply_block, stiffness_scratch
from vgmpi.kernels.grid.phase_nodes import node_index_of
from vgmpi.kernels.simd.vector16 import load, pointer, store
from vgmpi.runtime.jit import always_inline, kernel

MIN_CHANGE = 1e-5  # [-] smaller changes of a velocity are rounding, no contact


@kernel
def begin_remainder(rows, impulses, fields, remainder):
    """Set the remainder of no change of velocity, the impulses, at the nodes of some blocks.

    Args:
        rows: Blocks to process, shape (n,).
        impulses, fields, remainder: See `find_remainder`.
    """
    own, loose, out = pointer(impulses), pointer(fields.loose), pointer(remainder)
    for b in rows:
        for n in range(192 * b, 192 * (b + 1), 16):
            store(out, n, load(loose, n) * load(own, n))


@kernel
def find_remainder(rows, neighbors, trace, impulses, fields, w, remainder):
    """Set the remainder to the impulses less K w at the nodes of some blocks.

    Args:
        rows: Blocks to process, shape (n,).
        neighbors: Rows of the 27 blocks around each, flat.
        trace: See kernels/grid/cell_stiffness.py, of each block, shape (n,).
        impulses: Impulses, flat.
        fields: SolidFields.
        w: Changes of velocity, flat.
        remainder: Flat (out).
    """
    scratch = stiffness_scratch(w.dtype)
    own, loose, out = pointer(impulses), pointer(fields.loose), pointer(remainder)
    for b in rows:
        multiply_block(w, neighbors, b, fields.cells, trace[b], scratch)
        product = pointer(scratch.product)
        for q in range(0, 192, 16):
            n = 192 * b + q
            store(out, n, load(loose, n) * (load(own, n) - load(product, q)))


@kernel
def divide_by_mass(rows, ties, pulls, fields, remainder, change):
    """Set the change to M^-1 T^T of a remainder at the heavy nodes of some blocks, and to D Q^T.

    Args:
        rows: Blocks to process, shape (n,).
        ties: Ties of heavy nodes to those that follow them.
        pulls: Ties of light nodes to those that they follow.
        fields: SolidFields.
        remainder: Flat, 0 in directions that are held, known around the nodes of this rank.
        change: Flat (out).
    """
    loose, inverse = pointer(fields.loose), pointer(fields.inverse)
    left, out = pointer(remainder), pointer(change)
    for b in rows:
        for a in range(3):
            for q in range(0, 64, 16):
                n = 192 * b + 64 * a + q
                own = load(loose, n) * load(inverse, 64 * b + q)
                store(out, n, own * load(left, n))
    for t in range(len(ties.nodes)):
        b, q = ties.nodes[t] // 64, ties.nodes[t] % 64
        for a in range(3):
            n = 192 * b + 64 * a + q
            total = remainder[n]
            for k in range(ties.first[t], ties.first[t + 1]):
                other = ties.others[k]
                total += ties.weights[k] * remainder[192 * (other // 64) + 64 * a + other % 64]
            change[n] = fields.loose[n] * fields.inverse[64 * b + q] * total
    for t in range(len(pulls.nodes)):
        node = pulls.nodes[t]
        for a in range(3):
            n = 192 * (node // 64) + 64 * a + node % 64
            total = fields.inverse_own[node] * remainder[n]
            for k in range(pulls.first[t], pulls.first[t + 1]):
                other = pulls.others[k]
                left = remainder[192 * (other // 64) + 64 * a + other % 64]
                total -= pulls.weights[k] * fields.inverse_own[other] * left
            change[n] = fields.loose[n] * fields.relative_response[node] * total


@kernel
def add_change(rows, weight, ties, pushes, fields, change, w):
    """Bring w to (1 - weight) w + weight (T, Q) change at the nodes of some blocks.

    Args:
        rows: Blocks to process, shape (n,).
        weight: Weight of the sweep.
        ties: Ties of light nodes to those that they follow.
        pushes: Ties of heavy nodes to those that follow them.
        fields: SolidFields.
        change: Flat, known around the nodes of this rank.
        w: Flat (in/out).
    """
    values, out = pointer(change), pointer(w)
    remaining = w.dtype.type(1) - weight
    for b in rows:
        for n in range(192 * b, 192 * (b + 1), 16):
            store(out, n, remaining * load(out, n) + weight * load(values, n))
    for t in range(len(ties.nodes)):
        b, q = ties.nodes[t] // 64, ties.nodes[t] % 64
        for a in range(3):
            n = 192 * b + 64 * a + q
            total = w.dtype.type(0)
            for k in range(ties.first[t], ties.first[t + 1]):
                other = ties.others[k]
                total += ties.weights[k] * change[192 * (other // 64) + 64 * a + other % 64]
            w[n] += fields.loose[n] * weight * total
    for t in range(len(pushes.nodes)):
        node = pushes.nodes[t]
        for a in range(3):
            n = 192 * (node // 64) + 64 * a + node % 64
            total = w.dtype.type(0)
            for k in range(pushes.first[t], pushes.first[t + 1]):
                other = pushes.others[k]
                momentum = fields.mass[other] * change[192 * (other // 64) + 64 * a + other % 64]
                total += pushes.weights[k] * momentum
            w[n] -= fields.loose[n] * weight * fields.inverse_own[node] * total


@kernel
def sweep(rows, neighbors, trace, weights, ties, impulses, fields, work):
    """Make sweeps from no change over solids whose nodes no other thread or rank computes.

    Args:
        rows: Blocks to process, shape (n,).
        neighbors, trace, impulses, fields: See `find_remainder`.
        weights: Weights of the sweeps.
        ties: Ties of heavy nodes to those that follow them, and of these to those.
        work: Remainder and change, scratch, and w, 0 (in/out), flat.
    """
    pushes, pulls = ties
    remainder, change, w = work
    for k, weight in enumerate(weights):
        if k == 0:
            begin_remainder(rows, impulses, fields, remainder)
        else:
            find_remainder(rows, neighbors, trace, impulses, fields, w, remainder)
        divide_by_mass(rows, pushes, pulls, fields, remainder, change)
        add_change(rows, weight, pulls, pushes, fields, change, w)


@kernel
def take_impulses(rows, nodes, per_unit, nodal, impulses):
    """Take the impulses at the nodes of some blocks.

    Args:
        rows: Blocks to process, shape (n,).
        nodes: PhaseNodes.
        per_unit: Inverse mass of a full cell [1/kg].
        nodal: Impulse [kg m/s], and a fourth number, shape (node blocks, 256).
        impulses: The same per mass of a full cell, flat (out).
    """
    for b in rows:
        nb = nodes.node_block[b]
        for q in range(64):
            for a in range(3):
                value = nodal[nb, 4 * q + a] * per_unit
                is_own = nodes.region[b, q]
                impulses[192 * b + 64 * a + q] = value if is_own else 0.0 * per_unit


@kernel
def store_impulses(rows, nodes, unit, w, remainder, fields, velocity, nodal):
    """Store the impulses that give the nodes of some blocks their changes of velocity.

    What presses them on walls stays, so that these find their friction.

    Args:
        rows: Blocks to process, shape (n,).
        nodes: PhaseNodes.
        unit: Mass of a full cell [kg].
        w: Changes of velocity, flat.
        remainder: Impulses less K w, also where walls hold nodes, flat; none without walls.
        fields: SolidFields.
        velocity: Velocity [m/s] and mass [kg], shape (node blocks, 256).
        nodal: See `take_impulses` (in/out).
    """
    for b in rows:
        nb = nodes.node_block[b]
        for q in range(64):
            mass = unit * fields.mass[64 * b + q]
            for a in range(3):
                n = 192 * b + 64 * a + q
                impulse = mass * fields.uptake[64 * b + q] * w[n]
                if mass > 0 and len(remainder) > 0 and not fields.loose[n] > 0:
                    is_low = node_index_of(nodes.block[b], q, a) == 0
                    reach = mass * velocity[nb, 4 * q + a]  # it does not leave the wall
                    impulse = unit * remainder[n]
                    impulse = min(impulse, -reach) if is_low else max(impulse, -reach)
                nodal[nb, 4 * q + a] = impulse


@kernel
def expect_velocities(rows, nodes, velocity, w, expected):
    """Note the velocities of the nodes of some blocks with changes that are to come.

    Args:
        rows: Blocks to process, shape (n,).
        nodes: PhaseNodes.
        velocity: Velocity [m/s] and mass [kg], shape (node blocks, 256).
        w: Changes of velocity, flat.
        expected: Flat (out).
    """
    for b in rows:
        nb = nodes.node_block[b]
        for q in range(64):
            for a in range(3):
                n = 192 * b + 64 * a + q
                expected[n] = velocity[nb, 4 * q + a] + w[n]


@always_inline
def _is_on_wall(block, q, axis, extent):
    """Return whether a node of a block is on a wall across an axis, or beyond it."""
    node = node_index_of(block, q, axis)
    return node <= 0 or node >= extent[axis]


@kernel
def take_contact(rows, nodes, extent, velocity, fields, expected, impulses, touches):
    """Take the impulses of what has changed the nodes of some blocks where nothing holds them.

    Of nodes on walls these are the impulses across the wall.

    Args:
        rows: Blocks to process, shape (n,).
        nodes: PhaseNodes.
        extent: Cells of the domain, shape (3,).
        velocity, expected: See `expect_velocities`.
        fields: SolidFields.
        impulses: Per mass of a full cell, flat (out).
        touches: Becomes 1 if there are any, shape (1,) (in/out).
    """
    for b in rows:
        nb = nodes.node_block[b]
        for q in range(64):
            mass, on_wall = fields.mass[64 * b + q], False
            if fields.is_held[64 * b + q] > 0 or not mass > 0:
                continue
            for a in range(3):
                on_wall = on_wall or _is_on_wall(nodes.block[b], q, a, extent)
            for a in range(3):
                n = 192 * b + 64 * a + q
                is_free = not on_wall or _is_on_wall(nodes.block[b], q, a, extent)
                if not is_free or not fields.loose[n] > 0:
                    continue
                change = velocity[nb, 4 * q + a] - expected[n]
                if abs(change) > MIN_CHANGE * abs(expected[n]):
                    impulses[n] = mass * change
                    touches[0] = 1


@kernel
def spread_contact(rows, nodes, w, fields, impulses, velocity):
    """Replace what impulses did to the nodes of some blocks by what they do to all together.

    Args:
        rows: Blocks to process, shape (n,).
        nodes: PhaseNodes.
        w: Changes of velocity by the impulses, flat.
        fields: SolidFields.
        impulses: Per mass of a full cell, flat.
        velocity: Velocity [m/s] and mass [kg], shape (node blocks, 256) (in/out).
    """
    for b in rows:
        nb = nodes.node_block[b]
        for q in range(64):
            mass = fields.mass[64 * b + q]
            if not mass > 0:
                continue
            for a in range(3):
                n = 192 * b + 64 * a + q
                velocity[nb, 4 * q + a] += w[n] - impulses[n] / mass
