"""Schedule of inlets by times and ids alone, and regions of outlets.

A layer of an inlet's lattice (scene/inlet_geometry.py) is spawned at the far end of the nozzle,
carried along, released, and passes the mouth.
"""

import math
from typing import NamedTuple

import numpy as np

from vgmpi.scene import inlet_geometry
from vgmpi.scene.inlets_outlets import Inlet
from vgmpi.scene.scene import Scene
from vgmpi.scene.sections import WALLS
from vgmpi.scene.shapes import Shape

OPEN_WALL_DEPTH_CELLS = 4  # [cells] depth of an open wall's region; no particle is farther out
# RELEASE_OFFSET_CELLS is the distance before the mouth [cells] at which a layer is released. The
# layers behind it share its nodes and do not fall; they hold it up for as long (measured: 0.26 to
# 0.35 cells at 2.5 to 0.5 m/s).
RELEASE_OFFSET_CELLS = 0.3
MAX_LAYERS = 2.0**40  # layer numbers up to this are exact in the products that give their times


class InletPlan(NamedTuple):
    """Plan of an inlet.

    Layer k holds the ids first + k n .. first + (k + 1) n - 1 with n = len(mouth).
    """

    name: str
    entity: int  # row among objects and inlets; inlets follow the objects
    group: int
    first: int  # first id
    mouth: np.ndarray  # (n, 3) [m] positions of a layer's particles in the mouth
    direction: tuple[float, float, float]  # unit vector
    speed: float  # [m/s]
    spacing: float  # [m] of the lattice
    ahead: int  # number of layers in the nozzle
    layers: int  # number of layers that ever come
    start: float  # [s]
    early: float  # [s] from the release of a layer until it passes the mouth
    color: tuple[float, float, float]

    @property
    def period(self) -> float:
        """Time from one layer to the next [s]."""
        return self.spacing / self.speed

    @property
    def velocity(self) -> np.ndarray:
        """Inlet velocity, shape (3,) [m/s]."""
        return self.speed * np.array(self.direction)

    @property
    def volume(self) -> float:
        """Rest volume of a particle [m3]."""
        return self.spacing**3

    def mouth_time(self, layer):
        """Return the times at which layers pass the mouth [s]."""
        return self.start + (layer + 0.5) * self.period

    def spawn_time(self, layer):
        """Return the times at which layers are spawned [s]."""
        return self.mouth_time(layer) - self.ahead * self.period

    def release_time(self, layer):
        """Return the times at which layers are released [s]; from then on they move freely."""
        return self.mouth_time(layer) - self.early

    def spawned_layers(self, time: float) -> int:
        """Return the number of layers spawned up to and including a time [s]."""
        return self._by(time, self.spawn_time)

    def passed_layers(self, time: float) -> int:
        """Return the number of layers that have passed the mouth up to and including a time [s]."""
        return self._by(time, self.mouth_time)

    def released_layers(self, time: float) -> int:
        """Return the number of layers released up to and including a time [s]."""
        return self._by(time, self.release_time)

    def _by(self, time: float, when) -> int:
        """Return the number of layers k with when(k) <= time; `when` ascends."""
        low, high = 0, self.layers
        while low < high:
            middle = (low + high) // 2
            if when(middle) <= time:
                low = middle + 1
            else:
                high = middle
        return low

    def places(self, ids: np.ndarray, time: float) -> np.ndarray:
        """Return the positions at a time [s] of particles carried on the lattice, shape (m, 3) [m].

        They are computed number by number: the rounding of a matrix product may depend on its
        shape.
        """
        layer, point = np.divmod(ids - self.first, len(self.mouth))
        displacement = self.speed * (time - self.mouth_time(layer))
        return self.mouth[point] + displacement[:, None] * np.array(self.direction)


class OutletPlan(NamedTuple):
    """Region in which particles are removed."""

    name: str
    shape: Shape
    since: float = 0.0  # [s] from when on


def inlet_speed(scene: Scene, source: Inlet) -> float:
    """Return the speed of an inlet's particles [m/s]."""
    if source.speed is not None:
        return source.speed
    n = len(inlet_geometry.inlet_points(source, scene.domain.cell))
    area = n * inlet_geometry.spacing(source, scene.domain.cell) ** 2
    if source.volume_flow_rate is not None:
        return source.volume_flow_rate / area
    assert source.mass_flow_rate is not None  # ensured by the scene's reader
    return source.mass_flow_rate / (scene.material[source.material].bulk_density * area)


def layer_count(scene: Scene, source: Inlet) -> int:
    """Return the number of layers of an inlet.

    These are the layers that pass the mouth until the inlet ends, of those spawned during the run.
    The particles that enter up to some time do not depend on when the run ends.
    """
    period = inlet_geometry.spacing(source, scene.domain.cell) / inlet_speed(scene, source)
    spawned = (
        (scene.time.end - source.start_time) / period
        + inlet_geometry.layers_in_nozzle(source)
        + 0.5
    )
    count = (
        spawned
        if source.end_time is None
        else min(spawned, (source.end_time - source.start_time) / period + 0.5)
    )
    return max(0, math.floor(min(count, MAX_LAYERS)))


def outlet_plans(scene: Scene) -> tuple[OutletPlan, ...]:
    """Return the outlets of a scene, then its open walls: one cell deep, with all behind them."""
    plans = [OutletPlan(sink.name, sink.shape, sink.start_time or 0.0) for sink in scene.outlet]
    dx, size = scene.domain.cell, scene.domain.size
    for name in scene.domain.open_walls:
        axis, side = divmod(WALLS.index(name), 2)
        low, high = (
            [-OPEN_WALL_DEPTH_CELLS * dx] * 3,
            [edge + OPEN_WALL_DEPTH_CELLS * dx for edge in size],
        )
        if side:
            low[axis] = size[axis] - dx
        else:
            high[axis] = dx
        since = scene.domain.opens[WALLS.index(name)] or 0.0
        plans.append(OutletPlan(name, Shape.model_validate({"box": [low, high]}), since))
    return tuple(plans)


def inlet_plans(scene: Scene, group_of: tuple, count: list[int]) -> tuple[InletPlan, ...]:
    """Return the plans of a scene's inlets.

    Args:
        scene: The scene.
        group_of: Group of each object and inlet.
        count: Prepared particles of each object and inlet.

    Raises:
        SceneError: An inlet needs more layers than are prepared. A resumed run can only insert
            particles that it prepared at its start.
    """
    plans, errors = [], []
    objects, dx = len(scene.object), scene.domain.cell
    for k, source in enumerate(scene.inlet, objects):
        mouth = inlet_geometry.inlet_points(source, dx)
        ready, needed = int(count[k]) // len(mouth), layer_count(scene, source)
        if needed > ready:
            message = (
                f"inlet '{source.name}' has particles kept ready for {ready} layers, this asks"
                f" for {needed}: a run with an inlet that does not end cannot be extended"
            )
            errors.append((("time", "end"), message))
        fast = inlet_speed(scene, source)
        plans.append(
            InletPlan(
                source.name, k, group_of[k], int(sum(count[:k])), mouth, source.direction, fast,
                inlet_geometry.spacing(source, dx), inlet_geometry.layers_in_nozzle(source), ready,
                source.start_time,
                RELEASE_OFFSET_CELLS * dx / fast, source.color,
            )
        )  # fmt: skip
    if errors:
        raise scene.error(errors)
    return tuple(plans)
