"""Imports of sources are parsed once; what is damaged counts as absent."""

import pytest

from vgmpi.runtime import source_digest

ENTRY = ([("np", "numpy"), ("f", "vgmpi.x.f")], ["Path"])


@pytest.fixture
def store(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    source_digest._stored_entries.cache_clear()
    yield source_digest.store_path()
    source_digest._stored_entries.cache_clear()


def test_an_entry_comes_back_in_the_next_process(store):
    source_digest._write_entry("a", ENTRY)
    source_digest._stored_entries.cache_clear()
    assert source_digest._read_entry("a") == ENTRY and source_digest._read_entry("b") is None


@pytest.mark.parametrize("damage", ["byte", "cut", "junk"])
def test_damage_is_absence(store, damage):
    source_digest._write_entry("a", ENTRY)
    source_digest._write_entry("b", ENTRY)
    data = store.read_bytes()
    first = data.index(b"\n") + 1
    spoiled = {
        "byte": data.replace(b"numpy", b"nimpy", 1),
        "cut": data[: first - 5] + b"\n" + data[first:],
        "junk": b"\xff\x00\n" + data[first:],
    }[damage]
    store.write_bytes(spoiled)
    source_digest._stored_entries.cache_clear()
    assert source_digest._read_entry("a") is None and source_digest._read_entry("b") == ENTRY


def test_a_folder_that_cannot_be_written_is_no_fault(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    source_digest._stored_entries.cache_clear()
    source_digest._write_entry("a", ENTRY)
    assert source_digest._read_entry("a") == ENTRY
    source_digest._stored_entries.cache_clear()


def test_a_source_is_parsed_once(store, monkeypatch):
    path = source_digest.module_path("vgmpi.kernels.particle_records")
    first = source_digest._Parsed("vgmpi.kernels.particle_records", path)
    monkeypatch.setattr(source_digest.ast, "parse", lambda text: pytest.fail("parsed again"))
    again = source_digest._Parsed("vgmpi.kernels.particle_records", path)
    assert (again.imports, again.annotated) == (first.imports, first.annotated)
    assert again.digest == first.digest and first.imports
