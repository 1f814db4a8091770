"""The reference of a scene file as Markdown, made from the tables that read it."""

from collections.abc import Iterator
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from vgmpi import couplings, materials
from vgmpi.scene import (
    forms,
    gravity,
    loads,
    motion,
    nozzle,
    objects,
    probes,
    resume,
    settings,
    sources,
)
from vgmpi.tables import Quantity, same_units

_INTRO = """# The scene file

<!-- made by: python -m vgmpi.scene > docs/scene.md -->

A scene is a TOML file. Numbers are in SI units; a text with a unit, such as `"2 cm"`, `"0.1 MPa"`
or `"35 deg"`, is read as that unit. z points up. A key whose default is *required* must be given.
Errors are reported all at once, each with its line, and nothing is written then.

A whole scene, in which a capture falls into water; all that it leaves out has a default:

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
gaussians = "duck.ply"                    # any Gaussian file in the scene's folder
up = "-y"                                 # the axis of the file that points up
height = "25 cm"
position = ["50 cm", "50 cm", "40 cm"]    # of the middle of its base
```

Any key can be replaced on the command line: `--set domain.cell='1 cm'`,
`--set object.duck.height='20 cm'` (objects by name, or by number from 0). Paths are relative to the
scene's folder and must lie in it, unless `allow_outside = true` or the path comes from `--set`,
where it may also be relative to the current folder.
"""


def scene_reference() -> str:
    """docs/scene.md."""
    parts = [_INTRO, _section("Top of the file", settings.Top)]
    for name, table in settings.SECTIONS.items():
        parts.append(_section(f"[{name}]", table))
    parts.append(_section("[domain] gravity_keyframes", gravity.GravityKeyframe))
    parts.append(_section("[domain] boundary", settings.Boundary))
    parts.append(_section("A wall", settings.Wall))
    for kind, material in materials.registry.items():
        parts.append(_section(f'[material.NAME] kind = "{kind}"', material))
        if material.presets:
            parts.append(_presets(material.presets))
    parts.append(_section("[[object]]", objects.Object))
    inner: dict[str, type[BaseModel]] = {
        "shape": forms.Shape,
        "sphere": forms.Sphere,
        "ellipsoid": forms.Ellipsoid,
        "cylinder and capsule": forms.Rod,
        "cone": forms.Cone,
        "torus": forms.Torus,
        "select": objects.Select,
        "rotation": objects.Rotation,
        "mode": objects.Mode,
        "fraction_profile": objects.Profile,
        "motion": motion.Motion,
        "motion keyframes": motion.Keyframe,
    }
    for name, inside in inner.items():
        parts.append(_section(f"[[object]] {name}", inside))
    for kind, coupling in couplings.registry.items():
        parts.append(_section(f'[[coupling]] kind = "{kind}"', coupling))
    parts.append(_section("[[source]]", sources.Inflow))
    parts.append(_section("[[source]] disc", nozzle.Disc))
    parts.append(_section("[[source]] rectangle", nozzle.Rectangle))
    parts.append(_section("[[sink]]", sources.Sink))
    parts.append(_section("[[load]]", loads.Load))
    parts.append(_section("[[probe]]", probes.Probe))
    parts.append(_may_change())
    return "\n".join(parts)


def _section(title: str, table: type[BaseModel]) -> str:
    said = " ".join((table.__doc__ or "").split())
    rows = ["| key | unit | default | allowed | meaning |", "|---|---|---|---|---|"]
    for name, field in table.model_fields.items():
        cells = (f"`{name}`", _unit(field), _default(field), _allowed(field), _meaning(field))
        rows.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return "\n".join([f"## {title}", "", said, "", *rows, ""])


def _may_change() -> str:
    """What may be another key at a resume."""
    rows = [f"| `{key}` | {said} |" for key, said in resume.may_change().items()]
    head = (
        "A run that goes on with `--resume` may have another value of these keys. All else must be"
        " as it was: what is not is named with its line and both values. With `--change` the run"
        " goes on even so, and its checkpoints keep a list of what was changed, when."
    )
    said = ["## Going on from a checkpoint", "", head, "", "| key | what happens |", "|---|---|"]
    return "\n".join([*said, *rows, ""])


def _given(value: float | str) -> str:
    return f'`"{value}"`' if isinstance(value, str) else f"{value:.4g}"


def _presets(presets: dict[str, dict]) -> str:
    """What each preset gives."""
    keys = list(dict.fromkeys(key for values in presets.values() for key in values))
    rows = ["| preset | " + " | ".join(f"`{key}`" for key in keys) + " |"]
    rows.append("|---" * (len(keys) + 1) + "|")
    for name, values in presets.items():
        given = (_given(values[key]) if key in values else "" for key in keys)
        rows.append(f'| `"{name}"` | ' + " | ".join(given) + " |")
    return "\n".join(["Presets, in SI units; a key that is given wins:", "", *rows, ""])


def _meaning(field: FieldInfo) -> str:
    return " ".join((field.description or "").split())


def _quantities(thing: Any) -> Iterator[Quantity]:
    """Every Quantity inside an annotation or a field."""
    if isinstance(thing, Quantity):
        yield thing
    metadata = (
        thing.metadata if isinstance(thing, FieldInfo) else getattr(thing, "__metadata__", ())
    )
    for item in (*metadata, *get_args(thing)):
        yield from _quantities(item)
    if isinstance(thing, FieldInfo):
        yield from _quantities(thing.annotation)


def _unit(field: FieldInfo) -> str:
    found = next(_quantities(field), None)
    if found is None or found.unit in ("", "1"):
        return ""
    others = [unit for unit in same_units(found.unit) if unit != found.unit]
    return found.unit + (f" ({', '.join(others)})" if others else "")


def _default(field: FieldInfo) -> str:
    if field.default is PydanticUndefined:
        return "*required*" if _kind(field) is None else ""
    value = field.default
    if isinstance(value, BaseModel):
        return "see below"
    if value is None or value == () or value == "":
        return ""
    return f"`{_toml(value)}`"


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, tuple):
        return f"[{', '.join(map(_toml, value))}]"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _kind(field: FieldInfo) -> str | None:
    """The only possible value of a field, if there is only one."""
    if get_origin(field.annotation) is Literal and len(get_args(field.annotation)) == 1:
        return get_args(field.annotation)[0]
    return None


def _allowed(field: FieldInfo) -> str:
    words = [word for word in _literals(field.annotation)]
    if words:
        return ", ".join(f"`{_toml(word)}`" for word in words)
    found = next(_quantities(field), None)
    if found is not None:
        return found.bounds()
    said = []
    for item in field.metadata:
        bounds = ((sign, getattr(item, key, None)) for key, sign in _SIGN.items())
        said += [f"{sign} {bound}" for sign, bound in bounds if bound is not None]
    return " and ".join(said)


_SIGN = {"ge": ">=", "gt": ">", "le": "<=", "lt": "<"}


def _literals(annotation: Any) -> list[Any]:
    if get_origin(annotation) is Literal:
        return list(get_args(annotation))
    return [word for part in get_args(annotation) for word in _literals(part)]
