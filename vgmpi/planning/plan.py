"""The plan: what a scene needs, worked out before any array exists.

Boundary kinds, contact pairs, time step, bytes, steps; groups.py has the phases and groups with
their fields. Arrays are allocated from it, kernels are specialised on it, files are written by it;
a field the plan does not name does not exist.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..couplings.base import MIXING, Rules
from ..couplings.contact import Contact
from ..materials.base import function
from ..scene.gravity import Keys, at, mean
from ..scene.loads import mean_share
from ..scene.scene import Scene
from ..scene.settings import Accuracy
from .colour_sets import Exchange, exchange
from .driven import DrivenPlan, Extents, driven_phases, driven_plans
from .groups import GroupPlan, PhasePlan, completed, groups_of, held, phases_of
from .inflow import SinkPlan, SourcePlan, sink_plans, source_plans
from .sharing import rules, slipping
from .surroundings import Surroundings

REALS: dict[str, np.dtype] = {
    "single": np.dtype(np.float32),
    "double": np.dtype(np.float64),
}
# motion is restored after some steps: seldom costs less; where the shortest waves swing to and fro
# in that time they get back more than they lost, and grow (docs/extremes.md)
SELDOM, SWING = 3, 1.3  # most steps; most cells that a wave goes
MOST_STEPS = 2.0**52  # beyond these a step is lost beside the time it is added to


class Keeps(NamedTuple):
    """How much particles keep of the motion that the grid does not see (FLIP)."""

    share: float  # in each step
    damping: float  # [s] in which they lose all but 1 / e of it

    def over(self, dt: float) -> float:
        """The share they keep in a step of dt [s]."""
        return self.share * math.exp(-dt / self.damping)


class Plane(NamedTuple):
    """A wall that pushes known surfaces by contact."""

    axis: int
    side: int  # 0 at the node 0, 1 at the other end
    node: int
    friction: float


@dataclass(frozen=True)
class Plan:
    """Everything the solver is told. SI units."""

    cells: tuple[int, int, int]
    dx: float
    real: np.dtype
    gravity: tuple[float, float, float]
    walls: tuple[tuple[str, float], ...]  # west, east, south, north, floor, roof
    phases: tuple[PhasePlan, ...]
    groups: tuple[GroupPlan, ...]
    group_of: tuple[int, ...]  # group of each object, -1 for scenery; then of each source
    first_id: tuple[int, ...]  # of each object and source
    count: tuple[int, ...]  # particles of each object; of each source all that may come
    # (phases + 1, phases), the last row for colliders; or a row for each, where one has its own
    friction: tuple[tuple[float, ...], ...]
    stiff: tuple[float, ...]  # [Pa] to waves, of every phase's stiffest law at rest
    contact: bool  # two phases or more: they may touch
    collider: bool
    times: np.ndarray  # (frames,) [s]
    cfl: float
    fixed_dt: float  # [s], 0 if chosen by cfl
    rate: float  # lower bound of 1 / dt [1/s] from what does not change (viscosity, diffusion)
    rules: Rules | None = None  # how phases share space
    colours: Exchange | None = None  # those that travel with every step
    affine: bool = True  # particles carry the velocity's gradient (APIC)
    splines: bool = False  # strains and forces by gradients of the B-splines
    keeps: Keeps | None = None  # FLIP and AFLIP
    restores: int = 0  # steps after which motion gets back what transfers took; 0: never
    gravity_ramp: float = 0.0  # [s] in which gravity grows
    gravity_keys: Keys = ()  # where it changes, from the start on
    # [m], of every solid body, for other objects nan; none where no fluid is, or it is not known
    thickness: tuple[float, ...] = ()
    surroundings: tuple[Surroundings, ...] = ()  # of each object and source, where they are known
    sources: tuple[SourcePlan, ...] = ()
    sinks: tuple[SinkPlan, ...] = ()
    driven: tuple[DrivenPlan, ...] = ()
    opens: tuple[float | None, ...] = (None,) * 6  # [s] when each wall vanishes
    feels: bool = False  # what each collider and wall gives is summed

    @property
    def flows(self) -> bool:
        """Whether particles come and go."""
        return bool(self.sources or self.sinks)

    @property
    def starts_with(self) -> int:
        """Particles of all objects: they have the first ids."""
        return self.sources[0].first if self.sources else self.particles

    @property
    def drifts(self) -> bool:
        """Whether fluids drift into each other by diffusion, and keep that out of their momentum;
        as the paper prints it they do not."""
        return self.rules is not None and bool(self.rules.drifting_apart.any())

    @property
    def planes(self) -> tuple[Plane, ...]:
        """The walls that push known surfaces by contact."""
        if not any(phase.surface for phase in self.phases):
            return ()
        return tuple(
            Plane(k // 2, k % 2, k % 2 * self.cells[k // 2], friction)
            for k, (kind, friction) in enumerate(self.walls)
            if kind == "separate"
        )

    @property
    def rubs(self) -> bool:
        """Whether a body whose surface is known rubs against something."""
        found = [plane.friction for plane in self.planes]
        for p, phase in enumerate(self.phases):
            if phase.surface:
                found += [mu for q, mu in enumerate(self.friction[p]) if q != p]
                found += [row[p] for row in self.friction[len(self.phases) :]] * self.collider
        return any(mu > 0 for mu in found)

    @property
    def particles(self) -> int:
        return sum(self.count)

    def ahead(self, now: float) -> np.ndarray:
        """Times [s] of the frames that a run which is at `now` [s] has yet to write."""
        return self.times[self.times > now + 1e-6 * (self.times[1] - self.times[0])]

    def gravity_between(self, t0: float, t1: float) -> np.ndarray:
        """Mean gravity (3,) [m/s2] between two times [s]."""
        if self.gravity_keys:
            return mean(self.gravity_keys, t0, t1)
        return np.array(self.gravity) * mean_share(t0, t1, self.gravity_ramp)

    def gravity_at(self, time: float) -> np.ndarray:
        """Gravity (3,) [m/s2] at a time [s], a ramp's at its full strength."""
        return at(self.gravity_keys, time) if self.gravity_keys else np.array(self.gravity)

    def bytes_per_particle(self, group: int) -> int:
        """Memory of one particle: position, channels, id."""
        return sum(self.fields(group).values())

    def fields(self, group: int) -> dict[str, int]:
        """Bytes of everything that one particle of a group has of its own. What holds for an object
        or a material is in no particle: its id says which object it belongs to."""
        width = self.real.itemsize
        own = {channel.name: channel.width * width for channel in self.groups[group].channels}
        return {"x": 3 * width, **own, "id": 8}

    def bytes(self) -> int:
        """Memory of all ranks together, without the interpreters: particles, nodes, sorting."""
        total = 0
        for k, n in enumerate(self.count):
            if self.group_of[k] >= 0:
                # growth of a quarter, 16-padding, three index arrays while sorting
                total += int(n * (1.4 * self.bytes_per_particle(self.group_of[k]) + 24))
        for kept in self.driven:  # there is room for them in two groups
            n = sum(self.count[k] for k in kept.things)
            total += int(n * 1.4 * self.bytes_per_particle(kept.joins))
        width, nodes = self.real.itemsize, 64 * 4
        one = 8 * (1 if width == 4 else 2) + width  # a number's sum, and the number
        touches = self.contact or self.collider or bool(self.planes)
        layers = 1 + touches + self.rubs + any(group.apart for group in self.groups)
        layers += max(group.coefficients for group in self.groups)
        more = (self.rules is not None) + (self.keeps is not None) + self.drifts
        # a block holds some 300 particles, and reaches node blocks that hold none
        blocks = 4.0 * self.particles / 300.0 + 27 * len(self.phases)
        return total + int(blocks * nodes * (layers * one + more * width))


