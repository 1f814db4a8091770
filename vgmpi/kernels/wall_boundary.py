"""The six walls of the domain and their conditions at nodes.

A stick or slip wall stands on a node plane and mirrors the interior: the momentum that falls on the
ghost nodes beyond it is folded back, reflected, onto their mirror nodes, and the ghosts' velocities
are read from the mirror. That makes the wall second order (a plain clamp at the wall node is first
order). Since every particle that touches a ghost node touches its mirror node too, both happen
inside a patch. An open wall does nothing: particles that reach it are removed
(features/inlets_outlets/coupling.py).

A separate wall only pushes. On liquids it is a clamp with Coulomb friction, or a mirror where the
grid finds their pressure (features/implicit_pressure). On everything else it
is a mirror for what presses on it and a clamp for what pulls: the patch of a segment folds back the
momentum on a ghost node, with the stress impulse, if it leads into the wall. Without that, the
pressure on the wall would push the nodes inside toward it, and the body would sink until half a
cell of it is beyond. Twice this momentum is added to the wall's node, so that momentum stays and
the clamp at the wall's nodes, with its friction, acts on all that presses. A ghost node at rest,
as one without mass is after this, takes its velocity from the mirror. The decision needs the sums
of one segment only, so that it is the same on any number of ranks. Stiff bodies with resolved
surfaces meet the wall like a collider (kernels/grid/contact.py).

A patch meets a wall by a code: 8 * (index of the wall's nodes in the patch) + kind; 0 where it
meets none.
"""

import numpy as np

from vgmpi.kernels.simd.cooperative import strided_range, sync_threads
from vgmpi.runtime.jit import always_inline, device_function

from .grid.collider_hold import give_back_push, lost_push
from .nodal_fields.field_protocol import MIRROR_IMPULSE, MIRROR_MOMENT
from .reaction_impulses import (
    add_fold_reaction,
    add_mirror_reaction,
    add_wall_reaction,
    set_node,
    store_ghost_mass,
    was_folded,
)

# 0: a separate wall that pushes resolved surfaces by contact, not at its nodes; YIELDING: one for
# everything else but liquids; RELEASING: one for liquids whose pressure the grid finds, a mirror
# whose nodes may leave it (features/implicit_pressure)
STICK, SLIP, SEPARATE, OPEN, YIELDING, RELEASING = 1, 2, 3, 4, 5, 6
KINDS = {"stick": STICK, "slip": SLIP, "separate": SEPARATE, "open": OPEN}
SIDE = 8  # nodes along an edge of a patch
# numbers of a patch from a node to the next along x, y, z
NODE_STRIDES = 4 * SIDE * SIDE, 4 * SIDE, 4


def patch_codes(block: np.ndarray, cells: tuple, kinds: np.ndarray) -> np.ndarray:
    """Return the wall codes of patches, shape (n, 3, 2) int32.

    Block b holds base nodes 4 b - 1 .. 4 b + 2, so its patch begins at node 4 b - 2.

    Args:
        block: Block coordinates, shape (n, 3).
        cells: Cells of the domain, three numbers.
        kinds: Wall kinds, shape (3, 2), 0 for a wall without a nodal condition.
    """
    codes = np.zeros((len(block), 3, 2), np.int32)
    for a in range(3):
        for side, node in ((0, 0), (1, cells[a])):
            wall_index = node - (4 * block[:, a] - 2)
            ghost = wall_index - 1 if side == 0 else wall_index + 1
            met = (wall_index >= 1) & (wall_index <= 6) & (ghost >= 0) & (ghost <= 7)
            met &= kinds[a, side] not in (0, OPEN)
            codes[met, a, side] = 8 * wall_index[met] + kinds[a, side]
    return codes


@device_function
def _plane_strides(a):
    """Return the strides in a patch across the planes of axis a, and along their i and j."""
    if a == 0:
        return NODE_STRIDES
    if a == 1:
        return NODE_STRIDES[1], NODE_STRIDES[0], NODE_STRIDES[2]
    return NODE_STRIDES[2], NODE_STRIDES[0], NODE_STRIDES[1]


