"""Compiled code on disk: damage is seen, and a folder that cannot be written is done without."""

import logging
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import numba
import numpy as np
import pytest

from vgmpi.runtime import cache_files, compile_cache, compile_key, compiled_kernels, source_digest


def half(x):
    return 0.5 * x + 0.125


def third(x):
    return x / 3.0


def fresh(function=half):
    """The function as a new process finds it."""
    return compile_cache.njit_cached(error_model="numpy")(function)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    assert fresh()(1.0) == 0.625
    return tmp_path


def file_in(folder, name="half"):
    (path,) = folder.rglob(f"{name}-*")
    return path


def test_it_is_found_again(folder):
    assert [p.suffix for p in folder.rglob("*") if p.is_file()] == [".nbc"]
    made = fresh()
    assert made(3.0) == 1.625 and made.stats.cache_hits[(numba.float64,)] == 1


def test_a_file_says_what_it_is(folder):
    head = file_in(folder).read_bytes().split(b"\n\n")[0].decode()
    assert f"function {__name__}.half\n" in head and f"\nnumba {numba.__version__}\n" in head
    assert f"\nsource {__name__} " in head and "/" not in head


def test_a_damaged_one_is_compiled_anew(folder):
    """40 bits, each of a whole file; then cut off, empty, and another's."""
    path = file_in(folder)
    draw = random.Random(5)
    for k in range(43):
        whole = path.read_bytes()
        damaged = bytearray(whole)
        if k < 40:
            damaged[draw.randrange(len(whole))] ^= 1 << draw.randrange(8)
        else:
            damaged = [whole[: len(whole) // 2], b"", b"not numba's"][k - 40]
        path.write_bytes(damaged)
        made = fresh()
        assert made(3.0) == 1.625
        assert not made.stats.cache_hits, f"case {k}"
        assert fresh()(3.0) == 1.625 and path.read_bytes() != damaged  # mended


def test_one_under_the_name_of_another_is_compiled_anew(folder):
    assert fresh(third)(3.0) == 1.0
    file_in(folder).write_bytes(file_in(folder, "third").read_bytes())
    made = fresh()
    assert made(3.0) == 1.625 and not made.stats.cache_hits


@pytest.mark.parametrize(
    "module, name, value",
    [
        (compile_key, "_versions", lambda: ("numba 0.1", "llvmlite 0.1", "numpy 2.0")),
        (compile_key, "FP_CONTRACTION", "other"),
        (numba.config, "LOOP_VECTORIZE", 0),
        (compile_key, "_source_lines", lambda modules: ["source x 0"]),
    ],
)
def test_another_version_or_setting_has_its_own(folder, monkeypatch, module, name, value):
    monkeypatch.setattr(module, name, value)
    made = fresh()
    assert made(3.0) == 1.625 and not made.stats.cache_hits
    assert len(list(folder.rglob("half-*"))) == 2


def test_options_and_signatures_have_their_own(folder):
    made = compile_cache.njit_cached(error_model="numpy", fastmath={"contract"})(half)
    assert made(3.0) == 1.625 and not made.stats.cache_hits
    assert made(np.float32(3.0)) == 1.625 and len(list(folder.rglob("half-*"))) == 3


def test_without_a_folder_it_runs_and_says_so_once(tmp_path, monkeypatch, caplog):
    (tmp_path / "file").touch()
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "file" / "below"))
    compile_cache._warn_uncached.cache_clear()
    with caplog.at_level(logging.WARNING, "vgmpi"):
        assert fresh()(1.0) == fresh()(1.0) == 0.625
    (said,) = caplog.messages
    assert "NUMBA_CACHE_DIR" in said and not list(Path(tmp_path).rglob("*.nb?"))


def test_a_folder_that_can_only_be_read_is_read(folder, monkeypatch):
    def refuse(*_, **__):
        raise PermissionError(13, "read only")

    for module, name in ((cache_files.os, "open"), (compile_cache.os, "replace")):
        monkeypatch.setattr(module, name, refuse)
    made, other = fresh(), fresh(third)
    assert made(3.0) == 1.625 and made.stats.cache_hits
    assert other(3.0) == 1.0 and not list(folder.rglob("third-*"))


def test_a_lock_is_released_where_compilation_fails(folder):
    def wrong(x):
        return x.nothing

    made = fresh(wrong)
    with pytest.raises(numba.TypingError):
        made(1.0)
    assert not list(folder.rglob("*.lock")) and not made._cache.locks


def test_a_lock_that_stays_is_not_waited_for_forever(folder, monkeypatch):
    path = folder / "some"
    held, other = cache_files.FileLock(path), cache_files.FileLock(path)
    monkeypatch.setattr(cache_files, "PATIENCE", 0.1)
    start = time.monotonic()
    assert held.acquire() and not other.acquire() and time.monotonic() - start < 60
    held.release()
    assert other.acquire()
    other.release()
    assert not list(folder.glob("*.lock"))


def test_a_source_that_changed_meanwhile_keeps_nothing(folder, monkeypatch):
    """What is in memory is not what is on disk: a later process would get the older code."""
    monkeypatch.setattr(source_digest, "_STARTED", 0.0)
    source_digest._parsed.cache_clear()
    compile_key._source_lines.cache_clear()
    made = fresh()
    assert made(3.0) == 1.625 and not made.stats.cache_hits
    assert fresh(third)(3.0) == 1.0 and not list(folder.rglob("third-*"))


def test_a_function_without_a_module_is_not_kept(folder):
    space = {}
    exec("def bare(x): return x + 1.0", space)
    assert fresh(space["bare"])(3.0) == 4.0 and not list(folder.rglob("bare-*"))


def test_markers_follow_the_key(folder, monkeypatch):
    before = compiled_kernels.compiled_marker("fluid")
    assert before.parent == folder and before == compiled_kernels.compiled_marker("fluid")
    monkeypatch.setattr(compile_key, "_source_lines", lambda modules: ["source x 0"])
    assert compiled_kernels.compiled_marker("fluid") != before


def test_the_folder_is_the_users_unless_numba_has_one(monkeypatch, tmp_path):
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert compile_cache.cache_folder() == tmp_path / "vgmpi" / "compiled"


def test_who_waits_says_for_whom(tmp_path, monkeypatch, caplog):
    """Of a stopped process, how it goes on; on every rank, since others wait for one that waits."""
    monkeypatch.setattr(cache_files, "ANNOUNCE_SECONDS", 0.05)
    monkeypatch.setattr(cache_files, "PATIENCE", 0.3)
    path = tmp_path / "kernel-0123.nbc"
    code = (
        "import sys; from pathlib import Path; from vgmpi.runtime.cache_files import FileLock\n"
        f"print(FileLock(Path({str(path)!r})).acquire(), flush=True); sys.stdin.read()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as holder:
        assert holder.stdout.readline() == "True\n"
        os.kill(holder.pid, signal.SIGSTOP)
        os.waitid(os.P_PID, holder.pid, os.WSTOPPED)
        with caplog.at_level(cache_files.ON_EVERY_RANK, "vgmpi"):
            assert not cache_files.FileLock(path).acquire()
        os.kill(holder.pid, signal.SIGCONT)
        holder.stdin.close()
    wanted = f"waits for process {holder.pid}, which compiles kernel: 0 s so far, at most 0 s"
    assert caplog.messages[0] == f"{wanted}; it is stopped: kill -CONT {holder.pid}"
