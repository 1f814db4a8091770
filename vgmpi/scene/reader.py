"""From the tables of a TOML file to a checked scene, or to all that is wrong with it."""

import math
import os
import re
import shlex
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from vgmpi import couplings, materials
from vgmpi.couplings.base import CONTACT
from vgmpi.misspelt import nearest, nearest_file
from vgmpi.scene import levels
from vgmpi.scene.gravity import gravity_complaints
from vgmpi.scene.loads import Load, load_complaints
from vgmpi.scene.objects import Object, body_complaint, object_complaints, release_complaints
from vgmpi.scene.probes import Probe, collider_names, probe_complaints
from vgmpi.scene.scene import Scene, mixed, phase_of
from vgmpi.scene.settings import MOST_CELLS, SECTIONS, Appearance, Domain, Output, Top
from vgmpi.scene.sources import (
    Inflow,
    Sink,
    balance_complaints,
    sink_complaints,
    source_complaints,
)
from vgmpi.source import Source
from vgmpi.tables import SceneError, explain, got

REQUIRED = ("domain", "time", "material", "object")
LISTS = ("object", "coupling", "load", "probe", "source", "sink")
# of the command that a comment in a scene gives
FLAGS = re.compile(r"# +python \S*make_assets\.py(?: [^\s-]\S*)?((?: --\w+(?: [\w.]+)+)+)")
# what keys inside these were called before; the old names are still read
OLD_NAMES = dict.fromkeys(("object", "load", "probe"), {"color": "colour"})


def load(
    path: str | Path, overrides: list[str] | tuple[str, ...] = (), text: str | None = None
) -> Scene:
    """Read a scene file; `overrides` are "key=value" and replace what the file says; `text` stands
    for what is in the file.

    Raises SceneError with all errors in the order of the file: "file:line: key: what is wrong".
    """
    source = Source(path, overrides, text, old_names=OLD_NAMES)
    return Reader(source).scene(tuple(overrides))


