"""Files of users are replaced whole or not at all, by one function."""

import os
import re
from pathlib import Path

import pytest

from vgmpi.runtime import user_files
from vgmpi.runtime.user_files import replace_file

ROOT = Path(__file__).parents[2]


def test_parts_are_joined_and_nothing_is_left(tmp_path):
    path = tmp_path / "a.toml"
    replace_file(path, "é", b"\x00", "")
    assert path.read_bytes() == "é".encode() + b"\x00"
    assert os.listdir(tmp_path) == ["a.toml"]


@pytest.mark.parametrize("call", ["fsync", "replace"])
def test_a_failure_leaves_the_old_file(tmp_path, monkeypatch, call):
    def fail(*_):
        raise OSError(28, "No space left on device")

    path = tmp_path / "a.toml"
    path.write_text("old")
    monkeypatch.setattr(user_files.os, call, fail)
    with pytest.raises(OSError, match="No space left"):
        replace_file(path, "new and longer")
    assert path.read_text() == "old" and os.listdir(tmp_path) == ["a.toml"]


def test_no_link_is_followed(tmp_path):
    other, link = tmp_path / "other", tmp_path / "link"
    other.write_text("stays")
    link.symlink_to(other)
    replace_file(link, "new")
    assert other.read_text() == "stays" and link.read_text() == "new" and not link.is_symlink()


def test_no_other_place_writes_files_of_users():
    """Writers of HDF5, of videos and of locks have files of their own kinds."""
    pattern = re.compile(r"\.write_text\(|\.write_bytes\(|open\([^)]*[\"'][wx]b?[\"']")
    allowed = {
        "vgmpi/runtime/user_files.py",
        "postprocess/frames/frame_colors.py",  # a cache
        "vgmpi/runtime/compile_cache.py",  # a cache, with checksums
        "vgmpi/tools/bench/benchmark_case.py",  # scenes in a temporary folder
        "vgmpi/tools/bench/interleaved_rounds.py",  # a log of a temporary folder
        "vgmpi/io/hdf5_writer.py",  # large files, beside and renamed as well
    }
    files = [*ROOT.glob("vgmpi/**/*.py"), *ROOT.glob("postprocess/**/*.py")]
    found = {str(p.relative_to(ROOT)) for p in files if pattern.search(p.read_text())}
    assert found <= allowed
