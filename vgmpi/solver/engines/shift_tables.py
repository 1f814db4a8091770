"""Kernel arguments of particle shifting (kernels/transfer/particle_shifting.py)."""

from vgmpi.kernels.colliders.moving_colliders import MovingColliders
from vgmpi.kernels.colliders.static_colliders import StaticColliders
from vgmpi.kernels.transfer.particle_shifting import NodeFill, ShiftConstants
from vgmpi.parallel.block_lattice import BITS
from vgmpi.planning.plan import Plan

from .engine_protocol import DITHER


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