class Reader:
    """Collects the errors of all tables of one source before any is raised."""

    def __init__(self, source: Source):
        self.source = source
        self.errors: list[tuple[tuple, str]] = []

    def scene(self, overrides: tuple[str, ...]) -> Scene:
        data = levels.filled(self.source.data)
        self.keys(data)
        top = self.table(Top, {k: v for k, v in data.items() if k in Top.model_fields}, ())
        tables = {
            name: self.table(table, data.get(name, {}), (name,))
            for name, table in SECTIONS.items()
            if name in data or name not in REQUIRED
        }
        kinds = self.materials(data.get("material", {}))
        objects = self.objects(data.get("object", []), kinds)
        pairs = self.couplings(data.get("coupling", []), kinds)
        sources = self.sources(data.get("source", []), kinds, tables, objects)
        self.families_of_phases({"object": objects, "source": sources}, kinds, pairs)
        role = {o.name: o.role for o in objects if o} if None not in objects else None
        self.colour_bodies(tables.get("appearance"), role)
        for inner, said in gravity_complaints(data.get("domain", {})):
            self.wrong(("domain", *inner), said)
        fluid = any(m is None or m.family == "fluid" for m in kinds.values())
        size = tables["domain"].size if tables.get("domain") else None
        loads = self.listed(
            data.get("load", []), "load", Load, lambda raw, load: load_complaints(raw, load, role)
        )
        colliders = collider_names(objects)
        probes = self.listed(
            data.get("probe", []),
            "probe",
            Probe,
            lambda raw, probe: probe_complaints(raw, probe, role, size, fluid, colliders),
        )
        sinks = self.listed(
            data.get("sink", []), "sink", Sink, lambda raw, _: sink_complaints(raw, sources)
        )
        domain = tables.get("domain")
        flows = bool(sources or sinks or (domain and domain.open_walls))
        self.errors += balance_complaints(probes, flows, objects)
        if domain:
            self.whole_cells(domain)
            self.at_rest(objects, domain)
        outside = top is not None and top.allow_outside
        files = self.files(objects, tables.get("output"), outside)
        self.finish()
        return Scene(
            path=self.source.path,
            folder=self.source.folder,
            text=self.source.text,
            title=top.title,
            seed=top.seed,
            material=kinds,
            object=tuple(objects),
            coupling=tuple(pairs),
            load=tuple(loads),
            probe=tuple(probes),
            inflow=tuple(sources),
            sink=tuple(sinks),
            files=files,
            overrides=overrides,
            source=self.source,
            **tables,
        )

    def keys(self, data: dict) -> None:
        """Whether what stands at the top is known, and all that must is there."""
        known = (*Top.model_fields, *SECTIONS, "material", *LISTS)
        for key in data:
            if key not in known:
                near = nearest(key, known) or f"; known: {', '.join(known)}"
                self.wrong((key,), f"unknown key{near}")
        for key in REQUIRED:
            if key not in data and not (key == "object" and data.get("source")):
                header = "[[object]]" if key == "object" else f"[{key}]"
                header = "[material.name]" if key == "material" else header
                self.wrong((key,), f"required table {header} is missing")

    def colour_bodies(self, looks: Appearance | None, role: dict[str, str] | None) -> None:
        for k, name in enumerate((looks and looks.colour_bodies) or ()):
            if said := body_complaint(name, role):
                self.wrong(("appearance", "colour_bodies", k), said)

    def wrong(self, path: tuple, said: str) -> None:
        self.errors.append((path, said))

    def finish(self) -> None:
        if self.errors:
            raise SceneError(self.source.lines(self.errors))

    def table(self, table: type[BaseModel], raw: Any, path: tuple) -> Any:
        """The validated table, or None after its errors are noted."""
        if not isinstance(raw, dict):
            self.wrong(path, f"must be a table of keys; {got(raw)}")
            return None
        try:
            return table.model_validate(raw)
        except ValidationError as error:
            for inner, said in explain(error, table):
                self.wrong((*path, *inner), said)
            return None

    def kind(self, registry: dict[str, type], raw: Any, path: tuple) -> Any:
        """A table whose class is chosen by its key `kind`."""
        if not isinstance(raw, dict):
            return self.wrong(path, f"must be a table of keys; {got(raw)}")
        if "kind" not in raw:
            return self.wrong((*path, "kind"), f"required key is missing: {' | '.join(registry)}")
        cls = registry.get(raw["kind"]) if isinstance(raw["kind"], str) else None
        if cls is None:
            allowed = f"must be one of {', '.join(registry)}{nearest(raw['kind'], registry)}"
            return self.wrong((*path, "kind"), f"{allowed}; {got(raw['kind'])}")
        return self.table(cls, raw, path)

    def materials(self, raw: Any) -> dict[str, Any]:
        """Materials by name; None stands for one that has errors, so that its name still counts."""
        if not isinstance(raw, dict):
            self.wrong(("material",), "must hold tables: [material.water]")
            return {}
        return {n: self.kind(materials.registry, m, ("material", n)) for n, m in raw.items()}

    def objects(self, raw: Any, kinds: dict[str, Any]) -> list[Any]:
        if not isinstance(raw, list) or not all(isinstance(item, dict) for item in raw):
            self.wrong(("object",), "must be a list of tables: [[object]]")
            return []
        found: list[Any] = []
        first: dict[str, int] = {}
        for k, item in enumerate(raw):
            found.append(self.table(Object, item, ("object", k)))
            for inner, said in object_complaints(item):
                self.wrong(("object", k, *inner), said)
            self.once("object", k, item, first)
            made_of = item.get("material")
            if isinstance(made_of, str) and made_of not in kinds:
                self.unknown_material(("object", k, "material"), made_of, kinds)
        pours = bool(self.source.data.get("source"))
        if not raw and not pours:
            self.wrong(("object",), "there is no object")
        elif not pours and all(item.get("role") == "scenery" for item in raw):
            self.wrong(("object",), "all objects are scenery: at least one must be a body")
        for k, thing in enumerate(found):
            made_of = kinds.get(thing.material) if thing else None
            if thing and thing.compressed != "no" and made_of:
                if not hasattr(made_of, "theta_below"):
                    self.wrong(("object", k, "compressed"), "is only for fluids")
            follows = made_of and made_of.family == "solid" and thing and thing.deforms is not False
            if thing and thing.passive and made_of and not follows:
                said = "is only for solids that deform: it rides along with their F"
                self.wrong(("object", k, "passive"), said)
            if thing and made_of:
                for key, said in release_complaints(thing, made_of.family):
                    self.wrong(("object", k, key), said)
            unknown = thing is None or (thing.material in kinds and made_of is None)
            if unknown or (made_of and made_of.family == "fluid"):
                continue
            if "opacity_scale" in raw[k]:
                self.wrong(
                    ("object", k, "opacity_scale"), "is only for fluids; solids have opacity"
                )
        return found

    def once(self, table: str, k: int, item: dict, first: dict[str, int]) -> None:
        """Names are unique."""
        name = item.get("name")
        if isinstance(name, str) and first.setdefault(name, k) != k:
            other = self.source.place((table, first[name], "name"))[1]
            self.wrong((table, k, "name"), f"is taken: {other} has the same name")

    def at_rest(self, objects: list[Any], domain: Domain) -> None:
        """Whether there is a weight for a fluid to be compressed by."""
        for k, thing in enumerate(objects):
            if thing is None or thing.compressed == "no":
                continue
            path, (gx, gy, gz) = ("object", k, "compressed"), domain.gravity
            if gx or gy or gz >= 0:
                self.wrong(path, f"needs gravity along -z alone; it is {list(domain.gravity)}")
            elif domain.gravity_ramp:
                self.wrong(path, "needs gravity from the start: domain.gravity_ramp is set")

    def listed(self, raw: Any, name: str, table: type[BaseModel], complaints) -> list[Any]:
        """The tables of a list [[name]], None for those with errors; complaints: (raw, table or
        None) -> (path, text) of all else that is wrong."""
        if not isinstance(raw, list) or not all(isinstance(item, dict) for item in raw):
            self.wrong((name,), f"must be a list of tables: [[{name}]]")
            return []
        found = [self.table(table, item, (name, k)) for k, item in enumerate(raw)]
        first: dict[str, int] = {}
        for k, item in enumerate(raw):
            self.once(name, k, item, first)
            for inner, said in complaints(item, found[k]):
                self.wrong((name, k, *inner), said)
        return found

    def sources(
        self, raw: Any, kinds: dict[str, Any], tables: dict[str, Any], objects: list[Any]
    ) -> list[Any]:
        """The sources, None for those with errors."""

        def complaints(item: dict, source: Inflow | None) -> list[tuple[tuple, str]]:
            return source_complaints(item, source, kinds, tables, objects)

        found = self.listed(raw, "source", Inflow, complaints)
        for k, source in enumerate(found):
            if source is not None and source.material not in kinds:
                self.unknown_material(("source", k, "material"), source.material, kinds)
        return found

    def families_of_phases(
        self, things: dict[str, list], kinds: dict[str, Any], pairs: list
    ) -> None:
        """A phase holds several families only where all its bodies name it, and none of them
        shares space with other phases."""
        known = [c for c in pairs if c is not None]
        apart = mixed(known)
        shares = {name for c in known if c.rule != CONTACT for name in c.between}
        first: dict[str, tuple[Object | Inflow, str]] = {}
        for path, thing in (((of, k), t) for of in things for k, t in enumerate(things[of])):
            made_of = kinds.get(thing.material) if thing else None
            if made_of is None:
                continue
            phase, family = phase_of(thing, made_of.family, apart), made_of.family
            other, others = first.setdefault(phase, (thing, family))
            if others == family:
                continue
            said = (
                f"'{phase}' already holds a {others}, object {other.name!r}, this is a {family}: "
            )
            for one in (other, thing):
                if one.phase is None:
                    said += f"to share one velocity field, {one.name!r} must name it too"
                elif one.material in shares:
                    said += f"{one.material!r} shares space with another phase by a coupling"
                else:
                    continue
                self.wrong((*path, "phase"), said)
                break

    def unknown_material(self, path: tuple, name: str, kinds: dict[str, Any]) -> None:
        known = f"defined are {', '.join(kinds)}" if kinds else "none is defined"
        self.wrong(path, f"there is no [material.{name}]{nearest(name, kinds)}; {known}")

    def couplings(self, raw: Any, kinds: dict[str, Any]) -> list[Any]:
        if not isinstance(raw, list):
            self.wrong(("coupling",), "must be a list of tables: [[coupling]]")
            return []
        found: list[Any] = []
        first: dict[tuple, int] = {}
        for k, item in enumerate(raw):
            found.append(self.kind(couplings.registry, item, ("coupling", k)))
            between = item.get("between") if isinstance(item, dict) else None
            if not isinstance(between, list) or not all(isinstance(b, str) for b in between):
                continue
            for place, name in enumerate(between):
                if name not in kinds:
                    self.unknown_material(("coupling", k, "between", place), name, kinds)
            two = [kinds.get(b) for b in between]
            if found[-1] and len(two) == 2 and all(two) and (said := found[-1].refuses(*two)):
                self.wrong(("coupling", k, "between"), f"{said}; {got(between)}")
            pair = tuple(sorted(between))
            if first.setdefault(pair, k) != k:
                other = self.source.place(("coupling", first[pair]))[1]
                self.wrong(("coupling", k, "between"), f"{other} is about the same two already")
        return found

    def whole_cells(self, domain: Domain) -> None:
        for axis, edge in enumerate(domain.size):
            count = edge / domain.cell
            path = ("domain", "size", axis)
            if count > MOST_CELLS:
                self.wrong(path, f"is {count:.3g} cells; at most {MOST_CELLS} are possible")
            elif abs(count - round(count)) > 1e-6 * max(1.0, count):
                low, high = math.floor(count) * domain.cell, math.ceil(count) * domain.cell
                near = f"{low:.6g} m or {high:.6g} m" if low > 0 else f"{high:.6g} m"
                self.wrong(
                    path,
                    f"must be a whole number of cells of {domain.cell:g} m; {edge:g} m is"
                    f" {count:.4g} cells, nearest are {near}",
                )
            elif round(count) < 4:
                self.wrong(path, f"must be at least 4 cells of {domain.cell:g} m; got {edge:g} m")

    def files(self, objects: list[Any], output: Output | None, outside: bool) -> dict[str, Path]:
        """The files of all objects by their names; and the folder to write into is the scene's
        own."""
        if output is not None and not outside:
            self.output_inside(output.folder)
        found = ((o, self.file(k, o, outside)) for k, o in enumerate(objects) if o)
        return {o.name: file for o, file in found if file}

    def output_inside(self, folder: str) -> None:
        """A scene from elsewhere does not write where it likes."""
        path, home = ("output", "folder"), self.source.folder
        if self.source.overridden(path):
            return
        if not (home / folder).resolve().is_relative_to(home.resolve()):
            self.wrong(
                path,
                "lies outside the scene's folder: give it on the command line (-o), or set"
                f" allow_outside = true at the top of the scene; {got(folder)}",
            )

    def file(self, k: int, thing: Object, outside: bool) -> Path | None:
        """The file of an object, found to be there and allowed; None where it has none."""
        key = next((key for key in ("gaussians", "mesh") if getattr(thing, key)), None)
        if key is None:
            return None
        path, name = ("object", k, key), getattr(thing, key)
        folder = self.source.folder
        given = self.source.overridden(path)  # on the command line, in which any file is meant
        candidates = [Path(name), folder / name] if given else [folder / name]
        there = next((c for c in candidates if os.path.isfile(c)), None)
        if there is None and "\0" in name:
            self.wrong(path, f"no file has such a name; {got(name)}")
        elif there is None:
            missing = candidates[-1]
            near = self.maker(missing) or nearest_file(missing)
            self.wrong(path, f"there is no file {missing}{near}")
        elif not (given or outside) and not there.resolve().is_relative_to(folder.resolve()):
            self.wrong(
                path,
                f"{name!r} lies outside the scene's folder: move it below, or set"
                " allow_outside = true at the top of the scene",
            )
        else:
            return there.resolve()
        return None

    def maker(self, missing: Path) -> str:
        """ "; python .../make_assets.py ... makes it" where a script beside or above a missing file
        can make it, with the flags that a comment in the scene gives it; else nothing."""
        for above in missing.parents:
            script = above / "assets" / "make_assets.py"
            if os.path.isfile(script) and f'"{missing.stem}": ' in script.read_text(
                errors="replace"
            ):
                flags = FLAGS.search(self.source.text)
                words = map(shlex.quote, (near(script), near(missing.parent)))
                return f"; python {' '.join(words)}{flags[1] if flags else ''} makes it"
        return ""


def near(path: Path) -> str:
    """The path from the current folder where it lies below that, else from the root."""
    path, here = path.resolve(), Path.cwd()
    return str(path.relative_to(here) if path.is_relative_to(here) else path)
