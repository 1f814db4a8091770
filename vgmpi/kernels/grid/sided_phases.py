"""Constants of the phases, and nodes next to thin walls, whose two sides are two velocity fields.

For the field of side s, a wall is a half space behind the face of that side. Where no wall is
close, and beyond the edges of walls, both fields are one: they have the mean velocity, and contact
sees the sum of both.
"""

from collections import namedtuple
from typing import NamedTuple

import numpy as np

from vgmpi.kernels.simd.cooperative import strided_range, sync_threads
from vgmpi.kernels.simd.static_dispatch import static_dispatch
from vgmpi.runtime.jit import device_function

SIDED_CELLS = 1.5  # [cells] distance from a wall within which its two sides are two fields


class Phases(NamedTuple):
    """Constants of the phases that the grid update needs."""

    least: np.ndarray  # (phases,) [kg] mass of a cell full of its lightest material
    contact_priority: np.ndarray  # (phases,) priority of its surface for the normal: lowest first
    friction: np.ndarray  # (phases + 1, phases) [-] Coulomb coefficients, last row: colliders
    stiff: np.ndarray  # (phases,) [Pa] wave modulus of its stiffest law at rest
    surface: np.ndarray  # (phases,) bool: the surfaces of its bodies are resolved
    at_walls: np.ndarray  # (phases,) bool: separate walls push these surfaces by contact
    liquid: np.ndarray  # (phases,) bool: it holds a liquid


# The fields of Phases, and the thin walls next to the nodes of this rank: `side` (phases,), 1 or -1
# (back side of walls), 0 without sides; `twin` (phases,), the same phase on the other side or -1;
# `walls` (n, 64, 4), outward normal and distance [m] of the nearest collider; `faces`
# (n, 64, 2, 4), see `SampledShells`.
SidedPhases = namedtuple("SidedPhases", (*Phases._fields, "side", "twin", "walls", "faces"))  # type: ignore[misc]


def sided_phases(phases: Phases, sides, solids) -> Phases | SidedPhases:
    """Return the phases with the thin walls where they are now; as they are without thin walls.

    Args:
        phases: Constants of the phases.
        sides: WallSidesPlan, or None.
        solids: Colliders at the nodes, or None.
    """
    if sides is None or solids is None:
        return phases
    rows = np.array(sides.side), np.array(sides.twin), solids.nodes, solids.table.faces
    return SidedPhases._make((*phases, *rows))


@static_dispatch
def unite_sides(phases, block, solid, phase_of, nodes, offsets, dx):
    """Move what is on the back side of walls into the other field, where both are one.

    There, the back field has velocity 0 and the negative of its mass.

    Args:
        phases: Constants of the phases.
        block, solid: Context of the block; its row among those near colliders, or -1.
        phase_of: Phase of each node block.
        nodes: Velocities and masses, flat (in/out).
        offsets: Values of the field of offsets, flat (in/out).
        dx: Cell size [m].
    """


@unite_sides.of(Phases)
def _no_union(phases, block, solid, phase_of, nodes, offsets, dx):
    pass


@unite_sides.of(SidedPhases)
def _unite(phases, block, solid, phase_of, nodes, offsets, dx):
    for back in range(block.n0, block.n1):
        front = _other_side(phases, back, block.n0, block.n1, phase_of)
        if front < 0:
            continue
        for node in strided_range(64):
            o, p = 256 * front + 4 * node, 256 * back + 4 * node
            if nodes[p + 3] <= 0.0 or is_sided(phases, solid, node, dx):
                continue
            m, n = nodes[o + 3], nodes[p + 3]
            for c in range(3):
                nodes[o + c] = (m * nodes[o + c] + n * nodes[p + c]) / (m + n)
                nodes[p + c] = 0.0
            nodes[o + 3], nodes[p + 3] = m + n, -n
            if block.meets:
                for c in range(4):
                    offsets[o + c] += offsets[p + c]
    sync_threads()


@static_dispatch
def part_sides(phases, block, phase_of, nodes):
    """Give the back field its mass and the common velocity where `unite_sides` made both one.

    Args:
        phases: Constants of the phases.
        block: Context of the block.
        phase_of: Phase of each node block.
        nodes: Velocities and masses, flat (in/out).
    """


@part_sides.of(Phases)
def _no_parting(phases, block, phase_of, nodes):
    pass


@part_sides.of(SidedPhases)
def _part(phases, block, phase_of, nodes):
    sync_threads()
    for back in range(block.n0, block.n1):
        front = _other_side(phases, back, block.n0, block.n1, phase_of)
        if front < 0:
            continue
        for node in strided_range(64):
            o, p = 256 * front + 4 * node, 256 * back + 4 * node
            if nodes[p + 3] < 0.0:
                for c in range(3):
                    nodes[p + c] = nodes[o + c]
                nodes[o + 3] += nodes[p + 3]
                nodes[p + 3] = -nodes[p + 3]
    sync_threads()


