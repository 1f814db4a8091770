"""What a run in coarser cells has shown of where particles go, for the scene's own cells."""

from dataclasses import replace
from typing import NamedTuple

from ..scene.scene import Scene
from .features import step
from .pace import Pace
from .plan import Plan
from .surroundings import Surroundings


class Standing(NamedTuple):
    """How all stand at a moment."""

    steps: float  # since the moment before, in the scene's own cells
    number: tuple[int, ...]  # of particles, of each object and source, of the scene's own
    around: tuple[Surroundings, ...]  # of each, in the scene's own cells


class Rehearsal(NamedTuple):
    """A run of the scene in cells of `cell` [m]."""

    cell: float
    took: float  # [s]
    moments: tuple[Standing, ...]  # one after the other

    @property
    def steps(self) -> float:
        """In the scene's own cells."""
        return sum(one.steps for one in self.moments)

    def time(self, scene: Scene, plan: Plan, pace: Pace) -> float:
        """Of all particles and steps on one core [ns]."""
        return sum(
            one.steps * step(scene, replace(plan, count=one.number, surroundings=one.around), pace)
            for one in self.moments
        )
