"""Reactions of rigid boundaries on bodies: impulse, its moment and work per step.

They are recorded for each collider, each body with prescribed motion and each wall.

Sums are integer multiples of quanta, so that their terms may come in any order. Where no reactions
are requested the record is None, and nothing of this module is compiled in. Terms come from three
sources: the action of rigid boundaries at nodes (kernels/grid/contact.py, apply_wall_conditions);
the change of momentum when ghost nodes are folded at a mirroring wall (fold_ghost_momentum); and
the mirrored velocities that particles gather (fill_ghost_velocity), whose impulse is the ghost
nodes' own mass times the difference from their mirror image.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.kernels.simd.cooperative import atomic_add_int
from vgmpi.runtime.jit import device_function

NUMBERS = 7  # per row: impulse [kg m/s], moment about the domain's origin [kg m2/s], work [J]
WALLS = 6
PLANE = 64  # nodes in a plane of a patch


class ReactionSums(NamedTuple):
    """Reaction sums of one thread, and the node and boundary that it is processing."""

    # (rows, 7) int64; rows: colliders, prescribed bodies, then walls: west, east; south, north; ...
    sums: np.ndarray
    quanta: np.ndarray  # (7,) quantum of each sum, a power of two
    counts: np.ndarray  # (blocks, 64) uint8: 1 at nodes that this rank alone counts
    now: np.ndarray  # (3,) current block, node and row
    node: np.ndarray  # (3,) [m] position of the current node
    surface_point: np.ndarray  # (3,) [m] position of the surface that acts on it
    pairs: np.ndarray  # (m,) row of each contact pair at a node
    places: np.ndarray  # (m, 3) [m] position of its rigid surface
    first: int  # row of the first wall
    dx: float  # [m] cell size


class GhostNodes(NamedTuple):
    """Ghost nodes of the segments of a group that reach beyond walls."""

    reactions: ReactionSums  # sums of the calling thread
    slot: np.ndarray  # (segments,) row of mass, -1 for segments that reach no wall
    low: np.ndarray  # (segments, 3) first node of each patch
    mass: np.ndarray  # (n, 6, 64) [kg] own mass of the nodes beyond each wall
    share: float  # [-] fraction of the momentum mirror's impulse that particles take up
    change_share: float  # [-] fraction for the mirror of the velocity change (FLIP)
    holds_mass: int  # whether the sums contain the mass


def reaction_sums(rows: int, quanta: np.ndarray, phases: int, dx: float) -> ReactionSums:
    """Return empty reaction sums of one thread.

    Args:
        rows: Number of colliders, prescribed bodies and walls.
        quanta: Quantum of each of the seven sums, shape (7,).
        phases: Number of phases.
        dx: Cell size [m].
    """
    m = phases * (phases + 1) // 2 + 3 * phases
    return ReactionSums(
        np.zeros((rows, NUMBERS), np.int64), quanta, np.zeros((0, 64), np.uint8),
        np.zeros(3, np.int64), np.zeros(3), np.zeros(3), np.zeros(m, np.int64), np.zeros((m, 3)),
        rows - WALLS, dx,
    )  # fmt: skip


@device_function
def _add(reaction, row, position, jx, jy, jz, work):
    """Add an impulse [kg m/s] on bodies at a position [m], and its work [J], to a row."""
    own, quanta = reaction.sums[row], reaction.quanta
    atomic_add_int(own, 0, np.int64(np.rint(jx / quanta[0])))
    atomic_add_int(own, 1, np.int64(np.rint(jy / quanta[1])))
    atomic_add_int(own, 2, np.int64(np.rint(jz / quanta[2])))
    atomic_add_int(own, 3, np.int64(np.rint((position[1] * jz - position[2] * jy) / quanta[3])))
    atomic_add_int(own, 4, np.int64(np.rint((position[2] * jx - position[0] * jz) / quanta[4])))
    atomic_add_int(own, 5, np.int64(np.rint((position[0] * jy - position[1] * jx) / quanta[5])))
    atomic_add_int(own, 6, np.int64(np.rint(work / quanta[6])))


# ---- at nodes -----------------------------------------------------------------------------------


@device_function
def set_block(reaction, b):
    """Set the block of the following records."""
    if reaction is not None:
        reaction.now[0] = b


@device_function
def set_node(reaction, node, i, j, k):
    """Set the node of the following records.

    Args:
        reaction: Reaction sums (in/out), or None.
        node: Number of the node in its block.
        i, j, k: Node indices in the domain.
    """
    if reaction is not None:
        reaction.now[1] = node
        reaction.node[0], reaction.node[1], reaction.node[2] = (
            i * reaction.dx,
            j * reaction.dx,
            k * reaction.dx,
        )


@device_function
def set_collider(reaction, number, surface):
    """Set a collider as the source of the following records.

    Args:
        reaction: Reaction sums (in/out), or None.
        number: Row of the collider.
        surface: Its outward normal and the distance of the node [m], shape (4,).
    """
    if reaction is not None:
        reaction.now[2] = number
        for c in range(3):
            reaction.surface_point[c] = reaction.node[c] - surface[3] * surface[c]


@device_function
def set_wall(reaction, a, side, surface):
    """Set the wall across axis a as the source of the following records.

    Args:
        reaction: Reaction sums (in/out), or None.
        a, side: Axis and side of the wall.
        surface: Its inward normal and the distance of the node [m], shape (4,).
    """
    if reaction is not None:
        set_collider(reaction, reaction.first + 2 * a + side, surface)


@device_function
def _counted(reaction):
    """Return whether this rank counts the current node."""
    return reaction.counts[reaction.now[0], reaction.now[1]] != 0


@device_function
def add_contact_reaction(reaction, before, after, mass, speed, was, pairs):
    """Add the reaction of a rigid boundary that changed the velocity of a phase.

    Args:
        reaction: Reaction sums (in/out), or None.
        before: Velocity of the phase before, shape (3,) [m/s].
        after: Velocity of the phase after, shape (3,) [m/s].
        mass: Nodal mass of the phase [kg].
        speed: Velocity of the boundary, shape (3,) [m/s].
        was, pairs: Range of the contact pairs in which the boundary takes part.
    """
    if reaction is not None:
        for q in range(was, pairs):
            reaction.pairs[q] = reaction.now[2]
            for c in range(3):
                reaction.places[q, c] = reaction.surface_point[c]
        if _counted(reaction):
            m = np.float64(mass)
            jx, jy, jz = (
                m * (after[0] - before[0]), m * (after[1] - before[1]), m * (after[2] - before[2])
            )  # fmt: skip
            work = jx * speed[0] + jy * speed[1] + jz * speed[2]
            _add(reaction, reaction.now[2], reaction.surface_point, jx, jy, jz, work)


@device_function
def add_prescribed_reaction(reaction, row, before, after, mass, speed, was, pairs):
    """Add the reaction of a body with prescribed motion; it acts at the node.

    Args:
        reaction: Reaction sums (in/out), or None.
        row: Row of the body, -1 if neither of two phases is prescribed.
        before: Velocity of the phase before, shape (3,) [m/s].
        after: Velocity of the phase after, shape (3,) [m/s].
        mass: Nodal mass of the phase [kg].
        speed: Velocity of the body, shape (3,) [m/s].
        was, pairs: Range of the contact pairs in which the body takes part.
    """
    if reaction is not None:
        for q in range(was, pairs):
            reaction.pairs[q] = row
        if row >= 0:
            reaction.now[2] = row
            for c in range(3):
                reaction.surface_point[c] = reaction.node[c]
            add_contact_reaction(reaction, before, after, mass, speed, was, pairs)


@device_function
def add_pair_reactions(reaction, pairs, workspace):
    """Add the impulses of contact pairs with a rigid or prescribed member.

    Args:
        reaction: Reaction sums (in/out), or None.
        pairs: Number of pairs.
        workspace: Contact scratch of the thread (kernels/grid/contact.py).
    """
    if reaction is not None:
        if _counted(reaction):
            for q in range(pairs):
                if reaction.pairs[q] >= 0:
                    a, b, n, push = (
                        workspace.master[q],
                        workspace.other[q],
                        workspace.normals[q],
                        workspace.impulse[q],
                    )
                    # of two phases the prescribed one is heavier by many orders of magnitude
                    first = a < 0 or workspace.effective_mass[a] > workspace.effective_mass[b]
                    k, speed = (1.0, workspace.v[a]) if first else (-1.0, workspace.v[b])
                    jx = k * (push[0] * n[0] + push[1])
                    jy = k * (push[0] * n[1] + push[2])
                    jz = k * (push[0] * n[2] + push[3])
                    work = jx * speed[0] + jy * speed[1] + jz * speed[2]
                    _add(reaction, reaction.pairs[q], reaction.places[q], jx, jy, jz, work)


@device_function
def add_wall_reaction(reaction, a, side, plane, node, low, before, v):
    """Add the reaction of a wall that changed the velocity of a node.

    Args:
        reaction: Reaction sums (in/out), or None.
        a, side: Axis and side of the wall.
        plane: Node plane of the wall.
        node: Number of the node in its block.
        low: First node of the block, shape (3,).
        before: Velocity before, shape (3,) [m/s].
        v: Velocity after and mass, shape (4,).
    """
    if reaction is not None:
        set_node(reaction, node, low[0] + node // 16, low[1] + node // 4 % 4, low[2] + node % 4)
        if _counted(reaction):
            reaction.node[a] = plane * reaction.dx
            m = np.float64(v[3])
            jx, jy, jz = m * (v[0] - before[0]), m * (v[1] - before[1]), m * (v[2] - before[2])
            _add(reaction, reaction.first + 2 * a + side, reaction.node, jx, jy, jz, 0.0)


@device_function
def add_pressure_reaction(reaction, row, push, speed):
    """Add an impulse on bodies by a collider or a wall, at the surface point of `set_collider`.

    The caller sees to it that one rank alone counts it.

    Args:
        reaction: Reaction sums (in/out), or None.
        row: Row of the collider or the wall.
        push: Impulse on bodies, shape (3,) [kg m/s].
        speed: Velocity of the boundary, shape (3,) [m/s].
    """
    if reaction is not None:
        work = push[0] * speed[0] + push[1] * speed[1] + push[2] * speed[2]
        _add(reaction, row, reaction.surface_point, push[0], push[1], push[2], work)


# ---- in patches ---------------------------------------------------------------------------------


@device_function
def _on_plane(ghosts, s, a, side, wall, i, j, jx, jy, jz):
    """Add an impulse on a wall across axis a, at the node (i, j) of a patch's plane."""
    position, low = ghosts.reactions.surface_point, ghosts.low[s]
    first, second = (1, 2) if a == 0 else ((0, 2) if a == 1 else (0, 1))
    position[a], position[first], position[second] = low[a] + wall, low[first] + i, low[second] + j
    for c in range(3):
        position[c] *= ghosts.reactions.dx
    _add(ghosts.reactions, ghosts.reactions.first + 2 * a + side, position, jx, jy, jz, 0.0)


