"""The page docs/benchmarks/validation.md and its plots, made from the rows of the CSV file.

The parts between markers are generated; the rest of the page is written by hand and kept.
"""

import re
from collections import defaultdict
from fnmatch import fnmatchcase
from pathlib import Path

from tests.benchmarks.validation_rows import (
    COMPARISON,
    CONTROL,
    DEVIATION,
    OTHER,
    PASS,
    PUBLISHED,
    ROOT,
    TOPICS,
    Row,
)
from tests.benchmarks.validation_summary import SUMMARY, Effect

PAGE, PICTURES = ROOT / "docs" / "benchmarks" / "validation.md", ROOT / "docs" / "pictures"
COMMAND = "python -m tests.benchmarks.validation"
PARTS = ("summary", "topics")
LARGEST = 60_000  # bytes of a picture
FIGURES = 4  # shown for each topic
COLUMNS = ("case", "result", "reference", "error (tolerance)", "outcome", "source")
BESIDE = ("case", "published", "explicit pressure", "implicit pressure", "cells", "source")
RUN = re.compile(r"(?P<case>.+), (?P<cells>\d+) cells.*, (?P<pressure>explicit|implicit) pressure")


def number(value: float) -> str:
    """Format with four digits, with powers of ten only where there would be many zeros."""
    return f"{value:.4g}" if value == 0 or 1e-4 <= abs(value) < 1e6 else f"{value:.1e}"


def span(values: list[float], digits: int = 4) -> str:
    """Format the range of some values."""
    least, most = (f"{v:.{digits}g}" for v in (min(values), max(values)))
    return least if least == most else f"{least} to {most}"


def percent(values: list[float]) -> str:
    """Format the range of fractions in percent."""
    values = [100 * value for value in values]
    if max(values) < 1e-3:
        return "below 0.001 %"
    if min(values) < 1e-3:
        return f"at most {max(values):.2g} %"
    return span(values, 2) + " %"


