"""Markdown reference of the scene file, generated from the tables that read it."""

from collections.abc import Iterator
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

A scene is a TOML file. Numbers are in SI units. A text with a unit, such as `"2 cm"`, `"0.1 MPa"`
or `"35 deg"`, is converted. z points up. A key whose default is *required* has no default.
All errors are reported at once, each with its line, before anything is written.

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
    parts = [_INTRO, _section("Top of the file", sections.TopLevelKeys)]
    for name, table in section_tables().items():
        parts.append(_section(f"[{name}]", table))
    parts.append(_section("[domain] gravity_keyframes", gravity.GravityKeyframe))
    parts.append(_section("[domain] boundary", sections.Boundary))
    parts.append(_section("A wall", sections.Wall))
    for kind, material in materials.registry.items():
        parts.append(_section(f'[material.NAME] kind = "{kind}"', material))
        if material.presets:
            parts.append(_presets(material.presets))
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
        parts.append(_section(f"[[object]] {name}", inside))
    for kind, coupling in couplings.registry.items():
        parts.append(_section(f'[[coupling]] kind = "{kind}"', coupling))
    for name, tables in table_lists().items():
        parts += [
            _section(f"[[{name}]]" + (f' kind = "{kind}"' if kind else ""), table)
            for kind, table in tables.tables.items()
        ]
        parts += [_section(f"[[{name}]] {title}", t) for title, t in tables.sections.items()]
    parts.append(_section("[[probe]]", probes.Probe))
    parts.append(_restart_section())
    return "\n".join(parts)


def _section(title: str, table: type[BaseModel]) -> str:
    """Return the section of one table."""
    description = " ".join((table.__doc__ or "").split())
    rows = ["| key | unit | default | allowed | meaning |", "|---|---|---|---|---|"]
    is_part = any(table in feature.sections.values() for feature in features())
    inherited = shapes.Shape.model_fields if is_part and issubclass(table, shapes.Shape) else {}
    for name, field in table.model_fields.items():
        if name in inherited:  # its section has it
            continue
        cells = (f"`{name}`", _unit(field), _default(field), _allowed(field), _meaning(field))
        rows.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return "\n".join([f"## {title}", "", description, "", *rows, ""])


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


def _presets(presets: dict[str, dict]) -> str:
    """Return the table of a material's presets."""
    keys = list(dict.fromkeys(key for values in presets.values() for key in values))
    rows = ["| preset | " + " | ".join(f"`{key}`" for key in keys) + " |"]
    rows.append("|---" * (len(keys) + 1) + "|")
    for name, values in presets.items():
        cells = (_preset_value(values[key]) if key in values else "" for key in keys)
        rows.append(f'| `"{name}"` | ' + " | ".join(cells) + " |")
    return "\n".join(["Presets in SI units. Explicit keys override them:", "", *rows, ""])


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
    """Return the unit of a field with its alternatives."""
    quantity = next(_quantities(field), None)
    if quantity is None or quantity.unit in ("", "1"):
        return ""
    alternatives = [unit for unit in compatible_units(quantity.unit) if unit != quantity.unit]
    return quantity.unit + (f" ({', '.join(alternatives)})" if alternatives else "")


def _default(field: FieldInfo) -> str:
    """Return the default of a field as Markdown."""
    if field.default is PydanticUndefined:
        return "*required*" if _kind(field) is None else ""
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


def _kind(field: FieldInfo) -> str | None:
    """Return the only possible value of a field, or None if there are several."""
    if get_origin(field.annotation) is Literal and len(get_args(field.annotation)) == 1:
        return get_args(field.annotation)[0]
    return None


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
