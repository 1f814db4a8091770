"""Markdown reference of the scene file, generated from the tables that read it."""

import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from vgmpi import materials
from vgmpi.materials import couplings
from vgmpi.runtime.config.schema import Quantity, compatible_units

from . import (
    captures,
    gravity,
    objects,
    point_sets,
    probes,
    regions,
    resume_rules,
    rigid_motion,
    sections,
    shapes,
)
from .scene_feature import features, object_table, section_tables, table_lists

_INTRO = """# The scene file

<!-- made by: python -m vgmpi.scene > docs/reference/scene.md -->

This page lists every key of a scene file with unit, default and meaning.

A scene is a TOML file. Numbers are in SI units. A text with a unit of the same dimension, such as
`"2 cm"`, `"0.1 MPa"` or `"35 deg"`, is converted. z points up. A key whose default is *required*
has no default. All errors are reported at once, each with its line, before anything is written.

This complete scene drops a capture into water. All other keys have defaults:

```toml
[domain]
size = ["1 m", "1 m", "1 m"]
cell = "2 cm"
[time]
end = "1 s"
[material]
water = { kind = "fluid", max_speed = "3 m/s" }
rubber = { kind = "elastic", density = 400, youngs_modulus = "0.1 MPa" }
[[object]]
name = "pool"
material = "water"
shape = { box = [[0, 0, 0], [1, 1, 0.2]] }
[[object]]
name = "duck"
material = "rubber"
gaussians = "duck.ply"                    # a Gaussian file in the scene's folder
up = "-y"                                 # the axis of the file that points up
height = "25 cm"
position = ["50 cm", "50 cm", "40 cm"]    # of the center of its base
```

Override any key on the command line: `--set domain.cell='1 cm'`,
`--set object.duck.height='20 cm'` (objects by name, or by number from 0). Paths are relative to the
scene's folder and must lie in it, unless `allow_outside = true` is set or the path comes from
`--set`. A path from `--set` may also be relative to the current folder.
"""


def scene_reference() -> str:
    """Return the text of docs/reference/scene.md."""
    parts = [_section("Top of the file", sections.TopLevelKeys)]
    for name, table in section_tables().items():
        parts.append(_section(f"[{name}]", table))
    parts.append(_section("[domain] gravity_keyframes", gravity.GravityKeyframe))
    parts.append(_section("[domain] boundary", sections.Boundary))
    parts.append(_section("A wall", sections.Wall))
    parts += _kind_sections("[material.NAME]", materials.registry)
    parts.append(_section("[[object]]", object_table()))
    inner: dict[str, type[BaseModel]] = {
        "points": point_sets.Points,
        "shape": shapes.Shape,
        "region": regions.Region,
        "sphere": shapes.Sphere,
        "ellipsoid": shapes.Ellipsoid,
        "cylinder and capsule": shapes.CylinderShape,
        "cone": shapes.Cone,
        "torus": shapes.Torus,
        "select": captures.Select,
        "rotation": objects.Rotation,
        "velocity_mode": objects.VelocityMode,
        "volume_fraction_profile": objects.FractionProfile,
        **{title: table for feature in features() for title, table in feature.sections.items()},
        "motion": rigid_motion.Motion,
        "motion keyframes": rigid_motion.Keyframe,
    }
    for name, inside in inner.items():
        is_part = issubclass(inside, shapes.Shape) and inside is not shapes.Shape
        parts.append(_section(f"[[object]] {name}", inside, _rows(shapes.Shape) if is_part else ()))
    parts += _kind_sections("[[coupling]]", couplings.registry)
    for name, tables in table_lists().items():
        parts += _kind_sections(f"[[{name}]]", tables.tables)
        parts += [_section(f"[[{name}]] {title}", t) for title, t in tables.sections.items()]
    parts.append(_section("[[probe]]", probes.Probe))
    return "\n".join([_INTRO, _other_units("\n".join(parts)), *parts, _restart_section()])


def _rows(table: type[BaseModel]) -> list[str]:
    """Return the rows of a table's keys, without those that the title or another table says."""
    rows = []
    for name, field in table.model_fields.items():
        if name == "preset" or name == "kind" and len(_literals(field.annotation)) < 2:
            continue
        cells = (f"`{name}`", _unit(field), _default(field), _allowed(field), _meaning(field))
        rows.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return rows


def _section(title: str, table: type[BaseModel], other_rows: Iterable[str] = ()) -> str:
    """Return the section of one table, without rows that another section has."""
    return _format_section(
        title, _description(table), [r for r in _rows(table) if r not in other_rows]
    )


def _format_section(title: str, text: str, rows: list[str]) -> str:
    """Return a section with a text and rows."""
    head = ["| key | unit | default | allowed | meaning |", "|---|---|---|---|---|"]
    return "\n".join([f"## {title}", "", text, "", *head, *rows, ""])


def _description(table: type[BaseModel]) -> str:
    """Return the docstring of a table as one line."""
    return " ".join((table.__doc__ or "").split())


