"""Accuracy presets: values for the keys that a scene does not give.

Each is a set of choices that were measured (docs/how-to/choose-accuracy.md, `python -m
tests.benchmarks.levels`).
"""

from dataclasses import dataclass
from typing import Any

from pydantic import TypeAdapter, ValidationError

from vgmpi.runtime.config.schema import Positive

EDGES = TypeAdapter(tuple[Positive, Positive, Positive])
MIN_CELLS = 4  # [cells] along an edge
PRUNING = ("prune", "prune_scale", "passive_gaussians")


@dataclass(frozen=True)
class Level:
    """Values of one accuracy preset.

    Attributes:
        cells: Minimum number of cells along the longest edge.
        precision: Precision of the numbers.
        max_compression: Compression of liquids that are given by max_speed or max_depth.
        prune: Pruning of bodies made of Gaussians or a mesh.
    """

    cells: int
    precision: str
    max_compression: float
    prune: str = "off"


LEVELS = {
    "draft": Level(32, "single", 0.04, prune="auto"),
    "standard": Level(64, "single", 0.01),
    "high": Level(96, "double", 0.01),
}


def apply_accuracy_preset(data: dict[str, Any]) -> dict[str, Any]:
    """Return the tables of a scene, completed by its accuracy preset; `data` is not changed."""
    accuracy = data.get("accuracy")
    name = accuracy.get("level") if isinstance(accuracy, dict) else None
    level = LEVELS.get(name) if isinstance(name, str) else None
    if level is None or not isinstance(accuracy, dict):
        return data
    out = {**data, "accuracy": {"precision": level.precision, **accuracy}}
    domain, materials = data.get("domain"), data.get("material")
    if isinstance(domain, dict) and "cell" not in domain:
        cell = _cell(domain.get("size"), level.cells)
        out["domain"] = {**domain, **({"cell": cell} if cell else {})}
    if isinstance(materials, dict):
        out["material"] = {key: _liquid(table, level) for key, table in materials.items()}
    objects = data.get("object")
    if isinstance(objects, list) and level.prune != "off":
        out["object"] = [_pruned(table, level) for table in objects]
    return out


def _cell(size: Any, min_cells: int) -> float | None:
    """Return a cell size [m] that divides every edge, with at least `min_cells` on the longest."""
    try:
        edges = EDGES.validate_python(size)
    except ValidationError:
        return None
    longest = max(edges)
    for count in range(min_cells, 4 * min_cells):
        counts = [edge / longest * count for edge in edges]
        if min(counts) > MIN_CELLS - 0.5 and all(abs(n - round(n)) < 1e-6 * count for n in counts):
            return longest / count
    return None


def _liquid(table: Any, level: Level) -> Any:
    """Return a material table with the preset's compression if it is a liquid."""
    stiff = isinstance(table, dict) and ("max_speed" in table or "max_depth" in table)
    return {"max_compression": level.max_compression, **table} if stiff else table


def _pruned(table: Any, level: Level) -> Any:
    """Return an object table with the preset's pruning if it can be pruned."""
    is_capture = isinstance(table, dict) and ("gaussians" in table or "mesh" in table)
    if not is_capture or table.get("role") == "scenery" or not table.keys().isdisjoint(PRUNING):
        return table
    return {"prune": level.prune, **table}