def make_plan(
    scene: Scene,
    count: list[int],
    volume: list[float],
    collider: bool,
    center: list[list[float]] | None = None,
    shades: np.ndarray | None = None,
    surface: list[bool] | None = None,
    extents: Extents | None = None,
) -> Plan:
    """The plan of a scene whose objects have `count` particles of `volume` [m3] in total each, with
    their `center` [m], without which bodies of one volume are told apart by their names alone;
    shades: see colour_sets.shades; surface: of each, whether its particles know it, of none by
    default; extents: see driven.driven_plans. Raises SceneError where no step is as it must be."""
    bodies = {k: scene.material[t.material] for k, t in enumerate(scene.things) if t.material}
    real, n = REALS[scene.accuracy.precision], len(volume)
    center, surface = center or [[0.0] * 3] * n, surface or [False] * n
    phases = phases_of(scene, bodies, volume, center, surface, driven_phases(scene))
    plain, group_of = groups_of(scene, bodies, phases, real)
    sharing, colours = rules(scene, plain, phases), exchange(scene, phases, shades)
    _check_transfer(scene, sharing)
    keeps, restores = _keeps(scene.accuracy), _restores(scene)
    whole = tuple(completed(scene, group, sharing, colours, keeps, restores) for group in plain)
    whole = held(scene, slipping(whole, sharing, scene.time.cfl * scene.domain.cell), phases)
    driven, groups, group_of = driven_plans(scene, whole, group_of, phases, extents or {})
    plan = Plan(
        cells=scene.domain.cells,
        dx=scene.domain.cell,
        real=real,
        gravity=scene.domain.gravity,
        walls=tuple(scene.domain.walls),
        phases=phases,
        groups=groups,
        group_of=group_of,
        first_id=tuple(int(n) for n in np.concatenate([[0], np.cumsum(count)[:-1]])),
        count=tuple(int(n) for n in count),
        friction=_friction(scene, groups, len(phases)),
        stiff=_stiff(groups, len(phases)),
        contact=len(phases) > 1,
        collider=collider,
        times=np.linspace(0.0, scene.time.end, scene.time.frames),
        cfl=scene.time.cfl,
        fixed_dt=scene.time.dt,
        rate=_rate(bodies.values(), sharing, scene.domain.cell),
        rules=sharing,
        colours=colours,
        affine=scene.accuracy.affine,
        splines=scene.accuracy.gradient == "splines",
        keeps=keeps,
        restores=restores,
        gravity_ramp=scene.domain.gravity_ramp,
        gravity_keys=_gravity_keys(scene),
        sources=source_plans(scene, group_of, count),
        sinks=sink_plans(scene),
        driven=driven,
        opens=tuple(scene.domain.opens),
        feels=any(probe.feels for probe in scene.probe),
    )
    _check_steps(scene, plan)
    return plan


