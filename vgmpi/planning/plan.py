"""The plan: what a scene needs, worked out before any array exists.

Phases, groups and their fields, boundary kinds, contact pairs, time step, bytes, steps. Arrays are
allocated from it, kernels are specialised on it, files are written by it; a field the plan does not
name does not exist.
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ..couplings.base import DRAG, MIXING, Rules
from ..couplings.contact import Contact
from ..materials.base import function, state_channels
from ..scene.loads import mean_share
from ..scene.objects import Object
from ..scene.scene import Scene
from .channels import Channels
from .colour_sets import Exchange, exchange
from .sharing import rules

MASTERY = {
    "solid": 0,
    "snow": 1,
    "sand": 2,
    "fluid": 3,
}  # whose surface gives the normal where two phases touch
COLOUR_COST = 0.6  # of a coefficient of colour that travels, relative to a fluid's step
REALS: dict[str, np.dtype] = {
    "single": np.dtype(np.float32),
    "double": np.dtype(np.float64),
}


class GroupPlan(NamedTuple):
    """A group of particles: one phase, one material."""

    name: str  # phase/material
    phase: int
    material: str
    law: tuple  # numbers of the law, in the precision of the run
    density: float  # [kg/m3] at rest, pores included
    state: tuple[tuple[str, tuple[float, ...]], ...]  # what the law carries, by name, at rest
    cost: float  # work per particle relative to a fluid's
    share: float = 1.0  # of a particle's rest volume that the material takes up itself
    apart: bool = False  # its stress's impulses are kept apart from momentum
    pores: float = 1.0  # least share of space at the start, of fluids that flow through sand
    stiff: float = 0.0  # [m2/s2] squared speed of waves that such sand adds
    dense: float = 1.0  # density relative to such sand's grains, at least 1
    followed: bool = False  # carries its total deformation gradient, which its law does not know
    coefficients: int = 0  # of its colours, which travel with every step

    @property
    def porous(self) -> bool:
        """Whether its particles carry their share of space."""
        return self.pores < 1.0

    @property
    def rest(self) -> tuple:
        """The law's state at rest, one number per channel."""
        return tuple(value for _, values in self.state for value in values)

    @property
    def carries(self) -> tuple[str, ...]:
        """Names of what the law's state holds."""
        return tuple(name for name, _ in self.state)

    @property
    def channels(self) -> Channels:
        """What its particles carry."""
        return _channels(self.state, self.porous, self.followed, self.coefficients)

    def bound(self, wave2):
        """Squared wave speed [m2/s2], that of the law being wave2, in the pores at the start."""
        return wave2 * (1.0 + (1.0 / self.pores - 1.0) * self.dense) + self.stiff


@lru_cache(maxsize=64)
def _channels(state: tuple, porous: bool, followed: bool, coefficients: int) -> Channels:
    return Channels(dict(state), porous, followed, coefficients)


