"""python -m tests.benchmarks.validation [--fast | --draw | --page]: data and page of validation.

Runs the tests of tests/physics and collects the rows that they record with
`tests.support.validation_record.held`. Writes the rows to docs/benchmarks/data/validation.csv, the
plots to docs/pictures, and the generated parts of docs/benchmarks/validation.md. With --fast the
long tests do not run and their rows stay as they are. --draw uses the records of the last run.
--page makes only the page, from the CSV file. Returns pytest's exit code; data and page are also
written if a row fails.
"""

import argparse
import os
import shutil
import subprocess
import sys
from pathlib import Path

from tests.benchmarks import validation_page, validation_rows
from tests.benchmarks.validation_rows import CSV, FAIL, ROOT, UNEXPECTED

RECORDS = ROOT / ".cache" / "held"  # of the last run: a JSON file for each row, pytest's report
REPORT = "report.xml"


def run(fast: bool, folder: Path) -> int:
    """Run the tests, which write their records to `folder`. Return pytest's exit code."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    command = [sys.executable, "-m", "pytest", "tests/physics", "-q"]
    command += [f"--junitxml={folder / REPORT}", "--timeout=1800"]
    command += ["-m", "not slow"] if fast else []
    environment = os.environ | {"VGMPI_HELD": str(folder)}
    return subprocess.run(command, cwd=ROOT, env=environment).returncode


def update(folder: Path, fast: bool) -> None:
    """Write the CSV file and the plots from the records in `folder`."""
    new, records = validation_rows.collect(folder)
    if not new:
        raise SystemExit("no rows: run without --draw first")
    old = validation_rows.read(CSV)
    rows = validation_rows.merge(old if fast else [], new)
    validation_page.draw_all(rows, old, records, validation_page.PICTURES)
    validation_rows.write(CSV, rows)
    seconds = validation_rows.durations(folder / REPORT)
    for test in sorted(seconds, key=seconds.get, reverse=True)[:10]:
        print(f"{seconds[test]:8.1f} s  {test}")


def main(arguments: list[str]) -> int:
    """Run the command; return the exit code of pytest."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.benchmarks.validation", description=__doc__
    )
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--fast", action="store_true", help="without the long tests")
    which.add_argument("--draw", action="store_true", help="no tests: records of the last run")
    which.add_argument("--page", action="store_true", help="only the page, from the CSV file")
    chosen = parser.parse_args(arguments)
    code, mark = 0, RECORDS / "fast"
    if not (chosen.draw or chosen.page):
        code = run(chosen.fast, RECORDS)
        if chosen.fast:
            mark.touch()
    if not chosen.page:
        update(RECORDS, mark.exists())
    rows = validation_rows.read(CSV)
    page = validation_page.PAGE
    page.write_text(validation_page.page(page.read_text(), rows))
    wrong = [row.case for row in rows if row.outcome in (FAIL, UNEXPECTED)]
    head = f"{page.relative_to(ROOT)}: {len(rows)} rows, {len(wrong)} not as expected"
    print(head, *wrong, sep="\n  ")
    return code


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
