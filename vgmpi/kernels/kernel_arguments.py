"""Kernel arguments by name, and limits of a step that kernels hold.

The tables hold the particles and segments of a group, the node blocks of a rank, the sums of a
nodal field and the domain's walls. docs/explanation/time-step.md explains the limits. They stand in
one place for kernels, engines and the solver, and in this folder because the cache of compiled code
is named by its contents (runtime/jit.py): an edit here is seen.
"""

from typing import NamedTuple

import numpy as np

MAX_VOLUME_STRAIN_PER_STEP = (
    0.1  # [-] largest relative volume change of a particle in a step: |tr C| dt
)
J_MIN, J_MAX = 0.1, 5.0  # [-] bounds of a particle's volume ratio; beyond them the run ends

# fractions of the mass of one full cell of the phase's lightest material
NODE_MASS_FLOOR = 1e-20  # [-] a lighter node holds rounding errors only, and stays at rest
# [-] A lighter node takes no part in contact: its sums (kernels/reproducible_sums.py) have fewer
# digits than a number in single precision, and directions would suffer.
CONTACT_MASS_FLOOR = 2.0**-21


class Particles(NamedTuple):
    """Particle arrays of a group on this rank, see particle_group.ParticleGroup."""

    xi: np.ndarray  # (3, cap) fixed-point positions
    f: np.ndarray  # (channels, cap) floating-point channels
    ids: np.ndarray  # (cap,) particle ids


class Segments(NamedTuple):
    """Segments of a group, one per row: particles of one block each."""

    start: np.ndarray  # (n,) first particle
    count: np.ndarray  # type: ignore[assignment]  # (n,) number of particles; hides a method
    table: np.ndarray  # (n, 27) node blocks around
    accumulator_rows: (
        np.ndarray
    )  # (n, 27) rows of sums to add to: those node blocks, or a thread's copies
    split: np.ndarray  # (n,) bool: more than the velocity is gathered (separate stress, cells)
    limit: np.ndarray  # (n, 3, 2) [cells from the block center] range of positions
    mirror: np.ndarray  # (n, 3, 2) wall codes (wall_boundary.py)


class NodeBlocks(NamedTuple):
    """Node blocks of a rank, block after block, one per phase that touches it."""

    first: np.ndarray  # (blocks + 1,) node blocks of each block
    phase: np.ndarray  # (node blocks,) phase of each
    coordinates: np.ndarray  # (blocks, 3) block coordinates
    may_touch: np.ndarray  # (blocks,) bool: two phases, or a phase and a collider, may touch here
    solid: np.ndarray  # (blocks,) row among the collider's blocks, or -1
    copy_offsets: np.ndarray  # (node blocks + 1,) offsets into `copies`
    copies: np.ndarray  # rows of sums to which threads other than the first add


class Sums(NamedTuple):
    """Nodal field: its accumulators, their biases and their values."""

    sums: np.ndarray  # (rows, words, 256) see kernels/reproducible_sums.py
    bias: np.ndarray  # (phases, words, 16) biases
    has_terms: np.ndarray  # (node blocks,) uint8: 1 if it has terms
    nodes: np.ndarray  # (node blocks, 256) values in the working precision


class Walls(NamedTuple):
    """Walls of the domain: west, east; south, north; floor, roof."""

    cells: np.ndarray  # (3,) cells of the domain
    kinds: np.ndarray  # (3, 2) wall kinds for liquids, see wall_boundary.KINDS
    kinds_for_solids: np.ndarray  # (3, 2) wall kinds for everything else
    kinds_for_surfaces: (
        np.ndarray
    )  # (3, 2) wall kinds for resolved surfaces: 0 if contact pushes them
    friction: np.ndarray  # (3, 2) [-] Coulomb coefficients


class Step(NamedTuple):
    """Constants of one step."""

    dt: float  # [s] time step
    dx: float  # [m] cell size
    gravity_increment: np.ndarray  # (4,) [m/s] velocity change by gravity in dt, and 0


class BlockContext(NamedTuple):
    """One block: its node blocks are n0 .. n1, its first node is `low`."""

    n0: int
    n1: int
    may_touch: bool  # whether phases may touch here, so that offsets exist
    at_wall: bool  # whether some of its nodes are on or beyond a wall
    low_x: int
    low_y: int
    low_z: int


class NodalFields(NamedTuple):
    """Nodal arrays of node blocks, as pointers to their data (vector16.pointer)."""

    phase: np.ndarray  # (node blocks,) phase of each
    min_cell_mass: np.ndarray  # (phases,) [kg] mass of a full cell
    cells: np.ndarray  # (3,) cells of the domain
    grid: np.ndarray  # (256 node blocks,) velocity [m/s] and mass [kg]
    forces: np.ndarray  # same shape: separate impulses [kg m/s] and volume [m3]
    offsets: np.ndarray  # same shape: offsets [m4] and volume [m3], if the block's phases may touch
