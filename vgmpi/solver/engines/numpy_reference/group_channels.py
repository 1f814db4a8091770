"""Channels of a group's particles as doubles, and surfaces of solids that follow from them."""

from typing import Any

import numpy as np

from vgmpi.kernels.nodal_fields.surface_distance import MAX_DEPTH_CELLS
from vgmpi.materials.material import law_function
from vgmpi.parallel.particle_group import ParticleGroup
from vgmpi.planning.particle_channels import CURVATURE_TO_FULL


def get_channel(group: ParticleGroup, name: str) -> np.ndarray:
    """Return a channel of all particles, shape (n, width)."""
    return group.get(name, group.index()).astype(np.float64)


def put_channel(group: ParticleGroup, name: str, values: np.ndarray) -> None:
    """Set a channel of all particles, shape (n, width)."""
    group.put(name, group.index(), values)


def law_state(group: ParticleGroup) -> tuple[np.ndarray, ...]:
    """Return the state that the law of the group reads, a row per number."""
    return tuple(row.astype(np.float64) for row in group.law_state(group.index()))


def put_law_state(group: ParticleGroup, state: tuple) -> None:
    """Set the state that the law of the group has updated."""
    first = 0
    for name, values in group.plan.state:
        rows = [np.broadcast_to(s, len(group)) for s in state[first : first + len(values)]]
        put_channel(group, name, np.stack(rows, 1))
        first += len(values)


def law_in_doubles(group: ParticleGroup) -> tuple:
    """Return the numbers of the group's law in double precision."""
    law: Any = group.plan.law
    return law._make(float(c) for c in law)


def kirchhoff_stress(law, state: tuple, C: np.ndarray) -> np.ndarray:
    """Return the Kirchhoff stress, shape (n, 3, 3) [Pa]."""
    components = law_function(law, "stress")(law, state, tuple(C.T))
    xx, yy, zz, xy, xz, yz = (np.broadcast_to(c, len(C)) for c in components)
    return np.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], 1).reshape(-1, 3, 3)


def resolved_surface(group: ParticleGroup, dx: float) -> tuple[np.ndarray, ...]:
    """Return normals, signed distances [m], normal gradients [1/m] and certainties.

    Args:
        group: Particles of a solid.
        dx: Cell size [m].
    """
    reference = get_channel(group, "surface")
    certainty = np.linalg.norm(reference[:, :3], axis=1)
    curvature = reference[:, CURVATURE_TO_FULL].reshape(-1, 3, 3)
    F = np.eye(3) + get_channel(group, "F" if group.plan.tracks_deformation else "H").reshape(
        -1, 3, 3
    )
    F_inv = np.linalg.inv(F)
    covector = np.einsum("nba,nb->na", F_inv, reference[:, :3])  # F^-T n0
    size = np.linalg.norm(covector, axis=1)
    some, max_depth = size > 0, MAX_DEPTH_CELLS * dx
    normal = np.where(some[:, None], covector / np.where(some, size, 1.0)[:, None], 0.0)
    stretch = np.where(some, certainty / np.where(some, size, 1.0), 0.0)  # 1 / |F^-T n0|
    current_curvature = np.einsum("nba,nbc,ncd->nad", F_inv, curvature, F_inv)  # F^-T K0 F^-1
    distance = np.clip(stretch * reference[:, 3], -max_depth, max_depth)
    return normal, distance, stretch[:, None, None] * current_curvature, certainty
