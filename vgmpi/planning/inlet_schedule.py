"""Schedule of inlets by times and ids alone, and regions of outlets.

The particles of an inlet (scene/inlet_geometry.py) are numbered as they pass the mouth, one by one
at equal intervals. A layer of them, one per column, is spawned at once at the far end of the
nozzle. Each particle is carried along, released, and passes the mouth at its own time.
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
# RELEASE_OFFSET_CELLS is the distance before the mouth [cells] at which a particle is released.
# Those behind it share its nodes and do not fall; they hold it up for as long (measured: 0.13 to
# 0.20 cells at 0.6 to 2.5 m/s).
RELEASE_OFFSET_CELLS = 0.2
MAX_PARTICLES = 2.0**40  # numbers up to this are exact in the products that give their times
TIE_LAYERS = 1e-6  # [layers] by which rounding may keep one from the end of the run it is due at


class InletPlan(NamedTuple):
    """Plan of an inlet.

    Particle m has the id first + m and the place m modulo len(mouth) in the mouth.
    """

    name: str
    entity: int  # row among objects and inlets; inlets follow the objects
    group: int
    first: int  # first id
    mouth: np.ndarray  # (n, 3) [m] positions of a layer's particles in the mouth, as they pass it
    direction: tuple[float, float, float]  # unit vector
    speed: float  # [m/s]
    spacing: float  # [m] along the columns
    ahead: int  # number of layers in the nozzle
    particles: int  # number of particles that ever come
    start: float  # [s]
    early: float  # [s] from the release of a particle until it passes the mouth
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

    def mouth_time(self, number):
        """Return the times at which particles pass the mouth [s], by their numbers."""
        return self.start + (number + 0.5) * (self.period / len(self.mouth))

    def spawn_time(self, number):
        """Return the times at which particles are spawned [s]: their layer fits into the nozzle."""
        return self.start + (number // len(self.mouth) + 1 - self.ahead) * self.period

    def release_time(self, number):
        """Return the times at which particles are released [s]; from then on they move freely."""
        return self.mouth_time(number) - self.early

    def spawned(self, time: float) -> int:
        """Return the number of particles spawned up to and including a time [s]."""
        return self._by(time, self.spawn_time)

    def passed(self, time: float) -> int:
        """Return the number of particles that passed the mouth up to and including a time [s]."""
        return self._by(time, self.mouth_time)

    def released(self, time: float) -> int:
        """Return the number of particles released up to and including a time [s]."""
        return self._by(time, self.release_time)

    def _by(self, time: float, when) -> int:
        """Return the number of particles m with when(m) <= time; `when` does not descend."""
        low, high = 0, self.particles
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
        number = ids - self.first
        displacement = self.speed * (time - self.mouth_time(number))
        mouth = self.mouth[number % len(self.mouth)]
        return mouth + displacement[:, None] * np.array(self.direction)


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


def particle_count(scene: Scene, source: Inlet) -> int:
    """Return the number of particles of an inlet.

    These are the particles that pass the mouth until the inlet ends, of those spawned during the
    run. The particles that enter up to some time do not depend on when the run ends.
    """
    n = len(inlet_geometry.inlet_points(source, scene.domain.cell))
    period = inlet_geometry.spacing(source, scene.domain.cell) / inlet_speed(scene, source)
    layers = (scene.time.end - source.start_time) / period
    layers += inlet_geometry.layers_in_nozzle(source) + TIE_LAYERS
    count = n * math.floor(min(layers, MAX_PARTICLES))
    if source.end_time is not None:
        count = min(count, math.floor(n * (source.end_time - source.start_time) / period + 0.5))
    return max(0, min(count, int(MAX_PARTICLES)))


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
        since = scene.domain.wall_opening_times[WALLS.index(name)] or 0.0
        plans.append(OutletPlan(name, Shape.model_validate({"box": [low, high]}), since))
    return tuple(plans)


def inlet_plans(scene: Scene, group_of: tuple, count: list[int]) -> tuple[InletPlan, ...]:
    """Return the plans of a scene's inlets.

    Args:
        scene: The scene.
        group_of: Group of each object and inlet.
        count: Prepared particles of each object and inlet.

    Raises:
        SceneError: An inlet needs more particles than are prepared. A resumed run can only insert
            particles that it prepared at its start.
    """
    plans, errors = [], []
    objects, dx = len(scene.object), scene.domain.cell
    for k, source in enumerate(scene.inlet, objects):
        mouth = inlet_geometry.inlet_points(source, dx)
        ready, needed = int(count[k]), particle_count(scene, source)
        if needed > ready:
            message = (
                f"inlet '{source.name}' has {ready:,} particles kept ready, this asks for"
                f" {needed:,}: a run with an inlet that does not end cannot be extended"
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
