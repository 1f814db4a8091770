"""Sizes, imports, names and prose of the code get no worse than tests/house/ratchets.toml says."""

import warnings

import pytest

from tests.house import ratchet
from tests.house.imports import find_single_importers, list_deferred_imports
from tests.house.source_file import SourceFile, list_files, name_module
from tests.house.survey import Survey, survey_files, survey_program

RATCHETS = ratchet.read_ratchets()


def check(verdict):
    """Fail on errors; warn of notes, the first three of them."""
    for note in verdict.notes[:3]:
        warnings.warn(note, stacklevel=2)
    assert not verdict.errors, "\n".join(verdict.errors)


@pytest.mark.parametrize("name", RATCHETS["limits"])
def test_sizes_are_within_their_limits(name):
    check(ratchet.judge_limit(name, survey_program(), RATCHETS))


@pytest.mark.parametrize("name", RATCHETS["counts"])
def test_counts_only_fall(name):
    check(ratchet.judge_count(name, survey_program(), RATCHETS))


def test_every_size_and_every_count_is_judged():
    measured = survey_program()
    assert measured.sizes.keys() == RATCHETS["limits"].keys()
    assert measured.places.keys() == RATCHETS["counts"].keys()
    assert RATCHETS["exceptions"].keys() <= RATCHETS["limits"].keys()


PATH = "vgmpi/solver/made_up.py"


def measure(text, path=PATH):
    """Return the survey of a single file."""
    return survey_files([SourceFile(path, text)])


def fields(count):
    return "".join(f"    a{i}: int\n" for i in range(count))


def attributes(count):
    return "    def f(self):\n" + "".join(f"        self.a{i} = 0\n" for i in range(count))


def arguments(count):
    return ", ".join(f"a{i}" for i in range(count))


def module_imports(count):
    return "".join(f"import {name_module(path)}\n" for path in list_files("vgmpi/kernels")[:count])


@pytest.mark.parametrize(
    "name, place, size, text",
    [
        ("lines of a file", PATH, 801, 801 * "x = 1\n"),
        ("lines of a function", f"{PATH}: f", 121, "def f():\n" + 120 * "    x = 1\n"),
        ("arguments", f"{PATH}: f", 13, f"def f({arguments(7)}, *, b, c, d, e, f, g): ..."),
        ("arguments", f"{PATH}: f", 13, f"async def f({arguments(11)}, *b, **c): ..."),
        ("values in a row", f"{PATH}: f", 9, f"def f(): return {arguments(9)}"),
        ("values in a row", f"{PATH}: f", 9, f"def f(x): {arguments(9)} = x"),
        ("values in a row", f"{PATH}: f", 9, f"def f(x):\n    for {arguments(9)} in x: ..."),
        ("imports", PATH, 21, module_imports(21)),
        ("members", f"{PATH}: A", 21, f"class A(NamedTuple):\n{fields(21)}"),
        ("members", f"{PATH}: A", 21, f"@dataclass(frozen=True)\nclass A:\n{fields(21)}"),
        ("members", f"{PATH}: A", 21, f"class A:\n{attributes(21)}"),
    ],
)
def test_too_much_is_an_error(name, place, size, text):
    limits = {"limits": RATCHETS["limits"]}
    verdict = ratchet.judge_limit(name, measure(text), limits)
    hard = RATCHETS["limits"][name]["hard"]
    assert verdict.errors == [f"{place}: {size} {name}, at most {hard} are allowed"]
    assert all(
        not ratchet.judge_limit(other, measure(text), limits).errors
        for other in RATCHETS["limits"]
        if other != name
    )


def test_a_tensor_is_one_thing():
    text = "def f(): return 1, 2, 3, 4, 5, 6, 7, 8, 9"
    sizes = measure(text, "vgmpi/materials/tensor_math/made_up.py").sizes
    assert "values in a row" not in sizes and "values in a row" in measure(text).sizes


def test_above_the_soft_limit_is_a_note():
    verdict = ratchet.judge_limit("lines of a file", measure(501 * "x = 1\n"), RATCHETS)
    assert verdict == ([], [f"{PATH}: 501 lines of a file, better are 500"])


