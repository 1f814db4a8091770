"""What the levels of accuracy were seen to be off by, and to cost (`python -m tests.levels`)."""

import csv
from functools import cache
from importlib import resources
from pathlib import Path

from ..scene.levels import LEVELS
from ..scene.scene import Scene

PATH = Path(str(resources.files(__package__))) / "marks.csv"
# error: a share; cpu: time of the processors [s]
COLUMNS = ("case", "family", "what", "tolerance", "level", "error", "cpu")


@cache
def marks() -> tuple[dict[str, str], ...]:
    """Rows of the table: a case at a level each."""
    with open(PATH, newline="") as file:
        return tuple(csv.DictReader(file))


def told(scene: Scene) -> list[str]:
    """Lines of --plan: what the scene's level was seen to be off by on the cases nearest to its
    materials, and what it costs beside the others. None where it has no level."""
    level = scene.accuracy.level
    if level is None:
        return []
    used = {thing.material for thing in scene.things if thing.material}
    families = {scene.material[name].family for name in used}
    rows = [row for row in marks() if row["family"] in families]
    rows = rows or list(marks())
    mine = [row for row in rows if row["level"] == level]
    off = "; ".join(f"{row['what']} {100 * float(row['error']):.2g} %" for row in mine)
    lines = [f"  level       {level}: seen to be off by: {off}"]
    cost = {one: sum(float(row["cpu"]) for row in rows if row["level"] == one) for one in LEVELS}
    beside = [
        f"{one} {cost[one] / cost[level]:.2g}" for one in LEVELS if one != level and cost[level]
    ]
    return [*lines, f"              time there, that of {level} being 1: {', '.join(beside)}"]
