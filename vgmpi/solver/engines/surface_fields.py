"""Nodal fields that are read next to free bodies alone: which particles of a group contribute."""

from typing import Any, NamedTuple

import numpy as np

from vgmpi.kernels.colliders.surface_flow import REACH_CELLS
from vgmpi.kernels.kernel_arguments import Particles
from vgmpi.kernels.nodal_fields import body_fields
from vgmpi.kernels.nodal_fields.body_fields import BodyFields
from vgmpi.kernels.particle_records import BATCH
from vgmpi.kernels.transfer.surface_p2g import (
    SurfaceStencils,
    find_contributing_particles,
    flag_nodes,
    particles_to_surface_nodes,
)
from vgmpi.parallel.exchange_topology import NEAR_BODIES, ExchangeTopology
from vgmpi.parallel.particle_group import ParticleGroup
from vgmpi.planning.plan import Plan

from .nodal_field_storage import FieldContribution


class SurfaceContributions(NamedTuple):
    """Contributions to the nodal fields next to surfaces, for the current tables."""

    stencils: SurfaceStencils
    chosen: np.ndarray  # (segments,) bool, segments of which particles may contribute
    kind: BodyFields
    # (fields, contribution to offsets, segments): segments whose offsets other contact needs, too,
    # have those added at all nodes
    transfers: list[tuple[tuple[str, ...], Any, np.ndarray]]


def is_summed_at_surfaces(plan: Plan) -> bool:
    """Return whether the fields near surfaces are summed at the nodes next to colliders alone.

    Some features read them at more nodes.
    """
    elsewhere = any(each.reads_all_nodes for each in plan.features)
    return any(each.reads_at_colliders for each in plan.features) and not elsewhere


def patch_count(plan: Plan) -> int:
    """Return the number of patches of a thread that `fill_at_surfaces` needs."""
    return len(NEAR_BODIES) + 1 if is_summed_at_surfaces(plan) else 0


def surface_flags(engine) -> np.ndarray:
    """Return which nodes contact with colliders may read, 64 bits for each block near them.

    Args:
        engine: CPU engine, with the colliders of the present step.
    """
    if all(part.surface is None for part in engine.parts):
        return np.zeros(0, np.uint64)
    movers = engine.solids
    flags = np.zeros(len(movers.nodes), np.uint64)
    flag_nodes(movers.nodes, movers.collider_number, movers.is_free, REACH_CELLS, movers.dx, flags)
    return flags


def fill_at_surfaces(engine, g: int, thread: int, rows: np.ndarray, dt: float) -> None:
    """Scatter what particles contribute to the nodes next to free bodies.

    Args:
        engine: CPU engine.
        g: Number of the group.
        thread: Number of the thread.
        rows: Segments of the group to process, shape (n,).
        dt: Time step [s] in the precision of the run.
    """
    part = engine.parts[g]
    surface, particles = part.surface, Particles(part.group.xi, part.group.f, part.group.ids)
    if surface is None:
        return
    scratch = engine.memory.scratch[thread]
    engine.call_if_rows(
        (), find_contributing_particles, rows[surface.chosen[rows]], part.segments, particles,
        engine.flags, surface.stencils, scratch,
    )  # fmt: skip
    for names, offsets, chosen in surface.transfers:
        engine.call_if_rows(
            (g, len(names)), particles_to_surface_nodes, rows[chosen[rows]], surface.kind, offsets,
            part.group.plan.law, part.segments, particles,
            tuple(engine.layers[name].sums for name in names), surface.stencils, scratch, dt,
        )  # fmt: skip


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
    selected, table = by_field[0].chosen, tables.table[rows]
    block = np.repeat(np.arange(len(tables.coordinates)), np.diff(tables.first))[table]
    is_single = ~(np.diff(tables.first) > 1)[block].any(1) & ~mirror.any(axis=(1, 2))
    others, both = [], np.zeros(len(rows), bool)
    for contribution in contributions:
        if contribution.layer == "offsets" and plan.pair_rules is None and not plan.planes:
            both = contribution.chosen & selected & is_single
            offsets, contribution = (
                contribution,
                contribution._replace(chosen=contribution.chosen & ~both),
            )
        if contribution.layer not in NEAR_BODIES and contribution.chosen.any():
            others.append(contribution)
    transfers: list = [(NEAR_BODIES, None, selected & ~both)]
    if both.any():
        transfers.append(((*NEAR_BODIES, "offsets"), offsets.kind, both))
    stencils = surface_stencils(group, selected, tables.solid[block])
    kind = body_fields.kind(plan, group.plan)
    return others, SurfaceContributions(stencils, selected, kind, transfers)


def restrict_offsets(engine) -> None:
    """Sum no offsets in node blocks where no contact reads them, next to free bodies.

    They are read near colliders, in blocks of several phases, and where segments add to all nodes.
    Blocks to which other ranks add are summed, too: sums that are not read are not reset, and would
    return to the other rank with those of earlier steps.

    Args:
        engine: CPU engine, with new tables and parts.
    """
    tables = engine.tables
    if all(part.surface is None for part in engine.parts):
        return
    counts = np.diff(tables.first)
    is_read = np.repeat((tables.solid >= 0) | (counts > 1), counts)
    for part in engine.parts:
        for contribution in part.contributions:
            if contribution.layer == "offsets":
                is_read[part.segments.table[contribution.chosen]] = True
    for fields in tables.shared.values():
        if "offsets" in fields:
            is_read[fields["offsets"].receive_blocks] = True
    engine.layers["offsets"].has_terms &= is_read


def surface_stencils(
    group: ParticleGroup, selected: np.ndarray, neighbors: np.ndarray
) -> SurfaceStencils:
    """Return tables for the segments near surfaces, empty but for the blocks around.

    Args:
        group: The group.
        selected: Segments near surfaces, shape (segments,) bool.
        neighbors: Rows of the 27 blocks around each among those near colliders, or -1.
    """
    count = int(selected.sum())
    batch = np.append(0, np.cumsum(-(-group.count[selected] // BATCH)))
    return SurfaceStencils(
        np.cumsum(selected) - 1, np.ascontiguousarray(neighbors[selected]), batch,
        np.zeros((int(batch[-1]), 2), np.int64), np.zeros((count, 6), np.int64),
        np.zeros(count, np.int64),
    )  # fmt: skip
