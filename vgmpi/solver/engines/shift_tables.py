"""Kernel arguments of particle shifting (kernels/transfer/particle_shifting.py)."""

import numpy as np

from vgmpi.kernels.colliders.moving_colliders import MovingColliders
from vgmpi.kernels.colliders.static_colliders import StaticColliders
from vgmpi.kernels.transfer.particle_shifting import NodeFill, ShiftConstants
from vgmpi.parallel.block_lattice import BITS
from vgmpi.planning.plan import Plan

from .engine_protocol import DITHER
from .plan_tables import wall_table


def node_fill(plan: Plan) -> NodeFill | None:
    """Return what fills the nodes' cells, without colliders; None if no particles are shifted.

    Prescribed bodies have no mass on the grid. Where liquids of one phase differ in density, their
    volumes count, elsewhere masses do. Sand with a liquid in its pores counts by its grains.
    """
    if not plan.shift_interval:
        return None
    by_volume = np.array([phase.fills_by_volume for phase in plan.phases])
    full = np.array(
        [plan.dx**3 if by_volume[p] else phase.max_cell_mass for p, phase in enumerate(plan.phases)]
    )  # [m3] or [kg] in a full cell
    space = 1.0 / full
    if plan.rules is not None:
        porous = (plan.rules.mixture_set >= 0) & ~plan.rules.fluid
        space = np.where(porous, plan.rules.volume / plan.dx**3, space)
    space[[phase.driven for phase in plan.phases]] = 0.0
    shifts = np.zeros(len(plan.phases), bool)
    for group in plan.groups:
        shifts[group.phase] |= group.shifts
    walls = wall_table(plan)
    return NodeFill(
        space.astype(plan.real), by_volume, shifts,
        np.zeros((0, 64, 4), plan.real), walls.cells, walls.kinds,
    )  # fmt: skip


def with_colliders(
    fill: NodeFill | None, solids: StaticColliders | MovingColliders | None
) -> NodeFill | None:
    """Return the fill of nodes with the colliders where they are now."""
    if fill is None or solids is None:
        return fill
    return fill._replace(colliders=solids.nodes)


def shift_constants(plan: Plan, duration: float, step: int) -> ShiftConstants:
    """Return the constants of a shift.

    Args:
        plan: Plan of the run.
        duration: Length of the steps since the last shift [s].
        step: Number of the step; the dither follows from it.
    """
    return ShiftConstants(
        plan.real.type(duration), 2.0 ** BITS[plan.real], *(d * step % 1.0 for d in DITHER)
    )
