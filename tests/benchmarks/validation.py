"""python -m tests.benchmarks.validation [--fast | --draw]: the table and the plots of
docs/validation.md.

Runs the tests of tests/physics, the long ones too unless --fast, collects what they note by
`tests.support.validation_record.held`, and rewrites the part of the page between the two markers;
the rest of the page
is written by hand and kept. --draw makes the page of the rows of the last run. Returns pytest's
exit code; the page is written also where a row was missed, and says so.
"""

import argparse
import json
import os
import platform
import re
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
ROWS = ROOT / ".cache" / "held"  # of the last run: a JSON file per row, and pytest's report
PAGE, PICTURES = ROOT / "docs" / "validation.md", ROOT / "docs" / "pictures"
BEGIN, END = (
    "<!-- made by: python -m tests.benchmarks.validation -->",
    "<!-- end of what is made -->",
)
REPORT = "report.xml"
LARGEST = 60_000  # bytes of a picture
# heading -> words in the names of its files; the first that fits takes a file
FIELDS = {
    "Sand and water": "drag settling infiltration ponded heap terzaghi porous pores consolidation",
    "Mixing": "mixing diffusion rayleigh slip_time separation",
    "Contact": "contact collision incline plate float archimedes renumber pairs free",
    "Solids": "bar torsion cantilever beam spin metal foam plasticine solid",
    "Sand and snow": "sand snow granular",
    "Liquids": "dam slosh poiseuille vortices viscosity hydrostatic fluid paste column",
    "Colours": "colour",
    "Conservation and loads": "conservation loads",
}
OTHER = "Other"


class Cells(NamedTuple):
    """A row of the table; the names are the heads of its columns."""

    case: str
    found: str
    reference: str
    error: str
    tolerance: str
    outcome: str
    seconds: str
    source_remarks: str
    test: str


COLUMNS = tuple(name.replace("_", ", ") for name in Cells._fields)


def run(fast: bool, folder: Path) -> int:
    """Runs the tests; rows and report come to lie in `folder`. pytest's exit code."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    command = [sys.executable, "-m", "pytest", "tests/physics", "-q"]
    command += [f"--junitxml={folder / REPORT}", "--timeout=1800"]
    command += ["-m", "not slow"] if fast else []
    return subprocess.run(
        command, cwd=ROOT, env=os.environ | {"VGMPI_HELD": str(folder)}
    ).returncode


def collect(folder: Path) -> list[dict]:
    """Rows in the order in which they were noted, with the seconds of their test's call."""
    rows = [json.loads(file.read_text()) for file in folder.glob("*.json")]
    rows.sort(key=lambda row: row["seconds"])
    cost = {}
    if (folder / REPORT).is_file():
        for case in ElementTree.parse(folder / REPORT).iter("testcase"):
            file = case.get("classname", "").replace(".", "/")
            cost[f"{file}.py::{case.get('name')}"] = float(case.get("time", "nan"))
    for row in rows:
        row["seconds"] = cost.get(row["test"])
    return rows


def field(row: dict) -> str:
    """Heading of a row, by the name of its test's file."""
    file = Path(row["test"].split("::")[0]).stem
    for heading, words in FIELDS.items():
        if any(word in file for word in words.split()):
            return heading
    return OTHER


def number(value: float) -> str:
    """Four digits; powers of ten only where there would be many zeros."""
    return f"{value:.4g}" if value == 0 or 1e-4 <= abs(value) < 1e6 else f"{value:.1e}"


def measured(value: float, unit: str) -> str:
    return number(value) + ("" if unit in ("", "1") else f" {unit}")


def cells(row: dict) -> Cells:
    """A row of the table."""
    kind, unit = row["kind"], row["unit"]
    if kind in ("below", "above"):
        reference, error = number(row["reference"]), ""
        tolerance = ("< " if kind == "below" else "> ") + number(row["tolerance"])
    else:
        reference = measured(row["reference"], unit)
        if kind == "relative":
            error, tolerance = f"{100 * row['error']:.2g} %", f"{100 * row['tolerance']:.3g} %"
        else:
            error, tolerance = number(row["error"]), number(row["tolerance"])
    if row["good"] == row["expected"]:
        outcome = "held" if row["good"] else "fails, as it must"
    else:
        outcome = "**missed**" if row["expected"] else "**holds, but should not**"
    source = "; ".join(part for part in (row["source"], row["note"]) if part)
    seconds = "" if row["seconds"] is None else f"{row['seconds']:.1f}"
    file, _, name = row["test"].partition("::")
    test = f"`{Path(file).name}::{name}`"
    case, found = row["case"], measured(row["value"], unit)
    return Cells(case, found, reference, error, tolerance, outcome, seconds, source, test)


