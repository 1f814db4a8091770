"""Interface of the compute engines: what a time step asks of the machine that does its work.

A step calls, in this order:

    begin, fill(border), pack ... fill(inner), update(inner) ... add, update(border), gather

With surfaces or an implicit pressure that couple the nodes, `begin_coupling` and `end_coupling`
come before `gather`.

A step of no time (dt = 0) only passes velocities through the grid, and ends with `restore` in the
place of `gather`.

An engine keeps the particles of a rank (`groups`), transfers them to the nodes (`fill`), hands the
sums that other ranks need to the halo exchange and takes theirs (`pack`, `add`), computes the nodal
velocities (`update`) and advects the particles (`gather`).
"""

from typing import Any, NamedTuple, Protocol

import numpy as np

from vgmpi.kernels.rigid.moving_colliders import MovingColliders
from vgmpi.kernels.rigid.prescribed_motion import PrescribedBodies
from vgmpi.kernels.rigid.static_colliders import StaticColliders
from vgmpi.kernels.transfer.particle_shifting import ShiftConstants
from vgmpi.parallel.block_lattice import BlockLattice
from vgmpi.parallel.exchange_topology import ExchangeTopology
from vgmpi.parallel.halo_exchange import FieldMessage
from vgmpi.parallel.particle_group import ParticleGroup
from vgmpi.planning.plan import Plan

# Generators of a low-discrepancy sequence in the unit cube (Roberts 2018). It is the dither of a
# step and is equal on all ranks.
DITHER = (0.8191725133961645, 0.6710436067037893, 0.5497004779019703)


class AccumulatorOverflow(NamedTuple):
    """Node block in which a sum left its range; the lowest block is reported."""

    block: tuple[int, ...]  # (3,) block coordinates
    phase: int  # velocity field
    layer: str  # name of the nodal field


class StepReport(NamedTuple):
    """Result of a step on this rank."""

    rate: float  # [1/s] lower bound of 1/dt from the particles
    far: float  # [cells] largest distance of a particle from the center of its block
    reach: tuple[float, float, float]  # maxima that bound the next sums, see `ParticleMaxima`
    wrong: list[tuple[int, int]]  # failed particles: id and reason (g2p.INVALID_VOLUME ...)
    beyond: list[AccumulatorOverflow]  # sums that left their range


class ParticleMaxima(NamedTuple):
    """Maxima over all particles in the previous step, which bound the sums of the next step."""

    speed: float  # [m/s] largest velocity component
    turn: float  # [1/s] norm of the velocity gradient
    stress: float  # [m^2/s^2] stress divided by density
    rate: float  # [1/s] lower bound of 1/dt, see `StepReport`
    dt: float  # [s] length of that step

    @classmethod
    def of(cls, maxima: np.ndarray, rate: float, dt: float) -> "ParticleMaxima":
        """Return the record of a step.

        Args:
            maxima: Speed [m/s], norm of the velocity gradient [1/s] and stress over density
                [m^2/s^2], shape (3,).
            rate: Lower bound of 1/dt [1/s].
            dt: Length of the step [s].
        """
        return cls(float(maxima[0]), float(maxima[1]), float(maxima[2]), rate, dt)

    def fastest(self, plan: Plan, dt: float, load_speed: float) -> float:
        """Return the speed above which the sums of a step hold no momentum per mass [m/s].

        The quanta of the sums follow from it. A particle gives a node at most its own speed, its
        velocity gradient over the distance 1.5 sqrt(3) dx, and the action of its stress. The stress
        has grown by at most the stiffness, rho c^2, times the strain of a step; 3 times that is
        allowed for.

        Args:
            plan: Plan of the run.
            dt: Length of the step [s].
            load_speed: Speed added by loads [m/s].
        """
        waves = (self.rate * plan.cfl * plan.dx) ** 2
        stress = 2.0 * self.stress + 3.0 * waves * self.turn * self.dt
        speed = self.speed + load_speed + 2.6 * plan.dx * self.turn + 4.0 * dt / plan.dx * stress
        speed *= 1.0 + 4.0 * plan.restores  # exceeds what transfers can have lost
        return float(min(plan.dx / dt, speed))


UNKNOWN_MAXIMA = ParticleMaxima(np.inf, np.inf, np.inf, np.inf, 0.0)


class Engine(Protocol):
    """Particles and nodes of one rank."""

    groups: list[ParticleGroup]
    words: int  # doubles per sum; messages are made of them
    pins: Any  # pinned parts of bodies (boundary/pinned_coupling.py), or None

    def __init__(
        self, plan: Plan, lattice: BlockLattice, solids: StaticColliders | MovingColliders | None,
        threads: int,
        driven: PrescribedBodies | None = None,
    ): ...  # fmt: skip

    def enable_reactions(self, rows: int, quanta: np.ndarray, rank: int) -> None:
        """Start to sum the reactions of colliders and walls.

        Args:
            rows: Number of bodies: colliders, then walls.
            quanta: Quanta of the fixed-point sums, shape (7,). They change from step to step.
            rank: This rank.
        """

    def given(self) -> np.ndarray:
        """Return the reactions summed on this rank since the last call.

        Returns:
            Impulse, its moment about the domain's origin, and work in quanta, shape (rows, 7)
            int64; colliders come first, then walls.
        """

    def set_topology(self, tables: ExchangeTopology, unchanged: bool) -> None:
        """Allocate nodal storage and segment tables after a particle sort.

        Args:
            tables: Segments, node blocks and exchange lists of this rank.
            unchanged: Whether the tables equal the previous ones, so that storage is reused.
        """

    def open(self, wall: int) -> None:
        """Remove a wall (0 to 5: west, east, south, north, floor, roof) that has vanished."""

    def begin(
        self, dt: float, gravity: np.ndarray, speed: float, shift: ShiftConstants | None = None
    ) -> None:
        """Begin a step.

        Args:
            dt: Length of the step [s], 0 for a step of no time.
            gravity: Acceleration, shape (3,) [m/s^2].
            speed: Bound of `ParticleMaxima.fastest` [m/s].
            shift: Constants of the shift of liquids that a step of no time makes, or None.
        """

    def fill(self, border: bool) -> None:
        """Scatter segments to the grid: at the border to other ranks, or all others."""

    def pack(self, part: FieldMessage) -> None:
        """Pack the sums of this rank into a section of a message."""

    def add(self, part: FieldMessage) -> None:
        """Add the sums of another rank from a section of a message."""

    def update(self, border: bool) -> None:
        """Compute velocities at the nodes shared with other ranks (border), or at all others."""

    def begin_coupling(self) -> None:
        """Prepare the nodes for slip, pinned parts, free rigid bodies and an implicit pressure.

        These read and change `layers`, `blocks`, `phases`, `walls` and `room` of the engine.
        """

    def end_coupling(self) -> None:
        """Take the nodal velocities that these kernels have changed."""

    def gather(self, step: int) -> StepReport:
        """Transfer grid velocities to the particles, advect them and return the report."""

    def restore(self, times: int) -> list[AccumulatorOverflow]:
        """Compensate the motion that transfers have lost, measured by a step of no time.

        Args:
            times: Factor of the loss that is added to the particles.

        Returns:
            Sums that left their range, as in `StepReport`.
        """
