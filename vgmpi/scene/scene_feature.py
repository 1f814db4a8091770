"""Optional features of scenes: their list, and what each adds to the tables of a scene.

A feature is a folder of vgmpi/features with a module `feature` that defines FEATURE. It is found by
its name in FEATURES, as a material is found by its file: the rooms below know the methods of
`SceneFeature` and no feature.
"""

import inspect
from collections.abc import Callable, Mapping
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np
from pydantic import BaseModel, BeforeValidator, create_model

from vgmpi.runtime.config.schema import Color, Share, StrictModel

from .objects import Object, checked_name, default_alpha_min, per_cell
from .sections import SECTIONS

# In the order in which they act, and plan in three rounds (`plan_features`). It numbers groups and
# orders sums: part of the results.
FEATURES = (
    "mixtures", "color_transfer", "flip",
    "wave_zones", "loads", "moving_colliders", "surface_slip", "implicit_viscosity",
    "implicit_elasticity", "implicit_pressure", "pinned_parts", "rigid_bodies",
    "prescribed_motion", "reactions", "inlets_outlets", "releases", "thin_walls", "shifting",
)  # fmt: skip

Errors = list[tuple[tuple, str]]  # (path of a key, message)


class NoKeys(StrictModel):
    """Keys of a feature that adds none."""


class InitialParticles(NamedTuple):
    """Particles at the start, in the order of their ids."""

    x: np.ndarray  # (n, 3) [m] positions
    vol0: np.ndarray  # (n,) [m3] rest volumes
    owner: np.ndarray  # (n,) object of each
    entries: list[dict]  # of the objects and particle sources in output files
    sh: np.ndarray  # (n, K, 3) spherical harmonics of the colors


class ParticleSource(StrictModel):
    """Table of a list whose items have particles, as objects do; see `TableList`."""

    name: Annotated[str, BeforeValidator(checked_name)]
    """unique name, among objects too: letters, digits, spaces, _ and -, beginning with a letter"""
    material: str
    """name of a [material.*] table"""
    particles_per_cell: Annotated[int, BeforeValidator(per_cell)] = 8
    """particles per full cell: 1, 8, 27 or 64"""
    phase: str | None = None
    """name of its velocity field, as for an object"""
    color: Color = (0.7, 0.7, 0.7)
    """"#rrggbb" or three numbers 0..1"""
    opacity: Share = 0.95
    """opacity of its Gaussians"""
    opacity_scale: Share = 1.0
    """fluids only: factor on opacities in rendering; water looks realistic at 0.005 .. 0.05"""

    # attributes of an `Object` that it lacks
    role: ClassVar[str] = "source"
    collider: ClassVar[bool] = False
    track_deformation: ClassVar[bool | None] = None
    motion: ClassVar[None] = None
    free_body: ClassVar[None] = None

    @property
    def alpha_threshold(self) -> float:
        """Return the opacity below which a contribution is not drawn."""
        return default_alpha_min(self.opacity_scale)


class TableList(NamedTuple):
    """List of tables at the top of a scene, [[name]], whose items may have unique names."""

    tables: Mapping[str, type[BaseModel]]  # class of the items by their key `kind`; by "": of all
    sections: Mapping[str, type[BaseModel]] = {}  # tables inside these, for the reference, by title

    @property
    def holds_particles(self) -> bool:
        """Return whether its items have particles, as objects do."""
        return all(issubclass(table, ParticleSource) for table in self.tables.values())


class SceneTables(NamedTuple):
    """Tables of a scene as read so far, None in place of invalid ones."""

    sections: Mapping[str, Any]  # by name
    materials: Mapping[str, Any]  # by name
    objects: list
    lists: dict[str, list]  # lists of features by name; each is complete when the next is read
    place: Callable[[tuple], str]  # path of a key -> "file:line"

    @property
    def roles(self) -> dict[str, str] | None:
        """Return the roles of objects by name, None if one is invalid, see validate_body_name."""
        if None in self.objects:
            return None
        return {obj.name: "rigid" if obj.rigid else obj.role for obj in self.objects}