@static_dispatch
def average_sides(phases, n0, n1, solid, phase_of, nodes, dx):
    """Give both sides their mean velocity where they are one, without changing their masses.

    Args:
        phases: Constants of the phases.
        n0, n1: Node blocks of a block.
        solid: Row of the block among those near colliders, or -1.
        phase_of: Phase of each node block.
        nodes: Velocities and masses, flat (in/out).
        dx: Cell size [m].
    """


@average_sides.of(Phases)
def _no_average(phases, n0, n1, solid, phase_of, nodes, dx):
    pass


@average_sides.of(SidedPhases)
def _average(phases, n0, n1, solid, phase_of, nodes, dx):
    for back in range(n0, n1):
        front = _other_side(phases, back, n0, n1, phase_of)
        if front < 0:
            continue
        for node in strided_range(64):
            o, p = 256 * front + 4 * node, 256 * back + 4 * node
            m, n = nodes[o + 3], nodes[p + 3]
            if n <= 0.0 or is_sided(phases, solid, node, dx):
                continue
            for c in range(3):
                nodes[o + c] = nodes[p + c] = (m * nodes[o + c] + n * nodes[p + c]) / (m + n)
    sync_threads()


@static_dispatch
def are_apart(phases, p, q, solid, node, dx):
    """Return whether two phases lie on different sides of a wall, so that they do not meet.

    Args:
        phases: Constants of the phases.
        p, q: The two phases.
        solid: Row of the block among those near colliders, or -1.
        node: Node in its block.
        dx: Cell size [m].
    """


@are_apart.of(Phases)
def _never_apart(phases, p, q, solid, node, dx):
    return False


@are_apart.of(SidedPhases)
def _apart(phases, p, q, solid, node, dx):
    return phases.side[p] * phases.side[q] < 0 and is_sided(phases, solid, node, dx)


@static_dispatch
def face_of_side(phases, p, solid, node, dx, normal, distance):
    """Return the distance [m] of a node outside a collider as a phase meets it.

    Where both sides of a wall are one field, that is the closest face.

    Args:
        phases: Constants of the phases.
        p: Phase.
        solid: Row of the block among those near colliders.
        node: Node in its block.
        dx: Cell size [m].
        normal: Outward normal of the closest face; then of that which the phase meets (in/out).
        distance: Distance of the node outside the closest face [m].
    """


@face_of_side.of(Phases)
def _closest_face(phases, p, solid, node, dx, normal, distance):
    return distance


@face_of_side.of(SidedPhases)
def _own_face(phases, p, solid, node, dx, normal, distance):
    if phases.side[p] == 0 or not is_sided(phases, solid, node, dx):
        return distance
    face = phases.faces[solid, node, (1 - phases.side[p]) // 2]
    for c in range(3):
        normal[c] = face[c]
    return face[3]


@static_dispatch
def distance_of_side(phases, p, solid, node):
    """Return the distance [m] of a node outside the face of a thin wall on the side of a phase.

    Args:
        phases: Constants of the phases.
        p: Phase.
        solid: Row of the block among those near colliders.
        node: Node in its block.
    """


@distance_of_side.of(Phases)
def _no_distance(phases, p, solid, node):
    return np.inf


@distance_of_side.of(SidedPhases)
def _own_distance(phases, p, solid, node):
    if phases.side[p] == 0:
        return np.inf
    return phases.faces[solid, node, (1 - phases.side[p]) // 2, 3]


@static_dispatch
def is_sided(phases, solid, node, dx):
    """Return whether the two sides of a thin wall are two fields at a node.

    Args:
        phases: Constants of the phases.
        solid: Row of the block among those near colliders, or -1.
        node: Node in its block.
        dx: Cell size [m].
    """


@is_sided.of(Phases)
def _is_never_sided(phases, solid, node, dx):
    return False


@is_sided.of(SidedPhases)
def _is_close_to_wall(phases, solid, node, dx):
    if solid < 0 or not phases.faces[solid, node, 0, 3] < np.inf:
        return False
    return phases.walls[solid, node, 3] < SIDED_CELLS * dx


@static_dispatch
def side_of(phases, p):
    """Return the side of thin walls on which a phase is: 1 or -1 (back), 0 on both."""


@side_of.of(Phases)
def _no_side(phases, p):
    return 0


@side_of.of(SidedPhases)
def _stored_side(phases, p):
    return phases.side[p]


@device_function
def _other_side(phases, back, n0, n1, phase_of):
    """Return the node block of the front side of a back one, or -1."""
    p = phase_of[back]
    if phases.side[p] < 0:
        for nb in range(n0, n1):
            if phase_of[nb] == phases.twin[p]:
                return nb
    return -1
