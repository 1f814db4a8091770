"""Compiled code on disk: damage is seen, and a folder that cannot be written is done without."""

import logging
import os
import random
import sys
from pathlib import Path

import numba
import pytest
from numba.core import caching as numbas

from tests.support import launch
from vgmpi.runtime import compile_cache, cpu_features, jit


def half(x):
    return 0.5 * x + 0.125


def fresh():
    """The function as a new process finds it."""
    return compile_cache.njit_cached(error_model="numpy")(half)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    assert fresh()(1.0) == 0.625
    return tmp_path


def test_it_is_found_again(folder):
    assert sorted(p.suffix for p in folder.rglob("*.nb?")) == [".nbc", ".nbi"]
    made = fresh()
    assert made(3.0) == 1.625 and made.stats.cache_hits[(numba.float64,)] == 1


@pytest.mark.parametrize("suffix", [".nbi", ".nbc"])
def test_a_damaged_one_is_compiled_anew(folder, suffix):
    """40 bits, each of a whole file; then cut off, empty, and another's."""
    (path,) = folder.rglob(f"*{suffix}")
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


def test_what_numba_itself_wrote_is_no_trouble(folder):
    for path in folder.rglob("*.nb?"):
        path.write_bytes(path.read_bytes()[: -compile_cache.CHECKSUM_BYTES])
    assert fresh()(3.0) == 1.625
    plain = numba.njit(cache=True, error_model="numpy")(half)
    assert plain(3.0) == 1.625 and plain.stats.cache_hits  # and it reads ours


def test_without_a_folder_it_runs_and_says_so_once(tmp_path, monkeypatch, caplog):
    (tmp_path / "file").touch()
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "file" / "below"))
    only = [numbas.UserProvidedCacheLocator]
    monkeypatch.setattr(numbas.CacheImpl, "_locator_classes", only)
    compile_cache._warn_uncached.cache_clear()
    with caplog.at_level(logging.WARNING, "vgmpi"):
        assert fresh()(1.0) == fresh()(1.0) == 0.625
    (said,) = caplog.messages
    assert "NUMBA_CACHE_DIR" in said and not list(Path(tmp_path).rglob("*.nb?"))


AFTER_NUMBA = """
import numba
import vgmpi
from vgmpi.runtime import jit
numba.njit(lambda x: x + 1.0)(2.0)  # reads the settings again where the environment has changed
print(numba.config.CACHE_DIR == str(jit.cache_folder()))
"""


def test_where_numba_came_first_the_folder_stays(monkeypatch):
    """Numba forgets what is not in the environment once a variable of its own there has changed."""
    for name in [name for name in os.environ if name.startswith("NUMBA_")]:
        monkeypatch.delenv(name)
    done = launch.run([sys.executable, "-c", AFTER_NUMBA])
    assert done.stdout == "True\n", done.stdout + done.stderr


def test_without_a_folder_the_stamp_is_not_in_the_current_one(monkeypatch):
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")
    assert cpu_features.compiled_marker("fluid").parent == jit.cache_folder()