@device_function
def add_fold_reaction(ghosts, s, a, side, wall, i, j, patch, ghost, stick, yields):
    """Add the reaction of folding a ghost node: a mirror reverses its odd components.

    Args:
        ghosts: Ghost nodes (in/out), or None.
        s: Row of the segment.
        a, side: Axis and side of the wall.
        wall: Plane of the wall in the patch.
        i, j: Indices of the node in the plane.
        patch: Patch of momenta and masses.
        ghost: Position of the ghost node in it.
        stick: Whether the wall is a stick wall.
        yields: Whether it lets go; the mass that it folds back is stored as negative, and the
            impulse is that of its nodes.
    """
    if ghosts is not None:
        if ghosts.holds_mass != 0:
            mass = -patch[ghost + 3] if yields else patch[ghost + 3]
            ghosts.mass[ghosts.slot[s], 2 * a + side, 8 * i + j] = mass
        if not yields:
            k = -2.0 * ghosts.share
            jx = k * patch[ghost] if stick or a == 0 else 0.0
            jy = k * patch[ghost + 1] if stick or a == 1 else 0.0
            jz = k * patch[ghost + 2] if stick or a == 2 else 0.0
            _on_plane(ghosts, s, a, side, wall, i, j, jx, jy, jz)


@device_function
def store_ghost_mass(ghosts, s, a, side, i, j, mass):
    """Store the mass of a ghost node beyond a wall that does not mirror.

    Args:
        ghosts: Ghost nodes (in/out), or None.
        s: Row of the segment.
        a, side: Axis and side of the wall.
        i, j: Indices of the node in the plane.
        mass: Mass of the ghost node [kg].
    """
    if ghosts is not None:
        if ghosts.holds_mass != 0:
            ghosts.mass[ghosts.slot[s], 2 * a + side, 8 * i + j] = mass


