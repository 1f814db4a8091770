"""Phases and groups: bodies that share a velocity field, and their particles by material.

A phase is one velocity field on the grid. A group holds the particles of one material in one phase;
its plan lists what they carry, cost and need.
"""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from vgmpi.materials.couplings.interaction import DRAG, MIXING
from vgmpi.materials.material import law_function, state_channels
from vgmpi.scene.objects import Object
from vgmpi.scene.scene import Scene
from vgmpi.scene.scene_feature import ParticleSource, phases_of_features

from .particle_channels import Channels
from .step_costs import COSTS

CONTACT_PRIORITY = {
    "solid": 0,
    "snow": 1,
    "sand": 2,
    "fluid": 3,
}  # Of two phases in contact, the one with the smaller number provides the surface normal.


class WaveTerms(NamedTuple):
    """Squared wave speed that bounds the steps of a group, from that of its law."""

    factor: float = 1.0  # [-] relative to its law's
    min_porosity: float = 1.0  # [-] smallest initial porosity, for fluids that flow through sand
    density_ratio: float = 1.0  # [-] density relative to such sand's grains, at least 1
    added: float = 0.0  # [m2/s2] squared wave speed that such sand adds
    on_grid: bool = False  # the grid slows its waves: a feature bounds the step by them


class VolumeTerms(NamedTuple):
    """Terms of the volume and the pressure of a group of liquid particles."""

    inverse_cell_mass: float = 0.0  # [1/kg] of a full cell with density correction, else 0
    by_cells: bool = False  # its volume follows the mean divergence of cells
    separate_pressure: bool = False  # its pressure is not that of its volume: a feature applies it
    softens_spray: bool = False  # its volume follows a part of the divergence where it fills little


class GroupPlan(NamedTuple):
    """Plan of a group of particles: one phase, one material."""

    name: str  # phase/material
    phase: int
    material: str
    family: str
    law: tuple  # parameters of the law, in the precision of the run
    density: float  # [kg/m3] reference density, pores included
    state: tuple[tuple[str, tuple[float, ...]], ...]  # state variables, reference values
    cost: float  # [-] work per particle relative to a fluid's
    share: float = 1.0  # [-] fraction of a particle's rest volume that the material itself fills
    separates_stress: bool = False  # stress impulses are summed separately from momentum
    shares_space: bool = False  # it is a fluid in a mixture or in pores
    wave: WaveTerms = WaveTerms()  # what bounds its steps
    tracks_deformation: bool = False  # stores its total deformation gradient, which its law lacks
    surface: bool = False  # its particles carry the surface descriptor of the body at rest
    extra_channels: tuple[tuple[str, str, int], ...] = ()  # name, unit and width, of features
    driven: bool = False  # a feature prescribes the velocity of its phase
    volume: VolumeTerms = VolumeTerms()  # how a liquid's volume follows the flow
    separate_viscosity: bool = False  # its law has no viscosity: a feature applies it
    carrier: str = ""  # feature that moves its particles outside the grid, see `ActiveFeature`

    @property
    def is_carried(self) -> bool:
        """True if its particles follow a given motion instead of the grid's."""
        return self.driven or bool(self.carrier)

    @property
    def is_liquid(self) -> bool:
        """True if its particles carry ln J as liquids do."""
        return self.carries[:1] == ("theta",)

    @property
    def stores_porosity(self) -> bool:
        """True if its particles carry their volume fraction."""
        return self.wave.min_porosity < 1.0

    @property
    def reference(self) -> tuple:
        """State of the law in the reference configuration, one number per channel."""
        return tuple(value for _, values in self.state for value in values)

    @property
    def carries(self) -> tuple[str, ...]:
        """Names of the law's state variables."""
        return tuple(name for name, _ in self.state)

    @property
    def has_deformation(self) -> bool:
        """Return whether its particles have a deformation gradient that frames can store."""
        return "H" in self.carries or self.tracks_deformation

    @property
    def channels(self) -> Channels:
        """Channels of its particles."""
        return _channels(
            self.state,
            self.stores_porosity,
            self.tracks_deformation,
            self.surface,
            self.extra_channels,
        )

    def bound(self, wave2):
        """Return the squared wave speed in the initial pores [m2/s2], given the law's `wave2`."""
        terms = self.wave
        in_pores = 1.0 + (1.0 / terms.min_porosity - 1.0) * terms.density_ratio
        return 0.0 if terms.on_grid else wave2 * terms.factor * in_pores + terms.added


@lru_cache(maxsize=64)
def _channels(state: tuple, *has) -> Channels:
    """Return the channels of a group; cached, since many groups have the same."""
    return Channels(dict(state), *has)


