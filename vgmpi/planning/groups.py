"""Phases and groups: who shares a velocity field, and what the particles of one material in it
carry, cost and need.
"""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ..couplings.base import DRAG, Rules
from ..materials.base import function, state_channels
from ..scene.objects import Object
from ..scene.scene import Scene
from ..scene.sources import Inflow
from .channels import Channels
from .colour_sets import Exchange

MASTERY = {
    "solid": 0,
    "snow": 1,
    "sand": 2,
    "fluid": 3,
}  # whose surface gives the normal where two phases touch
RESTORING_COST = 0.75  # of a step of no time, relative to a step (`vgmpi.bench.studies couplings`)
HOLDING_COST = 0.1  # of volume that is kept (`vgmpi.bench.studies couplings`)
# of FLIP and AFLIP, relative to the same without (`vgmpi.bench.studies couplings`)
KEEPING_COST = 1.7
COLOUR_COST = 0.6  # of a coefficient of colour that travels, relative to a fluid's step


class GroupPlan(NamedTuple):
    """A group of particles: one phase, one material."""

    name: str  # phase/material
    phase: int
    material: str
    family: str
    law: tuple  # numbers of the law, in the precision of the run
    density: float  # [kg/m3] at rest, pores included
    state: tuple[tuple[str, tuple[float, ...]], ...]  # what the law carries, by name, at rest
    cost: float  # work per particle relative to a fluid's
    share: float = 1.0  # of a particle's rest volume that the material takes up itself
    apart: bool = False  # its stress's impulses are kept apart from momentum
    shares: bool = False  # it is a fluid that shares space with other phases
    pores: float = 1.0  # least share of space at the start, of fluids that flow through sand
    stiff: float = 0.0  # [m2/s2] squared speed of waves that such sand adds
    dense: float = 1.0  # density relative to such sand's grains, at least 1
    slips: float = 1.0  # squared speed of waves where it slips through others, relative to its own
    followed: bool = False  # carries its total deformation gradient, which its law does not know
    surface: bool = False  # its particles know the surface of their body at rest
    coefficients: int = 0  # of its colours, which travel with every step
    driven: bool = False  # its motion is prescribed (driven.py)
    space: float = 0.0  # [1/kg] of what fills a cell, of fluids whose volume is held to it; or 0

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
        return _channels(self.state, self.porous, self.followed, self.surface, self.coefficients)

    def bound(self, wave2):
        """Squared wave speed [m2/s2], that of the law being wave2, in the pores at the start."""
        return wave2 * self.slips * (1.0 + (1.0 / self.pores - 1.0) * self.dense) + self.stiff


@lru_cache(maxsize=64)
def _channels(state: tuple, *has) -> Channels:
    return Channels(dict(state), *has)


class PhasePlan(NamedTuple):
    """A phase: one velocity field on the grid."""

    name: str
    families: tuple[str, ...]  # of its bodies
    objects: tuple[int, ...]  # rows of the scene's things that are ever in it
    mastery: int  # 0 for the phase whose normals count first
    least: float  # [kg] one cell full of its lightest material
    most: float  # [kg] one cell full of its densest
    surface: bool = False  # contact knows the surfaces of its bodies, and not their particles alone
    driven: bool = False  # its velocity is prescribed


def deforms(scene: Scene, thing: Object | Inflow) -> bool:
    """Whether frames have a body's total deformation gradient, for its Gaussians to follow."""
    if thing.material is None:
        return False
    material = scene.material[thing.material]
    asked = material.family == "solid" if thing.deforms is None else thing.deforms
    return asked and ("H" in material.carries or "F" in scene.output.fields)


def surfaced(scene: Scene) -> frozenset[str]:
    """Names of the phases of which contact may know the surfaces: of solids alone, where there is
    something to touch."""
    families: dict[str, set[str]] = {}
    for thing in scene.things:
        if thing.material is not None:
            of = families.setdefault(scene.phase_of(thing) or "", set())
            of.add(scene.material[thing.material].family)
    touches = len(families) > 1
    touches |= any(thing.collider or thing.driven for thing in scene.object)
    touches |= any(kind == "separate" for kind, _ in scene.domain.walls)
    return frozenset(name for name, of in families.items() if touches and of == {"solid"})


