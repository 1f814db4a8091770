"""What `make test` leaves to `make check`: nothing is lost, nothing runs twice, and each folder and
each law stays."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.benchmarks import choose_tests
from tests.support import long_tests
from tests.support.small_scenes import LAWS
from vgmpi.tools.bench.benchmark_case import BenchError

ROOT = Path(__file__).parents[1]
ONE, OTHER = "test_one.py", "test_other.py"  # in a tree of a test
NAMES = long_tests.read_names()
SMALL = """
import pytest
def test_brief(): ...
def test_long(): ...
@pytest.mark.parametrize("text", ["a", "a::b [c]"])
def test_cases(text): ...
@pytest.mark.slow
def test_slow(): ...
"""


def collected(root, *flags):
    """Return exit code, tests and text of a collection."""
    words = ("--collect-only", "-q", "-m", "not slow", "-p", "no:cacheprovider", *flags)
    command = [sys.executable, "-m", "pytest", *words]
    job = subprocess.run(command, cwd=root, capture_output=True, text=True)
    lines = job.stdout.splitlines()
    return job.returncode, [line for line in lines if line.startswith("tests/")], job.stdout


@pytest.fixture
def tree(tmp_path):
    """A small tree with this one's tests/conftest.py and a list of its own."""
    for name in ("conftest.py", "__init__.py", "support/__init__.py"):
        (tmp_path / "tests/support").mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / "tests" / name, tmp_path / "tests" / name)
    for name in ("support/cost_counter.py", "support/long_tests.py"):
        shutil.copy(ROOT / "tests" / name, tmp_path / "tests" / name)
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    for name in ("one", "other", "new"):
        (tmp_path / f"tests/test_{name}.py").write_text(SMALL)
    lines = f"{ONE}::test_long", f"{ONE}::test_cases[a::b [c]]", OTHER
    text = "# a comment\n\n" + "".join(f"tests/{line}\n" for line in lines)
    (tmp_path / "tests/long_tests.txt").write_text(text)
    return tmp_path


def test_both_parts_are_everything_once(tree):
    """A file that the list does not name is quick."""
    (_, every, _), (_, quick, _), (_, rest, _) = (
        collected(tree, *flags) for flags in ((), ("--part", "quick"), ("--part", "rest"))
    )
    assert sorted(quick + rest) == sorted(every) and len(set(every)) == len(every) == 12
    here = f"tests/{ONE}::"
    other = [name.replace("new", "other") for name in quick if "test_new" in name]
    assert [name for name in quick if "test_one" in name] == [
        here + "test_brief", here + "test_cases[a]",
    ]  # fmt: skip
    assert len(other) == 4 and rest == [
        here + "test_long", here + "test_cases[a::b [c]]", *other,
    ]  # fmt: skip


def test_names_that_stand_for_nothing_are_an_error(tree):
    gone = ("test_gone.py", f"{ONE}::test_cases[b]", f"{ONE}::test_gone")
    names = [f"tests/{name}" for name in gone]
    with open(tree / "tests/long_tests.txt", "a") as file:
        file.writelines(f"{name}\n" for name in names)
    for part in long_tests.PARTS:
        code, _, text = collected(tree, "--part", part)
        assert code != 0 and f"names no test: {', '.join(sorted(names))}\n" in text
    assert collected(tree)[0] == 0


def test_of_some_files_only_their_names_are_judged(tree):
    path = f"tests/{ONE}"
    assert collected(tree, "--part", "rest", path)[0] == 0
    code, tests, _ = collected(tree, "--part", "rest", f"{path}::test_long")
    assert code == 0 and tests == [f"{path}::test_long"]


def test_the_list_is_sorted():
    lines = [line for line in long_tests.PATH.read_text().splitlines() if line[0] != "#"]
    assert lines == sorted(NAMES)