@device_function
def was_folded(ghosts, s, a, side, i, j):
    """Return whether a wall that lets go has folded the mass of a ghost node back.

    Args:
        ghosts: Ghost nodes, or None.
        s: Row of the segment.
        a, side: Axis and side of the wall.
        i, j: Place of the node in its plane.
    """
    if ghosts is not None:
        return ghosts.mass[ghosts.slot[s], 2 * a + side, 8 * i + j] < 0
    return False


@device_function
def add_mirror_reaction(ghosts, fraction, s, a, side, wall, i, j, dx, dy, dz):
    """Add the reaction of a mirrored velocity that particles gather at a ghost node.

    Args:
        ghosts: Ghost nodes (in/out), or None.
        fraction: Fraction of the impulse that particles take up.
        s: Row of the segment.
        a, side: Axis and side of the wall.
        wall: Plane of the wall in the patch.
        i, j: Indices of the node in the plane.
        dx, dy, dz: Difference from the velocity to which the node's momentum went [m/s].
    """
    if ghosts is not None:
        m = fraction * abs(ghosts.mass[ghosts.slot[s], 2 * a + side, 8 * i + j])
        _on_plane(ghosts, s, a, side, wall, i, j, m * dx, m * dy, m * dz)


@device_function
def momentum_mirror_fraction(ghosts):
    """Return the fraction of the momentum mirror's impulse that particles take up."""
    if ghosts is not None:
        return ghosts.share
    return 1.0


@device_function
def velocity_mirror_fraction(ghosts):
    """Return the fraction of the velocity-change mirror's impulse that particles take up."""
    if ghosts is not None:
        return ghosts.change_share
    return 1.0
