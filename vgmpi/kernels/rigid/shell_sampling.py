"""Thin walls in the frames of their colliders: a signed distance for each side.

The distance of a side goes on decreasing through the wall and behind it, so that it is smooth
through the wall, however thin that is.
"""

from typing import Any, NamedTuple

import numpy as np

from vgmpi.kernels.colliders.sdf_sampling import (
    interpolate_cell,
    own_position,
    sample_side,
    store_side,
    turn_gradient,
)
from vgmpi.runtime.jit import device_function, kernel

WALL_BAND_CELLS = 5.0  # [cells] distance from a wall within which particles have a side
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


def with_shells(table, colliders: list) -> Any:
    """Return sampled colliders with their thin walls, as SampledShells.

    Args:
        table: SampledSdf.
        colliders: Colliders; `shell` is the ShellLattice of a thin wall or None.
    """
    shells = [getattr(collider, "shell", None) for collider in colliders]
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


@sample_side.of(SampledShells)
def _side(shells, m, own, sample):
    both = shells.scratch
    kind = sample_shell(shells, m, own, both)
    if kind == 0 or kind == EDGE:
        return 0
    side = 0 if both[0, 3] >= both[1, 3] else 1
    for k in range(4):
        sample[k] = both[side, k]
    return 1 - 2 * side


@store_side.of(SampledShells)
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
