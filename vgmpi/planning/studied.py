"""What a study that lies beside a scene found to be cheaper and hardly worse (vgmpi.study)."""

import csv
import hashlib

from ..scene.scene import Scene
from ..source import printable

FOLDER, TABLE = "tradeoff", "tradeoff.csv"
PLAIN = "as_it_is"  # the run of the scene as it stands
COLUMNS = ("setting", "cells", "cpu_s", "error", "set", "scene")
CHEAPER = 0.8  # of the time, for which something is said
WORSE, HARDLY = 1.1, 1e-3  # times the error of the scene as it stands, and shares beside it


def fingerprint(scene: Scene, overrides: tuple[str, ...] = ()) -> str:
    """Of the scene's text with all that is set beside it."""
    text = scene.text + repr((*scene.overrides, *overrides))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def told(scene: Scene) -> list[str]:
    """Lines of --plan, where a study of this very scene lies beside it: each knob that alone made
    it cheaper without making it worse to speak of."""
    path = scene.path.resolve().parent / FOLDER / TABLE
    try:
        with open(path, newline="") as file:
            rows = {row["setting"]: row for row in csv.DictReader(file)}
        own = rows.pop(PLAIN)
        if own["scene"] != fingerprint(scene):
            return []
        found = [_line(scene, own, row) for row in rows.values()]
    except (OSError, KeyError, ValueError, TypeError, csv.Error):  # none, or none of ours
        return []
    return [line for line in found if line]


def _line(scene: Scene, own: dict[str, str], row: dict[str, str]) -> str | None:
    was, off = float(own["error"]), float(row["error"])
    took = float(row["cpu_s"]) / float(own["cpu_s"])
    if took > CHEAPER or off > max(WORSE * was, was + HARDLY):
        return None
    key, _, value = row["set"].split()[0].partition("=")
    where = scene.place(tuple(key.split(".")))
    return printable(
        f"  advice      {where}: with {value} instead it took {took:.2f} of the time and was"
        f" {100 * off:.2g} % off instead of {100 * was:.2g} % in the study ({FOLDER}/{TABLE})"
    )
