"""Results of the board: lines of JSON on the disk, the front of every case, table and CSV."""

import csv
import io
import json
from pathlib import Path
from typing import Any

from .board_cases import CASES

QUANTITIES = (
    "level", "lower_half", "run_out", "height", "frequency", "energy_loss", "deflection", "decay",
    "force", "unsteadiness", "draught",
)  # fmt: skip
COLUMNS = (
    "case", "solver", "options", "particles", "cell", "steps", "simulated", "cpu", "wall", "error",
    *QUANTITIES, "same_bits", "on_front", "elapsed", "failure",
)  # fmt: skip
HEADINGS = (
    "solver", "options", "particles", "steps", "s / s", "wall s / s", "error", "same bits", "front"
)  # fmt: skip


def read_results(path: Path) -> list[dict[str, Any]]:
    """Return the results in a file of JSON lines; torn lines are skipped."""
    results = []
    for line in path.read_text().splitlines() if path.exists() else ():
        try:
            results.append(json.loads(line))
        except ValueError:
            continue
    return results


def run_key(result: dict[str, Any]) -> tuple[str, ...]:
    """Return what identifies a run: case, solver and options."""
    return (result["case"], result["solver"], *result["options"])


def seconds_per_second(result: dict[str, Any], clock: str = "cpu") -> float:
    """Return processor or wall time over simulated time."""
    return result[clock] / result["simulated"]


def on_one_core(result: dict[str, Any]) -> bool:
    """Tell whether a run has one thread: only such runs are compared by processor time."""
    return not any(word.startswith("threads=") for word in result["options"])


def comparable_error(result: dict[str, Any]) -> float:
    """Return the error of a run, at least what its reference can tell."""
    return max(result["error"], CASES[result["case"]].resolution)


def mark_front(results: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the results with `on_front`: no other run of the case is as cheap and as exact.

    Errors below the resolution of the case count as equal. A case without an error has the cheapest
    run per particle on its front. Runs on two cores are not on it.
    """
    marked = []
    single = [r for r in results if "cpu" in r and on_one_core(r)]
    for result in results:
        rivals = [r for r in single if r["case"] == result["case"]]
        if "cpu" not in result or not on_one_core(result):
            marked.append(result | {"on_front": False})
            continue
        if "error" in result:
            cost, error = seconds_per_second(result), comparable_error(result)
            better = [
                r
                for r in rivals
                if seconds_per_second(r) <= cost
                and comparable_error(r) <= error
                and (seconds_per_second(r) < cost or comparable_error(r) < error)
            ]
        else:
            cost = seconds_per_second(result) / result["particles"]
            better = [r for r in rivals if seconds_per_second(r) / r["particles"] < cost]
        marked.append(result | {"on_front": not better})
    return marked


def advantages(results: list[dict[str, Any]]) -> dict[tuple[str, str], float]:
    """Return, by case and rival, how many times its processor time this program needs less.

    Each run of a rival is held against this program's cheapest run whose error is not larger; the
    smallest ratio counts. A rival's run that no run of this program reaches counts as 0. Cases
    without an error compare time per particle. Runs on two cores do not count.
    """
    ratios: dict[tuple[str, str], float] = {}
    single = [r for r in results if "cpu" in r and on_one_core(r)]
    for result in single:
        if result["solver"] == "vgmpi":
            continue
        own = [r for r in single if r["solver"] == "vgmpi" and r["case"] == result["case"]]
        if "error" in result:
            error = comparable_error(result)
            costs = [seconds_per_second(r) for r in own if comparable_error(r) <= error]
            cost = seconds_per_second(result)
        else:
            costs = [seconds_per_second(r) / r["particles"] for r in own]
            cost = seconds_per_second(result) / result["particles"]
        key = (result["case"], result["solver"])
        ratio = cost / min(costs) if costs else 0.0
        ratios[key] = min(ratio, ratios.get(key, ratio))
    return ratios


def pair_cores(results: list[dict[str, Any]]) -> list[tuple[dict[str, Any], dict[str, Any]]]:
    """Return the pairs of runs that differ in their threads alone, the one on one core first."""
    runs = {run_key(result): result for result in results if "cpu" in result}
    pairs = []
    for result in runs.values():
        words = [word for word in result["options"] if word != "threads=2"]
        single = runs.get((result["case"], result["solver"], *words))
        if single is not None and "threads=2" in result["options"]:
            pairs.append((single, result))
    return pairs


def format_csv(results: list[dict[str, Any]]) -> str:
    """Return the results as a table of comma-separated values."""
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    for result in results:
        row = {
            key: f"{value:.5g}" if isinstance(value, float) else value
            for key, value in result.items()
        }
        writer.writerow(row | {"options": " ".join(result["options"])})
    return text.getvalue()


def format_tables(results: list[dict[str, Any]]) -> str:
    """Return Markdown: a table per case, how many times cheaper this program is, two cores."""
    lines = []
    for name, case in CASES.items():
        rows = [result for result in results if result["case"] == name and on_one_core(result)]
        if not rows:
            continue
        lines += [f"### {name}: {case.title}", ""]
        lines += [
            f"| {' | '.join(HEADINGS)} |",
            f"|{len(HEADINGS) * '---|'}",
        ]
        lines += [_format_row(row) for row in rows] + [""]
    ratios = advantages(results)
    if ratios:
        lines += ["| case | rival | processor time over vgmpi's at equal error |", "|---|---|---|"]
        lines += [
            f"| {case} | {solver} | {f'{ratio:.1f}' if ratio else 'not reached by vgmpi'} |"
            for (case, solver), ratio in ratios.items()
        ]
        lines.append("")
    pairs = pair_cores(results)
    if pairs:
        lines += ["### wall seconds per simulated second on one and on two cores", ""]
        lines += [
            "| case | solver | options | one core | two cores | ratio |",
            "|---|---|---|---|---|---|",
        ]
        lines += [_format_pair(*pair) for pair in pairs] + [""]
    lines += [_format_whole_time(results)] if results else []
    return "\n".join(lines)


def _format_whole_time(results: list[dict[str, Any]]) -> str:
    """Return how long all runs took, with what they compiled and their second runs."""
    minutes = sum(result.get("elapsed", 0.0) for result in results) / 60
    untimed = sum("elapsed" not in result for result in results)
    more = f", {untimed} more were not timed" if untimed else ""
    return f"{len(results) - untimed} runs took {minutes:.1f} minutes{more}."


def _format_pair(single: dict[str, Any], double: dict[str, Any]) -> str:
    """Return a run on one and on two cores as a row of a table."""
    seconds = [seconds_per_second(result, "wall") for result in (single, double)]
    cells = [single["case"], single["solver"], " ".join(single["options"])]
    cells += [f"{value:.3g}" for value in (*seconds, seconds[0] / seconds[1])]
    return f"| {' | '.join(cells)} |"


def _format_row(row: dict[str, Any]) -> str:
    """Return a run as a row of a table."""
    options = " ".join(row["options"])
    if "cpu" not in row:
        return f"| {row['solver']} | {options} | | | | | {row['failure']} | | |"
    error = f"{row['error']:.3g}" if "error" in row else ""
    bits = {True: "yes", False: "no", None: "one run"}[row["same_bits"]]
    cells = [
        row["solver"], options, f"{row['particles']:,}", f"{row['steps']:,}",
        f"{seconds_per_second(row):.3g}", f"{seconds_per_second(row, 'wall'):.3g}", error, bits,
        "yes" if row["on_front"] else "",
    ]  # fmt: skip
    return f"| {' | '.join(cells)} |"