class PhasePlan(NamedTuple):
    """A phase: one velocity field on the grid."""

    name: str
    family: str
    objects: tuple[int, ...]  # rows of the scene's objects
    mastery: int  # 0 for the phase whose normals count first
    least: float  # [kg] one cell full of its lightest material
    most: float  # [kg] one cell full of its densest


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
    group_of: tuple[int, ...]  # group of each object, -1 for scenery
    first_id: tuple[int, ...]  # of each object
    count: tuple[int, ...]  # particles of each object
    friction: tuple[tuple[float, ...], ...]  # (phases + 1, phases), the last row for colliders
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
    flip: float = 0.0  # share of FLIP's velocity, see scene.accuracy
    gravity_ramp: float = 0.0  # [s] in which gravity grows

    @property
    def drifts(self) -> bool:
        """Whether fluids drift into each other by diffusion, and keep that out of their momentum;
        as the paper prints it they do not."""
        return self.rules is not None and bool(self.rules.drifting_apart.any())

    @property
    def particles(self) -> int:
        return sum(self.count)

    def gravity_share(self, t0: float, t1: float) -> float:
        """Mean of gravity between two times [s], as a share of its full strength."""
        return mean_share(t0, t1, self.gravity_ramp)

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
        width, nodes = self.real.itemsize, 64 * 4
        one = 8 * (1 if width == 4 else 2) + width  # a number's sum, and the number
        layers = 1 + (self.contact or self.collider) + any(group.apart for group in self.groups)
        layers += max(group.coefficients for group in self.groups)
        more = 0 if self.rules is None and not self.flip else 1 + self.drifts
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
) -> Plan:
    """The plan of a scene whose objects have `count` particles of `volume` [m3] in total each, with
    their `center` [m], without which bodies of one volume are told apart by their names alone, and
    with the `shades` of their colours (colour_sets.shades).

    Raises SceneError where a fixed time step is above the bound.
    """
    made_of = {k: thing.material for k, thing in enumerate(scene.object) if thing.material}
    bodies = list(made_of)  # scenery has no material
    material_of = {k: scene.material[name] for k, name in made_of.items()}
    center = center or [[0.0] * 3] * len(volume)
    phases = _phases(scene, bodies, material_of, volume, center)
    key = {k: (scene.phase_of(scene.object[k]) or "", made_of[k]) for k in bodies}
    wanted = sorted(set(key.values()))
    groups = _groups(scene, phases, key, wanted)
    sharing = rules(scene, groups, phases)
    groups = tuple(_shared(scene, group, sharing) for group in groups)
    colours = exchange(scene, phases, shades)
    if colours is not None:
        groups = tuple(_coloured(group, int(colours.coefficients[group.phase])) for group in groups)
    flip = scene.accuracy.flip if scene.accuracy.transfer == "flip" else 0.0
    _check_transfer(scene, flip, sharing)
    if flip:
        groups = tuple(group._replace(apart=True) for group in groups)
    plan = Plan(
        cells=scene.domain.cells,
        dx=scene.domain.cell,
        real=REALS[scene.accuracy.precision],
        gravity=scene.domain.gravity,
        walls=tuple(scene.domain.walls),
        phases=phases,
        groups=groups,
        group_of=tuple(wanted.index(key[k]) if k in key else -1 for k in range(len(count))),
        first_id=tuple(int(n) for n in np.concatenate([[0], np.cumsum(count)[:-1]])),
        count=tuple(int(n) for n in count),
        friction=_friction(scene, groups, len(phases)),
        contact=len(phases) > 1,
        collider=collider,
        times=np.linspace(0.0, scene.time.end, scene.time.frames),
        cfl=scene.time.cfl,
        fixed_dt=scene.time.dt,
        rate=_rate(material_of.values(), sharing, scene.domain.cell),
        rules=sharing,
        colours=colours,
        affine=scene.accuracy.transfer == "apic",
        splines=scene.accuracy.gradient == "splines",
        flip=flip,
        gravity_ramp=scene.domain.gravity_ramp,
    )
    _check_fixed_dt(scene, plan)
    return plan


def _rate(materials, sharing: Rules | None, dx: float) -> float:
    """Lower bound of 1 / dt [1/s] by viscosity and diffusion."""
    spread = sharing.diffusion.max(initial=0.0) if sharing else 0.0
    return max(6.0 * max(m.kinematic_viscosity for m in materials), 6.0 * spread) / dx**2


def deforms(scene: Scene, thing: Object) -> bool:
    """Whether frames have a body's total deformation gradient, for its Gaussians to follow."""
    if thing.material is None:
        return False
    material = scene.material[thing.material]
    asked = material.family == "solid" if thing.deforms is None else thing.deforms
    return asked and ("H" in material.carries or "F" in scene.output.fields)


def _phases(scene, bodies, material_of, volume, center) -> tuple[PhasePlan, ...]:
    members: dict[str, list[int]] = {}
    for k in bodies:
        members.setdefault(scene.phase_of(scene.object[k]), []).append(k)
    names = sorted(members)

    def mastery(name):
        of = members[name]
        size = math.fsum(volume[k] for k in of)
        # rounded, so that the order of a sum does not tell twins apart
        middle = [
            math.fsum(volume[k] * center[k][a] for k in of) / max(size, 1e-300) for a in range(3)
        ]
        placed = [float(f"{m:.9e}") for m in middle]
        return MASTERY[material_of[of[0]].family], -float(f"{size:.9e}"), placed, name

    order = sorted(names, key=mastery)
    cell = scene.domain.cell**3
    return tuple(
        PhasePlan(
            name,
            material_of[members[name][0]].family,
            tuple(members[name]),
            order.index(name),
            min(material_of[k].bulk_density for k in members[name]) * cell,
            max(material_of[k].bulk_density for k in members[name]) * cell,
        )
        for name in names
    )


def _groups(scene: Scene, phases, key: dict, wanted: list) -> tuple[GroupPlan, ...]:
    """A group for each (phase, material) in `wanted`, before phases share space. key: those of each
    body."""
    real = REALS[scene.accuracy.precision]
    number = {phase.name: k for k, phase in enumerate(phases)}
    asked = {of for k, of in key.items() if deforms(scene, scene.object[k])}
    groups = (_group(number[p], p, m, scene.material[m], real) for p, m in wanted)
    return tuple(
        group._replace(followed=of in asked and "H" not in group.carries)
        for of, group in zip(wanted, groups, strict=True)
    )


