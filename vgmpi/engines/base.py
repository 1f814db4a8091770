"""What a step asks of the machine that does its work: the door behind which an engine is.

    begin, fill(border), pack ... fill(inner), update(inner) ... add, update(border), gather

A step of no time passes velocities alone through the grid, and ends by `restore` in the place of
`gather`.

An engine keeps the particles of a rank (`groups`), contributes them to the nodes (`fill`), hands
the sums that other ranks need to the halo and takes up theirs (`pack`, `add`), finds the nodes'
velocities (`update`) and moves the particles (`gather`).
"""

from typing import NamedTuple, Protocol

import numpy as np

from ..domain.blocks import Lattice
from ..domain.driven import Driven
from ..domain.halo import Part
from ..domain.movers import Movers
from ..domain.solids import Solids
from ..domain.state import Group
from ..domain.topology import Topology
from ..planning.plan import Plan

# generators of a sequence that fills the unit cube evenly (Roberts 2018): the dither of a step, the
# same on every rank
DITHER = (0.8191725133961645, 0.6710436067037893, 0.5497004779019703)


class Beyond(NamedTuple):
    """A node block of which a sum left its range; the lowest counts."""

    block: tuple[int, ...]  # its three coordinates
    phase: int
    layer: str


class Report(NamedTuple):
    """What a step found on this rank."""

    rate: float  # [1/s] least 1/dt that the particles allow
    far: float  # [cells] farthest from its block's middle
    reach: tuple[float, float, float]  # what bounds the sums of the next step, see `Reach`
    wrong: list[tuple[int, int]]  # id of a particle that went wrong, and why (g2p.CRUSHED ...)
    beyond: list[Beyond]


class Reach(NamedTuple):
    """Maxima over all particles of the step before, which bound the sums of the next."""

    speed: float  # [m/s] along an axis
    turn: float  # [1/s] size of the velocity's gradient
    stress: float  # [m2/s2] over density
    rate: float  # [1/s] as of Report
    dt: float  # [s] of that step

    @classmethod
    def of(cls, found: np.ndarray, rate: float, dt: float) -> "Reach":
        """found: speed, turn, stress (3,)."""
        return cls(float(found[0]), float(found[1]), float(found[2]), rate, dt)

    def fastest(self, plan: Plan, dt: float, pushed: float) -> float:
        """Speed [m/s] above which the sums of a step of dt [s] hold no momentum per mass: the
        quanta follow from it. pushed: by loads [m/s].

        A particle gives a node at most 1.5 sqrt(3) dx away its speed, what it turns by, and what
        its stress does, which has grown by its stiffness, rho c^2, times the strain of a step at
        the most; 3 times that is allowed for.
        """
        waves = (self.rate * plan.cfl * plan.dx) ** 2
        stress = 2.0 * self.stress + 3.0 * waves * self.turn * self.dt
        given = self.speed + pushed + 2.6 * plan.dx * self.turn + 4.0 * dt / plan.dx * stress
        given *= 1.0 + 4.0 * plan.restores  # more than transfers can have lost
        return float(min(plan.dx / dt, given))


UNKNOWN = Reach(np.inf, np.inf, np.inf, np.inf, 0.0)


class Engine(Protocol):
    """One rank's particles and nodes."""

    groups: list[Group]
    words: int  # doubles per sum, of which messages are made

    def __init__(
        self, plan: Plan, lattice: Lattice, solids: Solids | Movers | None, threads: int,
        driven: Driven | None = None,
    ): ...  # fmt: skip

    def feel(self, rows: int, quanta: np.ndarray, rank: int) -> None:
        """From now on sum what colliders and walls give to bodies: `rows` of them, in whole numbers
        of quanta (7,), which change from step to step; rank: this one."""

    def given(self) -> np.ndarray:
        """What they gave on this rank since this was asked: (rows, 7) int64, of colliders and then
        of walls the impulse, its moment about the domain's origin, and the work."""

    def adopt(self, tables: Topology, kept: bool) -> None:
        """Lay out what the tables ask for, after a sort; kept: they are those of before."""

    def open(self, wall: int) -> None:
        """A wall (west, east, south, north, floor, roof) has vanished."""

    def begin(self, dt: float, gravity: np.ndarray, speed: float) -> None:
        """Begin a step of dt [s], or of no time, with gravity (3,) [m/s2]; speed:
        Reach.fastest."""

    def fill(self, border: bool) -> None:
        """Contribute this rank's segments: those that reach other ranks' nodes, or the others."""

    def pack(self, part: Part) -> None:
        """Put what this rank summed into a part of a message."""

    def add(self, part: Part) -> None:
        """Add what another rank summed."""

    def update(self, border: bool) -> None:
        """Find the velocities at the nodes to which others add, or at the others."""

    def gather(self, step: int) -> Report:
        """Move the particles."""

    def restore(self, times: int) -> list[Beyond]:
        """Give the particles `times` what their motion has lost by a step of no time. Returns what
        Report has of sums."""