@device_function
def fold_ghost_momentum(patch, mirror, field_mirror, ghosts, s):
    """Add the ghost nodes of walls, reflected, to their mirror nodes.

    Stick and slip walls reflect all, separate walls of solids what presses on them.

    Args:
        patch: Patch (in/out), shape (2048,) or longer.
        mirror: Wall codes, shape (3, 2).
        field_mirror: How walls reflect the field, see nodal_fields/field_protocol.py.
        ghosts: Ghost nodes that record the change of momentum, or None.
        s: Row of the segment.
    """
    for a in range(3):
        for side in range(2):
            code = mirror[a, side]
            kind = code & 7
            yields = kind == YIELDING
            if code == 0 or kind == SEPARATE or (yields and field_mirror != MIRROR_IMPULSE):
                continue
            wall = code >> 3
            step = 1 if side == 0 else -1
            across, first, second = _plane_strides(a)
            for q in strided_range(SIDE * SIDE):
                i, j = q // SIDE, q % SIDE
                node = i * first + j * second
                inner, ghost = node + (wall + step) * across, node + (wall - step) * across
                if yields:
                    if not step * patch[ghost + a] < 0:  # it does not press
                        store_ghost_mass(ghosts, s, a, side, i, j, patch[ghost + 3])
                        continue
                    # what the reflection takes from the wall, its nodes press on it instead
                    pressed = patch[ghost + a]  # `2 *` it would be computed in double
                    patch[node + wall * across + a] += pressed + pressed
                add_fold_reaction(
                    ghosts, s, a, side, wall, i, j, patch, ghost, kind == STICK, yields
                )
                for c in range(4):
                    odd = c == a or (kind == STICK and c < 3 and field_mirror != MIRROR_MOMENT)
                    patch[inner + c] += -patch[ghost + c] if odd else patch[ghost + c]
                    patch[ghost + c] = 0
            sync_threads()
    if ghosts is not None:
        _store_masses(patch, mirror, ghosts, s)


@device_function
def _store_masses(patch, mirror, ghosts, s):
    """Store the masses of ghost nodes beyond walls that only push."""
    for a in range(3):
        for side in range(2):
            code = mirror[a, side]
            if code & 7 != SEPARATE:
                continue
            beyond = (code >> 3) - 1 if side == 0 else (code >> 3) + 1
            across, first, second = _plane_strides(a)
            for q in strided_range(SIDE * SIDE):
                i, j = q // SIDE, q % SIDE
                ghost = beyond * across + i * first + j * second
                store_ghost_mass(ghosts, s, a, side, i, j, patch[ghost + 3])


@device_function
def fill_ghost_velocity(patch, mirror, ghosts, fraction, s):
    """Set the velocities of the ghost nodes beyond walls from their mirror nodes.

    Args:
        patch: Patch (in/out), shape (2048,) or longer.
        mirror: Wall codes, shape (3, 2).
        ghosts: Ghost nodes that record reactions, or None.
        fraction: Fraction of the reaction that particles take up.
        s: Row of the segment.
    """
    for a in range(3):
        for side in range(2):
            code = mirror[a, side]
            if code == 0:
                continue
            wall = code >> 3
            kind = code & 7
            step = 1 if side == 0 else -1
            across, first, second = _plane_strides(a)
            for q in strided_range(SIDE * SIDE):
                i, j = q // SIDE, q % SIDE
                node = i * first + j * second
                inner, ghost = node + (wall + step) * across, node + (wall - step) * across
                mirrors = kind == SLIP or kind == RELEASING
                slips = mirrors or (kind == YIELDING and _is_at_rest(patch, ghost))
                if kind == STICK or mirrors:
                    patch[ghost + 3] = patch[inner + 3]
                for c in range(3):
                    if kind == STICK or (slips and c == a):
                        patch[ghost + c] = -patch[inner + c]
                    elif slips:
                        patch[ghost + c] = patch[inner + c]
                    elif c == a:
                        # a wall that only pushes: the flow interpolated at the wall must not
                        # enter it
                        before, image = patch[ghost + c], -patch[inner + c]
                        patch[ghost + c] = max(before, image) if side == 0 else min(before, image)
                        more = patch[ghost + c] - before
                        if was_folded(ghosts, s, a, side, i, j):
                            continue
                        x, y, z = _along(a, more)
                        add_mirror_reaction(ghosts, fraction, s, a, side, wall, i, j, x, y, z)
            sync_threads()
    if ghosts is not None:
        _record_mirror(patch, mirror, ghosts, fraction, s)


