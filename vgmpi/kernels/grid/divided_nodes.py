"""Constants of the phases, and nodes that a collider divides between phases.

A feature may divide nodes: it gives kernels a table of its own that begins with the fields of
`Phases`, and says with the functions of this module what differs at its nodes. A divided node has
two halves, each a velocity field of a material. Where it is not divided, both fields are one: they
have the mean velocity, and contact sees the sum of both.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.kernels.simd.static_dispatch import static_dispatch


class Phases(NamedTuple):
    """Constants of the phases that the grid update needs."""

    min_cell_mass: np.ndarray  # (phases,) [kg] mass of a cell full of its lightest material
    contact_priority: np.ndarray  # (phases,) priority of its surface for the normal: lowest first
    friction: np.ndarray  # (phases + 1, phases) [-] Coulomb coefficients, last row: colliders
    stiff: np.ndarray  # (phases,) [Pa] wave modulus of its stiffest law at rest
    surface: np.ndarray  # (phases,) bool: the surfaces of its bodies are resolved
    at_walls: np.ndarray  # (phases,) bool: separate walls push these surfaces by contact
    liquid: np.ndarray  # (phases,) bool: it holds a liquid


@static_dispatch
def unite_phases(phases, block, solid, phase_of, nodes, offsets, dx):
    """Move what is in the back half into the other field, where both are one.

    There, the back field has velocity 0 and the negative of its mass.

    Args:
        phases: Constants of the phases.
        block, solid: Context of the block; its row among those near colliders, or -1.
        phase_of: Phase of each node block.
        nodes: Velocities and masses, flat (in/out).
        offsets: Values of the field of offsets, flat (in/out).
        dx: Cell size [m].
    """


@unite_phases.register(Phases)
def _no_union(phases, block, solid, phase_of, nodes, offsets, dx):
    pass


@static_dispatch
def part_phases(phases, block, phase_of, nodes):
    """Give the back field its mass and the common velocity where `unite_phases` made both one.

    Args:
        phases: Constants of the phases.
        block: Context of the block.
        phase_of: Phase of each node block.
        nodes: Velocities and masses, flat (in/out).
    """


@part_phases.register(Phases)
def _no_parting(phases, block, phase_of, nodes):
    pass


@static_dispatch
def average_phases(phases, n0, n1, solid, phase_of, nodes, dx):
    """Give both halves their mean velocity where they are one, without changing their masses.

    Args:
        phases: Constants of the phases.
        n0, n1: Node blocks of a block.
        solid: Row of the block among those near colliders, or -1.
        phase_of: Phase of each node block.
        nodes: Velocities and masses, flat (in/out).
        dx: Cell size [m].
    """


@average_phases.register(Phases)
def _no_average(phases, n0, n1, solid, phase_of, nodes, dx):
    pass


@static_dispatch
def are_apart(phases, p, q, solid, node, dx):
    """Return whether two phases lie in different halves of a node, so that they do not meet.

    Args:
        phases: Constants of the phases.
        p, q: The two phases.
        solid: Row of the block among those near colliders, or -1.
        node: Node in its block.
        dx: Cell size [m].
    """


@are_apart.register(Phases)
def _never_apart(phases, p, q, solid, node, dx):
    return False


@static_dispatch
def face_of_phase(phases, p, solid, node, dx, normal, distance):
    """Return the distance [m] of a node outside a collider as a phase meets it.

    Where a node is not divided, that is the closest face.

    Args:
        phases: Constants of the phases.
        p: Phase.
        solid: Row of the block among those near colliders.
        node: Node in its block.
        dx: Cell size [m].
        normal: Outward normal of the closest face; then of that which the phase meets (in/out).
        distance: Distance of the node outside the closest face [m].
    """


@face_of_phase.register(Phases)
def _closest_face(phases, p, solid, node, dx, normal, distance):
    return distance


@static_dispatch
def distance_of_phase(phases, p, solid, node):
    """Return the distance [m] of a node outside the face that divides it, in the half of a phase.

    Args:
        phases: Constants of the phases.
        p: Phase.
        solid: Row of the block among those near colliders.
        node: Node in its block.
    """


@distance_of_phase.register(Phases)
def _no_distance(phases, p, solid, node):
    return np.inf


@static_dispatch
def is_divided(phases, solid, node, dx):
    """Return whether a collider divides a node between phases.

    Args:
        phases: Constants of the phases.
        solid: Row of the block among those near colliders, or -1.
        node: Node in its block.
        dx: Cell size [m].
    """


@is_divided.register(Phases)
def _is_never_divided(phases, solid, node, dx):
    return False


@static_dispatch
def half_of(phases, p):
    """Return the half of divided nodes in which a phase is: 1 or -1 (back), 0 in both."""


@half_of.register(Phases)
def _no_half(phases, p):
    return 0
