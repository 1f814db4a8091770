"""Compiled functions on disk, found by what is compiled.

A file holds one function for one signature. Its name and its first lines are the key
(compile_key.py): the sources that the code can see, versions, processor, options. The place and the
time of a source do not count, so that all copies of the same sources share one folder. A file that
is damaged, or another's under this name, counts as absent: the function is compiled again. Without
a writable folder nothing is kept.

numba's own cache is not used. `PRIVATE_PARTS` of tests/runtime/test_numba_parts.py lists what is
used of numba that it does not document.
"""

import contextlib
import functools
import hashlib
import itertools
import logging
import os
import pickle
import uuid
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
from numba import njit
from numba.core.bytecode import FunctionIdentity
from numba.core.caching import _Cache
from numba.core.compiler import CompileResult
from numba.core.serialize import dumps
from numba.core.sigutils import normalize_signature

from .cache_files import FileLock, user_folder
from .callee_code import KernelCompiler, link_as_callee, rebuild_callee
from .compile_key import NoKeyError, compile_key, modules_of

log = logging.getLogger("vgmpi")

CHECKSUM_BYTES = 4  # [bytes] CRC-32 of all that comes before it, at the end of a file
KEPT: set[str] = set()  # modules that have functions that are kept


def njit_cached(*, owns_callees: bool = False, **options: Any) -> Callable[[Callable], Any]:
    """Return a decorator: `numba.njit` with these options, and machine code kept on disk.

    Args:
        owns_callees: Whether the function that Python calls owns the functions that it calls,
            which is faster, but may round differently where products and sums are contracted.
        **options: Options of `numba.njit`.
    """

    def compiled(function: Callable) -> Any:
        """Compile a function when it is called, unless its code is on disk."""
        compiler = {"pipeline_class": KernelCompiler} if owns_callees else {}
        dispatcher = njit(**options, **compiler)(function)
        if hasattr(dispatcher, "_cache"):  # without NUMBA_DISABLE_JIT
            callees = {"callees": "owned and renamed"} if owns_callees else {}
            cache = ContentCache(function, dispatcher.targetoptions | callees)
            dispatcher._cache = cache
            dispatcher.compile = cache.releasing(dispatcher.compile)
            callee_options = dispatcher.targetoptions | {"linked": "as it is"}
            link_as_callee(dispatcher, ContentCache(function, callee_options, rebuild_callee))
            KEPT.add(str(function.__module__))
        return dispatcher

    return compiled


def cache_folder() -> Path:
    """Return the folder of compiled code: that of NUMBA_CACHE_DIR if it is set."""
    return Path(numba.config.CACHE_DIR or user_folder() / "compiled")


