"""Plan of inlets and outlets: inlets by times and ids alone, regions of outlets, costs, reports.

The particles of an inlet (geometry.py) are numbered as they pass the mouth, one by one
at equal intervals. A layer of them, one per column, is spawned at once at the far end of the
nozzle. Each particle is carried along, released, and passes the mouth at its own time.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from vgmpi.planning.feature_plan import FeaturePlan, PlanDraft
from vgmpi.planning.plan import Plan
from vgmpi.runtime.config.toml_source import escape_control_characters
from vgmpi.scene.scene import Scene
from vgmpi.scene.sections import WALLS
from vgmpi.scene.shapes import Shape

from . import geometry
from .table import Inlet

OPEN_WALL_DEPTH_CELLS = 4  # [cells] depth of an open wall's region; no particle is farther out
# RELEASE_OFFSET_CELLS is the distance before the mouth [cells] at which a particle is released.
# Those behind it share its nodes and do not fall; they hold it up for as long (measured: 0.13 to
# 0.20 cells at 0.6 to 2.5 m/s).
RELEASE_OFFSET_CELLS = 0.2
MAX_PARTICLES = 2.0**40  # numbers up to this are exact in the products that give their times
INLET_SECONDS = 3e-4  # [s] of processor time in a step
TIE_LAYERS = 1e-6  # [layers] by which rounding may keep one from the end of the run it is due at


class InletPlan(NamedTuple):
    """Plan of an inlet.

    Particle m has the id first + m and the place m modulo len(mouth) in the mouth.
    """

    name: str
    entity: int  # row among objects and particle sources, which follow the objects
    group: int
    first: int  # first id
    mouth: np.ndarray  # (n, 3) [m] positions of a layer's particles in the mouth, as they pass it
    direction: tuple[float, float, float]  # unit vector
    speed: float  # [m/s]
    spacing: float  # [m] along the columns
    nozzle_layers: int  # number of layers in the nozzle
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
        return self.start + (number // len(self.mouth) + 1 - self.nozzle_layers) * self.period

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


class InletsOutletsPlan(FeaturePlan):
    """Inlets and outlets of a run."""

    name, joins_compilation = "inlets_outlets", False

    def __init__(self, inlets: tuple[InletPlan, ...], outlets: tuple[OutletPlan, ...]):
        """Take the inlets and the outlets; walls that particles leave through are outlets."""
        self.inlets, self.outlets = inlets, outlets
        self.source_names = tuple(inlet.name for inlet in inlets)
        self.source_speeds = tuple(inlet.speed for inlet in inlets)
        self.removes_particles = bool(outlets)
        self.step_seconds = INLET_SECONDS * len(inlets)

    def inserted_counts(self, time: float) -> dict[int, int]:
        """Return the number of particles that each inlet has inserted up to a time [s]."""
        return {inlet.entity: inlet.spawned(time) for inlet in self.inlets}

    def mean_counts(self, plan: Plan) -> dict[int, int]:
        """Return the mean number of particles of each inlet over the run."""
        counts, end = {}, float(plan.times[-1])
        for inlet in self.inlets:
            middle = 0.5 * (inlet.mouth_time(0) + inlet.mouth_time(inlet.particles - 1))  # [s]
            share = min(max(1.0 - middle / end, 0.0), 1.0)
            counts[inlet.entity] = round(plan.count[inlet.entity] * share)
        return counts

    def report_lines(self, plan: Plan) -> list[str]:
        """Return the lines on inlets and outlets; memory and time include all that enters."""
        lines = [
            f"  inlet       {escape_control_characters(inlet.name)}:"
            f" {inlet.particles:,} particles,"
            f" {len(inlet.mouth)} every {inlet.period:.4g} s, at {inlet.speed:.4g} m/s:"
            f" {_mass_flow_rate(plan, inlet):.4g} kg/s"
            for inlet in self.inlets
        ]
        names = [escape_control_characters(outlet.name) for outlet in self.outlets]
        return lines + [f"  outlet      {name}" for name in names]

    def start(self, context: Any) -> Any:
        """Return the inlets and outlets as they act in a run.

        Args:
            context: See `FeaturePlan.start`.
        """
        from .coupling import InletsOutlets

        return InletsOutlets(self, context)


def inlet_speed(scene: Scene, source: Inlet) -> float:
    """Return the speed of an inlet's particles [m/s]."""
    if source.speed is not None:
        return source.speed
    n = len(geometry.inlet_points(source, scene.domain.cell))
    area = n * geometry.spacing(source, scene.domain.cell) ** 2
    if source.volume_flow_rate is not None:
        return source.volume_flow_rate / area
    assert source.mass_flow_rate is not None  # ensured by the scene's reader
    return source.mass_flow_rate / (scene.material[source.material].bulk_density * area)


def particle_count(scene: Scene, source: Inlet) -> int:
    """Return the number of particles of an inlet.

    These are the particles that pass the mouth until the inlet ends, of those spawned during the
    run. The particles that enter up to some time do not depend on when the run ends.
    """
    n = len(geometry.inlet_points(source, scene.domain.cell))
    period = geometry.spacing(source, scene.domain.cell) / inlet_speed(scene, source)
    layers = (scene.time.end - source.start_time) / period
    layers += geometry.layers_in_nozzle(source) + TIE_LAYERS
    count = n * math.floor(min(layers, MAX_PARTICLES))
    if source.end_time is not None:
        count = min(count, math.floor(n * (source.end_time - source.start_time) / period + 0.5))
    return max(0, min(count, int(MAX_PARTICLES)))


def outlet_plans(scene: Scene) -> tuple[OutletPlan, ...]:
    """Return the outlets of a scene, then its open walls: one cell deep, with all behind them."""
    plans = [
        OutletPlan(sink.name, sink.shape, sink.start_time or 0.0) for sink in scene.lists["outlet"]
    ]
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


def inlet_plans(
    scene: Scene, group_of: Sequence[int], count: Sequence[int]
) -> tuple[InletPlan, ...]:
    """Return the plans of a scene's inlets.

    Args:
        scene: The scene.
        group_of: Group of each object and particle source.
        count: Prepared particles of each.

    Raises:
        SceneError: An inlet needs more particles than are prepared. A resumed run can only insert
            particles that it prepared at its start.
    """
    plans, errors = [], []
    rows, dx = {id(entity): k for k, entity in enumerate(scene.entities)}, scene.domain.cell
    for source in scene.lists["inlet"]:
        k = rows[id(source)]
        mouth = geometry.inlet_points(source, dx)
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
                geometry.spacing(source, dx), geometry.layers_in_nozzle(source), ready,
                source.start_time,
                RELEASE_OFFSET_CELLS * dx / fast, source.color,
            )
        )  # fmt: skip
    if errors:
        raise scene.error(errors)
    return tuple(plans)


def plan_inlets_outlets(draft: PlanDraft) -> InletsOutletsPlan:
    """Plan the inlets and outlets of a scene.

    Args:
        draft: Phases and groups of the scene.

    Raises:
        SceneError: See `inlet_plans`.
    """
    inlets = inlet_plans(draft.scene, draft.group_of, draft.particle_counts)
    return InletsOutletsPlan(inlets, outlet_plans(draft.scene))


def _mass_flow_rate(plan: Plan, inlet: InletPlan) -> float:
    """Return the mass flow rate of an inlet [kg/s]."""
    density = plan.groups[inlet.group].density
    return density * len(inlet.mouth) * inlet.volume / inlet.period