def phases_of(
    scene: Scene,
    bodies: dict,
    volume: list[float],
    center: list[list[float]],
    surface: list[bool],
    driven: dict[str, tuple[int, ...]],
) -> tuple[PhasePlan, ...]:
    """The phases of a scene, by name. bodies: material of each object that has one; volume [m3] and
    center [m] of each object; surface: of each, whether its particles know it (prepare/outline.py);
    driven: the bodies of phases of what is driven, by their names.
    """
    members = {name: list(rows) for name, rows in driven.items()}
    for k in bodies:
        members.setdefault(scene.phase_of(scene.things[k]) or "", []).append(k)
    names = sorted(members)

    def mastery(name):
        of = members[name]
        size = math.fsum(volume[k] for k in of)
        # rounded, so that the order of a sum does not tell twins apart
        middle = [
            math.fsum(volume[k] * center[k][a] for k in of) / max(size, 1e-300) for a in range(3)
        ]
        placed = [float(f"{m:.9e}") for m in middle]
        first = min(MASTERY[bodies[k].family] for k in of)
        return first, -float(f"{size:.9e}"), placed, name

    order = sorted(names, key=mastery)
    cell = scene.domain.cell**3
    return tuple(
        PhasePlan(
            name,
            tuple(sorted({bodies[k].family for k in members[name]})),
            tuple(members[name]),
            order.index(name),
            min(bodies[k].bulk_density for k in members[name]) * cell,
            max(bodies[k].bulk_density for k in members[name]) * cell,
            all(surface[k] for k in members[name]),
            name in driven,
        )
        for name in names
    )


def groups_of(
    scene: Scene, bodies: dict, phases: tuple[PhasePlan, ...], real: np.dtype
) -> tuple[tuple[GroupPlan, ...], tuple[int, ...]]:
    """A group for each phase and material that meet in a body, before phases share space; and the
    group of each object, -1 for scenery. bodies: as of phases_of; real: type of its numbers."""
    key = {k: (scene.phase_of(scene.things[k]) or "", scene.things[k].material) for k in bodies}
    wanted = sorted(set(key.values()))
    number = {phase.name: k for k, phase in enumerate(phases)}
    asked = {of for k, of in key.items() if deforms(scene, scene.things[k])}
    groups = (_group(number[p], p, m, scene.material[m], real) for p, m in wanted)
    found = tuple(
        _followed(group, of in asked, phases[group.phase].surface)
        for of, group in zip(wanted, groups, strict=True)
    )
    return found, tuple(wanted.index(key[k]) if k in key else -1 for k in range(len(scene.things)))


def _followed(group: GroupPlan, drawn: bool, surface: bool) -> GroupPlan:
    """The group with what tells how its bodies and their surfaces have deformed."""
    known = "H" in group.carries
    return group._replace(followed=(drawn or surface) and not known, surface=surface)


def _group(phase: int, phase_label: str, name: str, material, real: np.dtype) -> GroupPlan:
    law = material.law()
    rest = tuple(v for values in material.carries.values() for v in values)
    assert len(rest) == state_channels(type(law))
    with np.errstate(over="ignore"):  # plan.py refuses what does not fit
        typed = type(law)(*(real.type(v) for v in law))
    return GroupPlan(
        name=f"{phase_label}/{name}",
        phase=phase,
        material=name,
        family=material.family,
        law=typed,
        density=material.bulk_density,
        state=tuple((name, tuple(values)) for name, values in material.carries.items()),
        cost=material.cost,
        share=material.solid_share,
    )


def completed(
    scene: Scene, group: GroupPlan, sharing: Rules | None, colours: Exchange | None, keeps: object,
    restores: int,
) -> GroupPlan:  # fmt: skip
    """The group with what it needs to share space, for colours that travel, for FLIP, and for
    motion that is restored every few steps."""
    group = _shared(scene, group, sharing)
    if colours is not None:
        group = _coloured(group, int(colours.coefficients[group.phase]))
    if restores:
        group = group._replace(cost=group.cost * (1.0 + RESTORING_COST / restores))
    if keeps is None:
        return group
    return group._replace(apart=True, cost=group.cost * KEEPING_COST)


def _shared(scene: Scene, group: GroupPlan, sharing: Rules | None) -> GroupPlan:
    """The group with what it needs to share space with other phases."""
    if sharing is None or sharing.together[group.phase] < 0 or not sharing.fluid[group.phase]:
        return group
    group = group._replace(apart=True, shares=True)
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


def held(
    scene: Scene, groups: tuple[GroupPlan, ...], phases: tuple[PhasePlan, ...]
) -> tuple[GroupPlan, ...]:
    """The groups with what holds their volume to the space that they take, which are liquids by
    themselves. Raises SceneError where liquids of other densities have the field of one."""
    return tuple(_held(scene, group, phases[group.phase]) for group in groups)


def _held(scene: Scene, group: GroupPlan, phase: PhasePlan) -> GroupPlan:
    if scene.accuracy.volume != "kept" or group.carries[:1] != ("theta",) or group.shares:
        return group
    if phase.least < phase.most:
        said = (
            f"{phase.name!r} holds liquids of different density, whose cells do not tell how full"
            " they are; give each a phase of its own, or a coupling of kind 'mixing'"
        )
        raise scene.error([(("accuracy", "volume"), said)])
    space = 1.0 / (group.density * scene.domain.cell**3)
    return group._replace(space=space, cost=group.cost * (1.0 + HOLDING_COST))


def _coloured(group: GroupPlan, count: int) -> GroupPlan:
    """The group with colours of `count` coefficients that travel with every step."""
    return group._replace(coefficients=count, cost=group.cost + COLOUR_COST * count)
