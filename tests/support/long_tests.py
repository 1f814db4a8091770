"""The long tests, which `make test` leaves to `make check`: the names in tests/long_tests.txt.

A name is a file, `FILE::FUNCTION` or `FILE::FUNCTION[PARAMETERS]`. A test that no line names
belongs to `make test`, so new tests run there until `python -m tests.benchmarks choose-tests` has
measured them as long.
"""

from collections.abc import Iterable
from pathlib import Path

PATH = Path(__file__).parents[1] / "long_tests.txt"
PARTS = ("quick", "rest")
# Files of `make check` that take minutes begin first, so that all processes end at the same time.
FIRST = (
    "tests/cuda/test_card_bits.py",
    "tests/cuda/test_card_compiles.py",
    "tests/parallel/test_scene_bits.py",
    "tests/tools/test_written_scenes.py",
    "tests/campaigns/test_campaigns.py",
    "tests/parallel/test_fit_ranks.py",
)


def read_names(path: Path = PATH) -> frozenset[str]:
    """Return the names in a list: one per line, without comments and empty lines."""
    lines = (line.strip() for line in path.read_text().splitlines())
    return frozenset(line for line in lines if line and not line.startswith("#"))


def names_of(test: str) -> tuple[str, str, str]:
    """Return the names that stand for a test: its file, its function, and itself."""
    function = test.partition("[")[0]
    return test.partition("::")[0], function, test


def is_long(test: str, names: frozenset[str]) -> bool:
    """Return whether a list names a test, its function or its file."""
    return not names.isdisjoint(names_of(test))


def select_part(tests: Iterable[str], part: str, names: frozenset[str]) -> set[str]:
    """Return the tests of a part: `quick` are those that no name stands for, `rest` the others."""
    return {test for test in tests if is_long(test, names) == (part == "rest")}


def begins(test: str) -> int:
    """Return the place of a test's file among those that begin first."""
    file = names_of(test)[0]
    return FIRST.index(file) if file in FIRST else len(FIRST)


def find_unknown_names(names: frozenset[str], tests: Iterable[str], root: Path) -> list[str]:
    """Return the names that stand for nothing.

    Args:
        names: names of the list.
        tests: tests that were collected, all of each file. A file without any is not judged: it
            was not asked for, or is skipped as a whole where a package is missing.
        root: folder that the names begin at.
    """
    known = {name for test in tests for name in names_of(test)}
    return sorted(
        name
        for name in names - known
        if (file := names_of(name)[0]) in known or not (root / file).is_file()
    )
