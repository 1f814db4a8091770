"""Cost of each part of a step by stage, from which `--plan` tells a step's time.

`python -m tests.benchmarks step-model` fits the costs to steps of scenes as they run.
"""

from dataclasses import astuple, dataclass, fields
from typing import NamedTuple


@dataclass(frozen=True)
class StageCost:
    """Cost or time by stage of a step; the names of the stages are those of `--profile`."""

    p2g: float = 0.0
    grid: float = 0.0
    g2p: float = 0.0
    sort: float = 0.0

    def __add__(self, other: "StageCost") -> "StageCost":
        """Return the sum by stage."""
        return StageCost(*(a + b for a, b in zip(astuple(self), astuple(other), strict=True)))

    def __mul__(self, factor: float) -> "StageCost":
        """Return the product of each stage with a factor."""
        return StageCost(*(factor * a for a in astuple(self)))

    __rmul__ = __mul__

    @property
    def total(self) -> float:
        """Return the sum over the stages."""
        return sum(astuple(self))


STAGES = tuple(field.name for field in fields(StageCost))


class ProximityCost(NamedTuple):
    """Cost of particles at most one block away from something that they may touch."""

    particle: StageCost  # per particle
    block: StageCost  # per block of particles
    nodes: StageCost = StageCost()  # per node block that both phases reach


class PhaseProximity(NamedTuple):
    """Proximity of an object's particles to another phase."""

    phase: str
    share: float  # [-] fraction of the particles that are at most a block from it
    blocks: int  # blocks that hold these particles
    nodes: int  # node blocks that both reach

    def scaled(self, factor: float) -> "PhaseProximity":
        """Return the proximity with a multiple of the blocks."""
        blocks, nodes = round(factor * self.blocks), round(factor * self.nodes)
        return self._replace(blocks=blocks, nodes=nodes)


class Proximity(NamedTuple):
    """Proximity of one object's particles to other phases and colliders."""

    blocks: int = 0  # blocks that hold them
    phases: tuple[PhaseProximity, ...] = ()  # proximity to each other phase
    collider: float = 0.0  # [-] fraction of them that is at most a block from a collider

    def scaled(self, factor: float) -> "Proximity":
        """Return the proximity with a multiple of the blocks."""
        phases = tuple(phase.scaled(factor) for phase in self.phases)
        return self._replace(blocks=round(factor * self.blocks), phases=phases)


class StepCosts(NamedTuple):
    """Costs of the parts of a step. The unit is one step of a fluid particle."""

    law: StageCost  # shares of the step of a particle with its law alone: the sum is 1
    correction: StageCost  # one transfer correction
    fullness: StageCost  # of nodes, and shift of particles, besides a transfer correction
    rest_volume: StageCost  # one sum of rest volumes, where liquids differ in density
    separate_stress: StageCost  # stress impulses of their own, and the blend of FLIP
    cell_dilatation: StageCost  # dilatation by cells
    density_correction: StageCost
    carried_values: StageCost  # one nodal field of values that particles carry and exchange
    surface_contact: ProximityCost  # contact of solids with surface descriptors
    contact: ProximityCost  # contact of other bodies
    mixing: ProximityCost
    drag: ProximityCost
    collider: ProximityCost  # colliders at rest
    moving_collider: ProximityCost  # in addition, if a collider moves
    coupled_collider: ProximityCost  # colliders that what flows moves
    block: StageCost  # a block without its particles, and the disorder of partly filled blocks


COSTS = StepCosts(
    law=StageCost(0.38, 0.06, 0.52, 0.04),
    correction=StageCost(0.46, 0.02, 0.24),
    fullness=StageCost(0.0, 0.03, 0.26),
    rest_volume=StageCost(0.5, 0.1),
    separate_stress=StageCost(0.39, 0.05, 0.24),
    cell_dilatation=StageCost(0.05, 0.1, 0.2),
    density_correction=StageCost(0.0, 0.0, 0.1),
    carried_values=StageCost(0.3, 0.05, 0.25),
    surface_contact=ProximityCost(
        StageCost(0.13, 0.01, 0.07), StageCost(23.0, 10.0, 20.0), StageCost(0.0, 6.0)
    ),
    contact=ProximityCost(
        StageCost(0.2, 0.01, 0.08), StageCost(120.0, 45.0, 25.0), StageCost(0.0, 10.0)
    ),
    mixing=ProximityCost(
        StageCost(0.7, 0.05, 0.57), StageCost(60.0, 50.0, 55.0), StageCost(0.0, 60.0)
    ),
    drag=ProximityCost(
        StageCost(0.35, 0.02, 0.27), StageCost(35.0, 15.0, 27.0), StageCost(0.0, 45.0)
    ),
    collider=ProximityCost(StageCost(0.1, 0.1, 0.05), StageCost(50.0, 170.0, 20.0)),
    moving_collider=ProximityCost(StageCost(0.05, 0.1, 0.05), StageCost(0.0, 100.0)),
    coupled_collider=ProximityCost(StageCost(0.1, 0.1, 0.1), StageCost(30.0, 30.0, 30.0)),
    block=StageCost(75.0, 40.0, 75.0, 6.0),
)