class PhasePlan(NamedTuple):
    """Plan of a phase: one velocity field on the grid."""

    name: str
    families: tuple[str, ...]  # of its bodies
    objects: tuple[int, ...]  # rows of the objects and particle sources that are ever in it
    contact_priority: int  # contact priority; the normals of phase 0 come first
    min_cell_mass: float  # [kg] mass of a cell full of its lightest material
    max_cell_mass: float  # [kg] mass of a cell full of its densest material
    surface: bool = False  # contact uses surface descriptors of its bodies, not particles alone
    driven: bool = False  # its velocity is prescribed
    # contact with walls would not hold it: its weight or speed is too much, or it is a capture
    is_soft: bool = False
    shares_space: bool = False  # it lies in the same space as another phase

    @property
    def is_liquid(self) -> bool:
        """True if it holds a liquid, or lies in one; walls without a kind hold it."""
        return self.shares_space or "fluid" in self.families

    @property
    def meets_walls_by_contact(self) -> bool:
        """True if separate walls push its surfaces by contact, as colliders do."""
        return self.surface and not self.is_soft


def stores_deformation(scene: Scene, entity: Object | ParticleSource) -> bool:
    """Return whether frames store the total deformation gradient of a body for its Gaussians."""
    if entity.material is None:
        return False
    material = scene.material[entity.material]
    is_requested = (
        material.family == "solid" if entity.track_deformation is None else entity.track_deformation
    )
    return is_requested and ("H" in material.carries or "F" in scene.output.fields)


def phases_with_surface(scene: Scene) -> frozenset[str]:
    """Return the names of the phases for which contact may use surface descriptors.

    These are phases of solids alone, in scenes with something to touch.
    """
    families: dict[str, set[str]] = {}
    for entity in scene.entities:
        if entity.material is not None:
            kinds = families.setdefault(scene.phase_of(entity) or "", set())
            kinds.add(scene.material[entity.material].family)
    touches = len(families) > 1
    touches |= any(obj.collider for obj in scene.object) or bool(phases_of_features(scene))
    touches |= any(kind == "separate" for kind, _ in scene.domain.walls)
    return frozenset(name for name, kinds in families.items() if touches and kinds == {"solid"})


def phases_of(
    scene: Scene, bodies: dict, volume: list[float], center: list[list[float]],
    surface: list[bool], driven: dict[str, tuple[int, ...]],
) -> tuple[PhasePlan, ...]:  # fmt: skip
    """Return the phases of a scene, in the order of their names.

    Args:
        scene: The scene.
        bodies: Material of each object that has one, by its row.
        volume: Volume of each object [m3].
        center: Center of each object [m].
        surface: Whether the particles of each object know its surface
        (preprocess/built_object.py).
        driven: Rows of the bodies of each phase whose velocity a feature prescribes, by its name.
    """
    members = {name: list(rows) for name, rows in driven.items()}
    for k in bodies:
        members.setdefault(scene.phase_of(scene.entities[k]) or "", []).append(k)
    names = sorted(members)

    def mastery(name):
        """Return the sort key of a phase: contact priority, then size and position."""
        rows = members[name]
        size = math.fsum(volume[k] for k in rows)
        # rounded, so that the order of summation does not distinguish equal bodies
        middle = [
            math.fsum(volume[k] * center[k][a] for k in rows) / max(size, 1e-300) for a in range(3)
        ]
        placed = [float(f"{m:.9e}") for m in middle]
        first = min(CONTACT_PRIORITY[bodies[k].family] for k in rows)
        return first, -float(f"{size:.9e}"), placed, name

    densities = {
        name: [
            scene.material[m].bulk_density
            for k in members[name] for m in scene.materials_of(scene.entities[k])
        ]
        for name in names
    }  # fmt: skip
    order = sorted(names, key=mastery)
    cell = scene.domain.cell**3
    return tuple(
        PhasePlan(
            name,
            tuple(sorted({bodies[k].family for k in members[name]})),
            tuple(members[name]),
            order.index(name),
            min(densities[name]) * cell,
            max(densities[name]) * cell,
            all(surface[k] for k in members[name]),
            name in driven,
            shares_space=any(_shares_space(scene, k) for k in members[name]),
        )
        for name in names
    )


def _shares_space(scene: Scene, k: int) -> bool:
    """Return whether a coupling lets an entity lie in the same space as another.

    Sands in which the grid finds the pressure of the pores stay solids.
    """
    own = set(scene.materials_of(scene.entities[k]))
    rules = {MIXING} if scene.is_free_of_waves else {MIXING, DRAG}
    return any(c.rule in rules and not own.isdisjoint(c.between) for c in scene.coupling)


