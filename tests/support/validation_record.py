"""What the physics tests found beside what it is held to: asserted, and noted for the page of
validation.

With VGMPI_HELD set to a folder every call leaves a JSON file there; `python -m
tests.benchmarks.validation`
makes docs/validation.md and its plots of them.
"""

import json
import os
import re
import time
from collections.abc import Mapping
from pathlib import Path

_began = time.perf_counter()


def held(
    case: str,
    value: float,
    reference: float,
    tolerance: float,
    *,
    kind: str = "relative",
    unit: str = "1",
    source: str = "",
    note: str = "",
    expected: bool = True,
    curves: Mapping[str, tuple] | None = None,
    axes: tuple[str, str] = ("", ""),
) -> None:
    """Assert that `value` is within `tolerance` of `reference`, and note both.

    kind: "relative" or "absolute" error, or "below": value < tolerance, "above": value > tolerance.
    source: where the reference comes from. note: resolution, cost, what else to know. expected:
    False for a row that shows what is known to be wrong, such as printed equations: it is noted and
    must fail. curves: name -> (x, y) to plot, axes: their labels with units.
    """
    error = {
        "relative": abs(value - reference) / abs(reference) if reference else abs(value),
        "absolute": abs(value - reference),
        "below": value,
        "above": -value,
    }[kind]
    limit = -tolerance if kind == "above" else tolerance
    good = bool(error <= limit)
    _note(locals())
    print(f"{case}: {value:.6g} {unit} against {reference:.6g}, {kind} {tolerance:g}")
    assert good == expected, f"{case}: {value:.6g} {unit}, {reference:.6g} to {kind} {tolerance:g}"


def _note(found: dict) -> None:
    folder = os.environ.get("VGMPI_HELD")
    if not folder:
        return
    kept = ("case", "value", "reference", "tolerance", "kind", "unit", "source", "note")
    row = {key: found[key] for key in (*kept, "error", "good", "expected", "axes")}
    row["test"] = os.environ.get("PYTEST_CURRENT_TEST", "").split(" ")[0]
    row["seconds"] = time.perf_counter() - _began
    row["curves"] = {
        name: [[float(v) for v in axis] for axis in pair]
        for name, pair in (found["curves"] or {}).items()
    }
    path = Path(folder) / f"{re.sub(r'[^a-z0-9]+', '-', found['case'].lower())}.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(row, default=float))