@pytest.mark.parametrize(
    "size, error, note",
    [
        (26, "A: 26 members, at most 25 are allowed", None),
        (25, None, None),
        (24, None, f'{ratchet.FILE}: lower members, "A" to 24'),
        (20, f'{ratchet.FILE}: remove the exception members, "A"', None),
        (None, f'{ratchet.FILE}: remove the exception members, "A"', None),
    ],
)
def test_an_exception_only_falls(size, error, note):
    ratchets = {"limits": {"members": {"hard": 20}}, "exceptions": {"members": {"A": 25}}}
    measured = Survey({"members": {"A": size} if size else {"B": 1}}, {})
    verdict = ratchet.judge_limit("members", measured, ratchets)
    assert verdict == ([error] if error else [], [note] if note else [])


@pytest.mark.parametrize(
    "count, is_error, is_note", [(21, 1, 0), (20, 0, 0), (19, 0, 1), (17, 1, 0)]
)
def test_a_count_only_falls(count, is_error, is_note):
    measured = Survey({}, {"aliases": count * ["a.py:1: b as c"]})
    verdict = ratchet.judge_count("aliases", measured, {"counts": {"aliases": 20}})
    assert (len(verdict.errors), len(verdict.notes)) == (is_error, is_note)


@pytest.mark.parametrize(
    "name, text",
    [
        ("more than 8 arguments", f"def f({arguments(9)}): ..."),
        ("modules below 100 lines", 99 * "x = 1\n"),
        ("step results by position", "x = report[0]"),
        ("step results by position", "x = self.maxima[3:6]"),
        ("step results by position", "x = y[MAXIMA_SLICE]"),
        ("private names", "def f(given): ..."),
        ("private names", "def told(): ..."),
        ("private names", "class Known: ..."),
        ("private names", "for one in x: ..."),
        ("private fields", "class A:\n    near: int"),
        ("private fields", "class A:\n    near = 0"),
        ("private attributes", "x = y.given"),
        ("private attributes", "y.kept = 0"),
        ("aliases", "from x import y as z"),
        ("aliases", "import x as rest"),
    ],
)
def test_a_count_sees_its_place(name, text):
    text += "" if name == "modules below 100 lines" else 100 * "\nx = 1"
    assert {key: len(places) for key, places in measure(text).places.items() if places} == {name: 1}


def test_good_code_has_no_places():
    lines = [
        "import numpy as np",
        "np.add.at(x, y, 1)",
        "x = report[thread], y[0]",
        "z = row.count",
    ]
    assert not any(measure("\n".join(lines + 100 * ["x = 1"])).places.values())


def test_single_importers_are_found():
    """Of the same folder; y has two importers, and z's is elsewhere."""
    imports = {"v.a.x": {"v.a.w", "v.a.y"}, "v.a.w": {"v.a.y", "v.b.z"}, "v.b.z": {"numpy"}}
    assert find_single_importers(imports) == ["v.a.w <- v.a.x"]
    assert not find_single_importers(imports, {"v.a.x": {"v.a.w"}})


def test_a_module_that_a_function_loads_when_it_is_needed_is_deferred():
    text = "import v.a\n\ndef start():\n    import v.a, v.b\n"
    found = list_deferred_imports(SourceFile("v/x.py", text), {"v.a", "v.b"}.__contains__)
    assert found == {"v.b"}


DOCUMENT = '''
LIMIT = 3
def find(x): ...
class Cloud(NamedTuple):
    mass: float
    def move(self): self.center = 1
def use(cloud):
    """{}"""
    # {}
'''


@pytest.mark.parametrize(
    "name",
    [
        "Cloud.volume", "made_up.search", "solver.made_up.search", "engines.made_up", "MAX_LIMIT",
        "`seek`", "cloud.volume", "cloud.Mass", "other.find", "vgmpi.solver.absent",
    ],
)  # fmt: skip
def test_a_ghost_is_seen(name):
    """In a docstring and in a comment."""
    ghosts = measure(DOCUMENT.format(f"See {name}.", "")).places["ghosts"]
    assert ghosts == [f"{PATH}:8: {name.strip('`')}"]
    ghosts = measure(DOCUMENT.format("", f"as in {name}, and so on")).places["ghosts"]
    assert ghosts == [f"{PATH}:9: {name.strip('`')}"]


@pytest.mark.parametrize(
    "name",
    [
        "Cloud.mass", "Cloud.center", "made_up.find", "solver.made_up", "LIMIT", "`find`",
        "cloud.mass", "cloud.center", "np.add.at", "made_up.py", "example.com/cloud.volume",
        "int.from_bytes", "E501", "tests.house.ghosts", "MPI", "`find()`",
    ],
)  # fmt: skip
def test_what_exists_is_no_ghost(name):
    assert measure(DOCUMENT.format(name, f"see {name}.")).places["ghosts"] == []
