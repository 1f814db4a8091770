"""Thin walls in compiled code: colliders with two sides, and nodes that they divide.

The distance of a side goes on decreasing through the wall and behind it, so that it is smooth
through the wall, however thin that is. For the velocity field of side s, a wall is a half space
behind the face of that side. Where no wall is close, and beyond the edges of walls, both fields are
one (kernels/grid/divided_nodes.py).
"""

from collections import namedtuple
from typing import NamedTuple

import numpy as np

from vgmpi.kernels.colliders.sdf_sampling import (
    SampledSdf,
    interpolate_cell,
    own_position,
    sample_side,
    store_side,
    turn_gradient,
)
from vgmpi.kernels.grid.divided_nodes import (
    Phases,
    are_apart,
    average_phases,
    distance_of_phase,
    face_of_phase,
    half_of,
    is_divided,
    part_phases,
    unite_phases,
)
from vgmpi.kernels.simd.cooperative import strided_range, sync_threads
from vgmpi.runtime.jit import device_function, kernel

SIDED_CELLS = 1.5  # [cells] distance from a wall within which its two sides are two fields
WALL_BAND_CELLS = 5.0  # [cells] distance from a wall within which particles have a side
MIN_OVERLAP_CELLS = 0.05  # [cells] depth from which a body inside a wall is named
SIDED, NEAR_EDGE, EDGE = 1, 2, 3  # kinds of lattice points, 0: far from the wall


class ShellLattice(NamedTuple):
    """Sides of a thin wall on a lattice around it, at rest.

    The distance of a side is positive in what is free on that side, and negative in the wall and
    behind it.
    """

    start: np.ndarray  # (3,) [m] first point
    front: np.ndarray  # (nx, ny, nz) [m] signed distance of the front side
    back: np.ndarray  # (nx, ny, nz) [m] signed distance of the back side
    kinds: np.ndarray  # (nx, ny, nz) int8: SIDED, NEAR_EDGE, EDGE (beyond the edge) or 0

    @property
    def min_overlap_cells(self) -> float:
        """Return the depth in the wall [cells] from which a body that begins there is named."""
        return MIN_OVERLAP_CELLS

    @staticmethod
    def extend_table(table: SampledSdf, details: list) -> "SampledShells":
        """Return the table of sampled colliders with the sides of those that are thin walls.

        Args:
            table: Sampled colliders.
            details: ShellLattice of each collider, or None.
        """
        return _with_shells(table, details)


class SampledShells(NamedTuple):
    """Sampled colliders some of which are thin walls; the first fields are those of SampledSdf."""

    values: np.ndarray
    first: np.ndarray
    shape: np.ndarray
    start: np.ndarray
    spacing: float
    about: np.ndarray
    rotation: np.ndarray
    move: np.ndarray
    rotation_end: np.ndarray
    move_end: np.ndarray
    shell_first: np.ndarray  # (m,) row at which each lattice of a thin wall begins, -1 for none
    shell_shape: np.ndarray  # (m, 3) points of each lattice along the axes
    shell_start: np.ndarray  # (m, 3) [m] first point of each lattice
    distances: np.ndarray  # (n, 2) [m] see `ShellLattice`
    kinds: np.ndarray  # (n,)
    # (blocks, 64, 2, 4) (out) normal and distance [m] of the wall for its front and its back side;
    # an infinite distance if the closest face is not one of a thin wall, or beyond an edge
    faces: np.ndarray
    scratch: np.ndarray  # (2, 4)

    def with_blocks(self, count: int) -> "SampledShells":
        """Return the table with room for the nodes of some blocks near colliders."""
        return self._replace(faces=np.zeros((count, 64, 2, 4)))


def _with_shells(table: SampledSdf, shells: list) -> SampledShells:
    """Return sampled colliders with their thin walls; shells: ShellLattice of each, or None."""
    sizes = [0 if shell is None else shell.front.size for shell in shells]
    first = np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(np.int64)
    first[np.array(sizes) == 0] = -1
    thin = [shell for shell in shells if shell is not None]
    none = np.zeros(3)
    pairs = [np.stack([s.front.ravel(), s.back.ravel()], 1) for s in thin]
    shapes = np.array([none if s is None else s.front.shape for s in shells], np.int64)
    starts = np.array([none if s is None else s.start for s in shells], np.float64)
    kinds = np.concatenate([s.kinds.ravel() for s in thin]).astype(np.int8)
    rows = first, shapes, starts, np.concatenate(pairs), kinds
    return SampledShells._make((*table, *rows, np.zeros((0, 64, 2, 4)), np.zeros((2, 4))))


@device_function
def sample_shell(shells, m, own, sample):
    """Interpolate the distances of both sides of a thin wall and their gradients.

    Args:
        shells: SampledShells.
        m: Number of the collider.
        own: Point in the collider's frame, shape (3,) [m].
        sample: Gradient and distance [m] of the front and the back side (out), shape (2, 4).

    Returns:
        Kind of the closest lattice point, see `ShellLattice`.
    """
    if shells.shell_first[m] < 0:
        return 0
    nx, ny, nz = shells.shell_shape[m, 0], shells.shell_shape[m, 1], shells.shell_shape[m, 2]
    r = shells.spacing
    x = (own[0] - shells.shell_start[m, 0]) / r
    y = (own[1] - shells.shell_start[m, 1]) / r
    z = (own[2] - shells.shell_start[m, 2]) / r
    i, j, k = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
    if i < 0 or j < 0 or k < 0 or i > nx - 2 or j > ny - 2 or k > nz - 2:
        return 0
    x, y, z = x - i, y - j, z - k
    base = shells.shell_first[m] + (i * ny + j) * nz + k
    up, over = nz, ny * nz
    for side in range(2):
        v = shells.distances[:, side]
        interpolate_cell(v, base, over, up, (x, y, z), r, sample[side])
    return shells.kinds[base + int(x + 0.5) * over + int(y + 0.5) * up + int(z + 0.5)]


