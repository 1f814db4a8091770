"""Copies of the same sources share compiled code, and an edit of whatever it can see is seen.

Every call of `run` is a process of its own, on a package `small` of a few kernels. It keeps no
bytecode: Python takes a file of the same size and second for one that has not changed.
"""

import json
import os
import shutil
import sys

import pytest

from tests.support import launch

SMALL = {
    "__init__": "",
    "numbers": "FACTOR = 2.0\n",
    "callee": """
from vgmpi.runtime.compile_cache import njit_cached
from .numbers import FACTOR

@njit_cached()
def twice(x):
    return FACTOR * x
""",
    "caller": """
from vgmpi.runtime.compile_cache import njit_cached
from .callee import twice

@njit_cached()
def outer(x):
    return twice(x) + 1.0
""",
    "other": """
from vgmpi.runtime.compile_cache import njit_cached

@njit_cached()
def alone(x):
    return x - 1.0
""",
    "stub": """
from vgmpi.kernels.simd.static_dispatch import static_dispatch
from vgmpi.runtime.compile_cache import njit_cached

@static_dispatch
def act(kind, x):
    "Act."

@njit_cached()
def by_kind(kind, x):
    return act(kind, x)
""",
    "law": """
from typing import NamedTuple
from .stub import act

class Law(NamedTuple):
    a: float

@act.register(Law)
def _(kind, x):
    return kind.a * x + 10.0
""",
    "strange": """
from .law import Law
from .stub import act

del act.table[Law]

@act.register(Law)
def _(kind, x):
    return -1.0
""",
    "factory": """
import numba
from vgmpi.runtime.compile_cache import njit_cached

def make(k):
    @njit_cached()
    def scaled(x):
        return k * x
    return scaled

def written(text):
    space = {"__name__": __name__}
    exec(f"def written(x): return {text}", space)
    return njit_cached()(space["written"])

def with_inner(k):
    @numba.njit
    def inner(x):  # long enough that it is called, not inlined
        s = 0.0
        for i in range(int(x)):
            for j in range(i):
                if (i * j) % 7 == 3: s += k * i
                elif (i + j) % 5 == 2: s -= j
        return s + k
    return inner

two, three = make(2.0), make(3.0)
plus, minus = written("x + 0.5"), written("x - 0.5")
inner_a, inner_b = with_inner(2.0), with_inner(3.0)

@njit_cached()
def a(x):
    return inner_a(x)

@njit_cached()
def b(x):
    return inner_b(x)
""",
}
COUNTED = """
import json, sys
from numba.core import event
from importlib import import_module
with event.install_recorder("numba:compile") as found:
    values = []
    for call in sys.argv[1:]:
        name, _, extra = call.partition("+")
        module, function = name.split(".")
        if extra:
            import_module(f"small.{extra}")
        words = (import_module("small.law").Law(2.0),) if function == "by_kind" else ()
        values.append(getattr(import_module(f"small.{module}"), function)(*words, 5.0))
starts = [one.data["dispatcher"].py_func.__name__ for _, one in found.buffer if one.is_start]
print(json.dumps([values, starts]))
"""


def lay_out(folder):
    (folder / "small").mkdir(parents=True)
    for name, text in SMALL.items():
        (folder / "small" / f"{name}.py").write_text(text)
    return folder


def write(path, text):
    """Write a file with a time that tells nothing."""
    path.write_text(text)
    os.utime(path, (1e9, 1e9))


def start(folder, cache, *calls):
    env = {
        "PYTHONPATH": f"{folder}{os.pathsep}{launch.ROOT}",
        "NUMBA_CACHE_DIR": str(cache),
        "PYTHONDONTWRITEBYTECODE": "1",
    }
    return launch.start([sys.executable, "-c", COUNTED, *calls], env)


def read(done):
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def run(folder, cache, *calls):
    """Return the values of calls, and the names of the functions that were compiled for them."""
    return read(launch.finish(start(folder, cache, *calls)))


@pytest.fixture
def cache(tmp_path):
    return tmp_path / "cache"


def test_a_copy_compiles_nothing(tmp_path, cache):
    calls = ("caller.outer", "stub.by_kind", "factory.two", "factory.three", "factory.a")
    first = lay_out(tmp_path / "one")
    values, compiled = run(first, cache, *calls)
    assert values == [11.0, 20.0, 10.0, 15.0, 5.0] and "outer" in compiled
    second = tmp_path / "elsewhere" / "deeper"
    shutil.copytree(first, second)
    for path in second.rglob("*.py"):
        os.utime(path, (1e9, 1e9))
    assert run(second, cache, *calls) == [values, []]


@pytest.mark.parametrize(
    "file, old, new, call, value, compiled",
    [
        ("numbers", "2.0", "3.0", "caller.outer", 16.0, ["outer", "twice"]),
        ("callee", "FACTOR * x", "FACTOR * x * x", "caller.outer", 51.0, ["outer", "twice"]),
        ("law", "10.0", "20.0", "stub.by_kind", 30.0, ["by_kind", "_"]),
        ("factory", "make(2.0)", "make(4.0)", "factory.two", 20.0, ["scaled"]),
    ],
)
def test_an_edit_is_seen_by_those_that_see_it(
    tmp_path, cache, file, old, new, call, value, compiled
):
    folder = lay_out(tmp_path / "one")
    run(folder, cache, call, "other.alone")
    path = folder / "small" / f"{file}.py"
    text = path.read_text()
    assert old in text
    write(path, text.replace(old, new))
    assert run(folder, cache, call, "other.alone") == [[value, 4.0], compiled]
    write(path, text)  # the earlier code is still there
    assert run(folder, cache, call, "other.alone")[1] == []


def test_code_from_beyond_the_key_is_not_kept(tmp_path, cache):
    """Here by a module that puts its own code for a kind that is not its own."""
    folder = lay_out(tmp_path / "one")
    done = launch.finish(start(folder, cache, "stub.by_kind+strange"))
    assert read(done)[0] == [-1.0] and "small.strange" in done.stderr
    assert not list(cache.rglob("by_kind*"))


def test_functions_of_a_factory_are_told_apart(tmp_path, cache):
    folder = lay_out(tmp_path / "one")
    assert run(folder, cache, "factory.two", "factory.plus")[0] == [10.0, 5.5]
    values, compiled = run(folder, cache, "factory.three", "factory.minus")
    assert values == [15.0, 4.5] and compiled == ["scaled", "written"]
    calls = "factory.two", "factory.three", "factory.plus", "factory.minus"
    assert run(folder, cache, *calls) == [[10.0, 15.0, 5.5, 4.5], []]


def test_code_of_two_processes_is_not_mixed_up(tmp_path, cache):
    """Both have a closure of one factory; numba's names for them would be the same."""
    folder = lay_out(tmp_path / "one")
    values = [run(folder, cache, call)[0][0] for call in ("factory.a", "factory.b")]
    assert run(folder, cache, "factory.a", "factory.b") == [values, []]
    assert run(folder, cache, "factory.b", "factory.a") == [values[::-1], []]


def test_ten_processes_at_once_compile_once(tmp_path, cache):
    folder = lay_out(tmp_path / "one")
    jobs = [start(folder, cache, "caller.outer", "other.alone") for _ in range(10)]
    found = [read(launch.finish(job)) for job in jobs]
    assert all(values == [11.0, 4.0] for values, _ in found)
    assert sorted(sum((names for _, names in found), [])) == ["alone", "outer", "twice"]
    assert sorted(path.suffix for path in cache.rglob("*") if path.is_file()) == [".nbc"] * 3
