"""Slip of viscous liquids on colliders and on solids."""

from typing import Any

import numpy as np

from vgmpi.features.active_feature import ActiveFeature, NodeState, StartContext
from vgmpi.kernels.rigid import solid_slip, surface_slip
from vgmpi.kernels.rigid.body_nodes import SlipLaw
from vgmpi.kernels.rigid.solid_slip import SolidSlipLaw
from vgmpi.kernels.step_records import StepSpan
from vgmpi.parallel.exchange_topology import GRADIENTS, ExchangeTopology


class SurfaceSlip(ActiveFeature):
    """Slip of viscous liquids on surfaces at the nodes of a rank."""

    couples_nodes = True
    kernel: Any  # applies it at the nodes of some blocks

    def __init__(self, context: StartContext, law: SlipLaw | SolidSlipLaw):
        """Take what the slip depends on.

        Args:
            context: What a feature may take when a run starts.
            law: Slip of the phases.
        """
        self.plan, self.law, self.threads = context.plan, law, context.threads
        self.tables: ExchangeTopology | None = None
        self.rows: list[np.ndarray] = []  # blocks of each thread

    def blocks_of(self, tables: ExchangeTopology) -> np.ndarray:
        """Return which blocks have such surfaces, shape (blocks,) bool."""
        raise NotImplementedError

    def nodes_of(self, *fields):
        """Return the nodes as the kernel takes them.

        Args:
            fields: Velocities, offsets, and the three fields of velocity gradients.
        """
        raise NotImplementedError

    def couple_nodes(self, nodes: NodeState, span: StepSpan, gravity: np.ndarray) -> None:
        """Change the velocities of the nodes next to such surfaces.

        Args:
            nodes: Nodes of the rank.
            span: The step.
            gravity: Acceleration, shape (3,) [m/s2].
        """
        if self.tables is not nodes.tables:
            self.tables = nodes.tables
            rows = np.flatnonzero(self.blocks_of(nodes.tables))
            self.rows = np.array_split(rows, self.threads)
        near = self.nodes_of(
            nodes.velocities, nodes.fields["offsets"].nodes,
            tuple(nodes.fields[name].tables for name in GRADIENTS),
        )  # fmt: skip
        nodes.each(self._couple, nodes, near, span.dt)

    def _couple(self, thread: int, nodes: NodeState, near, dt: float) -> None:
        nodes.call(
            self.kernel, self.rows[thread], near, nodes.blocks, self.law, nodes.phases,
            nodes.walls, dt, self.plan.dx, nodes.reactions[thread],
        )  # fmt: skip


class ColliderSlip(SurfaceSlip):
    """Slip of viscous liquids on colliders."""

    kernel = staticmethod(surface_slip.apply_slip)

    def __init__(self, context: StartContext):
        """Take the slip lengths of the plan."""
        plan, solids = context.plan, context.collider_nodes
        assert plan.slip is not None
        lengths, viscosities = np.array(plan.slip.lengths), np.array(plan.slip.viscosities)
        if len(is_free := getattr(solids, "is_free", ())):
            lengths[is_free] = np.inf  # free bodies couple by themselves
        super().__init__(context, SlipLaw(lengths, viscosities))
        self.solids = solids

    def blocks_of(self, tables: ExchangeTopology) -> np.ndarray:
        """Return which blocks are near colliders, shape (blocks,) bool."""
        return tables.solid >= 0

    def nodes_of(self, *fields) -> surface_slip.NodesNearColliders:
        """Return the nodes near colliders; fields: see `SurfaceSlip.nodes_of`."""
        solids = self.solids
        return surface_slip.NodesNearColliders(solids.nodes, solids.moves, solids.whose, *fields)


class SolidSlip(SurfaceSlip):
    """Slip of viscous liquids on deformable bodies."""

    kernel = staticmethod(solid_slip.apply_solid_slip)

    def __init__(self, context: StartContext):
        """Take the slip lengths of the plan."""
        plan, prescribed = context.plan, context.prescribed
        slip, phases = plan.slip_of_solids, len(plan.phases)
        assert slip is not None
        driven = np.array([phase.driven for phase in plan.phases])
        rows = np.full(phases, -1) if prescribed is None else prescribed.motions.row
        law = SlipLaw(np.array(slip.lengths), np.array(slip.viscosities))
        super().__init__(context, SolidSlipLaw(law, driven, rows))

    def blocks_of(self, tables: ExchangeTopology) -> np.ndarray:
        """Return in which blocks several phases meet, shape (blocks,) bool."""
        return tables.meets & (np.diff(tables.first) > 1)

    def nodes_of(self, *fields) -> solid_slip.NodesOfPhases:
        """Return the nodes; fields: see `SurfaceSlip.nodes_of`."""
        return solid_slip.NodesOfPhases(*fields)


def start_collider_slip(context: StartContext) -> ColliderSlip | None:
    """Return the slip of a run's liquids on its colliders, or None if they slip freely."""
    has_slip = context.plan.slip is not None and context.collider_nodes is not None
    return ColliderSlip(context) if has_slip else None


def start_solid_slip(context: StartContext) -> SolidSlip | None:
    """Return the slip of a run's liquids on its solids, or None if they slip freely."""
    return None if context.plan.slip_of_solids is None else SolidSlip(context)