def _gravity_keys(scene: Scene) -> Keys:
    keys = scene.domain.gravity_keyframes
    return ((0.0, scene.domain.gravity), *((k.time, k.gravity) for k in keys)) if keys else ()


def _rate(materials, sharing: Rules | None, dx: float) -> float:
    """Lower bound of 1 / dt [1/s] by viscosity and diffusion."""
    spread = sharing.diffusion.max(initial=0.0) if sharing else 0.0
    return max(6.0 * max(m.kinematic_viscosity for m in materials), 6.0 * spread) / dx**2


def _friction(scene: Scene, groups, phases: int) -> tuple[tuple[float, ...], ...]:
    """Friction of every pair of phases, and of phases on colliders; of two materials that meet in
    one pair of phases the largest counts.
    """
    own = [thing.friction for thing in scene.object if thing.collider]
    own = own if any(mu is not None for mu in own) else [None]
    named = {frozenset(c.between): c.friction for c in scene.coupling if isinstance(c, Contact)}
    out = np.zeros((phases + len(own), phases))
    for a in groups:
        one = scene.material[a.material]
        out[phases:, a.phase] = np.maximum(
            out[phases:, a.phase], Contact.default_friction(one, one)
        )
        for b in groups:
            default = Contact.default_friction(one, scene.material[b.material])
            mu = named.get(frozenset((a.material, b.material)), default)
            out[a.phase, b.phase] = max(out[a.phase, b.phase], mu)
    for c, given in enumerate(own):
        if given is not None:
            out[phases + c] = given
    return tuple(tuple(float(v) for v in row) for row in out)


