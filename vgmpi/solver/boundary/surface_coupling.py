"""Slip of liquids on colliders and solids, and all that couples the nodes in a step."""

from typing import Any, NamedTuple

import numpy as np

from vgmpi.kernels.rigid import solid_slip, surface_slip
from vgmpi.kernels.rigid.body_nodes import SlipLaw
from vgmpi.kernels.rigid.solid_slip import SolidSlipLaw
from vgmpi.parallel.block_lattice import BlockLattice
from vgmpi.parallel.block_ownership import BlockDirectory
from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.parallel.exchange_topology import GRADIENTS, ExchangeTopology
from vgmpi.planning.plan import Plan

from .free_body_coupling import FreeBodyCoupling
from .implicit_pressure import ImplicitPressure, make_implicit_pressure
from .pinned_coupling import PinnedParts


class SurfaceSlip:
    """Slip of viscous liquids on surfaces at the nodes of a rank."""

    kernel: Any  # applies it at the nodes of some blocks

    def __init__(self, plan: Plan, law: SlipLaw | SolidSlipLaw, engine):
        """Take what the slip depends on.

        Args:
            plan: Plan of the run.
            law: Slip of the phases.
            engine: Engine.
        """
        self.plan, self.law, self.engine = plan, law, engine
        self.tables: ExchangeTopology | None = None
        self.shares: list[np.ndarray] = []

    def blocks_of(self, tables: ExchangeTopology) -> np.ndarray:
        """Return which blocks have such surfaces, shape (blocks,) bool."""
        raise NotImplementedError

    def nodes_of(self, *fields):
        """Return the nodes as the kernel takes them.

        Args:
            fields: Velocities, offsets, and the three fields of velocity gradients.
        """
        raise NotImplementedError

    def apply(self, dt: float) -> None:
        """Change the velocities of the nodes next to such surfaces in a step of dt [s]."""
        engine, layers = self.engine, self.engine.layers
        if self.tables is not engine.tables:
            self.tables = engine.tables
            rows = np.flatnonzero(self.blocks_of(engine.tables))
            self.shares = np.array_split(rows, engine.threads)
        nodes = self.nodes_of(
            layers["momentum"].nodes, layers["offsets"].nodes,
            tuple(layers[name].tables for name in GRADIENTS),
        )  # fmt: skip
        engine.each(self._apply, nodes, dt)

    def _apply(self, thread: int, nodes, dt: float) -> None:
        engine = self.engine
        engine.call_if_rows(
            (), self.kernel, self.shares[thread], nodes, engine.blocks, self.law, engine.phases,
            engine.walls, dt, self.plan.dx, engine.room[thread].given,
        )  # fmt: skip


class ColliderSlip(SurfaceSlip):
    """Slip of viscous liquids on colliders."""

    kernel = staticmethod(surface_slip.apply_slip)

    def __init__(self, plan: Plan, solids, engine):
        """Take the slip lengths of a plan.

        Args:
            plan: Plan of the run; it has slip lengths.
            solids: Colliders at the nodes.
            engine: Engine.
        """
        assert plan.slip is not None
        lengths, viscosities = np.array(plan.slip.lengths), np.array(plan.slip.viscosities)
        if plan.free_bodies:
            lengths[solids.is_free] = np.inf  # free bodies couple by themselves
        super().__init__(plan, SlipLaw(lengths, viscosities), engine)
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

    def __init__(self, plan: Plan, engine):
        """Take the slip lengths of a plan.

        Args:
            plan: Plan of the run; it has slip lengths of solids.
            engine: Engine.
        """
        slip, phases = plan.slip_of_solids, len(plan.phases)
        assert slip is not None
        driven = np.array([phase.driven for phase in plan.phases])
        rows = np.full(phases, -1) if engine.driven is None else engine.driven.ways.row
        law = SlipLaw(np.array(slip.lengths), np.array(slip.viscosities))
        super().__init__(plan, SolidSlipLaw(law, driven, rows), engine)

    def blocks_of(self, tables: ExchangeTopology) -> np.ndarray:
        """Return in which blocks several phases meet, shape (blocks,) bool."""
        return tables.meets & (np.diff(tables.first) > 1)

    def nodes_of(self, *fields) -> solid_slip.NodesOfPhases:
        """Return the nodes; fields: see `SurfaceSlip.nodes_of`."""
        return solid_slip.NodesOfPhases(*fields)


def make_surface_slip(plan: Plan, solids, engine) -> ColliderSlip | None:
    """Return the slip of a scene's liquids on its colliders, or None if they slip freely."""
    if plan.slip is None or solids is None:
        return None
    return ColliderSlip(plan, solids, engine)


def make_solid_slip(plan: Plan, engine) -> SolidSlip | None:
    """Return the slip of a scene's liquids on its solids, or None if they slip freely."""
    return None if plan.slip_of_solids is None else SolidSlip(plan, engine)


class NodalCouplings(NamedTuple):
    """Couplings of the nodes, after all that acts at each node alone."""

    slip: ColliderSlip | None  # slip of liquids on colliders
    slip_of_solids: SolidSlip | None  # slip of liquids on solids
    pins: PinnedParts | None  # pinned parts of bodies
    bodies: FreeBodyCoupling | None  # free rigid bodies
    pressure: ImplicitPressure | None  # implicit pressure of a liquid

    def set_tables(self, tables: ExchangeTopology, census: BlockDirectory) -> None:
        """Take new tables after a sort.

        Args:
            tables: Topology of this rank.
            census: Segments of this rank and nearby ones.
        """
        if self.pins is not None:
            self.pins.set_tables(tables)
        if self.pressure is not None:
            self.pressure.set_tables(tables, census)

    def apply(self, engine, dt: float, gravity: np.ndarray) -> None:
        """Couple the grid with surfaces and with its own pressure in a step.

        Args:
            engine: Engine.
            dt: Time step [s].
            gravity: Acceleration, shape (3,) [m/s2].
        """
        if all(coupling is None for coupling in self):
            return
        engine.begin_coupling()
        if self.pressure is not None:
            self.pressure.apply(dt)
        if self.slip is not None:
            self.slip.apply(dt)
        if self.slip_of_solids is not None:
            self.slip_of_solids.apply(dt)
        if self.pins is not None:
            self.pins.apply(engine, dt)
        if self.bodies is not None:
            self.bodies.advance(dt, gravity)
        engine.end_coupling()
        if self.pins is not None:
            self.pins.end_step(dt)


def make_couplings(
    plan: Plan, lattice: BlockLattice, solids, engine, ranks: SerialCommunicator,
    pins: PinnedParts | None, bodies: FreeBodyCoupling | None,
) -> NodalCouplings:  # fmt: skip
    """Return all that couples the nodes of a scene.

    Args:
        plan: Plan of the run.
        lattice: Lattice of the blocks.
        solids: Colliders at the nodes, or None.
        engine: Engine.
        ranks: Communicator.
        pins: Pinned parts, or None.
        bodies: Free rigid bodies, or None.
    """
    slip, slip_of_solids = make_surface_slip(plan, solids, engine), make_solid_slip(plan, engine)
    pressure = make_implicit_pressure(plan, lattice, engine, ranks)
    return NodalCouplings(slip, slip_of_solids, pins, bodies, pressure)
