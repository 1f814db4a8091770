"""Slip of liquids on colliders and solids, and all that couples the nodes in a step."""

from typing import NamedTuple

import numpy as np

from vgmpi.kernels.rigid import solid_slip, surface_slip
from vgmpi.kernels.rigid.body_nodes import SlipLaw
from vgmpi.parallel.block_lattice import BlockLattice
from vgmpi.parallel.block_ownership import BlockDirectory
from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.parallel.exchange_topology import GRADIENTS, ExchangeTopology
from vgmpi.planning.plan import Plan

from .free_body_coupling import FreeBodyCoupling
from .implicit_pressure import ImplicitPressure, make_implicit_pressure
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
    """Return the slip of a scene's liquids on its colliders, or None if they slip freely."""
    if plan.slip is None or solids is None:
        return None
    return SurfaceSlip(plan, solids, engine)


class SolidSlip:
    """Slip of viscous liquids on solids at the nodes of a rank."""

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
        self.law = solid_slip.SolidSlipLaw(law, driven, rows)
        self.plan, self.engine = plan, engine
        self.tables: ExchangeTopology | None = None
        self.shares: list[np.ndarray] = []
        self.scratch = [
            solid_slip.SlipScratch(*np.zeros((6, 3))) for _ in range(engine.threads)
        ]  # fmt: skip

    def apply(self, dt: float) -> None:
        """Change the velocities of the nodes at which phases meet in a step of dt [s]."""
        engine = self.engine
        if self.tables is not engine.tables:
            self.tables = engine.tables
            several = self.tables.meets & (np.diff(self.tables.first) > 1)
            self.shares = np.array_split(np.flatnonzero(several), engine.threads)
        layers = engine.layers
        nodes = solid_slip.NodesOfPhases(
            layers["momentum"].nodes, layers["offsets"].nodes,
            tuple(layers[name].tables for name in GRADIENTS),
        )  # fmt: skip
        engine.each(self._apply, nodes, dt)

    def _apply(self, thread: int, nodes, dt: float) -> None:
        engine = self.engine
        engine.call_if_rows(
            (), solid_slip.apply_solid_slip, self.shares[thread], nodes, engine.blocks, self.law,
            engine.phases, engine.walls, dt, self.plan.dx, self.scratch[thread],
            engine.room[thread].given,
        )  # fmt: skip


class NodalCouplings(NamedTuple):
    """Couplings of the nodes, after all that acts at each node alone."""

    slip: SurfaceSlip | None  # slip of liquids on colliders
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
    slip = make_surface_slip(plan, solids, engine)
    slip_of_solids = None if plan.slip_of_solids is None else SolidSlip(plan, engine)
    pressure = make_implicit_pressure(plan, lattice, engine, ranks)
    return NodalCouplings(slip, slip_of_solids, pins, bodies, pressure)
