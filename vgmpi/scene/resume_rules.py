"""Rules for restarts: keys of a scene that may change, and the changes that were made."""

from contextlib import suppress
from dataclasses import replace
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

from vgmpi.runtime.config.schema import ChangeableOnResume

from .scene import Scene
from .scene_feature import chosen_keys, features, section_tables
from .sections import TopLevelKeys

# Lists whose items may be added or removed; an item that stays must not change.
LISTS = {
    "probe": "a new probe starts now; the rows of a removed one are kept; one of the same name must"
    " not change",
}


def may_change() -> dict[str, str]:
    """Return the keys that may change at a restart, with the effects: {"time.end": ...}."""
    effects = {}
    tables: dict[str, type[BaseModel]] = {"": TopLevelKeys, **section_tables()}
    for section, table in tables.items():
        for name, field in table.model_fields.items():
            effect = next(
                (m.effect for m in field.metadata if isinstance(m, ChangeableOnResume)), ""
            )
            if effect:
                effects[f"{section}.{name}".lstrip(".")] = effect
    return effects | LISTS


# Keys of bodies that only make the particles of the start, which a resumed run has already.
PARTICLE_KEYS = frozenset(
    "region gaussians mesh shape frame select render_model up height width depth scale rotation"
    " position origin velocity angular_velocity velocity_mode volume_fraction"
    " volume_fraction_profile initial_pressure subtract particles_per_cell fill prune prune_scale"
    " passive_gaussians color opacity".split()
)


# keys of accuracy that a resumed run keeps where the scene does not name them
NUMERICS = "precision", "volume_correction"


def changes_without_effect(scene: Scene, differences: list[tuple[tuple, str]]) -> list[tuple]:
    """Return those of the changes, as (path, message), that a resumed run cannot follow.

    Args:
        scene: Scene of the restart.
        differences: Changes from `forbidden_changes`.
    """
    wrong = []
    particle_keys = PARTICLE_KEYS.union(
        *(each.object_keys.model_fields for each in features() if each.makes_particles)
    )
    for path, message in differences:
        of_body = path[0] == "object" and len(path) > 2 and scene.object[path[1]].role == "body"
        if (of_body and path[2] in particle_keys) or path[0] == "seed":
            reason = "the particles are those of the run so far, a new run makes others"
            wrong.append((path, f"{message}: {reason}"))
    return wrong


def with_accuracy_of_run(scene: Scene, before: dict) -> Scene:
    """Return the scene with the numerics of the run so far, unless the scene names them itself.

    Args:
        scene: Scene of the restart.
        before: `Scene.to_json` of the run so far.
    """
    own, numerics = before.get("accuracy", {}), {}
    with suppress(ValidationError):  # `forbidden_changes` then names what differs
        choices = {key: own.get(key, value) for key, value in chosen_keys().items()}
        scene = scene.with_choices(choices)
    for key in NUMERICS:
        allowed = get_args(type(scene.accuracy).model_fields[key].annotation)
        if key not in scene.accuracy.model_fields_set and own.get(key) in allowed:
            numerics[key] = own[key]
    return replace(scene, accuracy=scene.accuracy.model_copy(update=numerics))


def forbidden_changes(scene: Scene, before: dict) -> list[tuple[tuple, str]]:
    """Return forbidden changes: (path of the key in the scene, message with both values).

    Args:
        scene: Scene of the restart.
        before: `Scene.to_json` of the run so far.
    """
    now, allowed = scene.to_json(), may_change()
    differences: list[tuple[tuple, str]] = []
    for name in {**before, **now}:
        old, new = before.get(name), now.get(name)
        if isinstance(old, list) or isinstance(new, list):  # empty lists may be left out
            old, new = old or [], new or []
            _compare_lists(name, old, new, name in allowed, differences)
        elif name not in allowed:
            _compare_values((name,), old, new, allowed, differences)
    return differences


def _compare_values(path: tuple, old: Any, new: Any, allowed: dict, differences: list) -> None:
    """Compare two values, key by key where both are tables.

    Args:
        path: Path of the key in the scene.
        old: Value in the run so far.
        new: Value now.
        allowed: Keys that may change.
        differences: Forbidden changes (in/out).
    """
    if isinstance(old, dict) and isinstance(new, dict):
        for key in {**old, **new}:
            if ".".join(map(str, (*path, key))) not in allowed:
                _compare_values((*path, key), old.get(key), new.get(key), allowed, differences)
    elif old != new:
        differences.append((path, f"is {_short_value(new)}, in the run so far {_short_value(old)}"))


def _compare_lists(name: str, old: list, new: list, may_vary: bool, differences: list) -> None:
    """Compare two lists of tables, by the names of items where they have names.

    Args:
        name: Key of the list.
        old: Items in the run so far.
        new: Items now.
        may_vary: Whether items may be added or removed.
        differences: Forbidden changes (in/out).
    """
    old_items = {item.get("name", k): item for k, item in enumerate(old)}
    for k, item in enumerate(new):
        key = item.get("name", k)
        if key in old_items:
            _compare_values((name, k), old_items.pop(key), item, {}, differences)
        elif not may_vary:
            differences.append(((name, k), "is not in the run so far"))
    if old_items and not may_vary:
        removed = ", ".join(map(str, old_items))
        differences.append(((name,), f"has no {removed} any more, which is in the run so far"))


def _short_value(value: Any) -> str:
    """Return a value as a short text in the notation of a scene."""
    if value is None:
        return "not given"
    text = str(value).lower() if isinstance(value, bool) else repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
