"""Functions that compiled code calls: linked as they are, translated with what Python calls."""

import numba
import numpy as np
import pytest
from numba.core import event
from numba.core.codegen import JITCodeLibrary

from vgmpi.runtime import callee_code, compile_cache, jit


def third(x):
    if x < 0.0:
        raise ValueError("no third of what is negative")
    return x / 3.0


@jit.always_inline
def twice(x):
    return x + x


def two_thirds(x):
    return twice(third_compiled(x))


def both(x):
    return two_thirds_compiled(x) + third_compiled(x)


def make():
    """Compile the three anew, as a new process does; return them."""
    global third_compiled, two_thirds_compiled
    third_compiled = compile_cache.njit_cached(nogil=True)(third)
    two_thirds_compiled = compile_cache.njit_cached(nogil=True)(two_thirds)
    return third_compiled, two_thirds_compiled, compile_cache.njit_cached(nogil=True)(both)


class Compiled(event.Listener):
    """Names of what is compiled, in order."""

    def __init__(self):
        self.names = []

    def on_start(self, event):
        self.names.append(event.data["dispatcher"].py_func.__name__)

    def on_end(self, event):
        pass


@pytest.fixture
def compiled():
    listener = Compiled()
    event.register("numba:compile", listener)
    yield listener.names
    event.unregister("numba:compile", listener)


@pytest.fixture
def translated(monkeypatch):
    """Names of the modules that become machine code."""
    names, usual = [], JITCodeLibrary._finalize_final_module

    def finalize(self):
        names.extend([self.name] * (self.name != "nrt"))  # numba's own
        return usual(self)

    monkeypatch.setattr(JITCodeLibrary, "_finalize_final_module", finalize)
    return names


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    return tmp_path


def test_only_what_python_calls_is_translated(translated):
    inner, middle, outer = make()
    assert outer(3.0) == 3.0
    assert translated == ["both"]
    for function in (inner, middle):
        (code,) = function.overloads.values()
        assert isinstance(code.library, callee_code.CalleeLibrary)
        assert "wrapper" not in code.library.get_llvm_str()


def test_python_may_call_what_compiled_code_called_first(translated):
    inner, middle, outer = make()
    assert outer(3.0) == 3.0
    assert inner(3.0) == 1.0 and middle(3.0) == 2.0 and inner(6.0) == 2.0
    assert translated == ["both", "third", "two_thirds"]
    assert outer(6.0) == 6.0 and outer(1) == 1.0  # another signature


def test_all_of_it_is_found_on_disk(folder, compiled):
    make()[-1](3.0)
    assert compiled[:3] == ["both", "two_thirds", "third"]
    compiled.clear()
    assert make()[-1](3.0) == 3.0 and compiled == []
    for path in folder.rglob("both-*"):
        path.unlink()
    assert make()[-1](3.0) == 3.0 and compiled == ["both"]  # the others are linked from disk


def test_a_damaged_file_of_a_callee_is_made_anew(folder, compiled):
    make()[-1](3.0)
    for path in [*folder.rglob("both-*"), *folder.rglob("third-*")]:
        path.write_bytes(path.read_bytes()[:-9])
    compiled.clear()
    assert make()[-1](3.0) == 3.0 and compiled == ["both", "third"]


@pytest.mark.parametrize("again", [False, True], ids=["compiled", "from disk"])
def test_an_error_in_a_callee_is_raised(again):
    if again:
        make()[-1](3.0)
    with pytest.raises(ValueError, match="no third of what is negative"):
        make()[-1](-3.0)


def test_arrays_made_by_a_callee_are_counted():
    """References and memory are as numba's own: the array outlives the function that made it."""

    def made(n):
        return np.full(n, 2.5)

    made_compiled = compile_cache.njit_cached()(made)

    @numba.njit
    def use(n):
        a = made_compiled(n)
        return a, a.sum()

    array, total = use(4)
    assert total == 10.0 and array.tolist() == [2.5] * 4


def owned(x):
    return both_again(x) + 1.0


def test_a_kernel_may_own_what_it_calls(folder, compiled):
    """Its module exports nothing but the function; from disk it is the same."""
    global both_again
    for again in (False, True):
        both_again = make()[-1]
        kernel = compile_cache.njit_cached(owns_callees=True, nogil=True)(owned)
        assert kernel(3.0) == 4.0
        assert ("owned" in compiled) is not again
        if not again:
            (code,) = kernel.overloads.values()
            compiled.clear()
            assert isinstance(code.library, callee_code.KernelLibrary)
            text = code.library.get_llvm_str()
            assert "linkonce_odr" not in text and "define" in text
