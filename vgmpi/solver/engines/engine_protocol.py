"""Interface of the compute engines: what a time step asks of the machine that does its work.

A step calls, in this order:

    begin, fill(border), pack ... fill(inner), update(inner) ... add, update(border), gather

With features that filter stress impulses, `begin_impulses` follows `add`, before both updates. With
features that couple the nodes, `begin_coupling` and `end_coupling` come before `gather`.

A step of no time (dt = 0) only passes velocities through the grid, and ends with
`correct_transfers` in the place of `gather`.

An engine keeps the particles of a rank (`groups`), transfers them to the nodes (`fill`), hands the
sums that other ranks need to the halo exchange and takes theirs (`pack`, `add`), computes the nodal
velocities (`update`) and advects the particles (`gather`).
"""

from collections.abc import Mapping
from typing import Protocol

import numpy as np

from vgmpi.features.active_feature import ActiveFeature, EngineServices, NodeState
from vgmpi.kernels.colliders.moving_colliders import MovingColliders
from vgmpi.kernels.colliders.static_colliders import StaticColliders
from vgmpi.kernels.rigid.prescribed_motion import PhaseMotions
from vgmpi.kernels.step_records import AccumulatorOverflow, StepReport
from vgmpi.kernels.transfer.transfer_correction import CorrectionKinds
from vgmpi.parallel.block_lattice import BlockLattice
from vgmpi.parallel.exchange_topology import ExchangeTopology
from vgmpi.parallel.halo_exchange import FieldMessage
from vgmpi.parallel.particle_group import ParticleGroup
from vgmpi.planning.plan import Plan

CollidersAtNodes = StaticColliders | MovingColliders


class Engine(EngineServices, Protocol):
    """Particles and nodes of one rank."""

    groups: list[ParticleGroup]
    words: int  # doubles per sum; messages are made of them
    features: Mapping[str, ActiveFeature]  # of the run, set by the simulation

    def __init__(
        self, plan: Plan, lattice: BlockLattice, solids: CollidersAtNodes | None,
        threads: int,
        driven: PhaseMotions | None = None,
    ): ...  # fmt: skip

    def set_topology(self, tables: ExchangeTopology, unchanged: bool) -> None:
        """Allocate nodal storage and segment tables after a particle sort.

        Args:
            tables: Segments, node blocks and exchange lists of this rank.
            unchanged: Whether the tables equal the previous ones, so that storage is reused.
        """

    def begin(
        self, dt: float, gravity: np.ndarray, speed: float,
        correction: CorrectionKinds | None = None,
    ) -> None:  # fmt: skip
        """Begin a step.

        Args:
            dt: Length of the step [s], 0 for a step of no time.
            gravity: Acceleration, shape (3,) [m/s^2].
            speed: Bound of `ParticleMaxima.fastest` [m/s].
            correction: What a feature does in a step of no time, or None.
        """

    def fill(self, border: bool) -> None:
        """Scatter segments to the grid: at the border to other ranks, or all others."""

    def pack(self, part: FieldMessage) -> None:
        """Pack the sums of this rank into a section of a message."""

    def add(self, part: FieldMessage) -> None:
        """Add the sums of another rank from a section of a message."""

    def begin_impulses(self) -> NodeState:
        """Return the nodes, with velocities by momentum alone, before the updates of a step."""

    def update(self, border: bool) -> None:
        """Compute velocities at the nodes shared with other ranks (border), or at all others."""

    def begin_coupling(self) -> NodeState:
        """Return the nodes for what couples them, valid until `end_coupling`."""

    def end_coupling(self) -> None:
        """Take the nodal velocities that couplings have changed."""

    def gather(self, step: int) -> StepReport:
        """Transfer grid velocities to the particles, advect them and return the report."""

    def correct_transfers(self, times: int) -> list[AccumulatorOverflow]:
        """Compensate the motion that transfers have lost, measured by a step of no time.

        Args:
            times: Factor of the loss that is added to the particles.

        Returns:
            Sums that left their range, as in `StepReport`.
        """
