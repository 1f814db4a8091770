"""What sources bring, by times and ids alone, and what sinks take: a layer of a source's lattice
(scene/nozzle.py) is born at the far end of the nozzle, is carried along, is let go and passes the
mouth.
"""

import math
from typing import NamedTuple

import numpy as np

from ..scene import nozzle
from ..scene.forms import Shape
from ..scene.scene import Scene
from ..scene.settings import WALLS
from ..scene.sources import Inflow

BEHIND = 4  # cells: farther no particle is
# Cells before the mouth where a layer is let go: those behind it, whose nodes it shares and which
# do not fall, hold it up for as long (measured: .26 to .35 at 2.5 to .5 m/s).
EARLY = 0.3
MOST_LAYERS = 2.0**40  # their numbers are exact beside the times they pass


class SourcePlan(NamedTuple):
    """A source. Layer k holds the ids first + k n .. first + (k + 1) n - 1, n = len(mouth)."""

    name: str
    thing: int  # behind the objects
    group: int
    first: int  # id
    mouth: np.ndarray  # (n, 3) [m] where the particles of a layer pass the mouth
    direction: tuple[float, float, float]  # of length 1
    speed: float  # [m/s]
    spacing: float  # [m]
    ahead: int  # layers in the nozzle
    layers: int  # that ever come
    start: float  # [s]
    early: float  # [s] before it passes the mouth that a layer is let go
    colour: tuple[float, float, float]

    @property
    def period(self) -> float:
        """Time from one layer to the next [s]."""
        return self.spacing / self.speed

    @property
    def velocity(self) -> np.ndarray:
        """Of what comes (3,) [m/s]."""
        return self.speed * np.array(self.direction)

    @property
    def volume(self) -> float:
        """Rest volume of a particle [m3]."""
        return self.spacing**3

    def passes(self, layer):
        """When layers pass the mouth [s]."""
        return self.start + (layer + 0.5) * self.period

    def born(self, layer):
        """When layers are born [s]."""
        return self.passes(layer) - self.ahead * self.period

    def let_go(self, layer):
        """When layers are let go [s]; from then on they go by themselves."""
        return self.passes(layer) - self.early

    def born_by(self, time: float) -> int:
        """How many layers are born up to and with a time [s]."""
        return self._by(time, self.born)

    def passed_by(self, time: float) -> int:
        """How many layers have passed the mouth up to and with a time [s]."""
        return self._by(time, self.passes)

    def free_by(self, time: float) -> int:
        """How many layers are let go up to and with a time [s]."""
        return self._by(time, self.let_go)

    def _by(self, time: float, when) -> int:
        """How many layers k have when(k) <= time; when ascends."""
        low, high = 0, self.layers
        while low < high:
            middle = (low + high) // 2
            if when(middle) <= time:
                low = middle + 1
            else:
                high = middle
        return low

    def places(self, ids: np.ndarray, time: float) -> np.ndarray:
        """Positions (m, 3) [m] at a time [s] of particles that are carried on the lattice. Number
        by number: a product of matrices may round by its shape."""
        layer, point = np.divmod(ids - self.first, len(self.mouth))
        way = self.speed * (time - self.passes(layer))
        return self.mouth[point] + way[:, None] * np.array(self.direction)


class SinkPlan(NamedTuple):
    """A region in which particles end."""

    name: str
    shape: Shape
    since: float = 0.0  # [s]


def speed(scene: Scene, source: Inflow) -> float:
    """Of what a source brings [m/s]."""
    if source.velocity is not None:
        return source.velocity
    n = len(nozzle.mouth(source, scene.domain.cell))
    area = n * nozzle.spacing(source, scene.domain.cell) ** 2
    if source.flow is not None:
        return source.flow / area
    assert source.rate is not None  # the reader says so
    return source.rate / (scene.material[source.material].bulk_density * area)


def layers(scene: Scene, source: Inflow) -> int:
    """How many layers come: those that pass the mouth until the source ends, of those that are born
    in the run. What comes until a time does not depend on when the run ends."""
    period = nozzle.spacing(source, scene.domain.cell) / speed(scene, source)
    born = (scene.time.end - source.start) / period + nozzle.ahead(source) + 0.5
    found = born if source.end is None else min(born, (source.end - source.start) / period + 0.5)
    return max(0, math.floor(min(found, MOST_LAYERS)))


def sink_plans(scene: Scene) -> tuple[SinkPlan, ...]:
    """The sinks of a scene, then its open walls: a cell deep, and all that lies behind them."""
    found = [SinkPlan(sink.name, sink.shape) for sink in scene.sink]
    dx, size = scene.domain.cell, scene.domain.size
    for name in scene.domain.open_walls:
        axis, side = divmod(WALLS.index(name), 2)
        low, high = [-BEHIND * dx] * 3, [edge + BEHIND * dx for edge in size]
        if side:
            low[axis] = size[axis] - dx
        else:
            high[axis] = dx
        since = scene.domain.opens[WALLS.index(name)] or 0.0
        found.append(SinkPlan(name, Shape.model_validate({"box": [low, high]}), since))
    return tuple(found)


def source_plans(scene: Scene, group_of: tuple, count: list[int]) -> tuple[SourcePlan, ...]:
    """The sources of a scene of whose things `count` particles are kept ready. Raises SceneError
    where more are asked for: what was kept ready by the run so far is all that can come."""
    found, wrong = [], []
    objects, dx = len(scene.object), scene.domain.cell
    for k, source in enumerate(scene.inflow, objects):
        mouth = nozzle.mouth(source, dx)
        ready, asked = int(count[k]) // len(mouth), layers(scene, source)
        if asked > ready:
            said = (
                f"source '{source.name}' has particles kept ready for {ready} layers, this asks"
                f" for {asked}: a run with a source that does not end cannot be extended"
            )
            wrong.append((("time", "end"), said))
        fast = speed(scene, source)
        found.append(
            SourcePlan(
                source.name, k, group_of[k], int(sum(count[:k])), mouth, source.direction, fast,
                nozzle.spacing(source, dx), nozzle.ahead(source), ready, source.start,
                EARLY * dx / fast, source.colour,
            )
        )  # fmt: skip
    if wrong:
        raise scene.error(wrong)
    return tuple(found)