class ContentCache(_Cache):
    """Compiled code of one function on disk; takes the place of numba's own in a dispatcher."""

    def __init__(
        self, function: Callable, options: dict, rebuild: Callable = CompileResult._rebuild
    ):
        self.function, self.options, self.rebuild = function, options, rebuild
        self.enabled = True
        self.locks: dict[str, FileLock] = {}  # of what is being compiled, by key

    @property
    def cache_path(self) -> str:
        """Return the folder of the files of this function's module."""
        return str(cache_folder() / self.function.__module__)

    def releasing(self, compile_signature: Callable) -> Callable:
        """Return `Dispatcher.compile` that leaves no lock behind, compiled or not."""

        def compile_and_release(sig: Any) -> Any:
            """Compile a signature, then release what was locked for it."""
            locked_before = set(self.locks)
            try:
                return compile_signature(sig)
            finally:
                for key in set(self.locks) - locked_before:
                    lock = self.locks.pop(key, None)  # None if another thread was quicker
                    if lock is not None:
                        lock.release()

        return compile_and_release

    def load_overload(self, sig: Any, target_context: Any) -> CompileResult | None:
        """Return the code for a signature; None if it is this process that is to compile it."""
        target_context.refresh()
        key = self._key(sig, target_context)
        if key is None:
            return None
        packed = self._read(key)
        if packed is None and key not in self.locks:
            lock = FileLock(self.path(key))
            if lock.acquire():
                self.locks[key] = lock
                packed = self._read(key)  # another process may have made it meanwhile
        if packed is None:
            return None
        return self.rebuild(target_context, *pickle.loads(packed))

    def save_overload(self, sig: Any, data: CompileResult) -> None:
        """Keep the code for a signature, if it can be kept and the folder can be written."""
        key = self._key(sig, data.target_context)
        if key is None or data.lifted or data.library.has_dynamic_globals:
            return
        reduced = data._replace(type_annotation="")._reduce()  # it takes long to write
        if not self._covers(key, reduced[-1]):
            return
        try:
            _write(self.path(key), _packed(key, dumps(reduced)))
        except OSError:
            _warn_uncached()

    def is_begun(self, sig: Any, target_context: Any) -> bool:
        """Return whether there is code for a signature, or a process that compiles it."""
        target_context.refresh()
        key = self._key(sig, target_context)
        return key is not None and (self.path(key).exists() or FileLock(self.path(key)).exists())

    def enable(self) -> None:
        """Use the disk."""
        self.enabled = True

    def disable(self) -> None:
        """Leave the disk alone."""
        self.enabled = False

    def flush(self) -> None:
        """Forget the code of this function."""
        for path in Path(self.cache_path).glob(f"{self._stem()}-*"):
            path.unlink(missing_ok=True)

    def path(self, key: str) -> Path:
        """Return the file of a key."""
        digest = hashlib.sha256(key.encode()).hexdigest()[:24]
        return Path(self.cache_path) / f"{self._stem()}-{digest}.nbc"

    def _stem(self) -> str:
        return self.function.__qualname__.replace("<", "").replace(">", "")[:100]

    def _read(self, key: str) -> bytes | None:
        """Return the code of a key; None if there is none that is whole."""
        try:
            return _unpacked(self.path(key).read_bytes(), key)
        except OSError:
            return None

    def _key(self, sig: Any, target_context: Any) -> str | None:
        """Return the key for a signature; None if nothing is to be kept or found."""
        if not self.enabled:
            return None
        target = target_context.codegen().magic_tuple()
        try:
            return compile_key(self.function, self.options, normalize_signature(sig), target)
        except NoKeyError as error:
            log.debug("%s is not kept on disk: %s", self.function.__qualname__, error)
            return None

    def _covers(self, key: str, environments: tuple) -> bool:
        """Return whether the key has the sources of all functions that are compiled in."""
        covered = {self.function.__globals__.get("__name__"), *modules_of(key)}
        linked = {str(environment.globals.get("__name__")) for environment in environments}
        beyond = {name for name in linked - covered if name.split(".")[0] != "numba"}
        if beyond:
            log.warning(
                "%s is not kept on disk: it has code of %s, which its key does not cover",
                self.function.__qualname__, ", ".join(sorted(beyond)),
            )  # fmt: skip
        return not beyond


def _packed(key: str, data: bytes) -> bytes:
    """Return the content of a file."""
    content = key.encode() + b"\n\n" + data
    return content + zlib.crc32(content).to_bytes(CHECKSUM_BYTES, "little")


def _unpacked(content: bytes, key: str) -> bytes | None:
    """Return the data in a file's content; None if it is damaged or another key's."""
    head, data = key.encode() + b"\n\n", content[:-CHECKSUM_BYTES]
    is_whole = zlib.crc32(data).to_bytes(CHECKSUM_BYTES, "little") == content[-CHECKSUM_BYTES:]
    return data[len(head) :] if is_whole and data.startswith(head) else None


def _write(path: Path, content: bytes) -> None:
    """Write a file at once: other processes see it whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f"{path.name}.{uuid.uuid4().hex[:16]}.tmp")
    try:
        part.write_bytes(content)
        os.replace(part, path)
    except OSError:
        with contextlib.suppress(OSError):
            part.unlink()
        raise


@functools.cache
def _warn_uncached() -> None:
    """Warn once that compiled code cannot be cached."""
    log.warning(
        "compiled code cannot be kept: no folder for it can be written; every process compiles"
        " for itself (set NUMBA_CACHE_DIR to a folder that can)"
    )


def _number_functions_apart() -> None:
    """Let this process number its compiled functions from a random number on.

    numba tells closures of one factory apart by numbers that every process counts from 1. Code of
    two processes would therefore have different functions under one name, of which the linker takes
    the one that was loaded first for both.
    """
    FunctionIdentity._unique_ids = itertools.count(int.from_bytes(os.urandom(7), "little"))


_number_functions_apart()
os.register_at_fork(after_in_child=_number_functions_apart)
