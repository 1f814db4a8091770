"""Faces of colliders around nodes: their curvature, and walls of two or three cells.

Such a wall has one or two nodes across, with faces of opposite sides around them.
Next to a face without liquid, a node is closed: it does not respond to the pressure.
"""

import numpy as np

from vgmpi.runtime.jit import always_inline

CLOSED_DEPTHS = (0.25, 1.5)  # [cells] nodes less deep, and deeper, are not closed
FACE_DEPTH = 0.01  # [cells] depth up to which a node counts as outside
OPPOSITE = -0.5  # [-] product of the normals of faces of opposite sides, at most


@always_inline
def distance_beside(b, q, axis, side, lattice, colliders):
    """Return the distance of a collider from the node beside a node, inf where it is unknown [m].

    Args:
        b, q: Block, and number of the node in it.
        axis, side: Axis along which the other node lies, and -1 or 1.
        lattice, colliders: See pressure_system.py `share_nodes`.
    """
    size = 16 if axis == 0 else (4 if axis == 1 else 1)
    block_step = 9 if axis == 0 else (3 if axis == 1 else 1)
    block, node = b, q + side * size
    if q // size % 4 == (3 if side > 0 else 0):
        block = lattice.neighbors[27 * b + 13 + side * block_step]
        node -= side * 4 * size
    row = colliders.row[block] if block < len(colliders.row) else -1
    return colliders.nodes[row, node, 3] if row >= 0 else colliders.nodes.dtype.type(np.inf)


@always_inline
def curvature_at(b, q, lattice, colliders):
    """Return the sum of second differences of the distances at a node, 0 where some are unknown.

    Over the square of the cell size, it is twice the mean curvature of the nearest face.

    Args:
        b, q: Block, and number of the node in it.
        lattice, colliders: See pressure_system.py `share_nodes`.
    """
    own, total = colliders.nodes[colliders.row[b], q, 3], 0.0
    for a in range(3):
        for side in (-1, 1):
            distance = distance_beside(b, q, a, side, lattice, colliders)
            if not distance < np.inf:
                return 0.0 * own
            total += distance - own
    return total


@always_inline
def find_faces(b, q, lattice, colliders, dx, fill, min_fill, faces):
    """Find the faces of colliders around a node in one; return their number.

    Args:
        b, q: Block and node.
        lattice, colliders, dx: See pressure_system.py `share_nodes`.
        fill: Filled part of the nodes, flat.
        min_fill: Filled part of a node above which it has liquid.
        faces: Normal, and -1 at a node inside, 0 at one outside without liquid, 1 with liquid,
            shape (27, 4) (out).
    """
    count = 0
    for place in range(27):
        block, node = _node_around(b, q, place, lattice)
        row = colliders.row[block] if block < len(colliders.row) else -1
        if row < 0 or not -dx * (1.0 + FACE_DEPTH) < colliders.nodes[row, node, 3] < np.inf:
            continue
        for a in range(3):
            faces[count, a] = colliders.nodes[row, node, a]
        is_wet = fill[64 * block + node] > min_fill
        is_outside = colliders.nodes[row, node, 3] > -dx * FACE_DEPTH
        faces[count, 3] = (1.0 if is_wet else 0.0) if is_outside else -1.0
        count += 1
    return count


@always_inline
def _are_opposite(faces, i, j):
    """Return whether two normals point to opposite sides."""
    product = 0.0
    for a in range(3):
        product += faces[i, a] * faces[j, a]
    return product < OPPOSITE


@always_inline
def has_opposite_faces(count, faces):
    """Return whether some of the faces are those of opposite sides."""
    for i in range(count):
        for j in range(i):
            if _are_opposite(faces, i, j):
                return True
    return False


@always_inline
def has_dry_side(count, faces):
    """Return whether a face without liquid is on a side on which no other one has liquid."""
    for i in range(count):
        is_dry = faces[i, 3] == 0.0
        for j in range(count):
            is_dry = is_dry and not (faces[j, 3] > 0.0 and not _are_opposite(faces, i, j))
        if is_dry:
            return True
    return False


@always_inline
def _node_around(b, q, place, lattice):
    """Return block and number of one of the 27 nodes around a node, which itself has place 13."""
    block, node = 0, 0
    for a in range(3):
        size, weight = (16, 9) if a == 0 else ((4, 3) if a == 1 else (1, 1))
        step = q // size % 4 + place // weight % 3 - 1
        block += weight * (step // 4 + 1)
        node += size * (step % 4)
    return lattice.neighbors[27 * b + block], node
