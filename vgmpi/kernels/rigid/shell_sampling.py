"""Thin walls in the frames of their colliders: signed distance from the middle of the wall.

The distance from the middle surface is positive on the near side of a wall and negative on its far
side, so that it is smooth through the wall, however thin that is.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.runtime.jit import device_function, kernel

from .sdf_sampling import own_position, sample_side, store_side

WALL_BAND_CELLS = 5.0  # [cells] distance from a wall within which particles have a side
SIDED, NEAR_EDGE, EDGE = 1, 2, 3  # kinds of lattice points, 0: far from the wall


class ShellLattice(NamedTuple):
    """Sides and thickness of a thin wall on a lattice around it, at rest."""

    start: np.ndarray  # (3,) [m] first point
    middle: np.ndarray  # (nx, ny, nz) [m] distance from the middle surface, signed by side
    thickness: np.ndarray  # (nx, ny, nz) [m] of the closest wall
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
    middle: np.ndarray  # (n,) [m] see `ShellLattice`
    thickness: np.ndarray  # (n,) [m]
    kinds: np.ndarray  # (n,)
    # (blocks, 64) (out) [m] thickness of the wall next to a node, negative on its far side; 0: the
    # closest face is not one of a thin wall, or the node lies beyond its edge
    sides: np.ndarray
    scratch: np.ndarray  # (5,)


def with_shells(table, colliders: list) -> SampledShells:
    """Return sampled colliders with their thin walls.

    Args:
        table: SampledSdf.
        colliders: Colliders; `shell` is the ShellLattice of a thin wall or None.
    """
    shells = [getattr(collider, "shell", None) for collider in colliders]
    sizes = [0 if shell is None else shell.middle.size for shell in shells]
    first = np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(np.int64)
    first[np.array(sizes) == 0] = -1
    thin = [shell for shell in shells if shell is not None]
    zero = np.zeros(3)
    return SampledShells(
        *table, first,
        np.array([zero if s is None else s.middle.shape for s in shells], np.int64),
        np.array([zero if s is None else s.start for s in shells], np.float64),
        np.concatenate([s.middle.ravel() for s in thin]).astype(np.float64),
        np.concatenate([s.thickness.ravel() for s in thin]).astype(np.float64),
        np.concatenate([s.kinds.ravel() for s in thin]).astype(np.int8),
        np.zeros((0, 64)), np.zeros(5),
    )  # fmt: skip


@device_function
def sample_shell(shells, m, own, sample):
    """Interpolate distance from the middle of a thin wall and its gradient.

    Args:
        shells: SampledShells.
        m: Number of the collider.
        own: Point in the collider's frame, shape (3,) [m].
        sample: Gradient, distance from the middle surface [m] and thickness [m] (out), shape (5,).

    Returns:
        Kind of the closest lattice point, see `ShellLattice`.
    """
    if shells.shell_first[m] < 0:
        return 0
    nx, ny, nz = shells.shell_shape[m, 0], shells.shell_shape[m, 1], shells.shell_shape[m, 2]
    h = shells.spacing
    x = (own[0] - shells.shell_start[m, 0]) / h
    y = (own[1] - shells.shell_start[m, 1]) / h
    z = (own[2] - shells.shell_start[m, 2]) / h
    i, j, k = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
    if i < 0 or j < 0 or k < 0 or i > nx - 2 or j > ny - 2 or k > nz - 2:
        return 0
    x, y, z = x - i, y - j, z - k
    base = shells.shell_first[m] + (i * ny + j) * nz + k
    closest = base + int(x + 0.5) * ny * nz + int(y + 0.5) * nz + int(z + 0.5)
    v, up, over = shells.middle, nz, ny * nz
    a, b, c, d = v[base], v[base + 1], v[base + up], v[base + up + 1]
    e, f, g, q = v[base + over], v[base + over + 1], v[base + over + up], v[base + over + up + 1]
    low, high, low2, high2 = a + z * (b - a), c + z * (d - c), e + z * (f - e), g + z * (q - g)
    lower, upper = low + y * (high - low), low2 + y * (high2 - low2)
    sample[0] = (upper - lower) / h
    sample[1] = ((high - low) * (1 - x) + (high2 - low2) * x) / h
    along, along2 = (b - a) * (1 - y) + (d - c) * y, (f - e) * (1 - y) + (q - g) * y
    sample[2] = (along * (1 - x) + along2 * x) / h
    sample[3] = lower + x * (upper - lower)
    sample[4] = shells.thickness[closest]
    return shells.kinds[closest]


@sample_side.of(SampledShells)
def _side(shells, m, own, sample):
    shell = shells.scratch
    kind = sample_shell(shells, m, own, shell)
    if kind == 0 or kind == EDGE:
        return 0.0
    sign = 1.0 if shell[3] >= 0.0 else -1.0
    for k in range(3):
        sample[k] = sign * shell[k]
    sample[3] = sign * shell[3] - 0.5 * shell[4]
    return sign * shell[4]


@store_side.of(SampledShells)
def _store(shells, b, node, side):
    shells.sides[b, node] = side


@kernel
def find_sides(points, shells, middle, kinds):
    """Find the side of the closest thin wall on which points lie.

    Args:
        points: Points, shape (n, 3) [m].
        shells: SampledShells.
        middle: Distance from the middle of the closest wall, negative on its far side (out), shape
            (n,) [m].
        kinds: Kind of the closest lattice point, 0 far from all walls (out), shape (n,).
    """
    own, shell = np.zeros(3), shells.scratch
    for p in range(len(points)):
        middle[p], kinds[p] = np.inf, 0
        for m in range(len(shells.shell_first)):
            if shells.shell_first[m] < 0:
                continue
            own_position(shells, m, points[p], own)
            kind = sample_shell(shells, m, own, shell)
            if kind != 0 and abs(shell[3]) < abs(middle[p]):
                middle[p], kinds[p] = shell[3], kind