def _stiff(groups: tuple[GroupPlan, ...], phases: int) -> tuple[float, ...]:
    """Density times the squared speed of waves at rest [Pa], of each phase the largest."""
    out = [0.0] * phases
    for group in groups:
        wave2 = float(function(group.law, "wave_speed2")(group.law, group.rest))
        out[group.phase] = max(out[group.phase], group.density * wave2)
    return tuple(out)


def fastest(scene: Scene, plan: Plan, stiffened: bool = False) -> list[tuple[float, str]]:
    """(bound on the time step [s], what sets it) at the start, smallest first: of every body, and
    of what diffuses. stiffened: with every law as stiff as a run can make it.
    """
    dx, found = scene.domain.cell, []
    used = {group.material for group in plan.groups}
    for coupling in scene.coupling:
        if coupling.rule == MIXING and coupling.diffusion > 0 and used.issuperset(coupling.between):
            one, other = coupling.between
            bound = dx**2 / (6.0 * coupling.diffusion)
            found.append((bound, f"the diffusion of materials {one!r} and {other!r}"))
    speeds = [thing.speed for thing in scene.object] + [source.speed for source in plan.sources]
    for k, thing in enumerate(scene.things):
        if thing.material is None:
            continue
        material = scene.material[thing.material]
        law = material.law()
        rest = tuple(v for values in material.carries.values() for v in values)
        group = plan.groups[plan.group_of[k]]  # knows of the sand whose pores it fills
        wave = math.sqrt(group.bound(function(law, "wave_speed2")(law, rest)))
        wave *= math.sqrt(material.stiffening) if stiffened else 1.0
        found.append((scene.time.cfl * dx / (wave + speeds[k]), f"material {thing.material!r}"))
        if material.kinematic_viscosity > 0:
            bound = dx**2 / (6.0 * material.kinematic_viscosity)
            found.append((bound, f"the viscosity of material {thing.material!r}"))
    return sorted(found)


def _keeps(accuracy: Accuracy) -> Keeps | None:
    """What the scene asks particles to keep."""
    if not accuracy.keeps:
        return None
    if accuracy.flip is not None:
        return Keeps(accuracy.flip, math.inf)
    return Keeps(1.0, accuracy.damping)


def _restores(scene: Scene) -> int:
    """After how many steps motion is restored, or 0."""
    return max(1, min(SELDOM, int(SWING / scene.time.cfl))) if scene.accuracy.restores else 0


def _check_transfer(scene: Scene, sharing: Rules | None) -> None:
    if scene.accuracy.gradient == "splines" and (scene.accuracy.affine or sharing is not None):
        said = "splines are for pic and flip, in scenes without mixing and drag"
        raise scene.error([(("accuracy", "gradient"), said)])


def _check_steps(scene: Scene, plan: Plan) -> None:
    """Whether the laws are numbers, a fixed step is stable, and every step moves the time on."""
    for group in plan.groups:
        if not np.isfinite(group.law).all():
            said = f"its law has numbers beyond accuracy.precision = {scene.accuracy.precision!r}"
            raise scene.error([(("material", group.material), said)])
    bound, what = fastest(scene, plan)[0]
    if plan.fixed_dt > bound:
        said = f"{plan.fixed_dt:.4g} s is above the stable step of {what}: at most {bound:.4g} s"
        raise scene.error([(("time", "dt"), said)])
    dt, what = (plan.fixed_dt, "time.dt") if plan.fixed_dt else (bound, what)
    if not dt * MOST_STEPS >= plan.times[-1]:
        said = f"{plan.times[-1]:.4g} s are too many steps of {dt:.4g} s, set by {what}"
        raise scene.error([(("time", "end"), f"{said}; at most {MOST_STEPS:.2g} are possible")])
