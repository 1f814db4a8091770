"""Slip of liquids on the colliders of a scene, and all that couples at their surfaces in a step."""

import numpy as np

from vgmpi.kernels.rigid import surface_slip
from vgmpi.kernels.rigid.body_nodes import SlipLaw
from vgmpi.parallel.exchange_topology import GRADIENTS, ExchangeTopology
from vgmpi.planning.plan import Plan

from .free_body_coupling import FreeBodyCoupling
from .pinned_coupling import PinnedParts


class SurfaceSlip:
    """Slip of viscous liquids on the colliders at the nodes of a rank."""

    def __init__(self, plan: Plan, solids, engine):
        """Take the slip lengths of a plan.

        Args:
            plan: Plan of the run; it has slip lengths.
            solids: Colliders at the nodes.
            engine: Engine.
        """
        assert plan.slip is not None
        self.plan, self.solids, self.engine = plan, solids, engine
        lengths, viscosities = np.array(plan.slip.lengths), np.array(plan.slip.viscosities)
        if plan.free_bodies:
            lengths[solids.is_free] = np.inf  # free bodies couple by themselves
        self.law = SlipLaw(lengths, viscosities)
        self.tables: ExchangeTopology | None = None
        self.shares: list[np.ndarray] = []

    def apply(self, dt: float) -> None:
        """Change the velocities of the nodes next to colliders in a step of dt [s]."""
        engine = self.engine
        if self.tables is not engine.tables:
            self.tables = engine.tables
            close = np.flatnonzero(self.tables.solid >= 0)
            self.shares = np.array_split(close, engine.threads)
        layers = engine.layers
        nodes = surface_slip.NodesNearColliders(
            self.solids.nodes, self.solids.moves, self.solids.whose, layers["momentum"].nodes,
            layers["offsets"].nodes, tuple(layers[name].tables for name in GRADIENTS),
        )  # fmt: skip
        engine.each(self._apply, nodes, dt)

    def _apply(self, thread: int, nodes, dt: float) -> None:
        engine = self.engine
        engine.call_if_rows(
            (), surface_slip.apply_slip, self.shares[thread], nodes, engine.blocks, self.law,
            engine.phases, engine.walls, dt, self.plan.dx, engine.room[thread].given,
        )  # fmt: skip


def make_surface_slip(plan: Plan, solids, engine) -> SurfaceSlip | None:
    """Return the slip of a scene's liquids on its colliders, or None if they slip freely.

    Args:
        plan: Plan of the run.
        solids: Colliders at the nodes, or None.
        engine: Engine.
    """
    if plan.slip is None or solids is None:
        return None
    return SurfaceSlip(plan, solids, engine)


def couple_surfaces(
    engine, slip: SurfaceSlip | None, pins: PinnedParts | None, bodies: FreeBodyCoupling | None,
    dt: float, gravity: np.ndarray,
) -> None:  # fmt: skip
    """Couple the grid with the surfaces of colliders, pinned parts and free bodies in a step.

    Args:
        engine: Engine.
        slip: Slip on colliders, or None.
        pins: Pinned parts, or None.
        bodies: Free rigid bodies, or None.
        dt: Time step [s].
        gravity: Acceleration, shape (3,) [m/s2].
    """
    if slip is None and pins is None and bodies is None:
        return
    engine.begin_coupling()
    if slip is not None:
        slip.apply(dt)
    if pins is not None:
        pins.apply(engine, dt)
    if bodies is not None:
        bodies.advance(dt, gravity)
    engine.end_coupling()
    if pins is not None:
        pins.end_step(dt)