class SceneFeature:
    """Feature of scenes: its keys, their checks, and what is prepared and planned from them.

    Attributes:
        name: Name of its folder, under which its prepared data are stored.
        title: Noun phrase for messages: "pinned parts".
        force_source: Its bodies whose forces can be probed, as a message names them, or "".
        object_keys: Table of the keys that it adds to [[object]].
        makes_particles: Whether these keys only make particles of the start, as far as bodies go.
        sections: Tables inside these keys, for the reference, by title.
        section_keys: Tables of the keys that it adds to [accuracy] and others, by their names.
        lists: Lists of tables that it adds at the top, by name.
        chosen_keys: Its keys of [accuracy] that `choose_defaults` sets, each with the value that
            does without the feature.
        missing_engines: Engines that cannot run it.
        suits_implicit_pressure: Whether its lists may stand beside an implicit pressure.
        moves_bodies: Whether it gives whole bodies groups of their own: it plans before others.
        precedes_copies: Whether it plans before these copy groups.
        hints: What messages add on the help that it gives, by problem: "open mesh".
    """

    name = title = force_source = ""
    object_keys: type[StrictModel] = NoKeys
    makes_particles = False
    sections: Mapping[str, type[BaseModel]] = {}
    section_keys: Mapping[str, type[StrictModel]] = {}
    lists: Mapping[str, TableList] = {}
    chosen_keys: Mapping[str, str] = {}
    missing_engines: tuple[str, ...] = ()
    suits_implicit_pressure = moves_bodies = precedes_copies = False
    hints: Mapping[str, str] = {}

    def keys_of(self, obj: Object) -> list[str]:
        """Return those of its keys that an object has set."""
        fields = self.object_keys.model_fields.items()
        return [key for key, field in fields if getattr(obj, key) != field.default]

    def key_paths(self, scene: Any) -> list[tuple]:
        """Return the paths of those of its keys and tables that a scene has set."""
        paths: list[tuple] = []
        for k, obj in enumerate(scene.object):
            paths += [("object", k, key) for key in self.keys_of(obj)]
        for name, table in self.section_keys.items():
            values, fields = getattr(scene, name), table.model_fields
            without = {key: fields[key].default for key in fields} | dict(self.chosen_keys)
            paths += [(name, key) for key in fields if getattr(values, key) != without[key]]
        return paths + [(name, k) for name in self.lists for k in range(len(scene.lists[name]))]

    def named_parts(self, scene: Any) -> list[tuple[str, tuple]]:
        """Return what of it a scene has: noun phrases for messages, each with its first path."""
        return [(self.title, path) for path in self.key_paths(scene)[:1]]

    def check_object(self, raw: dict, is_scenery: bool) -> Errors:
        """Return the errors of one object as read, besides the values of its keys."""
        return []

    def check_list(self, name: str, raw: list[dict], tables: SceneTables) -> Errors:
        """Return the errors of one of its lists, besides the values of its keys.

        Args:
            name: Name of the list.
            raw: Its tables as read.
            tables: Tables of the scene, with the list itself and those of features before.
        """
        return []

    def check_probes(self, probes: list, tables: SceneTables) -> Errors:
        """Return the errors of probes that measure what they cannot because of the feature.

        Args:
            probes: Probes, None in place of invalid ones.
            tables: Tables of the scene.
        """
        return []

    def check_scene(self, objects: list, materials: dict, couplings: list, accuracy: Any) -> Errors:
        """Return what a scene with the feature cannot have.

        Args:
            objects: Objects of the scene.
            materials: Materials by their names, None in place of invalid ones.
            couplings: Couplings of its materials, None in place of invalid ones.
            accuracy: Table `accuracy`, or None.
        """
        return []

    def note_lines(self, scene: Any) -> list[str]:
        """Return a line on each effect of a valid scene, with or without it, that may surprise."""
        return []

    def changes_mass(self, scene: Any) -> bool:
        """Return whether particles enter or leave the domain of a scene because of the feature."""
        return False

    def has_force(self, obj: Object) -> bool:
        """Return whether the force on an object can be probed because of the feature."""
        return False

    def may_overlap(self, obj: Object) -> bool:
        """Return whether an object may well begin inside a collider because of the feature."""
        return False

    def hangs(self, obj: Object, lowest: np.ndarray, spacing: float) -> bool:
        """Return whether an object is held, but not at its lowest point.

        Args:
            obj: The object.
            lowest: The point, shape (1, 3) [m].
            spacing: Distance of its particles [m].
        """
        return False

    def check_size(self, obj: Object, length: float, size: tuple[float, ...]) -> Errors:
        """Return why an object is too large for the domain.

        Args:
            obj: The object.
            length: Its longest edge [m].
            size: Edges of the domain [m].
        """
        return []

    def takes_open_mesh(self, obj: Object) -> bool:
        """Return whether an open mesh of an object is a wall instead of the bound of a solid."""
        return False

    def complete_collider(
        self, obj: Object, collider: Any, dx: float, size: tuple[float, float, float]
    ) -> Any:
        """Return the collider of an object with what the feature adds to it.

        Args:
            obj: The object.
            collider: Its collider.
            dx: Cell size [m].
            size: Edges of the domain [m].
        """
        return collider

    def check_collider(self, scene: Any, collider: Any) -> Errors:
        """Return the errors of a collider, with paths from its object.

        Args:
            scene: The scene.
            collider: The collider.
        """
        return []

    def choose_defaults(self, scene: Any) -> Any:
        """Return a scene with values of the keys that it does not name, chosen from it alone.

        Each feature takes what those behind it in the list have chosen.
        """
        return scene

    def obstacles(self, scene: Any) -> Errors:
        """Return what a scene that has the feature cannot have beside it, as `plan` refuses it."""
        return []

    def removes_wave_bound(self, scene: Any) -> bool:
        """Return whether waves do not bound the steps of a scene because of the feature."""
        return False

    def advice_lines(self, scene: Any, plan: Any) -> list[str]:
        """Return lines of the plan report on a scene that lacks the feature and may want it.

        Args:
            scene: The scene.
            plan: Its plan.
        """
        return []

    def particle_estimates(self, scene: Any) -> list[tuple[int, float]]:
        """Return the number of particles and their spacing [m] of each of its particle sources."""
        return []

    def check_memory(self, scene: Any) -> None:
        """Raise SceneError if its particle sources are empty, or larger than the memory."""

    def check_bodies(self, scene: Any, pieces: list, colliders: list) -> Errors:
        """Return the errors of a scene with its objects as they were built.

        Args:
            scene: The scene.
            pieces: Its objects, each a preprocess/built_object.py `BuiltObject`.
            colliders: Colliders at the start.
        """
        return []

    def phases(self, scene: Any) -> dict[str, tuple[int, ...]]:
        """Return the rows of bodies that have a phase of their own for a time, by its name.

        The feature prescribes the velocity of these phases.
        """
        return {}

    def build_particles(self, scene: Any) -> list:
        """Return the particles of each of its particle sources, as a `BuiltObject`."""
        return []

    def prepare(self, scene: Any, particles: InitialParticles, colliders: list) -> Any:
        """Return its data at the start, the same on all ranks, or None if the scene has none.

        Args:
            scene: The scene.
            particles: Particles at the start.
            colliders: Colliders at the start.
        """
        return None

    def adjust_colliders(self, colliders: list, prepared: Any) -> list:
        """Return the colliders as they are with the prepared data."""
        return colliders

    def plan(self, draft: Any, prepared: Any) -> tuple[Any, Any]:
        """Return its `FeaturePlan`, or None if the scene has none, and the draft with its changes.

        Args:
            draft: A planning/feature_plan.py `PlanDraft`; new groups and phases come last.
            prepared: Result of `prepare`.
        """
        return None, draft


