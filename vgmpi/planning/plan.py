"""Plan of a run: everything that a scene requires, derived before any array is allocated.

This module derives boundary kinds, contact pairs, time step, memory and number of steps;
phases_and_groups.py has the phases and groups with their fields. Arrays are allocated from the
plan, kernels are specialized on it and files are written by it; a field that the plan does not name
does not exist.
"""

import math
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, TypeVar

import numpy as np

from vgmpi.materials.couplings.contact_rule import Contact
from vgmpi.materials.couplings.interaction import CONTACT
from vgmpi.materials.material import law_function
from vgmpi.scene.gravity import Keys, gravity_at, gravity_keys, mean_gravity
from vgmpi.scene.keyframes import mean_ramp_factor
from vgmpi.scene.scene import Scene
from vgmpi.scene.scene_feature import phases_of_features
from vgmpi.scene.step_estimates import falling_rate, squared_wave_speed

from .feature_plan import FeaturePlan, PlanDraft, plan_features
from .phases_and_groups import (
    GroupPlan,
    PhasePlan,
    groups_of,
    idle_phase,
    phases_of,
    with_corrections,
    with_soft_bodies,
)
from .region_groups import RegionPlan
from .step_costs import Proximity

FLOAT_TYPES: dict[str, np.dtype] = {
    "single": np.dtype(np.float32),
    "double": np.dtype(np.float64),
}
PlannedFeature = TypeVar("PlannedFeature", bound=FeaturePlan)
MAX_STEPS = 2.0**52  # with more steps, a step is lost to rounding when it is added to the time

# Longer intervals cost less. If the shortest waves oscillate within an interval of the transfer
# correction, they regain more than they lost and grow (docs/benchmarks/extremes.md). The first is
# the longest interval [steps], the second the longest travel of a wave in it [cells].
MAX_CORRECTION_INTERVAL, MAX_WAVE_TRAVEL_CELLS = 3, 1.3


class ContactWall(NamedTuple):
    """Wall that acts by contact on bodies with surface descriptors."""

    axis: int
    side: int  # 0: at node 0, 1: at the other end
    node: int  # number of its nodes along the axis
    friction: float  # [-] Coulomb coefficient


class GravityPlan(NamedTuple):
    """Gravity as it is and as it changes."""

    vector: tuple[float, float, float]  # [m/s2]
    ramp_time: float = 0.0  # [s] duration of its growth
    keys: Keys = ()  # (time, gravity) keyframes from the start on

    @property
    def changes(self) -> bool:
        """True if it is not the same all the time."""
        return bool(self.ramp_time or self.keys)

    def mean_between(self, t0: float, t1: float) -> np.ndarray:
        """Return the mean gravity between two times [s], shape (3,) [m/s2]."""
        if self.keys:
            return mean_gravity(self.keys, t0, t1)
        return np.array(self.vector) * mean_ramp_factor(t0, t1, self.ramp_time)

    def vector_at(self, time: float) -> np.ndarray:
        """Return the gravity at a time [s], shape (3,) [m/s2], with a ramp at its full strength."""
        return gravity_at(self.keys, time) if self.keys else np.array(self.vector)


class WallPlan(NamedTuple):
    """Walls of the domain, (kind, friction): west, east, south, north, floor, roof."""

    liquids: tuple[tuple[str, float], ...]
    solids: tuple[tuple[str, float], ...]  # for everything but liquids
    holding: tuple[str, ...] = ()  # slip walls that also hold back the bodies on them


class ContactPlan(NamedTuple):
    """Contact of phases with each other and with colliders."""

    # friction: (phases + 1, phases), the last row is for colliders; each collider has a row if one
    # has a coefficient of its own
    friction: tuple[tuple[float, ...], ...]
    stiffness: tuple[float, ...]  # [Pa] P-wave modulus of each phase's stiffest law at rest
    has_pairs: bool  # there are several phases, which may touch