@device_function
def turn_faces(shells, m, faces):
    """Store what `sample_shell` left in the scratch, with unit normals as the wall stands now.

    Args:
        shells: SampledShells.
        m: Number of the collider.
        faces: Normal and distance [m] of the front and the back side (out), shape (2, 4).
    """
    for q in range(2):
        turn_gradient(shells, m, shells.scratch[q], faces[q])
        faces[q, 3] = shells.scratch[q, 3]


@sample_side.register(SampledShells)
def _side(shells, m, own, sample):
    both = shells.scratch
    kind = sample_shell(shells, m, own, both)
    if kind == 0 or kind == EDGE:
        return 0
    side = 0 if both[0, 3] >= both[1, 3] else 1
    for k in range(4):
        sample[k] = both[side, k]
    return 1 - 2 * side


@store_side.register(SampledShells)
def _store(shells, m, b, node, side):
    for q in range(2):
        shells.faces[b, node, q, 3] = np.inf
    if side == 0:
        return
    turn_faces(shells, m, shells.faces[b, node])
    # walls thinner than half a cell, the spacing of the lattice, act as that thick
    excess = 0.5 * max(shells.spacing + shells.scratch[0, 3] + shells.scratch[1, 3], 0.0)
    for q in range(2):
        shells.faces[b, node, q, 3] -= excess


@kernel
def find_sides(points, shells, middle, kinds, faces):
    """Find the side of the closest thin wall on which points lie, and the wall's two faces.

    Args:
        points: Points, shape (n, 3) [m].
        shells: SampledShells.
        middle: Distance from the middle of the closest wall, negative on its back side (out), shape
            (n,) [m].
        kinds: Kind of the closest lattice point, 0 far from all walls (out), shape (n,).
        faces: Normal and distance [m] of that wall for the front and the back side (out), shape
            (n, 2, 4).
    """
    own, both = np.zeros(3), shells.scratch
    for p in range(len(points)):
        middle[p], kinds[p] = np.inf, 0
        for m in range(len(shells.shell_first)):
            if shells.shell_first[m] < 0:
                continue
            own_position(shells, m, points[p], own)
            kind = sample_shell(shells, m, own, both)
            depth = 0.5 * (both[0, 3] - both[1, 3])
            if kind != 0 and abs(depth) < abs(middle[p]):
                middle[p], kinds[p] = depth, kind
                turn_faces(shells, m, faces[p])


# The fields of Phases, and the thin walls next to the nodes of this rank: `side` (phases,), 1 or -1
# (back side of walls), 0 without sides; `twin` (phases,), the same phase on the other side or -1;
# `walls` (n, 64, 4), outward normal and distance [m] of the nearest collider; `faces`
# (n, 64, 2, 4), see `SampledShells`.
SidedPhases = namedtuple("SidedPhases", (*Phases._fields, "side", "twin", "walls", "faces"))  # type: ignore[misc]


@unite_phases.register(SidedPhases)
def _unite(phases, block, solid, phase_of, nodes, offsets, dx):
    for back in range(block.n0, block.n1):
        front = _other_side(phases, back, block.n0, block.n1, phase_of)
        if front < 0:
            continue
        for node in strided_range(64):
            o, p = 256 * front + 4 * node, 256 * back + 4 * node
            if nodes[p + 3] <= 0.0 or is_divided(phases, solid, node, dx):
                continue
            m, n = nodes[o + 3], nodes[p + 3]
            for c in range(3):
                nodes[o + c] = (m * nodes[o + c] + n * nodes[p + c]) / (m + n)
                nodes[p + c] = 0.0
            nodes[o + 3], nodes[p + 3] = m + n, -n
            if block.may_touch:
                for c in range(4):
                    offsets[o + c] += offsets[p + c]
    sync_threads()


@part_phases.register(SidedPhases)
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


@average_phases.register(SidedPhases)
def _average(phases, n0, n1, solid, phase_of, nodes, dx):
    for back in range(n0, n1):
        front = _other_side(phases, back, n0, n1, phase_of)
        if front < 0:
            continue
        for node in strided_range(64):
            o, p = 256 * front + 4 * node, 256 * back + 4 * node
            m, n = nodes[o + 3], nodes[p + 3]
            if n <= 0.0 or is_divided(phases, solid, node, dx):
                continue
            for c in range(3):
                nodes[o + c] = nodes[p + c] = (m * nodes[o + c] + n * nodes[p + c]) / (m + n)
    sync_threads()


@are_apart.register(SidedPhases)
def _apart(phases, p, q, solid, node, dx):
    return phases.side[p] * phases.side[q] < 0 and is_divided(phases, solid, node, dx)


@face_of_phase.register(SidedPhases)
def _own_face(phases, p, solid, node, dx, normal, distance):
    if phases.side[p] == 0 or not is_divided(phases, solid, node, dx):
        return distance
    face = phases.faces[solid, node, (1 - phases.side[p]) // 2]
    for c in range(3):
        normal[c] = face[c]
    return face[3]


@distance_of_phase.register(SidedPhases)
def _own_distance(phases, p, solid, node):
    if phases.side[p] == 0:
        return np.inf
    return phases.faces[solid, node, (1 - phases.side[p]) // 2, 3]


@is_divided.register(SidedPhases)
def _is_close_to_wall(phases, solid, node, dx):
    if solid < 0 or not phases.faces[solid, node, 0, 3] < np.inf:
        return False
    return phases.walls[solid, node, 3] < SIDED_CELLS * dx


@half_of.register(SidedPhases)
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
