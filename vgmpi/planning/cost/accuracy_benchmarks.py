"""Measured errors and costs of the accuracy presets (`python -m tests.benchmarks.levels`)."""

import csv
from functools import cache
from importlib import resources
from pathlib import Path

from vgmpi.scene.accuracy_presets import LEVELS
from vgmpi.scene.scene import Scene

PATH = Path(str(resources.files(__package__))) / "accuracy_benchmarks.csv"
# Units: error is a fraction, cpu is processor time in seconds.
COLUMNS = ("case", "family", "what", "tolerance", "level", "error", "cpu")


@cache
def accuracy_benchmarks() -> tuple[dict[str, str], ...]:
    """Return the rows of the table, one per case and preset."""
    with open(PATH, newline="") as file:
        return tuple(csv.DictReader(file))


def preset_accuracy_lines(scene: Scene) -> list[str]:
    """Return the lines of --plan on the measured error and the relative cost of the scene's preset.

    The lines use the cases nearest to the scene's materials. There are none if it has no preset.
    """
    level = scene.accuracy.level
    if level is None:
        return []
    used = {entity.material for entity in scene.things if entity.material}
    families = {scene.material[name].family for name in used}
    rows = [row for row in accuracy_benchmarks() if row["family"] in families]
    rows = rows or list(accuracy_benchmarks())
    mine = [row for row in rows if row["level"] == level]
    errors = "; ".join(f"{row['what']} {100 * float(row['error']):.2g} %" for row in mine)
    lines = [f"  level       {level}: seen to be off by: {errors}"]
    cost = {
        other: sum(float(row["cpu"]) for row in rows if row["level"] == other) for other in LEVELS
    }
    relative = [
        f"{other} {cost[other] / cost[level]:.2g}"
        for other in LEVELS
        if other != level and cost[level]
    ]
    return [*lines, f"              time there, that of {level} being 1: {', '.join(relative)}"]