@always_inline
def _is_at_rest(patch, node):
    """Return whether a node of a patch is at rest, as where all its mass was folded back."""
    return patch[node] == 0 and patch[node + 1] == 0 and patch[node + 2] == 0


@device_function
def complete_wall_mass(patch, mirror):
    """Complete the masses of nodes on stick and slip walls.

    Such a node holds the contribution of one side of the wall; the other side is its image.
    """
    for a in range(3):
        for side in range(2):
            code = mirror[a, side]
            if code == 0 or not (code & 7 == STICK or code & 7 == SLIP):
                continue
            across, first, second = _plane_strides(a)
            for q in strided_range(SIDE * SIDE):
                node = (code >> 3) * across + q // SIDE * first + q % SIDE * second
                patch[node + 3] = 2.0 * patch[node + 3]
            sync_threads()


@device_function
def _along(a, value):
    """Return a vector along axis a."""
    none = 0.0 * value
    return value if a == 0 else none, value if a == 1 else none, value if a == 2 else none


@device_function
def _record_mirror(patch, mirror, ghosts, fraction, s):
    """Record the reactions beyond walls that reflect, after all nodes are reflected."""
    for a in range(3):
        for side in range(2):
            code = mirror[a, side]
            if code == 0 or code & 7 == SEPARATE:
                continue
            wall = code >> 3
            step = 1 if side == 0 else -1
            across, first, second = _plane_strides(a)
            for q in strided_range(SIDE * SIDE):
                i, j = q // SIDE, q % SIDE
                node = i * first + j * second
                inner, ghost = node + (wall + step) * across, node + (wall - step) * across
                if code & 7 == YIELDING and not was_folded(ghosts, s, a, side, i, j):
                    continue
                x = patch[ghost] - patch[inner]
                y = patch[ghost + 1] - patch[inner + 1]
                z = patch[ghost + 2] - patch[inner + 2]
                add_mirror_reaction(ghosts, fraction, s, a, side, wall, i, j, x, y, z)


@device_function
def apply_wall_conditions(nodes, first, low, cells, kinds, friction, reaction, pushed, solids,
                          phases):  # fmt: skip
    """Apply the wall conditions to the velocities of a node block.

    Args:
        nodes: Nodal velocities (in/out); the node block is nodes[first:first + 256].
        first: Offset of the node block.
        low: First node of the block, three indices.
        cells: Cells of the domain, shape (3,).
        kinds: Wall kinds, shape (3, 2).
        friction: Coulomb coefficients, shape (3, 2).
        reaction: Reaction sums (in/out), or None.
        pushed: Phase of the node block and what may push it (grid/collider_hold.py).
        solids, phases: Rigid boundaries, and constants of the phases.
    """
    for a in range(3):
        stride = 16 if a == 0 else (4 if a == 1 else 1)
        stride_a, stride_b = (4, 1) if a == 0 else ((16, 1) if a == 1 else (16, 4))
        for side in range(2):
            kind = kinds[a, side]
            for plane in range(4):
                node = low[a] + plane
                into = -node if side == 0 else node - cells[a]
                if kind == 0 or kind == OPEN or into < 0 or (into > 0 and kind < SEPARATE):
                    continue
                for q in strided_range(16):
                    index = plane * stride + q // 4 * stride_a + q % 4 * stride_b
                    v = first + 4 * index
                    before = nodes[v], nodes[v + 1], nodes[v + 2]
                    if kind == STICK:
                        nodes[v] = nodes[v + 1] = nodes[v + 2] = 0
                    elif kind == SLIP:
                        nodes[v + a] = 0
                    else:
                        push = -nodes[v + a] if side == 0 else nodes[v + a]
                        if push > 0:
                            nodes[v + a] = 0
                            apply_coulomb_friction(nodes, v, friction[a, side] * push)
                    after = nodes[v], nodes[v + 1], nodes[v + 2], nodes[v + 3]
                    add_wall_reaction(reaction, a, side, side * cells[a], index, low, before, after)
                    for source in range(pushed.first, pushed.last):
                        lost = lost_push(pushed, solids, phases, source, index, before, nodes, v)
                        if lost > 0.0:
                            i, j, k = (
                                low[0] + index // 16, low[1] + index // 4 % 4, low[2] + index % 4
                            )  # fmt: skip
                            along = _along_walls(pushed.normal, i, j, k, cells, kinds)
                            set_node(reaction, index, i, j, k)
                            give_back_push(
                                pushed, solids, source, index, lost, along, nodes, v, reaction
                            )
                sync_threads()


