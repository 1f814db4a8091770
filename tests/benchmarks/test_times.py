"""Where the time of the tests goes, by file: duration, processor time, compiling, processes.

make test check
python -m tests.benchmarks test-times .cache/tests.xml .cache/check.xml
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree


@dataclass
class FileCosts:
    """Costs of the tests of one file: seconds, of processors, of compiling, processes, tests."""

    seconds: float = 0.0
    processor_seconds: float = 0.0
    compile_seconds: float = 0.0
    processes: int = 0
    tests: int = 0


def _cases(files: list[Path]) -> Iterator[tuple[str, str, ElementTree.Element]]:
    """Yield file, name and record of each test in files of `pytest --junitxml`."""
    for path in files:
        for case in ElementTree.parse(path).iter("testcase"):
            if module := case.get("classname"):  # a file that is skipped as a whole has none
                yield module.replace(".", "/") + ".py", case.get("name", ""), case


def read_seconds(files: list[Path]) -> dict[str, float]:
    """Return the seconds of each test from files of `pytest --junitxml`."""
    return {f"{file}::{name}": float(case.get("time", 0)) for file, name, case in _cases(files)}


def read_costs(files: list[Path]) -> dict[str, FileCosts]:
    """Return the costs by file from files of `pytest --junitxml`."""
    costs: dict[str, FileCosts] = {}
    for file, _, case in _cases(files):
        of_file = costs.setdefault(file, FileCosts())
        of_file.seconds += float(case.get("time", 0))
        of_file.tests += 1
        for item in case.iter("property"):
            if item.get("name", "").startswith("costs "):
                compiling, processes, computing = item.get("value", "0 0 0").split()
                of_file.compile_seconds += float(compiling)
                of_file.processes += int(processes)
                of_file.processor_seconds += float(computing)
    return costs


def text(costs: dict[str, FileCosts], rows: int) -> str:
    """Return a table of the most expensive files, and their sum."""
    lines = ["| file | seconds | processor seconds | of them compiling | processes | tests |"]
    lines += ["|---|---|---|---|---|---|"]
    order = sorted(costs, key=lambda name: -costs[name].processor_seconds)
    lines += [_row(f"`{name}`", costs[name]) for name in order[:rows]]
    every = FileCosts()
    for one in costs.values():
        every.seconds += one.seconds
        every.processor_seconds += one.processor_seconds
        every.compile_seconds += one.compile_seconds
        every.processes += one.processes
        every.tests += one.tests
    return "\n".join([*lines, _row(f"all {len(costs)} files", every)])


def _row(name: str, costs: FileCosts) -> str:
    """Return one row."""
    seconds = costs.seconds, costs.processor_seconds, costs.compile_seconds
    numbers = " | ".join(f"{one:.0f}" for one in seconds) + f" | {costs.processes}"
    return f"| {name} | {numbers} | {costs.tests} |"
