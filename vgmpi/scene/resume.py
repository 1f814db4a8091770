"""What of a scene may change when a run goes on from a checkpoint, and what has changed."""

from typing import Any

from vgmpi.scene.scene import Scene
from vgmpi.scene.settings import SECTIONS, Top
from vgmpi.tables import MayChange

# lists of which items may come and go; an item of the same name stays as it is
LISTS = {
    "probe": "a probe that is new begins here; of one that is gone the rows stay; one of the same"
    " name measures the same",
}


def may_change() -> dict[str, str]:
    """Keys that may be other ones at a resume, and what happens then: {"time.end": ...}."""
    found = {}
    for section, table in {"": Top, **SECTIONS}.items():
        for name, field in table.model_fields.items():
            said = next((m.said for m in field.metadata if isinstance(m, MayChange)), "")
            if said:
                found[f"{section}.{name}".lstrip(".")] = said
    return found | LISTS


def changes(scene: Scene, before: dict) -> list[tuple[tuple, str]]:
    """What is not as it was, and may not change: (path of the key in the scene, both values).

    before: `Scene.resolved` of the run so far.
    """
    now, allowed = scene.resolved(), may_change()
    found: list[tuple[tuple, str]] = []
    for name in {**before, **now}:
        old, new = before.get(name), now.get(name)
        if isinstance(old, list) and isinstance(new, list):
            _lists(name, old, new, name in allowed, found)
        elif name not in allowed:
            _values((name,), old, new, allowed, found)
    return found


def _values(path: tuple, old: Any, new: Any, allowed: dict, found: list) -> None:
    """Compare two values, key by key where both are tables."""
    if isinstance(old, dict) and isinstance(new, dict):
        for key in {**old, **new}:
            if ".".join(map(str, (*path, key))) not in allowed:
                _values((*path, key), old.get(key), new.get(key), allowed, found)
    elif old != new:
        found.append((path, f"is {_said(new)}, in the run so far {_said(old)}"))


def _lists(name: str, old: list, new: list, come_and_go: bool, found: list) -> None:
    """Compare two lists of tables, by their names where they have some."""
    was = {item.get("name", k): item for k, item in enumerate(old)}
    for k, item in enumerate(new):
        key = item.get("name", k)
        if key in was:
            _values((name, k), was.pop(key), item, {}, found)
        elif not come_and_go:
            found.append(((name, k), "is not in the run so far"))
    if was and not come_and_go:
        gone = ", ".join(map(str, was))
        found.append(((name,), f"has no {gone} any more, which is in the run so far"))


def _said(value: Any) -> str:
    """A value, short, as a scene would have it."""
    if value is None:
        return "not given"
    text = str(value).lower() if isinstance(value, bool) else repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