def _joined(cells: list[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _escaped(text: str) -> str:
    return text.replace("|", "\\|")


def _table(head: tuple[str, ...], lines: list[list[str]]) -> list[str]:
    return [_joined(list(head)), "|" + "---|" * len(head), *map(_joined, lines)]


def _anchor(topic: str) -> str:
    return topic.lower().replace(" ", "-")


def effect_line(effect: Effect, rows: list[Row]) -> list[str]:
    """Return the cells of an effect: name, test, result, reference."""
    found = []
    for pattern, text in effect.results:
        chosen = [row for row in rows if fnmatchcase(row.case, pattern)]
        if not chosen:
            raise ValueError(f"{effect.name}: no row of the CSV file is called {pattern!r}")
        values = [row.value for row in chosen]
        part = text.format(
            error=percent([row.error for row in chosen]),
            value=span(values, 3),
            percent=percent(values),
        )
        off = sum(row.outcome == DEVIATION for row in chosen)
        if off:
            many = f"{off} of {len(chosen)}: " if len(chosen) > 1 and off < len(chosen) else ""
            part += f" (*{many}known deviation*)"
        found.append(part)
    name = f"[{effect.name}](#{_anchor(effect.topic)})"
    return [name, effect.test, "; ".join(found), effect.reference]


def counts(rows: list[Row]) -> str:
    """Return a sentence with the number of rows by outcome."""
    total = defaultdict(int)
    for row in rows:
        total[row.outcome] += 1
    plural = {
        PASS: ("passes", "pass"),
        DEVIATION: ("is a known deviation", "are known deviations"),
        CONTROL: ("is a negative control", "are negative controls"),
        COMPARISON: ("is a comparison without a tolerance", "are comparisons without a tolerance"),
    }
    parts = []
    for name, many in sorted(total.items(), key=lambda item: -item[1]):
        one, more = plural.get(name, (f"is a {name}", f"are a **{name}**"))
        parts.append(f"{many} {one if many == 1 else more}")
    return f"Of {len(rows)} results {', '.join(parts)}."


def summary(rows: list[Row]) -> str:
    """Return the summary: counts and a table with a line for each effect."""
    head = ("effect", "test", "result", "reference")
    return "\n".join([counts(rows), "", *_table(head, [effect_line(one, rows) for one in SUMMARY])])


def _tolerance(row: Row) -> str:
    if row.kind == "relative":
        return f"{100 * row.tolerance:.3g} %"
    return {"below": "< ", "above": "> "}.get(row.kind, "") + number(row.tolerance)


def _with_unit(text: str, unit: str) -> str:
    return f"{text} {unit}".rstrip()


def _outcome(name: str) -> str:
    return name if name in (PASS, CONTROL) else f"**{name}**"


def cells(row: Row) -> list[str]:
    """Return the cells of a row, in the order of COLUMNS."""
    bound = row.kind in ("below", "above")
    error = {"relative": f"{100 * row.error:.2g} % ", "absolute": f"{number(row.error)} "}
    return [
        _escaped(row.case),
        _escaped(_with_unit(number(row.value), row.unit)),
        _escaped(_with_unit(number(row.reference), "" if bound else row.unit)),
        f"{error.get(row.kind, '')}({_tolerance(row)})",
        _outcome(row.outcome),
        _escaped(row.source),
    ]


def tolerance_used(row: Row) -> float:
    """Return the fraction of its tolerance that a passing row takes; 1 is the limit."""
    if row.kind in ("relative", "absolute"):
        return row.error / row.tolerance if row.tolerance else 0.0
    room = row.tolerance - row.reference
    if room:
        return (row.value - row.reference) / room
    return row.value / row.tolerance if row.kind == "below" else row.tolerance / row.value


def passing_cells(rows: list[Row]) -> list[str]:
    """Return passing rows as one line: the one closest to its tolerance."""
    name, *rest = cells(max(rows, key=tolerance_used))
    return [f"{name} (closest of {len(rows)})" if len(rows) > 1 else name, *rest]


def lines(rows: list[Row]) -> list[list[str]]:
    """Return the lines of a table: one for all passing rows, each other row.

    Negative controls are left out: they miss their tolerance on purpose.
    """
    groups = defaultdict(list)
    for row in (row for row in rows if row.outcome != CONTROL):
        groups[PASS if row.outcome == PASS else row.case].append(row)
    return [
        passing_cells(members) if members[0].outcome == PASS else cells(members[0])
        for members in groups.values()
    ]


def beside_lines(rows: list[Row]) -> list[list[str]]:
    """Return a line for each published number: those of both pressures at all resolutions."""
    groups = defaultdict(list)
    for row in rows:
        run = RUN.fullmatch(row.case)
        if run is None:
            raise ValueError(f"{row.case}: must end with the cells and the pressure")
        groups[run["case"], row.source].append((int(run["cells"]), run["pressure"], row))
    table = []
    for (case, source), runs in groups.items():
        cells = sorted({cells for cells, _, _ in runs})
        value = {(cells, pressure): number(row.value) for cells, pressure, row in runs}
        columns = [
            ", ".join(value.get((n, pressure), "-") for n in cells)
            for pressure in ("explicit", "implicit")
        ]
        first = runs[0][2]
        published = _with_unit(number(first.reference), first.unit)
        table.append([case, published, *columns, ", ".join(map(str, cells)), source])
    return table


def topic_table(topic: str, rows: list[Row]) -> list[str]:
    """Return the table of a topic."""
    if topic == PUBLISHED:
        return _table(BESIDE, beside_lines(rows))
    return _table(COLUMNS, lines(rows))


def figures(rows: list[Row]) -> list[str]:
    """Return the figures of a topic: the first plot of each test."""
    first = {}
    for row in rows:
        if row.plot:
            first.setdefault(row.test.split("[")[0], row)
    shown = list(first.values())[:FIGURES]
    return [_escaped(f"![{row.case}](../pictures/{row.plot})") for row in shown]


def topics(rows: list[Row]) -> str:
    """Return a section with a table and figures for each topic."""
    text = []
    for heading in (*TOPICS, OTHER):
        chosen = [row for row in rows if row.topic == heading]
        if chosen:
            text += [f"## {heading}", "", *topic_table(heading, chosen), ""]
            text += [*figures(chosen), ""]
    return "\n".join(text).rstrip()


def markers(part: str) -> tuple[str, str]:
    """Return the comments before and after a generated part."""
    return f"<!-- made by: {COMMAND} ({part}) -->", f"<!-- end of {part} -->"


def page(text: str, rows: list[Row]) -> str:
    """Return the page `text` with its generated parts made from the rows."""
    for part, made in zip(PARTS, (summary(rows), topics(rows)), strict=True):
        begin, end = markers(part)
        before, found, rest = text.partition(begin)
        _, closed, after = rest.partition(end)
        if not (found and closed):
            raise SystemExit(f"{PAGE}: the markers are missing: {begin} and {end}")
        text = f"{before}{begin}\n\n{made}\n\n{end}{after}"
    return text


def draw(record: dict, file: Path) -> None:
    """Plot the curves of a record: lines for theory and many values, symbols for the rest."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(4.8, 3.2), layout="constrained")
    for name, (x, y) in record["curves"].items():
        line = name.startswith(("exact", "theory")) or len(x) == 2 or len(x) > 60
        style = ("-", {"lw": 1.2}) if line else ("o", {"ms": 3})
        axes.plot(x, y, style[0], label=name, **style[1])
    axes.set(xlabel=record["axes"][0], ylabel=record["axes"][1])
    axes.set_title(record["case"], fontsize=9)
    axes.legend(fontsize=7, frameon=False)
    for dots in (100, 80, 60):
        figure.savefig(file, dpi=dots, metadata={"Software": None})
        if file.stat().st_size < LARGEST:
            break
    pyplot.close(figure)


def draw_all(rows: list[Row], old: list[Row], records: dict[str, dict], pictures: Path) -> None:
    """Draw the plots of the rows that have records and delete plots of rows that are gone."""
    pictures.mkdir(exist_ok=True)
    for row in rows:
        if row.plot and row.case in records:
            draw(records[row.case], pictures / row.plot)
    for name in {row.plot for row in old} - {row.plot for row in rows} - {""}:
        (pictures / name).unlink(missing_ok=True)