def test_files_that_take_minutes_begin_first():
    """As the list names them; the others in the order of their names."""
    code, tests, text = collected(ROOT, "--part", "rest", "tests/parallel", "tests/tools")
    assert code == 0, text
    files = list(dict.fromkeys(long_tests.names_of(test)[0] for test in tests))
    first = [
        name for name in long_tests.FIRST if name.startswith(("tests/tools", "tests/parallel"))
    ]
    assert files[: len(first)] == first and files[len(first) :] == sorted(files[len(first) :])
    assert {long_tests.names_of(name)[0] for name in NAMES}.issuperset(long_tests.FIRST)


def folders():
    files = (path.relative_to(ROOT) for path in (ROOT / "tests").glob("*/test_*.py"))
    return sorted({str(file.parent) for file in files} - {"tests/benchmarks"})


@pytest.mark.parametrize("folder", folders())
def test_each_folder_stays(folder):
    """With a file at least that no line names as a whole: its other tests are quick."""
    files = [str(path.relative_to(ROOT)) for path in (ROOT / folder).glob("test_*.py")]
    assert not NAMES.issuperset(files)


def test_each_law_and_all_mutations_stay():
    mutations = [f"tests/parallel/test_{name}.py" for name in ("mutations", "threads")]
    laws = ["tests/materials/test_laws.py", "tests/solver/test_engines.py"]
    code, tests, text = collected(ROOT, *laws, *mutations)
    assert code == 0, text
    quick = long_tests.select_part(tests, "quick", NAMES)
    for law in LAWS:
        assert f"{laws[1]}::test_engines_agree[{law}]" in quick
        assert any(test.startswith(laws[0]) and law in test for test in quick), law
    seen = {test for test in tests if "test_a_mutation_is_seen" in test}
    assert len(seen) > 20 and seen <= quick
    assert not long_tests.is_long("tests/parallel/test_bits_all.py::test_every_law", NAMES)


def test_what_is_kept_exists_and_is_quick():
    """A test that was renamed would no longer be kept, and nobody would notice."""
    for name in (name for names in choose_tests.KEPT.values() for name in names):
        assert not long_tests.is_long(name, NAMES), name
        file, _, function = long_tests.names_of(name)[1].partition("::")
        assert f"def {function}(" in (ROOT / file).read_text() or not function, name


KEPT = {"any": ("f.py::test_a",)}


def test_tests_are_chosen_by_their_seconds(monkeypatch):
    """Long tests first, then the files that take longest; never what is kept."""
    monkeypatch.setattr(choose_tests, "KEPT", KEPT)
    seconds = {
        "f.py::test_a[1]": 9.0, "f.py::test_b[1]": 5.0, "f.py::test_b[2]": 1.0,
        "g.py::test_a": 3.0, "g.py::test_b": 3.0, "h.py::test_a": 5.5,
    }  # fmt: skip
    names = [
        choose_tests.shorten(choose_tests.choose_long(seconds, budget), seconds)
        for budget in (99, 12, 9)
    ]
    assert names == [
        ["f.py::test_b[1]", "h.py"],
        ["f.py::test_b[1]", "g.py", "h.py"],
        ["f.py::test_b", "g.py", "h.py"],
    ]
    with pytest.raises(BenchError, match="always runs take 9 s"):
        choose_tests.choose_long(seconds, 8)


def test_the_list_is_written_from_reports(monkeypatch, tmp_path):
    monkeypatch.setattr(choose_tests, "KEPT", KEPT)
    case = '<testcase classname="{}" name="test_a" time="{}"/>'
    files = [tmp_path / "tests.xml", tmp_path / "check.xml"]
    skipped = '<testcase classname="" name="h" time="0"/>'
    files[0].write_text(f"<testsuites>{case.format('f', 5)}{skipped}</testsuites>")
    files[1].write_text(f"<testsuites>{case.format('g', 7)}</testsuites>")
    text = choose_tests.write(files, 20.0, tmp_path / "list.txt")
    assert text == "list.txt: make test: 1 tests, 5 s; make check: 1 tests, 7 s"
    assert long_tests.read_names(tmp_path / "list.txt") == {"g.py"}
