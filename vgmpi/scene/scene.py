"""Content of a scene file as typed, checked, frozen tables."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from vgmpi.materials.couplings.interaction import MIXING
from vgmpi.runtime.config.schema import SceneError
from vgmpi.runtime.config.toml_source import TomlSource

from .objects import Object
from .probes import Probe
from .scene_feature import ParticleSource, features, phases_of_features, source_lists
from .sections import SECTIONS, Accuracy, Appearance, Domain, Output, Time

DEFAULT_CFL, SMALL_CFL = 0.55, 0.4  # [-] default CFL number, and that of `courant_number`'s cases
# [cells] largest displacement of a particle in a step, and where waves do not bound the step
MAX_CELLS_PER_STEP, MAX_CELLS_WITHOUT_WAVES = 0.3, 1.0 / 3.0


@dataclass(frozen=True, repr=False)
class Scene:
    """Content of a scene file with defaults filled in, in SI units.

    `object`, `coupling` and the lists of features are in file order; `folder` contains the file;
    `text` is the file's text without the overrides, which `overrides` lists. A scene of a table has
    its values as JSON instead, and the folder in which the program runs.
    """

    path: Path
    folder: Path
    text: str
    title: str
    seed: int
    domain: Domain
    time: Time
    material: dict[str, Any]
    object: tuple[Object, ...]
    coupling: tuple[Any, ...] = ()
    probe: tuple[Probe, ...] = ()
    appearance: Appearance = Appearance()
    accuracy: Accuracy = Accuracy()
    output: Output = Output()
    lists: dict[str, tuple[Any, ...]] = field(default_factory=dict)  # lists of features, by name
    files: dict[str, Path] = field(
        default_factory=dict
    )  # file of each object that has one, by object name
    overrides: tuple[str, ...] = ()
    # why keys that the file does not name have their values, a line of the plan report on each
    choices: tuple[str, ...] = field(default=(), compare=False)
    source: TomlSource | None = field(default=None, repr=False, compare=False)

    def __repr__(self) -> str:
        bodies, sources = sum(obj.role == "body" for obj in self.object), len(self.particle_sources)
        inflow = f", {sources} inlets" if sources else ""
        nx, ny, nz = self.domain.cells
        return (
            f"<Scene {self.title or self.path.name!r}: {bodies} bodies{inflow},"
            f" {nx} x {ny} x {nz} cells, {self.time.end:g} s>"
        )

    @property
    def walls_of_solids(self) -> list[tuple[str, float]]:
        """Return (kind, friction) of the six walls for everything that is not a liquid.

        With FLIP, walls without a kind stay slip walls.
        """
        return self.domain.walls if self.accuracy.is_flip else self.domain.walls_of_solids

    @property
    def entities(self) -> tuple[Object | ParticleSource, ...]:
        """Return objects, then particle sources: all entities that particles can belong to."""
        return (*self.object, *self.particle_sources)

    @property
    def particle_sources(self) -> tuple[ParticleSource, ...]:
        """Return the items of lists of features that have particles."""
        return tuple(item for name in source_lists() for item in self.lists.get(name, ()))

    @property
    def has_particles(self) -> bool:
        """Return whether an entity has particles; else all bodies are rigid."""
        return any(entity.material is not None for entity in self.entities)

    @property
    def changes_mass(self) -> bool:
        """Return whether particles enter or leave the domain."""
        return any(feature.changes_mass(self) for feature in features())

    @property
    def courant_number(self) -> float:
        """Return the CFL number of the steps: that of the file, or the default.

        The smaller number is that of steps that waves do not bound, and of fixed steps.
        """
        if self.time.cfl is not None:
            return self.time.cfl
        is_small = self.is_free_of_waves or self.time.dt > 0.0
        return SMALL_CFL if is_small else DEFAULT_CFL

    @property
    def max_cells_per_step(self) -> float:
        """Return the largest displacement of a particle in a step [cells]."""
        return MAX_CELLS_WITHOUT_WAVES if self.is_free_of_waves else MAX_CELLS_PER_STEP

    @property
    def is_free_of_waves(self) -> bool:
        """Return whether a feature frees the steps of their bound by waves."""
        return any(feature.removes_wave_bound(self) for feature in features())

    @property
    def largest_tait_coefficient(self) -> float:
        """Return the largest Tait coefficient of the liquids that something is made of [Pa], or 0.

        Where the grid finds the pressure, it is the unit of pressures of all liquids.
        """
        used = self.used_materials.values()
        return max((getattr(material, "tait_coefficient", 0.0) for material in used), default=0.0)

    @property
    def used_materials(self) -> dict[str, Any]:
        """Return the materials that particles have, by name."""
        names = (name for entity in self.entities for name in self.materials_of(entity))
        return {name: self.material[name] for name in names}

    def is_moved(self, k: int) -> bool:
        """Return whether a feature prescribes the motion of an object, perhaps for a time."""
        return any(k in rows for rows in phases_of_features(self).values())

    def material_of(self, obj: Object) -> Any:
        """Return the material of a body."""
        assert obj.material is not None
        return self.material[obj.material]

    def materials_of(self, entity: Object | ParticleSource) -> tuple[str, ...]:
        """Return the names of the materials of an entity, those of its regions last."""
        regions = (entity.region or ()) if isinstance(entity, Object) else ()
        own = () if entity.material is None else (entity.material,)
        return tuple(dict.fromkeys((*own, *(region.material for region in regions))))

    def phase_of(self, entity: Object | ParticleSource) -> str | None:
        """Return the name of the velocity field of a body or particle source; None for scenery."""
        if entity.material is None:
            return None
        return phase_of(
            entity, self.material[entity.material].family, miscible_materials(self.coupling)
        )

    def with_defaults(self, values: Mapping[str, Any]) -> "Scene":
        """Return the scene with other defaults of keys of [accuracy], by key."""
        accuracy = self.accuracy.model_copy()
        for key, value in values.items():
            if key not in accuracy.model_fields_set:
                object.__setattr__(accuracy, key, value)  # it stays a key that nobody has named
        return replace(self, accuracy=accuracy)

    def with_choices(self, values: Mapping[str, Any]) -> "Scene":
        """Return the scene as if it named those of its keys of [accuracy] that it does not.

        Args:
            values: Values by key.

        Raises:
            ValidationError: Keys that it names do not go together with them.
        """
        own = self.accuracy
        choices = {key: value for key, value in values.items() if key not in own.model_fields_set}
        if all(getattr(own, key) == value for key, value in choices.items()):
            return self
        named = {key: getattr(own, key) for key in own.model_fields_set}
        return replace(self, accuracy=type(own).model_validate({**named, **choices}), choices=())

    def with_choice(self, key: str, reason: str) -> "Scene":
        """Return the scene with a line of the plan report on why a default was chosen.

        Args:
            key: Key of [accuracy].
            reason: The choice and its reason.
        """
        return replace(self, choices=(*self.choices, f"  {key:11s} {reason}"))

    def error(self, errors: list[tuple[tuple, str]]) -> SceneError:
        """Return the exception for (path of a key, message) pairs found after loading."""
        source = self.source or TomlSource(self.path, self.overrides)
        return SceneError(source.lines(errors))

    def place(self, path: tuple) -> str:
        """Return a key with its location: "material.water.tait_exponent (scene.toml:12)"."""
        source = self.source or TomlSource(self.path, self.overrides)
        return source.key_with_place(path)

    def to_json(self) -> dict[str, Any]:
        """Return all values, with defaults filled in, as plain JSON values."""
        tables = {name: getattr(self, name).model_dump(mode="json") for name in SECTIONS}
        tables["time"]["cfl"] = self.courant_number
        # Empty lists are left out, as in runs older than these tables.
        lists = {
            name: [x.model_dump(mode="json", exclude_none=True) for x in items]
            for name, items in self.lists.items()
            if items
        }
        return {
            "title": self.title,
            "seed": self.seed,
            **tables,
            "material": {k: m.model_dump(mode="json") for k, m in self.material.items()},
            "object": [o.model_dump(mode="json", exclude_none=True) for o in self.object],
            "coupling": [c.model_dump(mode="json") for c in self.coupling],
            "probe": [p.model_dump(mode="json", exclude_none=True) for p in self.probe],
            **lists,
        }


def phase_of(
    entity: Object | ParticleSource, family: str, mixed: frozenset[str] = frozenset()
) -> str:
    """Return the name of the velocity field of a body or particle source.

    All fluids share one, except materials in `mixed`, which mix with another; all sand and all snow
    share one each; every solid has its own.

    Args:
        entity: Object or particle source.
        family: Family of its material.
        mixed: Names of the materials that mix with others.
    """
    by_family = {
        "solid": entity.name,
        "fluid": entity.material if entity.material in mixed else family,
    }
    return entity.phase or by_family.get(family, family)


def miscible_materials(couplings: Iterable[Any]) -> frozenset[str]:
    """Return the names of the materials that mix with others, from the couplings of a scene."""
    return frozenset(name for c in couplings if c.rule == MIXING for name in c.between)
