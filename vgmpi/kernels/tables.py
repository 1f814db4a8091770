"""What kernels are handed, by name: the particles and segments of a group, the node blocks of a
rank, a layer's sums, what the domain's walls and the scene's phases are.
"""

from typing import NamedTuple

import numpy as np


class Particles(NamedTuple):
    """A group's particles on this rank, see domain.state.Group."""

    xi: np.ndarray  # (3, cap) fixed-point positions
    f: np.ndarray  # (channels, cap)
    ids: np.ndarray  # (cap,)


class Segments(NamedTuple):
    """A group's segments: particles of one block each; rows are segments."""

    start: np.ndarray  # (n,) first particle
    count: np.ndarray  # (n,)
    table: np.ndarray  # (n, 27) node blocks around
    into: np.ndarray  # (n, 27) rows of sums to add to: those node blocks, or a thread's copies
    split: np.ndarray  # (n,) bool: the stress's impulses are kept apart from momentum
    limit: np.ndarray  # (n, 3, 2) range of positions [cells from the block's middle]
    mirror: np.ndarray  # (n, 3, 2) wall codes (walls.py)


class NodeBlocks(NamedTuple):
    """The node blocks of a rank, block after block, one per phase that touches it."""

    first: np.ndarray  # (blocks + 1,) node blocks of each block
    phase: np.ndarray  # (node blocks,)
    at: np.ndarray  # (blocks, 3) block coordinates
    meets: np.ndarray  # (blocks,) bool: two phases, or a phase and a collider, may touch here
    solid: np.ndarray  # (blocks,) row among the collider's blocks, or -1
    copied: np.ndarray  # (node blocks + 1,) where the rows of `copies` of each begin
    copies: np.ndarray  # rows of sums in which threads other than the first add


class Sums(NamedTuple):
    """A layer: its sums, what they rest at, and their values."""

    sums: np.ndarray  # (rows, words, 256) see kernels/sums.py
    rest: np.ndarray  # (phases, words, 16)
    asked: np.ndarray  # (node blocks,) uint8: 1 where it has terms
    nodes: np.ndarray  # (node blocks, 256) in the precision of the run


class Walls(NamedTuple):
    """The domain's walls: west, east; south, north; floor, roof."""

    cells: np.ndarray  # (3,) of the domain
    kinds: np.ndarray  # (3, 2) see walls.KINDS
    met: np.ndarray  # (3, 2) the same as known surfaces have it: 0 where contact pushes them
    friction: np.ndarray  # (3, 2)


class Phases(NamedTuple):
    """What the grid must know of phases."""

    least: np.ndarray  # (phases,) [kg] of a cell full of its lightest material
    mastery: np.ndarray  # (phases,) whose surface gives the normal: lowest first
    friction: np.ndarray  # (phases + 1, phases), the last row for colliders
    stiff: np.ndarray  # (phases,) [Pa] to waves, of its stiffest law at rest
    surface: np.ndarray  # (phases,) bool: contact knows the surfaces of its bodies


class Step(NamedTuple):
    """The numbers of one step."""

    dt: float  # [s]
    dx: float  # [m]
    fall: np.ndarray  # (4,) velocity that gravity gives in dt [m/s], and 0