@device_function
def _along_walls(normal, i, j, k, cells, kinds):
    """Return a normal without its components into walls.

    Args:
        normal: Normal, shape (3,) or longer.
        i, j, k: Node indices in the domain.
        cells: Cells of the domain, shape (3,).
        kinds: Wall kinds, shape (3, 2).
    """
    x, y, z = normal[0], normal[1], normal[2]
    if _is_blocked(x, i, cells[0], kinds[0, 0], kinds[0, 1]):
        x = 0.0 * x
    if _is_blocked(y, j, cells[1], kinds[1, 0], kinds[1, 1]):
        y = 0.0 * y
    if _is_blocked(z, k, cells[2], kinds[2, 0], kinds[2, 1]):
        z = 0.0 * z
    return x, y, z


@device_function
def _is_blocked(component, node, cells, low, high):
    """Return whether one of two walls, of kinds low and high, stops a velocity across them."""
    if node <= 0 and low != 0 and low != OPEN and (component < 0.0 or low < SEPARATE):
        return True
    return node >= cells and high != 0 and high != OPEN and (component > 0.0 or high < SEPARATE)


@device_function
def apply_coulomb_friction(nodes, offset, reduction):
    """Reduce the length of a velocity by Coulomb friction, after its normal part was removed.

    Args:
        nodes: Nodal velocities (in/out).
        offset: Offset of the velocity, nodes[offset:offset + 3].
        reduction: Largest reduction of its length [m/s].
    """
    x, y, z = nodes[offset], nodes[offset + 1], nodes[offset + 2]
    size = np.sqrt(x * x + y * y + z * z)
    if size > reduction:
        factor = (size - reduction) / size
    else:
        factor = 0.0 * reduction
    for c in range(3):
        nodes[offset + c] *= factor


@device_function
def project_tangential(offsets, index, i, j, k, cells, kinds):
    """Remove the normal part of a volume offset at a mirroring wall, where its mirror cancels it.

    Args:
        offsets: Volume offsets (in/out).
        index: Position of the offset, offsets[index:index + 4].
        i, j, k: Node indices in the domain.
        cells: Cells of the domain, shape (3,).
        kinds: Wall kinds, shape (3, 2).
    """
    for a in range(3):
        node = i if a == 0 else (j if a == 1 else k)
        for side in range(2):
            kind = kinds[a, side]
            if node == side * cells[a] and (kind < SEPARATE or kind == RELEASING):
                offsets[index + a] = 0


@device_function
def stopped_axes(ijk, walls):
    """Return a bit for each axis along which a wall stops a node, -1 at a stick wall."""
    axes = 0
    for a in range(3):
        for side in range(2):
            if ijk[a] == side * walls.cells[a]:
                if walls.kinds[a, side] == STICK:
                    return -1
                if walls.kinds[a, side] == SLIP:
                    axes |= 1 << a
    return axes
