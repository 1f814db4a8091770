"""Choose the long tests that `make test` leaves to `make check`: writes tests/long_tests.txt.

make test check
python -m tests.benchmarks choose-tests .cache/tests.xml .cache/check.xml

Tests that take longer than LONG seconds are long, unless KEPT names them. If the others take more
than the budget, so are whole files, those that take longest first, but for what KEPT names in them.
"""

from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path

from tests.benchmarks.test_times import read_seconds
from tests.support.long_tests import PATH, names_of
from vgmpi.tools.bench.benchmark_case import BenchError

LONG = 4.0  # seconds
KEPT = {  # what `make test` runs however long it takes: folders, files, functions, tests
    "each law, coupling and transfer": (
        "tests/materials/test_laws.py",
        "tests/parallel/test_bits_all.py::test_every_law",
        "tests/solver/test_engines.py",
    ),
    "the same bits on ranks and threads": (
        "tests/parallel/test_bits.py::test_ranks[single-2]",
        "tests/parallel/test_bits.py::test_ranks[single-3]",
        "tests/parallel/test_bits.py::test_threads[single]",
        "tests/parallel/test_properties.py::test_any_way_gives_the_bits_of_one_rank[single]",
    ),
    "restart": (
        "tests/io/test_checkpoint.py",
        "tests/io/test_other_schema.py",
        "tests/parallel/test_bits.py::test_stop_between_two_sorts_and_resume[single]",
        "tests/parallel/test_faults.py::test_stop_after_steps",
    ),
    "mutations": (
        "tests/cuda/test_card_bits.py::test_what_is_broken_is_found",
        "tests/cuda/test_card_compiles.py::test_what_contracts_is_seen",
        "tests/parallel/test_mutations.py",
        "tests/parallel/test_threads.py",
        "tests/house/test_ratchets.py",
        "tests/test_house.py",
    ),
    "errors and messages": (
        "tests/campaigns/test_campaigns.py::test_a_failed_case_is_told_and_ends_in_code_1",
        "tests/campaigns/test_campaigns.py::test_a_small_campaign[damage]",
        "tests/campaigns/test_campaigns.py::test_a_small_campaign[inputs]",
        "tests/parallel/test_faults.py::test_a_blow_up_names_who_and_when",
        "tests/parallel/test_faults.py::test_an_exception_on_one_rank_ends_all",
        "tests/parallel/test_files_faults.py::test_file_size_limit",
        "tests/parallel/test_files_faults.py::test_kill_during_a_checkpoint",
        "tests/scene/test_bad_inlets.py",
        "tests/scene/test_bad_scenes.py",
    ),
    "liquids": (
        "tests/physics/test_dam_break.py",
        "tests/physics/test_poiseuille.py::test_newtonian",
    ),
    "grains": ("tests/physics/test_sand_column.py::test_run_out",),
    "solids": (
        "tests/physics/test_bounce.py::test_jumps_off[collider-8]",
        "tests/physics/test_cantilever.py::test_with_fewer_particles",
    ),
    "contact": ("tests/physics/test_archimedes.py", "tests/physics/test_incline.py::test_slides"),
    "mixing and drag": (
        "tests/physics/test_mixing.py::test_rayleigh_taylor",
        "tests/physics/test_terzaghi.py",
    ),
    "bodies that are driven": ("tests/physics/test_driven.py",),
    "inlets, outlets, loads": (
        "tests/physics/test_inlet.py",
        "tests/physics/test_loads.py",
        "tests/physics/test_torricelli.py",
    ),
}
HEAD = """\
# The tests that `make test` leaves to `make check`, by file, function or parameters.
# Written by `python -m tests.benchmarks choose-tests` from times: docs/developer/testing.md
# A test that is not named here belongs to `make test`.
"""


def is_kept(test: str) -> bool:
    """Return whether a test is of those that `make test` always runs."""
    kept = {name for names in KEPT.values() for name in names}
    folders = {str(parent) for parent in Path(names_of(test)[0]).parents}
    return not kept.isdisjoint(folders.union(names_of(test)))


def choose_long(seconds: dict[str, float], budget: float) -> set[str]:
    """Return the tests that are long.

    Args:
        seconds: seconds of each test [s].
        budget: most seconds that the other tests take together [s].

    Raises:
        BenchError: The tests that are kept take longer than the budget.
    """
    movable = {test for test in seconds if not is_kept(test)}
    long = {test for test in movable if seconds[test] > LONG}
    total = sum(seconds[test] for test in sorted(set(seconds) - long))
    by_file: dict[str, list[str]] = defaultdict(list)
    for test in sorted(movable - long):
        by_file[names_of(test)[0]].append(test)
    costs = {file: sum(seconds[test] for test in tests) for file, tests in by_file.items()}
    for file in sorted(costs, key=lambda file: (-costs[file], file)):
        if total <= budget:
            break
        long.update(by_file[file])
        total -= costs[file]
    if total > budget:
        raise BenchError(f"the tests that make test always runs take {total:.0f} s together")
    return long


def shorten(long: set[str], tests: Iterable[str]) -> list[str]:
    """Return the names for the long ones among all tests, sorted: a file whose tests are all long
    has one name, and so has a function.
    """
    others = {name for test in set(tests) - long for name in names_of(test)}
    return sorted({next(n for n in names_of(test) if n not in others) for test in long})


def write(files: list[Path], budget: float, path: Path = PATH) -> str:
    """Write the list from files of `pytest --junitxml`; returns what it contains, in a sentence."""
    seconds = read_seconds(files)
    long = choose_long(seconds, budget)
    path.write_text(HEAD + "".join(f"{name}\n" for name in shorten(long, seconds)))
    spent = sum(seconds[test] for test in long)
    quick = f"make test: {len(seconds) - len(long)} tests, {sum(seconds.values()) - spent:.0f} s"
    return f"{path.name}: {quick}; make check: {len(long)} tests, {spent:.0f} s"
