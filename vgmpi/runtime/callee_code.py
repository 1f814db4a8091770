"""Code of functions for the compiled functions that call them.

numba gives every function what a call from Python needs: wrappers, an optimized module, machine
code. Its callers link that module in and are optimized and translated again, so that the innermost
functions of a kernel pass the compiler once per level. Here a function that compiled code calls is
linked into its callers as it is, and only what Python calls is optimized and translated, with all
that it calls. Nothing is compiled with fastmath, but with contraction one product of a sum of two
is not rounded. LLVM may swap the two, the one that is known earlier first, so that the rounding
can depend on how much is optimized at once: see `_turned` of tensor_math/symmetric_eigen.py.

What a kernel links in can also become its own (`KernelCompiler`): LLVM then inlines what is called
once and leaves out unused arguments, which can change the rounding, too.

`PRIVATE_PARTS` of tests/runtime/test_numba_parts.py lists what is used of numba that it does not
document.
"""

import copy
from typing import Any

import llvmlite.binding as llvm
from numba.core import event, typing
from numba.core.codegen import CPUCodeLibrary, JITCodeLibrary
from numba.core.compiler import Compiler, CompileResult
from numba.core.sigutils import normalize_signature


class CalleeLibrary(CPUCodeLibrary):
    """Module of a function with all that it calls, to be linked into others; never translated."""

    def finalize(self) -> None:
        """Link in what the function calls."""
        self._raise_if_finalized()
        for library in dict.fromkeys(self._linking_libraries):
            self._reload_init.update(library._reload_init)
            self._final_module.link_in(library._get_module_for_linking(), preserve=True)
        self._finalize_dynamic_globals()
        self._finalized = True

    def serialize_using_object_code(self) -> bytes:
        """Return the content of a file: the module, which has no object code."""
        self._ensure_finalized()
        return self._get_module_for_linking().as_bitcode()


class CalleeCompiler(Compiler):
    """numba's compiler without wrappers, optimization of the module and machine code."""

    def __init__(self, typingctx, targetctx, library, args, return_type, flags, locals):
        flags = flags.copy()
        flags.no_cpython_wrapper = flags.no_cfunc_wrapper = flags.no_compile = True
        library = CalleeLibrary(targetctx.codegen(), "callee")
        super().__init__(typingctx, targetctx, library, args, return_type, flags, locals)

    def compile_extra(self, func: Any) -> CompileResult:
        """Compile a function and make its code known to those that call it."""
        return _introduced(super().compile_extra(func))


class KernelLibrary(JITCodeLibrary):
    """Module of a function that Python calls; nobody else calls what it links in."""

    def _optimize_final_module(self) -> None:
        """Optimize the module once the functions that were linked in are its own.

        They get other names: the linker looks for those of other modules by name, and would find
        these, whose arguments the optimization changes.
        """
        for function in self._final_module.functions:
            if function.linkage is llvm.Linkage.linkonce_odr and not function.is_declaration:
                function.linkage = llvm.Linkage.internal
                function.name = f"{function.name}.{self.name}"
        super()._optimize_final_module()


class KernelCompiler(Compiler):
    """numba's compiler of functions that only Python calls, which own what they link in."""

    def compile_extra(self, func: Any) -> CompileResult:
        """Compile a function with a library of its own."""
        library = KernelLibrary(self.state.targetctx.codegen(), func.__qualname__)
        library.enable_object_caching()
        self.state.library = library
        return super().compile_extra(func)


def _introduced(result: CompileResult) -> CompileResult:
    """Make the code of a function known to numba, under an entry point that nobody calls."""
    nowhere: Any = [].append  # numba accepts functions written in C only, and tells them apart
    result.target_context.insert_user_function(nowhere, result.fndesc, [result.library])
    return result._replace(entry_point=nowhere)


def rebuild_callee(target_context: Any, bitcode: bytes, fndesc: Any, env: Any, *rest: Any):
    """Return the code of a function from the content of a file.

    Args:
        target_context: numba's context.
        bitcode: Module of the function.
        fndesc: numba's description of the function.
        env: Environment of the function.
        *rest: Signature and what else `CompileResult._reduce` gives.
    """
    signature, objectmode, lifted, annotation, reload_init, environments = rest
    for function in reload_init:
        function()
    library = CalleeLibrary(target_context.codegen(), fndesc.qualname)
    library._shared_module = library._final_module = llvm.parse_bitcode(bitcode)
    library._finalized = True
    result = CompileResult(
        typing_context=target_context.typing_context, target_context=target_context,
        entry_point=None, typing_error=None, type_annotation=annotation, signature=signature,
        objectmode=objectmode, lifted=lifted, fndesc=fndesc, library=library, call_helper=None,
        environment=env, metadata=None, reload_init=reload_init, referenced_envs=environments,
    )  # fmt: skip
    return _introduced(result)


def link_as_callee(dispatcher: Any, cache: Any) -> None:
    """Make compiled code that calls a function link it in as it is.

    Args:
        dispatcher: The function as numba compiles it.
        cache: Where its code for callers is kept, see compile_cache.py.
    """
    compiler = copy.copy(dispatcher._compiler)
    compiler.pipeline_class, compiler._failed_cache = CalleeCompiler, {}
    compile_for_python = dispatcher.compile

    def compile_callee(args: tuple) -> None:
        """Compile the function for compiled code that calls it, unless it is compiled."""
        if args in dispatcher.overloads:
            return
        result = cache.load_overload(args, dispatcher.targetctx)
        if result is None:
            details = {"dispatcher": dispatcher, "args": args, "return_type": None}
            with dispatcher._compiling_counter, event.trigger_event("numba:compile", details):
                result = compiler.compile(args, None)
            cache.save_overload(args, result)
        dispatcher.overloads[args] = result

    compile_callee = cache.releasing(compile_callee)

    def call_template(args: tuple, kws: dict) -> tuple:
        """Return what numba asks of a function that a function it compiles calls."""
        signature, args = dispatcher._compiler.fold_argument_types(args, kws)
        compile_callee(tuple(args))
        name = dispatcher.py_func.__name__
        template = typing.make_concrete_template(name, name, dispatcher.nopython_signatures)
        return template, signature, args, {}

    def compile_signature(sig: Any) -> Any:
        """Compile the function for Python, with all that it calls."""
        args = tuple(normalize_signature(sig)[0])
        existing = dispatcher.overloads.get(args)
        if existing is not None and isinstance(existing.library, CalleeLibrary):
            del dispatcher.overloads[args]
        entry = compile_for_python(sig)
        result = dispatcher.overloads[args]
        for environment in result._find_referenced_environments():
            result.library.codegen.set_env(environment.env_name, environment)
        return entry

    dispatcher.get_call_template, dispatcher.compile = call_template, compile_signature
