"""Surfaces of solids at their particles, in plain NumPy; see planning/particle_channels.py."""

import numpy as np

from vgmpi.kernels.nodal_fields.surface_distance import MAX_DEPTH_CELLS
from vgmpi.parallel.particle_group import ParticleGroup
from vgmpi.planning.particle_channels import CURVATURE_TO_FULL

from .group_channels import get_channel


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
