"""Scratch of one thread for contact at one node."""

from typing import NamedTuple

import numpy as np

from vgmpi.kernels.reaction_impulses import ReactionSums


class ContactWorkspace(NamedTuple):
    """Scratch of one thread for contact at one node.

    It serves n phases, a collider and walls, and m pairs.
    """

    v: np.ndarray  # (n + 2, 3) [m/s] velocities, the last two of the collider and of walls
    mass: np.ndarray  # (n,) [kg]
    effective_mass: np.ndarray  # (n,) [kg] effective mass, huge for phases with prescribed motion
    here: np.ndarray  # (n,) node block of each phase at the node
    slope: np.ndarray  # (n, 3) [m/s per cell] velocity slope along a resolved surface's normal
    change: np.ndarray  # (n, 3) [m/s] velocity increments by elastic layers
    normals: np.ndarray  # (m, 10) normal, and scratch of the solver
    impulse: np.ndarray  # (m, 4) [kg m/s] normal and tangential
    friction: np.ndarray  # (m,) [-]
    fraction: np.ndarray  # (m,) [-] fraction of the slip that a pair loses
    master: np.ndarray  # (m,) first phase of each pair
    other: np.ndarray  # (m,) second phase of each pair
    pair_count: np.ndarray  # (n,) number of pairs of each phase
    plane: np.ndarray  # (4,) normal of a wall, and distance of the node from it [m]
    row: np.ndarray  # (n,) [-] friction of a wall
    given: ReactionSums | None = None  # reaction sums, if requested


def contact_workspace(n: int) -> ContactWorkspace:
    """Allocate contact scratch for n phases."""
    m = n * (n + 1) // 2 + 3 * n
    return ContactWorkspace(
        v=np.zeros((n + 2, 3)), slope=np.zeros((n, 3)), change=np.zeros((n, 3)), mass=np.zeros(n),
        effective_mass=np.zeros(n), here=np.zeros(n, np.int64),
        normals=np.zeros((m, 10)), impulse=np.zeros((m, 4)), friction=np.zeros(m),
        fraction=np.zeros(m),
        master=np.zeros(m, np.int64), other=np.zeros(m, np.int64), pair_count=np.zeros(n, np.int64),
        plane=np.zeros(4), row=np.zeros(n),
    )  # fmt: skip
