"""Nodal fields that are read next to free bodies alone: which particles of a group contribute."""

from typing import NamedTuple

import numpy as np

from vgmpi.kernels.particle_records import BATCH
from vgmpi.kernels.rigid.body_nodes import REACH_CELLS
from vgmpi.kernels.rigid.moving_colliders import MovingColliders
from vgmpi.kernels.transfer.surface_p2g import SurfaceStencils, flag_nodes
from vgmpi.parallel.exchange_topology import NEAR_BODIES, ExchangeTopology
from vgmpi.parallel.particle_group import ParticleGroup
from vgmpi.planning.plan import Plan

from .nodal_field_storage import FieldContribution


class SurfaceContributions(NamedTuple):
    """Contributions to the nodal fields next to surfaces, for the current tables."""

    stencils: SurfaceStencils
    chosen: np.ndarray  # (segments,) bool, segments of which particles may contribute
    # (fields, contribution kinds, segments): segments whose offsets other contact needs, too, have
    # those added at all nodes
    transfers: list[tuple[tuple[str, ...], tuple, np.ndarray]]


def is_summed_at_surfaces(plan: Plan) -> bool:
    """Return whether the fields near free bodies are summed at the nodes next to them alone.

    Pinned parts and thin walls read them at more nodes.
    """
    return plan.free_bodies and not plan.pins and plan.sides is None


def surface_flags(movers: MovingColliders, dx: float) -> np.ndarray:
    """Return which nodes contact with colliders may read, 64 bits for each block near them.

    Args:
        movers: Colliders at the nodes in the present step.
        dx: Cell size [m].
    """
    flags = np.zeros(len(movers.nodes), np.uint64)
    flag_nodes(movers.nodes, movers.whose, movers.is_free, REACH_CELLS, dx, flags)
    return flags


def split_contributions(
    plan: Plan, group: ParticleGroup, tables: ExchangeTopology, rows: np.ndarray,
    mirror: np.ndarray, contributions: list[FieldContribution],
) -> tuple[list[FieldContribution], SurfaceContributions | None]:  # fmt: skip
    """Return the contributions at all nodes, and those at the nodes next to surfaces, if any.

    Args:
        plan: Plan of the run.
        group: The group.
        tables: Exchange topology of this rank.
        rows: Segments of the group in the tables, shape (n,).
        mirror: Codes of the walls that the segments meet.
        contributions: All contributions of the group.
    """
    by_field = [c for c in contributions if c.layer in NEAR_BODIES]
    if not is_summed_at_surfaces(plan) or not by_field:
        return contributions, None
    near, table = by_field[0].chosen, tables.table[rows]
    block = np.repeat(np.arange(len(tables.at)), np.diff(tables.first))[table]
    is_single = ~(np.diff(tables.first) > 1)[block].any(1) & ~mirror.any(axis=(1, 2))
    others, both = [], np.zeros(len(rows), bool)
    for contribution in contributions:
        if contribution.layer == "offsets" and plan.rules is None and not plan.planes:
            both = contribution.chosen & near & is_single
            offsets, contribution = contribution, contribution._replace(
                chosen=contribution.chosen & ~both
            )
        if contribution.layer not in NEAR_BODIES and contribution.chosen.any():
            others.append(contribution)
    names, kinds = tuple(c.layer for c in by_field), tuple(c.kind for c in by_field)
    transfers = [(names, kinds, near & ~both)]
    if both.any():
        transfers.append(((*names, "offsets"), (*kinds, offsets.kind), both))
    stencils = surface_stencils(group, near, tables.solid[block])
    return others, SurfaceContributions(stencils, near, transfers)


def surface_stencils(group: ParticleGroup, near: np.ndarray, around: np.ndarray) -> SurfaceStencils:
    """Return tables for the segments near surfaces, empty but for the blocks around.

    Args:
        group: The group.
        near: Segments near surfaces, shape (segments,) bool.
        around: Rows of the 27 blocks around each among those near colliders, or -1.
    """
    count = int(near.sum())
    batch = np.append(0, np.cumsum(-(-group.count[near] // BATCH)))
    return SurfaceStencils(
        np.cumsum(near) - 1, np.ascontiguousarray(around[near]), batch,
        np.zeros((int(batch[-1]), 2), np.int64), np.zeros((count, 6), np.int64),
        np.zeros(count, np.int64),
    )  # fmt: skip
