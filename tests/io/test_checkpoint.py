"""Checkpoints: two are kept, broken ones are passed over in words."""

import json
import logging

import h5py
import numpy as np
import pytest

from tests.parallel.fault_job import state
from tests.support.simulated_ranks import run
from vgmpi.io import checkpoint, file_layout
from vgmpi.io.run_reader import inspect
from vgmpi.parallel.communicator import SerialCommunicator


def steps(folder):
    return sorted(int(p.stem[-9:]) for p in folder.glob("*.h5"))


@pytest.fixture
def folder(tmp_path):
    for step in (10, 20, 30):
        checkpoint.write(tmp_path, SerialCommunicator(), state(step, 70_000))
    return tmp_path


def test_the_last_two_are_kept(folder):
    assert steps(folder) == [20, 30]
    assert len(list(folder.iterdir())) == 4


def test_what_was_written_comes_back(folder):
    path = checkpoint.latest_valid(folder)
    checkpoint.verify(path)
    with checkpoint.open(path) as c:
        assert c.attrs["step"] == 30 and c.attrs["schema"] == file_layout.SCHEMA
        assert c.names("particles") == ["v", "x"] and c.count("particles/x") == 70_000
        assert (c.read_rows("particles/v", 69_990, 70_000) == -30.5).all()
    assert "agrees with its manifest" in inspect(path)


def test_going_on_from_an_older_one_gives_up_the_newer(folder):
    checkpoint.write(folder, SerialCommunicator(), state(25, 10))
    assert steps(folder) == [20, 25]
    assert checkpoint.latest_valid(folder).name.endswith("25.h5")


def test_clear(folder):
    checkpoint.clear(folder, SerialCommunicator())
    assert list(folder.iterdir()) == []
    for empty in (folder, folder / "nowhere"):
        with pytest.raises(checkpoint.CheckpointError) as none:
            checkpoint.latest_valid(empty)
        assert str(none.value) == f"--resume: no valid checkpoint in {empty}"
    checkpoint.clear(folder / "nowhere", SerialCommunicator())


def flip(path):
    with h5py.File(path, "r+") as f:
        f["particles/x"][69_999, 2] += 1e-9


def cut(path):
    path.write_bytes(path.read_bytes()[:-100])


def other_schema(path):
    manifest = path.with_suffix(".json")
    manifest.write_text(json.dumps({**json.loads(manifest.read_text()), "schema": 99}))


BREAKS = {
    "checksum of particles/x, chunk 1": flip,
    "bytes instead of": cut,
    "no manifest": lambda path: path.with_suffix(".json").unlink(),
    "manifest is not readable": lambda path: path.with_suffix(".json").write_text('{"schema"'),
    "the file is missing": lambda path: path.unlink(),
    "schema is 99": other_schema,
}


@pytest.mark.parametrize("text", BREAKS)
def test_a_broken_one_is_passed_over_in_words(folder, caplog, text):
    path = folder / "checkpoint_000000030.h5"
    BREAKS[text](path)
    with caplog.at_level(logging.WARNING):
        assert checkpoint.latest_valid(folder).name == "checkpoint_000000020.h5"
    (record,) = caplog.records
    said = record.getMessage()
    assert text in said and path.name in said and "\n" not in said
    assert "resuming from checkpoint_000000020.h5" in said
    with pytest.raises(checkpoint.CheckpointError, match=text):
        run(3, lambda ranks: checkpoint.verify(path, ranks))


def test_when_none_is_left(folder, caplog):
    for path in folder.glob("*.h5"):
        cut(path)
    with pytest.raises(checkpoint.CheckpointError) as none:
        run(2, lambda ranks: checkpoint.latest_valid(folder, ranks))
    assert not caplog.records
    text = str(none.value)
    assert text.startswith(f"--resume: no valid checkpoint in {folder}: checkpoint_000000030.h5 (")
    assert "; checkpoint_000000020.h5 (" in text and "NOT VALID" not in text


def test_names_outside_the_layout_are_refused(tmp_path):
    with pytest.raises(ValueError, match="particles/color"):
        wrong = {"particles": {"color": np.zeros(3)}}
        checkpoint.write(tmp_path, SerialCommunicator(), {"attrs": {"step": 1}, "groups": wrong})


def test_a_file_that_is_no_checkpoint_is_one_clear_line(tmp_path):
    (tmp_path / "a.h5").write_text("nothing")
    with pytest.raises(checkpoint.CheckpointError, match="a.h5: not a checkpoint: "):
        checkpoint.open(tmp_path / "a.h5")
