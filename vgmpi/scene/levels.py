"""Levels of accuracy: what stands in a scene for the keys that it does not give.

Each is a set of choices that were measured (docs/accuracy.md, `python -m tests.levels`).
"""

from dataclasses import dataclass
from typing import Any

from pydantic import TypeAdapter, ValidationError

from vgmpi.tables import Positive

EDGES = TypeAdapter(tuple[Positive, Positive, Positive])
FEWEST = 4  # cells along an edge
PRUNING = ("prune", "prune_scale", "passive")


@dataclass(frozen=True)
class Level:
    """cells: along the longest edge, at least; compression of liquids given by max_speed or
    depth; prune: of bodies made of Gaussians or a mesh."""

    cells: int
    precision: str
    compression: float
    prune: str = "off"


LEVELS = {
    "draft": Level(32, "single", 0.04, prune="auto"),
    "standard": Level(64, "single", 0.01),
    "high": Level(96, "double", 0.01),
}


def filled(data: dict[str, Any]) -> dict[str, Any]:
    """The tables of a scene with what its level says where nothing is given. data: as in the file;
    it stays as it is."""
    given = data.get("accuracy")
    name = given.get("level") if isinstance(given, dict) else None
    level = LEVELS.get(name) if isinstance(name, str) else None
    if level is None:
        return data
    out = {**data, "accuracy": {"precision": level.precision, **given}}
    domain, materials = data.get("domain"), data.get("material")
    if isinstance(domain, dict) and "cell" not in domain:
        cell = _cell(domain.get("size"), level.cells)
        out["domain"] = {**domain, **({"cell": cell} if cell else {})}
    if isinstance(materials, dict):
        out["material"] = {key: _liquid(one, level) for key, one in materials.items()}
    objects = data.get("object")
    if isinstance(objects, list) and level.prune != "off":
        out["object"] = [_pruned(one, level) for one in objects]
    return out


def _cell(size: Any, least: int) -> float | None:
    """[m], of which every edge is a whole number, the longest of at least so many."""
    try:
        edges = EDGES.validate_python(size)
    except ValidationError:
        return None
    longest = max(edges)
    for count in range(least, 4 * least):
        counts = [edge / longest * count for edge in edges]
        if min(counts) > FEWEST - 0.5 and all(abs(n - round(n)) < 1e-6 * count for n in counts):
            return longest / count
    return None


def _liquid(given: Any, level: Level) -> Any:
    stiff = isinstance(given, dict) and ("max_speed" in given or "depth" in given)
    return {"compression": level.compression, **given} if stiff else given


def _pruned(given: Any, level: Level) -> Any:
    made = isinstance(given, dict) and ("gaussians" in given or "mesh" in given)
    if not made or given.get("role") == "scenery" or not given.keys().isdisjoint(PRUNING):
        return given
    return {"prune": level.prune, **given}