def _kind_sections(head: str, tables: Mapping[str, type[BaseModel]]) -> list[str]:
    """Return the sections of tables by their `kind`; keys that kinds inherit come once."""
    families: dict[type[BaseModel], list[str]] = {}
    for kind, table in tables.items():
        base: Any = table.__base__
        family = base if base in tables.values() or _rows(base) else table
        families.setdefault(family, []).append(kind)
    parts = []
    for family, kinds in families.items():
        shared_rows: list[str] = []
        if len(kinds) > 1:
            shared_rows = _rows(family)
            texts = {kind: _description(tables[kind]) for kind in kinds}
            lines = [f'- `kind = "{kind}"`: {text}' for kind, text in texts.items()]
            title = head if len(kinds) == len(tables) else _kinds_title(head, kinds)
            parts += [_format_section(title, "\n".join(lines), shared_rows), _presets(family)]
        for kind in kinds:
            table = tables[kind]
            rows = [row for row in _rows(table) if row not in shared_rows]
            if rows:
                text = "Its own keys." if shared_rows else _description(table)
                parts += [_format_section(_kinds_title(head, [kind]), text, rows), _presets(table)]
    return [part for part in parts if part]


def _kinds_title(head: str, kinds: list[str]) -> str:
    """Return the title of a section about kinds of a table."""
    names = " or ".join(f'"{kind}"' for kind in kinds if kind)
    return f"{head} kind = {names}" if names else head


def _other_units(text: str) -> str:
    """Return a sentence with the other units of those in the rows of sections."""
    units = dict.fromkeys(re.findall(r"(?m)^\| `\w+` \| ([^|`]+?) \|", text))
    others = {si: [unit for unit in compatible_units(si) if unit != si] for si in units}
    names = [f"{si} ({', '.join(names)})" for si, names in others.items() if names]
    return f"Units, with others of the same dimension in parentheses: {'; '.join(names)}.\n"


def _restart_section() -> str:
    """Return the section about keys that may change at a restart."""
    rows = [f"| `{key}` | {effect} |" for key, effect in resume_rules.may_change().items()]
    head = (
        "These keys may change when a run resumes with `--resume`. Any other change is refused with"
        " its line and both values. `--change` resumes in spite of it, and the checkpoints record"
        " what was changed and when."
    )
    effect = ["## Resuming from a checkpoint", "", head, "", "| key | effect |", "|---|---|"]
    return "\n".join([*effect, *rows, ""])


def _preset_value(value: float | str) -> str:
    """Return a value of a preset as Markdown."""
    return f'`"{value}"`' if isinstance(value, str) else f"{value:.4g}"


def _presets(table: type[BaseModel]) -> str:
    """Return the table of a material's presets, "" without any."""
    presets: dict[str, dict] = getattr(table, "presets", {})
    if not presets:
        return ""
    keys = list(dict.fromkeys(key for values in presets.values() for key in values))
    rows = ["| `preset` | " + " | ".join(f"`{key}`" for key in keys) + " |"]
    rows.append("|---" * (len(keys) + 1) + "|")
    for name, values in presets.items():
        cells = (_preset_value(values[key]) if key in values else "" for key in keys)
        rows.append(f'| `"{name}"` | ' + " | ".join(cells) + " |")
    return "\n".join(["`preset` sets keys that are not set, in SI units:", "", *rows, ""])


def _meaning(field: FieldInfo) -> str:
    """Return the description of a field."""
    return " ".join((field.description or "").split())


def _quantities(source: Any) -> Iterator[Quantity]:
    """Yield every Quantity inside an annotation or a field."""
    if isinstance(source, Quantity):
        yield source
    metadata = (
        source.metadata if isinstance(source, FieldInfo) else getattr(source, "__metadata__", ())
    )
    for item in (*metadata, *get_args(source)):
        yield from _quantities(item)
    if isinstance(source, FieldInfo):
        yield from _quantities(source.annotation)


def _unit(field: FieldInfo) -> str:
    """Return the SI unit of a field, "" for numbers and other values."""
    quantity = next(_quantities(field), None)
    return "" if quantity is None or quantity.unit == "1" else quantity.unit


def _default(field: FieldInfo) -> str:
    """Return the default of a field as Markdown."""
    if field.default is PydanticUndefined:
        return "*required*"
    value = field.default
    if isinstance(value, BaseModel):
        return "see below"
    if value is None or value == () or value == "":
        return ""
    return f"`{_toml(value)}`"


def _toml(value: Any) -> str:
    """Return a value as TOML text."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, tuple):
        return f"[{', '.join(map(_toml, value))}]"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _allowed(field: FieldInfo) -> str:
    """Return the values that a field allows."""
    words = [word for word in _literals(field.annotation)]
    if words:
        return ", ".join(f"`{_toml(word)}`" for word in words)
    quantity = next(_quantities(field), None)
    if quantity is not None:
        return quantity.bounds()
    bounds_text = []
    for item in field.metadata:
        bounds = ((sign, getattr(item, key, None)) for key, sign in _SIGN.items())
        bounds_text += [f"{sign} {bound}" for sign, bound in bounds if bound is not None]
    return " and ".join(bounds_text)


_SIGN = {"ge": ">=", "gt": ">", "le": "<=", "lt": "<"}


def _literals(annotation: Any) -> list[Any]:
    """Return all literal values inside an annotation."""
    if get_origin(annotation) is Literal:
        return list(get_args(annotation))
    return [word for part in get_args(annotation) for word in _literals(part)]