def groups_of(
    scene: Scene, bodies: dict, phases: tuple[PhasePlan, ...], real: np.dtype
) -> tuple[tuple[GroupPlan, ...], tuple[int, ...]]:
    """Return a group for each phase and material that meet in a body, and the group of each object.

    The groups are those before phases share space. Materials of regions have groups, too.

    Args:
        scene: The scene.
        bodies: Material of each object that has one, by its row.
        phases: Phases of the scene.
        real: Type of the numbers.

    Returns:
        The groups, and the number of each object's group, -1 for scenery.
    """
    key = {k: (scene.phase_of(scene.entities[k]) or "", scene.entities[k].material) for k in bodies}
    parts = {k: [(key[k][0], m) for m in scene.materials_of(scene.entities[k])] for k in bodies}
    pairs = sorted({pair for pairs in parts.values() for pair in pairs})
    number = {phase.name: k for k, phase in enumerate(phases)}
    deforming = {
        pair for k in parts if stores_deformation(scene, scene.entities[k]) for pair in parts[k]
    }
    groups = (make_group(number[p], p, m, scene.material[m], real) for p, m in pairs)
    result = tuple(
        _with_deformation(group, names in deforming, phases[group.phase].surface)
        for names, group in zip(pairs, groups, strict=True)
    )
    return result, tuple(
        pairs.index(key[k]) if k in key else -1 for k in range(len(scene.entities))
    )


def _with_deformation(group: GroupPlan, drawn: bool, surface: bool) -> GroupPlan:
    """Return the group with the deformation that its Gaussians and its surfaces need."""
    has_gradient = "H" in group.carries
    return group._replace(
        tracks_deformation=(drawn or surface) and not has_gradient, surface=surface
    )


def make_group(phase: int, phase_label: str, name: str, material, real: np.dtype) -> GroupPlan:
    """Return the group of a material in a phase.

    Args:
        phase: Number of the phase.
        phase_label: Name of the phase.
        name: Name of the material.
        material: The material.
        real: Type of the numbers.
    """
    law = material.law()
    reference = tuple(v for values in material.carries.values() for v in values)
    assert len(reference) == state_channels(type(law))
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
        volume=VolumeTerms(softens_spray=material.is_liquid(typed)),
    )


def with_corrections(
    scene: Scene, groups: tuple[GroupPlan, ...], phases: tuple[PhasePlan, ...], interval: int
) -> tuple[GroupPlan, ...]:
    """Return the groups with the correction of motion, and with that of the volume of liquids.

    Args:
        scene: The scene.
        groups, phases: Groups and phases of the scene.
        interval: Steps between two corrections of motion, 0: never.
    """
    if interval:
        price = COSTS.correction.total / interval
        groups = tuple(group._replace(cost=group.cost + price) for group in groups)
    if scene.accuracy.dilatation == "cells":
        groups = tuple(
            group._replace(
                volume=group.volume._replace(by_cells=True),
                cost=group.cost + COSTS.cell_dilatation.total,
            )
            if group.is_liquid and not group.separates_stress
            else group
            for group in groups
        )
    return with_density_correction(scene, groups, phases)


def with_density_correction(
    scene: Scene, groups: tuple[GroupPlan, ...], phases: tuple[PhasePlan, ...]
) -> tuple[GroupPlan, ...]:
    """Return groups with the density correction of liquids, without those that share space.

    Raises:
        SceneError: Liquids of different density have one velocity field and a density correction.
    """
    if scene.accuracy.volume_correction != "density":
        return groups
    return tuple(
        _with_density_correction(scene, group, phases[group.phase])
        if group.is_liquid and not group.shares_space
        else group
        for group in groups
    )


def _with_density_correction(scene: Scene, group: GroupPlan, phase: PhasePlan) -> GroupPlan:
    """Return the group with its density correction."""
    if phase.min_cell_mass < phase.max_cell_mass:
        message = (
            f"{phase.name!r} holds liquids of different density, whose cells do not tell how full"
            " they are; give each a phase of its own, or a coupling of kind 'mixing'"
        )
        raise scene.error([(("accuracy", "volume_correction"), message)])
    volume = group.volume._replace(inverse_cell_mass=1.0 / (group.density * scene.domain.cell**3))
    return group._replace(volume=volume, cost=group.cost + COSTS.density_correction.total)


def idle_phase(scene: Scene, real: np.dtype) -> tuple[tuple[PhasePlan, ...], tuple[GroupPlan, ...]]:
    """Return a phase, and a group of a solid of the scene in it, both without particles."""
    name, solid = next((n, m) for n, m in scene.material.items() if m.family == "solid")
    mass = solid.bulk_density * scene.domain.cell**3
    phase = PhasePlan("rigid bodies", ("solid",), (), 0, mass, mass)
    return (phase,), (make_group(0, phase.name, name, solid, real),)


