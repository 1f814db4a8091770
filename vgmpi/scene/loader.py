"""Loader of scene files: checks all tables of a TOML file and builds a `Scene`."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from vgmpi import materials
from vgmpi.materials import couplings
from vgmpi.materials.couplings.interaction import CONTACT
from vgmpi.materials.material import kinds_with_preset, unknown_material
from vgmpi.runtime.config.schema import SceneError, format_input, format_validation_errors
from vgmpi.runtime.config.toml_source import TableSource, TomlSource
from vgmpi.runtime.message_text import did_you_mean

from . import accuracy_presets
from .gravity import validate_gravity
from .object_files import find_object_file
from .objects import Object, validate_body_name, validate_object
from .probes import Probe, collider_names, validate_probe
from .regions import validate_region_kinds
from .rigid_objects import as_collider, validate_bodies, validate_rigid_probes, validate_rigid_scene
from .scene import Scene, miscible_materials, phase_of
from .scene_feature import (
    ParticleSource,
    SceneFeature,
    SceneTables,
    check_object,
    features,
    object_table,
    section_tables,
    source_lists,
    table_lists,
)
from .sections import Appearance, Domain, Output, TopLevelKeys, validate_cell_counts
from .subtraction import validate_subtractions

REQUIRED = ("domain", "time", "material", "object")
SCENE_RULES = (
    validate_rigid_scene, validate_region_kinds,
    validate_subtractions,
)  # fmt: skip
LISTS = ("object", "coupling", "probe")


def load(
    path: str | Path | Mapping,
    overrides: list[str] | tuple[str, ...] = (),
    text: str | None = None,
) -> Scene:
    """Read a scene and check all of it.

    Args:
        path: Scene file (TOML), or a nested table with the content of one.
        overrides: "key=value" settings, which replace values of the scene.
        text: Content to use in place of the file's own.

    Raises:
        SceneError: All errors in the order of the file, "file:line: key: what is wrong"; those of a
            table without file and line.
    """
    if isinstance(path, Mapping):
        source: TomlSource = TableSource(path, overrides)
    else:
        source = TomlSource(path, overrides, text)
    return SceneLoader(source).scene(tuple(overrides))


def load_again(scene: Scene, overrides: tuple[str, ...]) -> Scene:
    """Return a scene with more overrides. Raises SceneError."""
    overrides = (*scene.overrides, *overrides)
    if isinstance(scene.source, TableSource):
        return load(scene.source.table, overrides)
    return load(scene.path, overrides, scene.text)


class SceneLoader:
    """Collector of the errors of all tables of one source, raised together at the end."""

    def __init__(self, source: TomlSource):
        self.source = source
        self.errors: list[tuple[tuple, str]] = []

    def scene(self, overrides: tuple[str, ...]) -> Scene:
        """Return the checked scene; raise SceneError with all errors."""
        data = accuracy_presets.apply_accuracy_preset(self.source.data)
        self.check_keys(data)
        top = self.table(
            TopLevelKeys, {k: v for k, v in data.items() if k in TopLevelKeys.model_fields}, ()
        )
        tables = {
            name: self.table(table, data.get(name, {}), (name,))
            for name, table in section_tables().items()
            if name in data or name not in REQUIRED
        }
        kinds = self.materials(data.get("material", {}))
        if accuracy := tables.get("accuracy"):
            self.check_numbers(kinds, accuracy.precision)
        objects = self.objects(data.get("object", []), kinds)
        pairs = self.couplings(data.get("coupling", []), kinds)
        read = SceneTables(tables, kinds, objects, {}, lambda path: self.source.place(path)[1])
        for feature in features():
            self.lists_of(feature, data, read)
        sources = {name: read.lists[name] for name in source_lists()}
        self.check_phase_families({"object": objects, **sources}, kinds, pairs)
        role = None
        if None not in objects:
            role = {o.name: "rigid" if o.rigid else o.role for o in objects}
            for validate in (*SCENE_RULES, *(feature.check_scene for feature in features())):
                self.errors += validate(objects, kinds, pairs, tables.get("accuracy"))
        self.check_color_bodies(tables.get("appearance"), role)
        for inner, message in validate_gravity(data.get("domain", {})):
            self.report(("domain", *inner), message)
        fluid = any(m is None or m.family == "fluid" for m in kinds.values())
        size = (domain := tables.get("domain")) and domain.size
        colliders = collider_names(objects)
        probes = self.table_list(
            data.get("probe", []), "probe", Probe,
            lambda raw, probe: validate_probe(raw, probe, role, size, fluid, colliders),
        )  # fmt: skip
        for feature in features():
            self.errors += feature.check_probes(probes, read)
        self.errors += validate_rigid_probes(probes, objects, self.has_sources())
        if domain:
            self.errors += validate_cell_counts(domain)
            self.check_hydrostatic(objects, domain)
        files = self.files(objects, tables.get("output"), top is not None and top.allow_outside)
        self.raise_if_errors()
        scene = Scene(
            path=self.source.path, folder=self.source.folder, text=self.source.text,
            title=top.title, seed=top.seed, material=kinds,
            object=tuple(as_collider(obj, kinds.get(obj.material)) for obj in objects),
            coupling=tuple(pairs), probe=tuple(probes), files=files,
            lists={name: tuple(items) for name, items in read.lists.items()}, overrides=overrides,
            source=self.source, **tables,
        )  # fmt: skip
        for feature in reversed(features()):
            scene = feature.choose_defaults(scene)
        return scene

    def check_keys(self, data: dict) -> None:
        """Report unknown keys at the top of the file and required tables that are missing."""
        valid = (*TopLevelKeys.model_fields, *section_tables(), "material", *LISTS, *table_lists())
        for key in data:
            if key not in valid:
                hint = did_you_mean(key, valid) or f"; known: {', '.join(valid)}"
                self.report((key,), f"unknown key{hint}")
        for key in REQUIRED:
            if key not in data and not (key == "object" and self.has_sources()):
                header = "[[object]]" if key == "object" else f"[{key}]"
                header = "[material.name]" if key == "material" else header
                self.report((key,), f"required table {header} is missing")

    def check_color_bodies(self, section: Appearance | None, role: dict[str, str] | None) -> None:
        """Report names in appearance.color_objects that are no bodies."""
        for k, name in enumerate((section and section.color_objects) or ()):
            if message := validate_body_name(name, role):
                self.report(("appearance", "color_objects", k), message)

    def has_sources(self) -> bool:
        """Return whether the file has particle sources besides its objects."""
        return any(self.source.data.get(name) for name in source_lists())

    def report(self, path: tuple, message: str) -> None:
        """Note one error; path: the key's path in the scene."""
        self.errors.append((path, message))

    def raise_if_errors(self) -> None:
        """Raise SceneError with all errors noted so far, if there are any."""
        if self.errors:
            raise SceneError(self.source.lines(self.errors))

    def table(self, table: type[BaseModel], raw: Any, path: tuple) -> Any:
        """Return the validated table, or None after its errors are noted."""
        if not isinstance(raw, dict):
            self.report(path, f"must be a table of keys; {format_input(raw)}")
            return None
        try:
            return table.model_validate(raw)
        except ValidationError as error:
            for inner, message in format_validation_errors(error, table):
                self.report((*path, *inner), message)
            return None

    def kind(self, registry: Mapping[str, type[BaseModel]], raw: Any, path: tuple) -> Any:
        """Validate a table whose class is chosen by its key `kind`."""
        if not isinstance(raw, dict):
            return self.report(path, f"must be a table of keys; {format_input(raw)}")
        if "kind" not in raw:
            kinds = " | ".join(registry)
            return self.report((*path, "kind"), f"required key is missing: {kinds}")
        cls = registry.get(raw["kind"]) if isinstance(raw["kind"], str) else None
        if cls is None:
            allowed = f"must be one of {', '.join(registry)}{did_you_mean(raw['kind'], registry)}"
            return self.report((*path, "kind"), f"{allowed}; {format_input(raw['kind'])}")
        return self.table(cls, raw, path)

    def materials(self, raw: Any) -> dict[str, Any]:
        """Return the materials by name; an invalid one is None, so that its name still counts."""
        if not isinstance(raw, dict):
            self.report(("material",), "must hold tables: [material.water]")
            return {}
        return {
            name: self.kind(
                materials.registry, self.with_kind_of_preset(table, name), ("material", name)
            )
            for name, table in raw.items()
        }

    def with_kind_of_preset(self, table: Any, name: str) -> Any:
        """Return the table of a material with the kind of its preset if it names no kind."""
        preset = table.get("preset") if isinstance(table, dict) and "kind" not in table else None
        if not isinstance(preset, str):
            return table
        kinds = kinds_with_preset(preset)
        if not kinds:
            presets = sorted({p for cls in materials.registry.values() for p in cls.presets})
            message = f"there is no such preset{did_you_mean(preset, presets)}"
            self.report(("material", name, "preset"), f"{message}; known: {', '.join(presets)}")
            return table
        return {"kind": kinds[0], **table}

    def objects(self, raw: Any, kinds: dict[str, Any]) -> list[Any]:
        """Return the objects, None in place of invalid ones."""
        if not self.is_table_list(raw, "object"):
            return []
        objects: list[Any] = []
        first: dict[str, int] = {}
        for k, item in enumerate(raw):
            objects.append(self.table(object_table(), item, ("object", k)))
            for inner, message in (*validate_object(item), *check_object(item)):
                self.report(("object", k, *inner), message)
            self.check_unique_name("object", k, item, first)
            material = item.get("material")
            if isinstance(material, str) and material not in kinds:
                self.report(("object", k, "material"), unknown_material(material, kinds))
        has_sources = self.has_sources()
        if not raw and not has_sources:
            self.report(("object",), "there is no object")
        elif not has_sources and (message := validate_bodies(raw)):
            self.report(("object",), message)
        for k, obj in enumerate(objects):
            material = kinds.get(obj.material) if obj else None
            if obj and obj.initial_pressure != "zero" and material and not obj.rigid:
                if not hasattr(material, "hydrostatic_theta"):
                    self.report(("object", k, "initial_pressure"), "is only for fluids")
            solid = material and material.family == "solid"
            follows = solid and obj and obj.track_deformation is not False
            if obj and obj.passive_gaussians and material and not follows:
                message = "is only for solids that deform: it rides along with their F"
                self.report(("object", k, "passive_gaussians"), message)
            unknown = obj is None or (obj.material in kinds and material is None)
            if unknown or (material and material.family == "fluid"):
                continue
            if "opacity_scale" in raw[k]:
                self.report(
                    ("object", k, "opacity_scale"), "is only for fluids; solids have opacity"
                )
        return objects

    def check_unique_name(self, table: str, k: int, item: dict, first: dict[str, int]) -> None:
        """Report a name that an earlier table of the list has."""
        name = item.get("name")
        if isinstance(name, str) and first.setdefault(name, k) != k:
            holder = self.source.place((table, first[name], "name"))[1]
            self.report((table, k, "name"), f"is taken: {holder} has the same name")

    def check_numbers(self, kinds: dict[str, Any], precision: str) -> None:
        """Report numbers of materials that the precision of the run cannot compute with."""
        for name, material in kinds.items():
            if material is not None:
                for key, message in numbers_out_of_range(material, precision):
                    self.report(("material", name, key), message)

    def check_hydrostatic(self, objects: list[Any], domain: Domain) -> None:
        """Report hydrostatic fluids in a scene without constant gravity along -z."""
        for k, obj in enumerate(objects):
            if obj is None or obj.initial_pressure == "zero":
                continue
            path, (gx, gy, gz) = ("object", k, "initial_pressure"), domain.gravity
            if gx or gy or gz >= 0:
                self.report(path, f"needs gravity along -z alone; it is {list(domain.gravity)}")
            elif domain.gravity_ramp_time:
                self.report(path, "needs gravity from the start: domain.gravity_ramp_time is set")

    def is_table_list(self, raw: Any, name: str) -> bool:
        """Return whether a value can be a list [[name]]; report it if not."""
        is_list = isinstance(raw, list) and all(isinstance(item, dict) for item in raw)
        if not is_list:
            self.report((name,), f"must be a list of tables: [[{name}]]")
        return is_list

    def table_list(self, raw: Any, name: str, table: type[BaseModel], complaints) -> list[Any]:
        """Return the tables of a list [[name]], None in place of invalid ones.

        `complaints(raw, table or None)` returns (path, message) of all further errors of one table.
        """
        if not self.is_table_list(raw, name):
            return []
        tables = [self.table(table, item, (name, k)) for k, item in enumerate(raw)]
        first: dict[str, int] = {}
        for k, item in enumerate(raw):
            self.check_unique_name(name, k, item, first)
            for inner, message in complaints(item, tables[k]):
                self.report((name, k, *inner), message)
        return tables

    def lists_of(self, feature: SceneFeature, data: dict, read: SceneTables) -> None:
        """Read the lists of a feature.

        Args:
            feature: The feature.
            data: Tables of the scene as read.
            read: Those that are read; the lists are added (in/out).
        """
        for name, tables in feature.lists.items():
            raw = data.get(name, [])
            if not self.is_table_list(raw, name):
                read.lists[name] = [None]
                continue
            common, first = tables.tables.get(""), dict[str, int]()
            read.lists[name] = []
            for k, item in enumerate(raw):
                path = (name, k)
                table = (
                    self.table(common, item, path)
                    if common
                    else self.kind(tables.tables, item, path)
                )
                read.lists[name].append(table)
                self.check_unique_name(name, k, item, first)
            self.errors += feature.check_list(name, raw, read)

    def check_phase_families(
        self, entities: dict[str, list], kinds: dict[str, Any], pairs: list
    ) -> None:
        """Report phases of several families that bodies do not all name, or that share space."""
        valid = [c for c in pairs if c is not None]
        mixing = miscible_materials(valid)
        shares = {name for c in valid if c.rule != CONTACT for name in c.between}
        first: dict[str, tuple[Object | ParticleSource, str]] = {}
        for path, entity in (
            ((key, k), t) for key in entities for k, t in enumerate(entities[key])
        ):
            material = kinds.get(entity.material) if entity else None
            if material is None:
                continue
            phase, family = phase_of(entity, material.family, mixing), material.family
            other, others = first.setdefault(phase, (entity, family))
            if others == family:
                continue
            message = (
                f"'{phase}' already holds a {others}, object {other.name!r}, this is a {family}: "
            )
            for body in (other, entity):
                if body.phase is None:
                    message += f"to share one velocity field, {body.name!r} must name it too"
                elif body.material in shares:
                    message += f"{body.material!r} shares space with another phase by a coupling"
                else:
                    continue
                self.report((*path, "phase"), message)
                break

    def couplings(self, raw: Any, kinds: dict[str, Any]) -> list[Any]:
        """Return the couplings, None in place of invalid ones."""
        if not isinstance(raw, list):
            self.report(("coupling",), "must be a list of tables: [[coupling]]")
            return []
        tables: list[Any] = []
        first: dict[tuple, int] = {}
        for k, item in enumerate(raw):
            tables.append(self.kind(couplings.registry, item, ("coupling", k)))
            between = item.get("between") if isinstance(item, dict) else None
            if not isinstance(between, list) or not all(isinstance(b, str) for b in between):
                continue
            for index, name in enumerate(between):
                if name not in kinds:
                    self.report(("coupling", k, "between", index), unknown_material(name, kinds))
            two = [kinds.get(b) for b in between]
            if tables[-1] and len(two) == 2 and all(two) and (message := tables[-1].refuses(*two)):
                self.report(("coupling", k, "between"), f"{message}; {format_input(between)}")
            pair = tuple(sorted(between))
            if first.setdefault(pair, k) != k:
                other = self.source.place(("coupling", first[pair]))[1]
                self.report(("coupling", k, "between"), f"{other} is about the same two already")
        return tables

    def files(self, objects: list[Any], output: Output | None, outside: bool) -> dict[str, Path]:
        """Return the files of all objects by name; check the output folder."""
        if output is not None and not outside:
            self.check_output_folder(output.folder)
        files = {}
        for k, obj in enumerate(objects):
            if obj is None:
                continue
            file, path, message = find_object_file(self.source, k, obj, outside)
            if message:
                self.report(path, message)
            if file is not None:
                files[obj.name] = file
        return files

    def check_output_folder(self, folder: str) -> None:
        """Report an output folder outside the scene's folder, unless the command line gives it."""
        path, home = ("output", "folder"), self.source.folder
        if self.source.overridden(path):
            return
        if not (home / folder).resolve().is_relative_to(home.resolve()):
            self.report(
                path,
                "lies outside the scene's folder: give it on the command line (-o), or set"
                f" allow_outside = true at the top of the scene; {format_input(folder)}",
            )


# Moduli, densities and their ratios stay normal numbers of the precision within this range.
LIMITS = {"single": 1e30, "double": 1e200}


def numbers_out_of_range(material: Any, precision: str) -> list[tuple[str, str]]:
    """Return (key, message) of each number of a material that the precision cannot compute with.

    Args:
        material: Table of a material.
        precision: `accuracy.precision`.
    """
    limit, errors = LIMITS[precision], []
    for key, value in material:
        if not isinstance(value, float) or value == 0.0 or not math.isfinite(value):
            continue
        if not 1.0 / limit <= abs(value) <= limit:
            limits = f"between {1.0 / limit:.0e} and {limit:.0e}"
            errors.append((
                key,
                f"is {value:g} in SI units; {precision} precision computes with numbers {limits}",
            ))  # fmt: skip
    return errors
