"""What the cache of compiled code uses of numba that numba does not document.

Where a new numba fails here, runtime/compile_cache.py, runtime/callee_code.py and
runtime/compile_key.py must be read again before the bound in pyproject.toml goes up.
"""

import inspect
import itertools

import numba
import pytest
from numba import types
from numba.core import (
    base,
    bytecode,
    caching,
    codegen,
    compiler,
    config,
    dispatcher,
    serialize,
    sigutils,
    typing,
)

from vgmpi.runtime import compile_cache, compile_key

# what it is, and its arguments
PRIVATE_PARTS = {
    "_Cache.load_overload": (caching._Cache.load_overload, ["self", "sig", "target_context"]),
    "_Cache.save_overload": (caching._Cache.save_overload, ["self", "sig", "data"]),
    "CompileResult._reduce": (compiler.CompileResult._reduce, ["self"]),
    "CompileResult._rebuild": (
        compiler.CompileResult._rebuild,
        ["target_context", "libdata", "fndesc", "env", "signature", "objectmode", "lifted",
         "typeann", "reload_init", "referenced_envs"],
    ),
    "Dispatcher.compile": (dispatcher.Dispatcher.compile, ["self", "sig"]),
    "Dispatcher.get_call_template": (
        dispatcher.Dispatcher.get_call_template, ["self", "args", "kws"]
    ),
    "CPUCodeLibrary.finalize": (codegen.CPUCodeLibrary.finalize, ["self"]),
    "CPUCodeLibrary._optimize_final_module": (
        codegen.CPUCodeLibrary._optimize_final_module, ["self"]
    ),
    "CodeLibrary.enable_object_caching": (codegen.CodeLibrary.enable_object_caching, ["self"]),
    "CPUCodeLibrary._get_module_for_linking": (
        codegen.CPUCodeLibrary._get_module_for_linking, ["self"]
    ),
    "CPUCodeLibrary._finalize_dynamic_globals": (
        codegen.CPUCodeLibrary._finalize_dynamic_globals, ["self"]
    ),
    "CompilerBase.__init__": (
        compiler.CompilerBase.__init__,
        ["self", "typingctx", "targetctx", "library", "args", "return_type", "flags", "locals"],
    ),
    "CompilerBase.compile_extra": (compiler.CompilerBase.compile_extra, ["self", "func"]),
    "CompileResult._find_referenced_environments": (
        compiler.CompileResult._find_referenced_environments, ["self"]
    ),
    "insert_user_function": (
        base.BaseContext.insert_user_function, ["self", "func", "fndesc", "libs"]
    ),
    "make_concrete_template": (
        typing.make_concrete_template, ["name", "key", "signatures"]
    ),
    "serialize.dumps": (serialize.dumps, ["obj"]),
    "sigutils.normalize_signature": (sigutils.normalize_signature, ["sig"]),
}  # fmt: skip


@pytest.mark.parametrize("name", PRIVATE_PARTS)
def test_a_part_of_numba_is_as_it_was(name):
    part, arguments = PRIVATE_PARTS[name]
    assert list(inspect.signature(part).parameters) == arguments, f"numba {numba.__version__}"


def test_the_cache_has_all_that_numba_calls():
    assert compile_cache.ContentCache.__abstractmethods__ == frozenset()
    text = inspect.getsource(dispatcher.Dispatcher.compile)
    assert "self._cache.load_overload(sig, self.targetctx)" in text
    assert "self._cache.save_overload(sig, cres)" in text
    assert "global_compiler_lock" in text  # nothing else compiles while a lock is waited for


def test_a_compiler_without_machine_code_is_asked_for_by_flags():
    flags = compiler.Flags()
    assert {"no_compile", "no_cpython_wrapper", "no_cfunc_wrapper"} <= set(flags.options)
    text = inspect.getsource(codegen.CPUCodeLibrary.finalize)
    assert "link_in" in text and "self._reload_init.update(library._reload_init)" in text
    assert text.index("link_in") < text.index("self._optimize_final_module()")


def test_functions_are_numbered_by_a_counter():
    assert isinstance(bytecode.FunctionIdentity._unique_ids, itertools.count)
    before = bytecode.FunctionIdentity.from_function(len_of).unique_id
    assert bytecode.FunctionIdentity.from_function(len_of).unique_id == before + 1 > 1 << 20
    text = inspect.getsource(bytecode.FunctionIdentity.from_function)
    assert "next(cls._unique_ids)" in text


def len_of(x):
    return len(x)


def test_a_compiled_function_has_what_is_asked_of_it():
    made = numba.njit(len_of)
    assert isinstance(made._cache, caching._Cache) and isinstance(made.targetoptions, dict)
    assert made((1, 2)) == 2
    (result,) = made.overloads.values()
    assert result.lifted == () and result.library.has_dynamic_globals is False
    environments = result._reduce()[-1]
    assert [one.globals["__name__"] for one in environments] == [__name__]
    triple, name, features = result.target_context.codegen().magic_tuple()
    assert triple and name and "," in features


def test_numba_still_has_these_settings():
    missing = {name for name in compile_key.SETTINGS if not hasattr(config, name)}
    assert missing <= {"USE_LLVM_LEGACY_PASS_MANAGER"}, missing


def test_types_are_told_by_their_names_and_their_public_parts():
    content = compile_key._Content()
    text = content.text((types.float64[:, ::1], types.literal(3), types.Omitted(2.0)))
    assert "array(float64, 2d, C)" in text and "Literal[int](3)" in text and "2.0" in text