class TimeStepPlan(NamedTuple):
    """Rules that bound a time step."""

    cfl: float  # [-] CFL number
    fixed: float  # [s] length of all steps, 0 if cfl bounds them
    min_rate: float  # [1/s] lower bound of 1 / dt from constant terms (viscosity, diffusion)
    max_cells: float  # [cells] largest displacement of a particle in a step
    motion_steps: tuple[float, ...] = ()  # least steps in equal intervals, by prescribed motions


class ObjectMeasures(NamedTuple):
    """Measures of the prepared objects and particle sources; empty if unknown."""

    thickness: tuple[float, ...] = ()  # [m] of solid bodies, else NaN; empty without fluids
    proximity: tuple[Proximity, ...] = ()
    volumes: tuple[float, ...] = ()  # [m3]
    weights: tuple[float, ...] = ()  # [Pa] on the bottom of each body of liquid, see liquid_weight
    tensions: tuple[float, ...] = ()  # [Pa] of each body of liquid in a closed box


@dataclass(frozen=True)
class Plan:
    """Everything that the solver needs to know of a scene, in SI units."""

    cells: tuple[int, int, int]
    dx: float  # [m] cell size
    real: np.dtype  # floating-point type of the particles
    gravity: GravityPlan
    walls: WallPlan
    phases: tuple[PhasePlan, ...]
    groups: tuple[GroupPlan, ...]
    group_of: tuple[int, ...]  # group of each object, -1 for scenery; then of each source
    first_id: tuple[int, ...]  # of each object and particle source
    count: tuple[int, ...]  # particles of each object; of each source all that may enter
    contact: ContactPlan
    collider: bool
    times: np.ndarray  # (frames,) [s]
    time_step: TimeStepPlan
    affine: bool = True  # particles carry the velocity gradient (APIC)
    splines: bool = False  # strains and forces use gradients of the B-splines
    correction_interval: int = 0  # [steps] interval of the transfer correction; 0: never
    measures: ObjectMeasures = ObjectMeasures()
    features: tuple[FeaturePlan, ...] = ()  # optional features, in the order in which they plan
    regions: tuple[RegionPlan, ...] = ()  # parts of bodies of another material, if known

    def feature(self, kind: type[PlannedFeature]) -> PlannedFeature | None:
        """Return the plan of an optional feature, or None if the scene does not have it."""
        return next((each for each in self.features if isinstance(each, kind)), None)

    def with_particles(self, count: tuple[int, ...], proximity: tuple[Proximity, ...]) -> "Plan":
        """Return this plan with other particles of the objects and sources, somewhere else."""
        return replace(self, count=count, measures=self.measures._replace(proximity=proximity))

    @property
    def numbers_colliders(self) -> bool:
        """True if the solver must know which collider a node is close to."""
        return any(feature.numbers_colliders for feature in self.features)

    @property
    def phases_of_bodies(self) -> int:
        """Number of phases that are bodies' own; those that features add come last."""
        return len(self.phases) - sum(feature.added_phases for feature in self.features)

    @property
    def changes_mass(self) -> bool:
        """True if particles are inserted or removed during the run."""
        return self.has_sources or any(feature.removes_particles for feature in self.features)

    @property
    def has_separate_pressure(self) -> bool:
        """True if a feature finds the pressure of liquids, which is not that of their volume."""
        return any(group.volume.separate_pressure for group in self.groups)

    @property
    def has_sources(self) -> bool:
        """True if particles are inserted during the run."""
        return any(feature.source_names for feature in self.features)

    @property
    def pair_rules(self) -> np.ndarray | None:
        """Interaction of each two phases, None if all are in contact; see `FeaturePlan`."""
        rules = [each.pair_rules for each in self.features if each.pair_rules is not None]
        if not rules:
            return None
        combined = rules[0]
        for pairs in rules[1:]:
            combined = np.where(combined == CONTACT, pairs, combined)
        return combined

    @property
    def separates_stress(self) -> bool:
        """True if all stress impulses are summed separately from momentum."""
        return any(feature.separates_stress for feature in self.features)

    def retained_share(self, dt: float) -> float:
        """Return the share of unresolved motion that particles retain in a step of dt [s]."""
        return sum(feature.retained_share(dt) for feature in self.features)

    @property
    def planes(self) -> tuple[ContactWall, ...]:
        """Walls that act by contact on bodies with surface descriptors."""
        if not any(phase.meets_walls_by_contact for phase in self.phases):
            return ()
        return tuple(
            ContactWall(k // 2, k % 2, k % 2 * self.cells[k // 2], friction)
            for k, (kind, friction) in enumerate(self.walls.solids)
            if kind == "separate"
        )

    @property
    def has_surface_friction(self) -> bool:
        """True if a body with a surface descriptor has friction against something."""
        frictions = [plane.friction for plane in self.planes]
        for p, phase in enumerate(self.phases):
            if phase.surface:
                frictions += [mu for q, mu in enumerate(self.contact.friction[p]) if q != p]
                frictions += [
                    row[p] for row in self.contact.friction[len(self.phases) :]
                ] * self.collider
        return any(mu > 0 for mu in frictions)

    @property
    def particles(self) -> int:
        """Number of particles of all objects and particle sources."""
        return sum(self.count)

    def remaining_times(self, now: float) -> np.ndarray:
        """Return the times [s] of the frames that a run at time `now` [s] has yet to write."""
        return self.times[self.times > now + 1e-6 * (self.times[1] - self.times[0])]

    def bytes_per_particle(self, group: int) -> int:
        """Return the memory of one particle [bytes]: position, channels, id."""
        return sum(self.fields(group).values())

    def fields(self, group: int) -> dict[str, int]:
        """Return the bytes of each field that one particle of a group stores.

        Values common to an object or a material are not stored per particle: the id gives the
        object.
        """
        width = self.real.itemsize
        own = {channel.name: channel.width * width for channel in self.groups[group].channels}
        return {"x": 3 * width, **own, "id": 8}

    def bytes(self) -> int:
        """Return the memory of all ranks together [bytes], without the interpreters.

        It includes particles, nodes and sorting.
        """
        total = 0
        for k, n in enumerate(self.count):
            if self.group_of[k] >= 0:
                # A quarter is spare, segments are padded to 16, sorting needs three index arrays.
                total += int(n * (1.4 * self.bytes_per_particle(self.group_of[k]) + 24))
        total += sum(feature.reserved_bytes(self) for feature in self.features)
        width, nodes = self.real.itemsize, 64 * 4
        sum_bytes = 8 * (1 if width == 4 else 2) + width  # a reproducible sum, and its value
        touches = self.contact.has_pairs or self.collider or bool(self.planes)
        layers = (
            1
            + touches
            + self.has_surface_friction
            + any(group.separates_stress for group in self.groups)
        )
        layers += sum(feature.summed_fields for feature in self.features)
        more = sum(len(feature.gathered) for feature in self.features)
        # A block holds about 300 particles and reaches node blocks without particles.
        blocks = 4.0 * self.particles / 300.0 + 27 * len(self.phases)
        return total + int(blocks * nodes * (layers * sum_bytes + more * width))


def make_plan(
    scene: Scene, count: list[int], volume: list[float], collider: bool,
    center: list[list[float]] | None = None,
    surface: list[bool] | None = None, prepared: Any = None,
) -> Plan:  # fmt: skip
    """Return the plan of a scene. Raises SceneError if no time step satisfies the scene.

    Args:
        scene: The scene.
        count: Particles of each object and particle source.
        volume: Total volume of each [m3].
        collider: True if there are colliders.
        center: Center of each [m]; without it the names order bodies of equal volume.
        surface: Whether the particles of each know its surface; default: none.
        prepared: Prepared data of features by name, see scene/scene_feature.py.
    """
    bodies = {k: scene.material[t.material] for k, t in enumerate(scene.entities) if t.material}
    real, n = FLOAT_TYPES[scene.accuracy.precision], len(volume)
    center, surface = center or [[0.0] * 3] * n, surface or [False] * n
    phases = phases_of(scene, bodies, volume, center, surface, phases_of_features(scene))
    plain, group_of = groups_of(scene, bodies, phases, real)
    phases, plain = (phases, plain) if bodies else idle_phase(scene, real)
    draft = PlanDraft(scene, phases, plain, group_of, count)
    draft = plan_features(draft, prepared or {}, True)
    interval = correction_interval(scene)
    complete = with_corrections(scene, draft.groups, draft.phases, interval)
    draft = plan_features(draft._replace(groups=complete), prepared or {}, False)
    groups = draft.groups
    phases = with_soft_bodies(scene, draft.phases, groups, volume, center)
    plan = Plan(
        cells=scene.domain.cells, dx=scene.domain.cell, real=real,
        gravity=GravityPlan(
            scene.domain.gravity, scene.domain.gravity_ramp_time, gravity_keys(scene.domain)
        ),
        walls=WallPlan(tuple(scene.domain.walls), tuple(scene.walls_of_solids)),
        phases=phases, groups=groups, group_of=draft.group_of, count=tuple(int(n) for n in count),
        first_id=tuple(int(n) for n in np.concatenate([[0], np.cumsum(count)[:-1]])),
        contact=ContactPlan(
            _friction_table(scene, groups, len(phases)), _wave_moduli(groups, len(phases)),
            len(phases) > 1,
        ),
        collider=collider,
        times=np.linspace(0.0, scene.time.end, scene.time.frames),
        time_step=TimeStepPlan(
            scene.courant_number, scene.time.dt, _rate(scene, groups, draft.features),
            scene.max_cells_per_step,
        ),
        affine=scene.accuracy.affine,
        correction_interval=interval,
        splines=scene.accuracy.gradient == "bspline",
        features=draft.features,
    )  # fmt: skip
    _check_transfer(scene, plan)
    _check_steps(scene, plan)
    return plan


def correction_interval(scene: Scene) -> int:
    """Return the number of steps between two transfer corrections, 0: never."""
    if not (scene.accuracy.corrects_transfers and scene.has_particles):
        return 0
    travel = int(MAX_WAVE_TRAVEL_CELLS / scene.courant_number)
    return max(1, min(MAX_CORRECTION_INTERVAL, travel))


def _friction_table(
    scene: Scene, groups: tuple[GroupPlan, ...], phases: int
) -> tuple[tuple[float, ...], ...]:
    """Return the friction of every pair of phases, and of phases on colliders.

    If several materials meet in one pair of phases, the largest coefficient counts.
    """
    own = [obj.friction for obj in scene.object if obj.collider]
    own = own if any(mu is not None for mu in own) else [None]
    named = {frozenset(c.between): c.friction for c in scene.coupling if isinstance(c, Contact)}
    out = np.zeros((phases + len(own), phases))
    for a in groups:
        material = scene.material[a.material]
        out[phases:, a.phase] = np.maximum(
            out[phases:, a.phase], Contact.default_friction(material, material)
        )
        for b in groups:
            default = Contact.default_friction(material, scene.material[b.material])
            mu = named.get(frozenset((a.material, b.material)), default)
            out[a.phase, b.phase] = max(out[a.phase, b.phase], mu)
    for c, value in enumerate(own):
        if value is not None:
            out[phases + c] = value
    return tuple(tuple(float(v) for v in row) for row in out)


def _rate(scene: Scene, groups: tuple[GroupPlan, ...], features: tuple[FeaturePlan, ...]) -> float:
    """Return the lower bound of 1 / dt [1/s] due to viscosity, features and gravity."""
    viscosity = max(
        0.0 if group.separate_viscosity else scene.material[group.material].kinematic_viscosity
        for group in groups
    )
    rates = (6.0 * viscosity / scene.domain.cell**2, *(each.min_rate for each in features))
    return max(*rates, falling_rate(scene))


def _wave_moduli(groups: tuple[GroupPlan, ...], phases: int) -> tuple[float, ...]:
    """Return the largest density times squared wave speed at rest, by phase [Pa]."""
    out = [0.0] * phases
    for group in groups:
        wave2 = float(law_function(group.law, "wave_speed2")(group.law, group.reference))
        out[group.phase] = max(out[group.phase], group.density * wave2)
    return tuple(out)


def initial_speeds(scene: Scene, plan: Plan) -> list[float]:
    """Return the speed [m/s] with which each object and particle source begins."""
    sources = [speed for feature in plan.features for speed in feature.source_speeds]
    return [obj.speed for obj in scene.object] + sources


def time_step_bounds(scene: Scene, plan: Plan, stiffened: bool = False) -> list[tuple[float, str]]:
    """Return (bound of the time step [s], its cause) at the start, smallest first.

    There is a bound for every body and every diffusing quantity. With `stiffened`, every law is as
    stiff as a run can make it.
    """
    dx, bounds = scene.domain.cell, []
    if rate := falling_rate(scene):
        bounds.append((1.0 / rate, "gravity across a cell"))
    bounds += [bound for feature in plan.features for bound in feature.step_bounds]
    speeds = initial_speeds(scene, plan)
    for k, entity in enumerate(scene.entities):
        if entity.material is None:
            continue
        for name in scene.materials_of(entity):
            material = scene.material[name]
            group = plan.groups[plan.group_of[k]]  # includes the sand whose pores it fills
            wave = math.sqrt(group.bound(squared_wave_speed(material)))
            wave *= math.sqrt(material.stiffening) if stiffened else 1.0
            if wave + speeds[k] > 0:  # waves do not bound the step with an implicit pressure
                kind = "the motion of" if group.volume.separate_pressure else "material"
                bounds.append((plan.time_step.cfl * dx / (wave + speeds[k]), f"{kind} {name!r}"))
            if material.kinematic_viscosity > 0 and not group.separate_viscosity:
                bound = dx**2 / (6.0 * material.kinematic_viscosity)
                bounds.append((bound, f"the viscosity of material {name!r}"))
    return sorted(bounds)


def _check_transfer(scene: Scene, plan: Plan) -> None:
    """Reject gradients of splines where the transfer scheme does not support them."""
    shares_space = plan.pair_rules is not None
    if scene.accuracy.gradient == "bspline" and (scene.accuracy.affine or shares_space):
        message = "bspline is for pic and flip, in scenes without mixing and drag"
        raise scene.error([(("accuracy", "gradient"), message)])


def _check_steps(scene: Scene, plan: Plan) -> None:
    """Check that the laws are finite, a fixed step is stable, and every step advances the time."""
    for group in plan.groups:
        if not np.isfinite(group.law).all():
            message = (
                f"its law has numbers beyond accuracy.precision = {scene.accuracy.precision!r}"
            )
            raise scene.error([(("material", group.material), message)])
    bound, cause = time_step_bounds(scene, plan)[0]
    fixed = plan.time_step.fixed
    if fixed > bound:
        message = f"{fixed:.4g} s is above the stable step of {cause}: at most {bound:.4g} s"
        raise scene.error([(("time", "dt"), message)])
    dt, cause = (fixed, "time.dt") if fixed else (bound, cause)
    if not dt * MAX_STEPS >= plan.times[-1]:
        message = f"{plan.times[-1]:.4g} s are too many steps of {dt:.4g} s, set by {cause}"
        raise scene.error([(("time", "end"), f"{message}; at most {MAX_STEPS:.2g} are possible")])
