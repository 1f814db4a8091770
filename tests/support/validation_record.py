"""Assert a result of a physics test against its reference and record it for the validation page.

If VGMPI_HELD names a folder, every call writes a JSON file there. `python -m
tests.benchmarks.validation` makes docs/benchmarks/data/validation.csv,
docs/benchmarks/validation.md and its plots of these files.
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
    deviation: bool = False,
    curves: Mapping[str, tuple] | None = None,
    axes: tuple[str, str] = ("", ""),
) -> None:
    """Assert that `value` is within `tolerance` of `reference`, and record both.

    Args:
        case: Name of the row.
        value: Result of the test.
        reference: Value that the result is compared with.
        tolerance: Largest error, or the bound of `kind` "below" and "above".
        kind: "relative" or "absolute" error, or "below": value < tolerance, "above": value >
            tolerance.
        unit: Unit of value and reference.
        source: Origin of the reference.
        note: Resolution and other remarks.
        expected: Whether the row should meet its tolerance. If False, the row must miss it.
        deviation: Whether a miss is a known deviation of the program. A row that is expected to
            miss without being a deviation is a negative control.
        curves: Name -> (x, y) to plot.
        axes: Labels of the plot with units.
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
    kept += ("error", "good", "expected", "deviation", "axes")
    row = {key: found[key] for key in kept}
    row["test"] = os.environ.get("PYTEST_CURRENT_TEST", "").rpartition(" (")[0]
    row["seconds"] = time.perf_counter() - _began
    row["curves"] = {
        name: [[float(v) for v in axis] for axis in pair]
        for name, pair in (found["curves"] or {}).items()
    }
    path = Path(folder) / f"{re.sub(r'[^a-z0-9]+', '-', found['case'].lower())}.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(row, default=float))
