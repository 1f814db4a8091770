"""Particle shifting as it acts in a run: its nodal field, and what its kernels read."""

from typing import Any, NamedTuple

import numpy as np

from vgmpi.features.active_feature import ActiveFeature, StartContext
from vgmpi.features.field_request import FieldRequest
from vgmpi.kernels.nodal_fields.field_protocol import (
    MIRROR_VECTOR,
    accumulate,
    particle_contribution,
)
from vgmpi.kernels.nodal_fields.momentum import by_weights
from vgmpi.kernels.particle_records import VOLUME
from vgmpi.kernels.reproducible_sums import next_power_of_two
from vgmpi.kernels.simd.row_ops import broadcast, store_records
from vgmpi.kernels.simd.vector16 import load
from vgmpi.kernels.step_records import dither_of_step
from vgmpi.kernels.transfer.transfer_correction import CorrectionKinds
from vgmpi.kernels.wall_boundary import KINDS
from vgmpi.parallel.block_lattice import BITS
from vgmpi.planning.plan import Plan

from .kernels import MAX_SHIFT_CELLS, NodeFill, ShiftConstants


class RestVolume(NamedTuple):
    """Contribution of rest volume [m3], in the step of no time before a shift.

    The mass of a node tells how full its cell is only where all liquids of its phase have one
    density.
    """

    mirror: float  # code of nodal_fields/field_protocol.py


def request_rest_volume(plan: Plan, phases: frozenset[int]) -> FieldRequest:
    """Return the request for the field, mirrored at walls as the mass of the particles is.

    Args:
        plan: The plan.
        phases: Phases whose liquids differ in density.
    """
    kind = RestVolume(plan.real.type(MIRROR_VECTOR))
    cell = np.full((len(plan.phases), 4), next_power_of_two(plan.dx**3))
    return FieldRequest(
        "rest volume", lambda _: cell, lambda group: kind if group.phase in phases else None,
        is_timeless=True,
    )  # fmt: skip


@particle_contribution.register(RestVolume)
def _rest_volume(kind, law, count, offset, cap, f, extra, peak, records, dt):
    zero = broadcast(f, 0.0)
    for n in range(0, count, 16):
        volume = load(f, offset + n + VOLUME * cap)
        store_records(
            records,
            16 * n,
            (
                zero, zero, zero, volume, zero, zero, zero, zero,
                zero, zero, zero, zero, zero, zero, zero, zero,
            ),
        )  # fmt: skip


accumulate.register(RestVolume)(by_weights)


class ParticleShifting(ActiveFeature):
    """Shifts of the liquids of a rank."""

    margin = MAX_SHIFT_CELLS  # the next shift must leave particles in their patches

    def __init__(self, own: Any, context: StartContext):
        """Take the `ShiftingPlan` and the colliders at the nodes."""
        plan = self.plan = context.plan
        self.correction_interval, self.colliders = own.correction_interval, context.collider_nodes
        self.fill = node_fill(plan, own)
        self.groups = frozenset(g for g, group in enumerate(plan.groups) if group.is_liquid)

    def correction_kinds(self, dt: float, step: int) -> CorrectionKinds:
        """Return the kinds with which liquids are shifted.

        Args:
            dt, step: See `ActiveFeature.correction_kinds`.
        """
        fill = self.fill
        if self.colliders is not None:
            fill = fill._replace(colliders=self.colliders.nodes)
        duration, units = self.correction_interval * dt, 2.0 ** BITS[self.plan.real]
        constants = ShiftConstants(self.plan.real.type(duration), units, *dither_of_step(step))
        return CorrectionKinds(fill, constants, self.groups)

    def dense_correction(self, dense: Any) -> Any:
        """Return how the reference engine shifts particles.

        Args:
            dense: See `ActiveFeature.dense_correction`.
        """
        from .reference import DenseShifting

        return DenseShifting(self.fill, dense)


def node_fill(plan: Plan, own: Any) -> NodeFill:
    """Return what fills the nodes' cells, without colliders.

    Prescribed bodies have no mass on the grid. Where liquids of one phase differ in density, their
    volumes count, elsewhere masses do. Sand with a liquid in its pores counts by its grains.

    Args:
        plan: The plan.
        own: The `ShiftingPlan`.
    """
    by_volume = np.isin(np.arange(len(plan.phases)), sorted(own.mixed_phases))
    full = np.array(
        [plan.dx**3 if by_volume[p] else phase.max_cell_mass for p, phase in enumerate(plan.phases)]
    )  # [m3] or [kg] in a full cell
    space = 1.0 / full
    for feature in plan.features:
        if (grains := feature.grain_volumes) is not None:
            space = np.where(grains > 0.0, grains / plan.dx**3, space)
    space[[phase.driven for phase in plan.phases]] = 0.0
    liquid = np.zeros(len(plan.phases), bool)
    for group in plan.groups:
        liquid[group.phase] |= group.is_liquid
    kinds = np.array([KINDS[kind] for kind, _ in plan.walls.liquids], np.int64).reshape(3, 2)
    return NodeFill(
        space.astype(plan.real), by_volume, liquid, np.zeros((0, 64, 4), plan.real),
        np.array(plan.cells), kinds,
    )  # fmt: skip
