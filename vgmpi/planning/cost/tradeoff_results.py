"""Result of a trade-off study beside a scene: settings that are cheaper and hardly less accurate.

The study is made by vgmpi.tools.tradeoff.
"""

import csv
import hashlib

from vgmpi.runtime.config.toml_source import escape_control_characters
from vgmpi.scene.scene import Scene

FOLDER, TABLE = "tradeoff", "tradeoff.csv"
BASELINE = "baseline"  # name of the run with the scene's own settings
COLUMNS = ("setting", "cells", "cpu_s", "error", "set", "scene")
MAX_RELATIVE_TIME = 0.8  # [-] relative time below which a setting is recommended
# [-] admissible error: relative to that of the scene's own settings, and as an absolute increase
MAX_RELATIVE_ERROR, MAX_ERROR_INCREASE = 1.1, 1e-3


def fingerprint(scene: Scene, overrides: tuple[str, ...] = ()) -> str:
    """Return a hash of the scene's text and of all overrides."""
    text = scene.text + repr((*scene.overrides, *overrides))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def cheaper_setting_lines(scene: Scene) -> list[str]:
    """Return the lines of --plan on settings that alone are cheaper at about the same error.

    There are none unless a study of this very scene lies beside it.
    """
    path = scene.path.resolve().parent / FOLDER / TABLE
    try:
        with open(path, newline="") as file:
            rows = {row["setting"]: row for row in csv.DictReader(file)}
        own = rows.pop(BASELINE)
        if own["scene"] != fingerprint(scene):
            return []
        lines = [_line(scene, own, row) for row in rows.values()]
    except (
        OSError,
        KeyError,
        ValueError,
        TypeError,
        csv.Error,
    ):  # there is no table, or it is not a study's
        return []
    return [line for line in lines if line]


def _line(scene: Scene, own: dict[str, str], row: dict[str, str]) -> str | None:
    """Return the line on one setting, None if it is not recommended."""
    before, error = float(own["error"]), float(row["error"])
    time = float(row["cpu_s"]) / float(own["cpu_s"])
    if time > MAX_RELATIVE_TIME or error > max(
        MAX_RELATIVE_ERROR * before, before + MAX_ERROR_INCREASE
    ):
        return None
    key, _, value = row["set"].split()[0].partition("=")
    where = scene.place(tuple(key.split(".")))
    return escape_control_characters(
        f"  advice      {where}: with {value} instead it took {time:.2f} of the time and was"
        f" {100 * error:.2g} % off instead of {100 * before:.2g} % in the study ({FOLDER}/{TABLE})"
    )
