"""Rows of the validation: collected from the tests, stored in docs/benchmarks/data."""

import csv
import json
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable
from dataclasses import asdict, dataclass, fields
from math import isinf
from pathlib import Path

ROOT = Path(__file__).parents[2]
CSV = ROOT / "docs" / "benchmarks" / "data" / "validation.csv"
PASS, DEVIATION, CONTROL = "pass", "known deviation", "negative control"
FAIL, UNEXPECTED, COMPARISON = "fail", "unexpected pass", "comparison"
OTHER, PUBLISHED = "Other", "Liquids beside published data"
# heading -> names of the test files, without "test_" and ".py"
TOPICS = {
    "Liquids": "hydrostatic dam_break slosh vortices poiseuille volume torricelli piston "
    "spinning_cylinder",
    PUBLISHED: "dam_break_gauges dam_break_obstacle dam_break_front dam_break_column lid_cavity "
    "channel_cylinder tank_sloshing",
    "Elastic solids": "bar cantilever torsion",
    "Granular materials": "sand_column",
    "Seepage and drag": "terzaghi infiltration drag heap",
    "Mixing": "mixing",
    "Bodies in a liquid": "archimedes sphere wheel",
    "Contact": "bounce collision pairs plate free",
    "Friction": "incline tilted roll driven_plane",
    "Prescribed motion and inlets": "driven inlet streams turning_box many_colliders",
    "Conservation": "conservation loads",
    "Color transport": "color_steps",
}


@dataclass(frozen=True)
class Row:
    """One result beside its reference."""

    topic: str
    case: str
    value: float
    unit: str
    reference: float
    error: float
    """Relative error (0.01 = 1 %) or absolute error; the value itself for bounds."""
    tolerance: float
    kind: str
    """One of relative, absolute, below, above."""
    outcome: str
    source: str
    note: str
    test: str
    plot: str
    """Name of the plot in docs/pictures, or empty."""


def topic(test: str) -> str:
    """Return the heading under which the rows of a test stand."""
    stem = Path(test.split("::")[0]).stem.removeprefix("test_")
    return next((name for name, stems in TOPICS.items() if stem in stems.split()), OTHER)


def outcome(good: bool, expected: bool, deviation: bool, tolerance: float = 0.0) -> str:
    """Return the class of a row from what the test found and expected."""
    if isinf(tolerance):
        return COMPARISON
    if good:
        return PASS if expected else UNEXPECTED
    if deviation:
        return DEVIATION
    return FAIL if expected else CONTROL


def slug(case: str) -> str:
    """Return the name of a case as a file name."""
    return re.sub(r"[^a-z0-9]+", "-", case.lower()).strip("-")


def _row(found: dict) -> Row:
    kept = ("case", "value", "unit", "reference", "error", "tolerance", "kind", "source", "note")
    shared = {key: found[key] for key in (*kept, "test")}
    shared["unit"] = "" if found["unit"] == "1" else found["unit"]
    good, expected, deviation = found["good"], found["expected"], found["deviation"]
    return Row(
        topic=topic(found["test"]),
        outcome=outcome(good, expected, deviation, found["tolerance"]),
        plot=f"{slug(found['case'])}.png" if found["curves"] else "",
        **shared,
    )


def collect(folder: Path) -> tuple[list[Row], dict[str, dict]]:
    """Return the rows of a test run and, by case, their records with curves.

    Args:
        folder: Folder with a JSON file for each row, written by `held`.
    """
    found = [json.loads(file.read_text()) for file in folder.glob("*.json")]
    found.sort(key=lambda record: record["seconds"])
    return [_row(record) for record in found], {record["case"]: record for record in found}


def durations(report: Path) -> dict[str, float]:
    """Return the seconds of each test from pytest's JUnit report."""
    seconds = {}
    if report.is_file():
        for case in ElementTree.parse(report).iter("testcase"):
            file = case.get("classname", "").replace(".", "/")
            seconds[f"{file}.py::{case.get('name')}"] = float(case.get("time", "nan"))
    return seconds


def ordered(rows: Iterable[Row]) -> list[Row]:
    """Return the rows by topic and test file; the order within a file is kept."""
    stems = [stem for names in TOPICS.values() for stem in names.split()]

    def place(row: Row) -> int:
        stem = Path(row.test.split("::")[0]).stem.removeprefix("test_")
        return stems.index(stem) if stem in stems else len(stems)

    return sorted(rows, key=place)


def merge(old: list[Row], new: list[Row]) -> list[Row]:
    """Return the new rows and those old rows whose case was not run again."""
    cases = {row.case for row in new}
    return ordered([row for row in old if row.case not in cases] + new)


def write(path: Path, rows: list[Row]) -> None:
    """Write the rows; numbers have at most six significant digits."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="") as file:
        table = csv.DictWriter(file, [field.name for field in fields(Row)], lineterminator="\n")
        table.writeheader()
        for row in rows:
            cells = asdict(row).items()
            table.writerow({k: f"{v:.6g}" if isinstance(v, float) else v for k, v in cells})


def read(path: Path) -> list[Row]:
    """Read the rows that `write` has written; none if there is no file."""
    if not path.is_file():
        return []
    numbers = ("value", "reference", "error", "tolerance")
    with path.open(newline="") as file:
        return [
            Row(**{key: float(cell) if key in numbers else cell for key, cell in record.items()})
            for record in csv.DictReader(file)
        ]
