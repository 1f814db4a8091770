"""Kernel arguments of the transfers of one particle group."""

from functools import reduce
from typing import NamedTuple

import numpy as np

from vgmpi.kernels.kernel_arguments import Particles, Segments
from vgmpi.kernels.reaction_impulses import GhostNodes
from vgmpi.kernels.simd.static_dispatch import Both
from vgmpi.kernels.step_records import AccumulatorOverflow
from vgmpi.kernels.transfer import g2p
from vgmpi.kernels.transfer.auxiliary_gather import VelocityOnly
from vgmpi.kernels.transfer.liquid_volume import CellDilatation, DensityCorrected
from vgmpi.parallel.block_lattice import position_limits
from vgmpi.parallel.exchange_topology import ExchangeTopology
from vgmpi.parallel.particle_group import ParticleGroup
from vgmpi.planning.phases_and_groups import GroupPlan
from vgmpi.planning.plan import Plan

from .nodal_field_storage import (
    FieldContribution,
    FieldRequests,
    contributions,
    timeless_contributions,
)
from .reaction_sums import ReactionAccumulators
from .surface_fields import SurfaceContributions, split_contributions
from .thread_memory import ThreadPartition


class GroupContext(NamedTuple):
    """Group with the kernel arguments of its transfers, for the current tables."""

    group: ParticleGroup
    segments: Segments
    partition: ThreadPartition  # segments of each thread
    contributions: list[FieldContribution]  # to the nodal fields
    timeless: list[FieldContribution]  # to the nodal fields in a step of no time
    carried: list[tuple[str, int]]  # (nodal field, first channel) of the values that it takes back
    numbers: g2p.GroupConstants
    ghosts: GhostNodes | None  # ghost nodes, where reactions of walls are requested
    surface: SurfaceContributions | None  # contributions at the nodes next to free bodies alone


def group_context(
    requests: FieldRequests, group: ParticleGroup, tables: ExchangeTopology, rows: np.ndarray,
    target: np.ndarray, partition: ThreadPartition, mirror: np.ndarray,
    reactions: ReactionAccumulators | None,
) -> GroupContext:  # fmt: skip
    """Return the kernel arguments of a group.

    Args:
        requests: Requested fields of the run.
        group: The group.
        tables: Exchange topology of this rank.
        rows: Segments of the group in the tables, shape (n,).
        target: Accumulator rows of the segments, shape (n, 27).
        partition: Segments of each thread.
        mirror: Codes of the walls that the segments meet.
        reactions: Accumulators of reactions, or None.
    """
    plan = requests.plan
    contributes = {name: chosen[rows] for name, chosen in tables.contributes.items()}
    is_apart = group.plan.separates_stress
    split = contributes["impulses"] if is_apart else np.zeros(len(rows), bool)
    gathers_more = split | group.plan.volume.by_cells
    for feature in plan.features:
        gathers_more |= bool(feature.gathers(group.plan)) and not feature.gathers_with_stress
    segments = Segments(
        group.start, group.count, tables.table[rows], target, gathers_more,
        position_limits(group.block, plan.cells), mirror,
    )  # fmt: skip
    at_nodes, surface = split_contributions(
        plan, group, tables, rows, mirror, contributions(requests, group.plan, contributes, split)
    )
    return GroupContext(
        group, segments, partition, at_nodes,
        timeless_contributions(requests, group.plan, contributes, split),
        requests.carried_by(group.plan),
        numbers_of(plan, group.plan),
        None if reactions is None else reactions.ghosts(group.block, mirror), surface,
    )  # fmt: skip


def numbers_of(plan: Plan, group: GroupPlan) -> g2p.GroupConstants:
    """Return the constants of a group in the precision of the run."""
    values = (
        plan.splines, plan.dx, _fill_per_number(plan, group) if group.volume.softens_spray else 0.0,
        float(group.is_liquid and not group.shares_space),
    )  # fmt: skip
    return g2p.GroupConstants(*map(plan.real.type, values))


def _fill_per_number(plan: Plan, group: GroupPlan) -> float:
    """Return the filled fraction of space per fourth nodal number, which liquids gather.

    The number is the fraction itself for phases that share space, else the mass [kg].
    """
    return 1.0 if group.shares_space else 1.0 / (group.density * plan.dx**3)


def particles_of(group: ParticleGroup) -> Particles:
    """Return the particle arrays of a group."""
    return Particles(group.xi, group.f, group.ids)


def auxiliary_gather_kind(plan: Plan, group: GroupPlan, auxiliary: dict, dt: float) -> tuple:
    """Return the kind of gather that a group needs besides the velocity.

    Args:
        plan: Plan of the run.
        group: Plan of the group.
        auxiliary: Auxiliary nodal values by name.
        dt: Length of the step [s].

    Returns:
        Kind of kernels/transfer/auxiliary_gather.py, wrapped by the density correction where the
        group has one.
    """
    inner = _kind_without_correction(plan, group, auxiliary, dt)
    return (
        DensityCorrected(inner, plan.real.type(group.volume.inverse_cell_mass))
        if group.volume.inverse_cell_mass
        else inner
    )


def _kind_without_correction(plan: Plan, group: GroupPlan, auxiliary: dict, dt: float) -> tuple:
    """Return the kind of gather without the density correction."""
    if group.volume.by_cells:
        return CellDilatation(0.0)
    kinds: list[tuple] = []
    patch_count = 0
    for feature in plan.features:
        if feature.has_gather_kind(group):
            kinds.append(feature.gather_kind(group, auxiliary, dt, patch_count))
            patch_count += len(feature.gathers(group))
    return reduce(Both, kinds) if kinds else VelocityOnly(0.0)


def lowest_overflow(
    lowest: np.ndarray, tables: ExchangeTopology, layer: str
) -> AccumulatorOverflow | None:
    """Return the lowest node block of a field in which a sum left its range, or None.

    Args:
        lowest: Block number plus 1 of each thread, 0 for none, shape (threads,).
        tables: Exchange topology of this rank.
        layer: Name of the nodal field.
    """
    if not lowest.any():
        return None
    nb = int(lowest[lowest > 0].min()) - 1
    block = int(np.searchsorted(tables.first, nb, side="right")) - 1
    i, j, k = (int(b) for b in tables.coordinates[block])
    return AccumulatorOverflow((i, j, k), int(tables.phase[nb]), layer)
