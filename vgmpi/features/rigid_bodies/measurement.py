"""Free rigid bodies measured at the start: thickness, surface points, overlaps."""

import numpy as np

from vgmpi.kernels.colliders.moving_colliders import SDF_SPACING_CELLS
from vgmpi.kernels.colliders.static_colliders import SDF_BAND_CELLS
from vgmpi.kernels.rigid.surface_points import points_on_surface

from .plan import Overlap, RigidBodiesSummary, RigidBodySummary

MIN_OVERLAP_CELLS = 0.25  # [cells] depth above which an overlap is told


def measure_rigid_bodies(colliders: list, dx: float) -> RigidBodiesSummary:
    """Return the free rigid bodies among colliders, and their overlaps with each other and others.

    Args:
        colliders: Colliders at the start.
        dx: Cell size [m].
    """
    rows = [m for m, collider in enumerate(colliders) if collider.body is not None]
    ends = np.array([collider.ends() for collider in colliders])
    bodies: list[RigidBodySummary] = []
    overlaps: dict[tuple[int, int], float] = {}
    for m in rows:
        collider = colliders[m]
        surface, depth = points_on_surface(collider, dx)
        shape = np.ceil((np.ptp(ends[m], axis=0) / dx + 2 * SDF_BAND_CELLS + 2) / SDF_SPACING_CELLS)
        bodies.append(
            RigidBodySummary(
                collider.name,
                float(collider.body.mass),
                2.0 * depth,
                len(surface),
                8 * int(np.prod(shape + 1)),
            )  # fmt: skip
        )
        meets = (ends[:, 0] < ends[m, 1]).all(1) & (ends[:, 1] > ends[m, 0]).all(1)
        for other in map(int, np.flatnonzero(meets)):
            if other != m:
                inside = -float(colliders[other].distance(surface).min(initial=np.inf))
                pair = (m, other) if m < other else (other, m)
                overlaps[pair] = max(overlaps.get(pair, 0.0), inside)
    pairs = [
        Overlap(colliders[a].name, colliders[b].name, depth)
        for (a, b), depth in overlaps.items()
        if depth > MIN_OVERLAP_CELLS * dx
    ]
    return RigidBodiesSummary(tuple(bodies), tuple(sorted(pairs, key=lambda pair: -pair.depth)))