@cache
def features() -> tuple[SceneFeature, ...]:
    """Return the features in the order in which they act."""
    return tuple(import_module(f"vgmpi.features.{name}.feature").FEATURE for name in FEATURES)


def chosen_keys() -> dict[str, str]:
    """Return the keys of [accuracy] that features choose; see `SceneFeature.chosen_keys`."""
    return {key: value for feature in features() for key, value in feature.chosen_keys.items()}


def hint(problem: str) -> str:
    """Return what features add to the message of a problem; see `SceneFeature.hints`."""
    return "".join(feature.hints.get(problem, "") for feature in features())


def feature_folders() -> list[str]:
    """Return the folders of the features' sources."""
    return [str(Path(inspect.getfile(type(feature))).parent) for feature in features()]


def _with_keys(table: type[BaseModel], additions: list[type[StrictModel]]) -> type[BaseModel]:
    """Return a table with the keys and checks of others behind its own."""
    if not additions:
        return table
    about = {"__module__": __name__, "__doc__": table.__doc__}
    base = (*reversed(additions), table)
    return create_model(table.__name__, __base__=base, **about)  # type: ignore[call-overload]


@cache
def object_table() -> type[Object]:
    """Return the table [[object]] with the keys of all features."""
    keys = [feature.object_keys for feature in features() if feature.object_keys is not NoKeys]
    return _with_keys(Object, keys)  # type: ignore[return-value]


@cache
def section_tables() -> dict[str, type[BaseModel]]:
    """Return the tables of `SECTIONS` with the keys of all features."""
    return {
        name: _with_keys(
            table, [f.section_keys[name] for f in features() if name in f.section_keys]
        )
        for name, table in SECTIONS.items()
    }


def table_lists() -> dict[str, TableList]:
    """Return the lists of tables of all features by name, in the order of the features."""
    return {name: tables for feature in features() for name, tables in feature.lists.items()}


def source_lists() -> list[str]:
    """Return the names of the lists whose items are particle sources."""
    return [name for name, tables in table_lists().items() if tables.holds_particles]


def phases_of_features(scene: Any) -> dict[str, tuple[int, ...]]:
    """Return the rows of bodies of each phase whose velocity a feature prescribes, by its name."""
    return {name: rows for each in features() for name, rows in each.phases(scene).items()}


def check_object(raw: dict) -> Errors:
    """Return the errors of one object as read that the features find."""
    is_scenery = raw.get("role") == "scenery"
    return [error for each in features() for error in each.check_object(raw, is_scenery)]


def prepare_features(
    scene: Any, particles: InitialParticles, colliders: list
) -> tuple[dict[str, Any], list]:
    """Return the prepared data of the features that a scene has, by name, and the colliders.

    Args:
        scene: The scene.
        particles: Particles at the start.
        colliders: Colliders at the start.
    """
    prepared: dict[str, Any] = {}
    for feature in features():
        if (data := feature.prepare(scene, particles, colliders)) is not None:
            prepared[feature.name] = data
            colliders = feature.adjust_colliders(colliders, data)
    return prepared, colliders