def table(rows: list[dict]) -> list[str]:
    lines = ["| " + " | ".join(COLUMNS) + " |", "|" + "---|" * len(COLUMNS)]
    for row in rows:
        lines.append("| " + " | ".join(text.replace("|", "\\|") for text in cells(row)) + " |")
    return lines


def slug(case: str) -> str:
    return re.sub(r"[^a-z0-9]+", "-", case.lower()).strip("-")


def draw(row: dict, file: Path) -> None:
    """The curves of a row as a small picture: lines for theory and many values, else points."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(4.8, 3.2), layout="constrained")
    for name, (x, y) in row["curves"].items():
        line = name.startswith(("exact", "theory")) or len(x) == 2 or len(x) > 60
        style = ("-", {"lw": 1.2}) if line else ("o", {"ms": 3})
        axes.plot(x, y, style[0], label=name, **style[1])
    axes.set(xlabel=row["axes"][0], ylabel=row["axes"][1])
    axes.set_title(row["case"], fontsize=9)
    axes.legend(fontsize=7, frameon=False)
    for dots in (100, 80, 60):
        figure.savefig(file, dpi=dots, metadata={"Software": None})
        if file.stat().st_size < LARGEST:
            break
    pyplot.close(figure)


def made(rows: list[dict], pictures: Path, fast: bool) -> str:
    """What stands between the markers; draws the pictures and drops those of rows that are gone."""
    pictures.mkdir(exist_ok=True)
    lines = [f"{len(rows)} rows; seconds are those of the whole test on {processor()}, one thread,"]
    lines += ["with the compilation of kernels that were not at hand."]
    lines += ["Without the long tests." if fast else "The long tests are among them.", ""]
    drawn = set()
    for heading in (*FIELDS, OTHER):
        chosen = [row for row in rows if field(row) == heading]
        if not chosen:
            continue
        lines += [f"### {heading}", "", *table(chosen), ""]
        for row in chosen:
            if row["curves"]:
                name = f"{slug(row['case'])}.png"
                draw(row, pictures / name)
                drawn.add(name)
                lines.append(f"![{row['case']}]({pictures.name}/{name})")
        lines += [""] if lines[-1] else []
    for file in pictures.glob("*.png"):
        if file.name not in drawn:
            file.unlink()
    return "\n".join(lines).rstrip()


def processor() -> str:
    """Its name as the system tells it."""
    info = Path("/proc/cpuinfo")
    names = re.findall(r"model name\s*:\s*(.+)", info.read_text()) if info.is_file() else []
    return names[0].strip() if names else platform.processor() or platform.machine()


def page(text: str, part: str) -> str:
    """The page `text` with `part` between the markers; all else is kept."""
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not (begin and end):
        raise SystemExit(f"{PAGE}: the markers are missing: {BEGIN} and {END}")
    return f"{before}{BEGIN}\n\n{part}\n\n{END}{after}"


def main(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tests.benchmarks.validation", description=__doc__
    )
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--fast", action="store_true", help="without the long tests")
    which.add_argument("--draw", action="store_true", help="only the page, of the last run's rows")
    chosen = parser.parse_args(arguments)
    mark = ROWS / "fast"
    code = 0
    if not chosen.draw:
        code = run(chosen.fast, ROWS)
        if chosen.fast:
            mark.touch()
    rows = collect(ROWS)
    if not rows:
        raise SystemExit("no rows: run without --draw first")
    text = page(PAGE.read_text(), made(rows, PICTURES, mark.exists()))
    PAGE.write_text(text)
    missed = [row["case"] for row in rows if row["good"] != row["expected"]]
    print(f"{PAGE.relative_to(ROOT)}: {len(rows)} rows, {len(missed)} missed", *missed, sep="\n  ")
    return code


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