def _group(phase: int, phase_label: str, name: str, material, real: np.dtype) -> GroupPlan:
    law = material.law()
    rest = tuple(v for values in material.carries.values() for v in values)
    assert len(rest) == state_channels(type(law))
    typed = type(law)(*(real.type(v) for v in law))
    return GroupPlan(
        name=f"{phase_label}/{name}",
        phase=phase,
        material=name,
        law=typed,
        density=material.bulk_density,
        state=tuple((name, tuple(values)) for name, values in material.carries.items()),
        cost=material.cost,
        share=material.solid_share,
    )


def _shared(scene: Scene, group: GroupPlan, sharing: Rules | None) -> GroupPlan:
    """The group with what it needs to share space with other phases."""
    if sharing is None or sharing.together[group.phase] < 0 or not sharing.fluid[group.phase]:
        return group
    group = group._replace(apart=True)
    for coupling in scene.coupling:
        if coupling.rule == DRAG and group.material in coupling.between:
            sand = scene.material[next(m for m in coupling.between if m != group.material)]
            rest = tuple(v for values in sand.carries.values() for v in values)
            law = sand.law()
            water = scene.material[group.material].model_copy(update={"tension": "off"}).law()
            real = type(group.law[0])
            group = group._replace(
                law=type(water)(*(real(v) for v in water)),  # water in pores bears no tension
                pores=min(group.pores, sand.porosity),
                stiff=max(group.stiff, float(function(law, "wave_speed2")(law, rest))),
                dense=max(group.dense, group.density / sand.density),
            )
    return group


def _coloured(group: GroupPlan, count: int) -> GroupPlan:
    """The group with colours of `count` coefficients that travel with every step."""
    return group._replace(coefficients=count, cost=group.cost + COLOUR_COST * count)


def _friction(scene: Scene, groups, phases: int) -> tuple[tuple[float, ...], ...]:
    """Friction of every pair of phases; of two materials that meet in one pair of phases the
    largest counts.
    """
    named = {frozenset(c.between): c.friction for c in scene.coupling if isinstance(c, Contact)}
    out = np.zeros((phases + 1, phases))
    for a in groups:
        one = scene.material[a.material]
        out[phases, a.phase] = max(out[phases, a.phase], Contact.default_friction(one, one))
        for b in groups:
            default = Contact.default_friction(one, scene.material[b.material])
            mu = named.get(frozenset((a.material, b.material)), default)
            out[a.phase, b.phase] = max(out[a.phase, b.phase], mu)
    return tuple(tuple(float(v) for v in row) for row in out)


def fastest(scene: Scene, plan: Plan) -> list[tuple[float, str]]:
    """(bound on the time step [s], what sets it) at the start, smallest first: of every body, and
    of what diffuses.
    """
    dx, found = scene.domain.cell, []
    for coupling in scene.coupling:
        if coupling.rule == MIXING and coupling.diffusion > 0:
            one, other = coupling.between
            bound = dx**2 / (6.0 * coupling.diffusion)
            found.append((bound, f"the diffusion of materials {one!r} and {other!r}"))
    for k, thing in enumerate(scene.object):
        if thing.material is None:
            continue
        material = scene.material[thing.material]
        law = material.law()
        rest = tuple(v for values in material.carries.values() for v in values)
        group = plan.groups[plan.group_of[k]]  # knows of the sand whose pores it fills
        wave = math.sqrt(group.bound(function(law, "wave_speed2")(law, rest)))
        found.append((scene.time.cfl * dx / (wave + thing.speed), f"material {thing.material!r}"))
        if material.kinematic_viscosity > 0:
            bound = dx**2 / (6.0 * material.kinematic_viscosity)
            found.append((bound, f"the viscosity of material {thing.material!r}"))
    return sorted(found)


def _check_transfer(scene: Scene, flip: float, sharing: Rules | None) -> None:
    apic, splines = scene.accuracy.transfer == "apic", scene.accuracy.gradient == "splines"
    if splines and (apic or sharing is not None):
        said = "splines are for pic and flip, in scenes without mixing and drag"
        raise scene.error([(("accuracy", "gradient"), said)])
    if flip and sharing is not None:
        said = "flip is not for scenes with mixing or drag: choose apic or pic"
        raise scene.error([(("accuracy", "transfer"), said)])


def _check_fixed_dt(scene: Scene, plan: Plan) -> None:
    bound, what = fastest(scene, plan)[0]
    if plan.fixed_dt > bound:
        said = f"{plan.fixed_dt:.4g} s is above the stable step of {what}: at most {bound:.4g} s"
        raise scene.error([(("time", "dt"), said)])