LAYER_CELLS = 2.5  # [cells] thickness of the layer
# [cells] overlap under the weight of all bodies, on the square of the cube root of a body's volume
MAX_RESTING_OVERLAP = 0.035
MAX_IMPACT = 0.1  # [-] speed at a wall over the wave speed: the part of the modulus that it takes


def with_soft_bodies(
    scene: Scene, phases: tuple[PhasePlan, ...], groups: tuple[GroupPlan, ...],
    volume: list[float], center: list[list[float]],
) -> tuple[PhasePlan, ...]:  # fmt: skip
    """Return the phases, of which those are marked that are too soft for contact with walls.

    Args:
        scene: The scene.
        phases, groups: Phases and groups of the scene.
        volume: Volume of each object and particle source [m3].
        center: Center of each [m].
    """
    if scene.accuracy.is_flip or all(kind != "separate" for kind, _ in scene.walls_of_solids):
        return phases
    keys = scene.domain.gravity_keyframes or ()
    pulls = [scene.domain.gravity, *(key.gravity for key in keys)]
    weight = max(math.hypot(*pull) for pull in pulls) * math.fsum(
        volume[k] * scene.material[entity.material].bulk_density
        for k, entity in enumerate(scene.entities)
        if entity.material is not None and scene.material[entity.material].family != "fluid"
    )
    return tuple(
        phase._replace(is_soft=_is_soft(scene, phase, p, groups, weight, pulls, volume, center))
        if phase.surface
        else phase
        for p, phase in enumerate(phases)
    )


def _is_soft(scene, phase, p, groups, weight, pulls, volume, center) -> bool:
    """Return whether the contact of a phase with walls would not hold it.

    Weight [N] or speed can be too much. Particles of captures lie outside of the smoothed surface
    that contact sees, and would sink through a wall before it acts.
    """
    if any(getattr(scene.entities[k], "gaussians", None) for k in phase.objects):
        return True
    own = [group for group in groups if group.phase == p]
    waves = [
        float(law_function(group.law, "wave_speed2")(group.law, group.reference)) for group in own
    ]
    modulus = min(group.density * wave for group, wave in zip(own, waves, strict=True))
    size = math.cbrt(math.fsum(volume[k] for k in phase.objects))
    if not (size > 0.0 and modulus > 0.0):
        return True
    if LAYER_CELLS * weight / size**2 > MAX_RESTING_OVERLAP * modulus:
        return True
    speed2 = max(_speed_squared(scene, k, pulls, size, center[k]) for k in phase.objects)
    return speed2 > MAX_IMPACT**2 * min(waves)


def _speed_squared(scene, k, pulls, size, center) -> float:
    """Return the squared speed with which an object may meet a wall below it [m2/s2]."""
    fastest = 0.0
    for pull in pulls:
        axis = int(np.argmax(np.abs(pull)))
        wall = 0.0 if pull[axis] < 0 else scene.domain.size[axis]
        height = max(abs(center[axis] - wall) - 0.5 * size, 0.0)
        fastest = max(fastest, 2.0 * abs(pull[axis]) * height)
    return fastest + scene.entities[k].speed ** 2


def connected_sets(n: int, pairs: list[tuple[int, int]]) -> np.ndarray:
    """Return the number of the connected set of each of n phases, -1 without a pair, shape (n,)."""
    lowest = np.arange(n)
    moved = True
    while moved:  # usually two passes, even with thousands of bodies
        moved = False
        for a, b in pairs:
            moved |= bool(lowest[a] != lowest[b])
            lowest[a] = lowest[b] = min(lowest[a], lowest[b])
    named = np.isin(np.arange(n), pairs)
    set_of = np.full(n, -1)
    if named.any():
        set_of[named] = np.unique(lowest[named], return_inverse=True)[1]
    return set_of


def color_sets(scene: Scene) -> list[int | None]:
    """Return the number of the set in which the colors of each object may travel.

    Bodies of one phase, and of fluids that mix, are in one set. Scenery has None. Files store the
    number (`color_group` of an object), so that a renderer need not know of couplings.
    """
    phase_of = [scene.phase_of(entity) for entity in scene.entities]
    names = sorted({name for name in phase_of if name is not None})
    number = {name: k for k, name in enumerate(names)}
    numbers_of: dict[str, set[int]] = {}
    for entity, name in zip(scene.entities, phase_of, strict=True):
        if name is not None:
            numbers_of.setdefault(str(entity.material), set()).add(number[name])
    pairs = [(k, k) for k in range(len(names))]  # every phase is paired with itself
    for coupling in scene.coupling:
        if coupling.rule == MIXING:
            first, second = (numbers_of.get(name, ()) for name in coupling.between)
            pairs += [(a, b) for a in first for b in second]
    set_of = connected_sets(len(names), pairs)
    return [None if name is None else int(set_of[number[name]]) for name in phase_of]
