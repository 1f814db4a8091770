"""Proximity of bodies at a moment: everything so near that a step has to take it into account."""

from typing import NamedTuple


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
