"""Tables and manifests: what is damaged is named with its line or entry."""

import json
import os

import numpy as np
import pytest

from tests.support import damaged_files
from vgmpi.io import checkpoint, csv_log, file_layout
from vgmpi.io.run_reader import RunError
from vgmpi.parallel.communicator import SerialCommunicator


@pytest.fixture
def out(tmp_path):
    return damaged_files.write(tmp_path / "out")


# ---- tables ------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["ledger", "probe"])
def test_every_byte_of_a_table_counts(out, kind):
    """A changed one names its line; a table may end anywhere, as a kill leaves it."""
    name, look = damaged_files.LOOKS[kind]
    path, want = out / name, look(out / name)
    text = path.read_bytes()
    for place in range(len(text)):
        line = text[:place].count(b"\n") + 1
        for bit in (0, 6):
            damaged_files.flip(path, place, bit)
            with pytest.raises(RunError, match=f"{name}:{line}: damaged: "):
                look(path)
            damaged_files.flip(path, place, bit)
    for end in range(text.index(b"\n") + 1, len(text)):
        path.write_bytes(text[:end])
        found = look(path)
        whole = text[:end].count(b"\n") - 1
        assert found == want[: len(found)] and whole <= len(found) <= whole + 1


@pytest.mark.parametrize("order", [[0, 1, 3, 4], [0, 1, 3, 2, 4], [0, 1, 1, 2], [0, 2]])
def test_rows_that_came_went_or_changed_places_are_named(out, order):
    path = out / file_layout.LEDGER
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(lines[k] for k in order))
    wrong = next(k for k, line in enumerate(order) if line != k)
    with pytest.raises(RunError, match=f"ledger.csv:{wrong + 1}: damaged: this row is not what"):
        csv_log.read_rows(path)


@pytest.mark.parametrize("text", ["", "nonsense", "\xff\xfe\n", "time,step\n0,1\n"])
def test_what_is_no_table_is_named(out, text):
    (out / file_layout.LEDGER).write_text(text, encoding="latin-1")
    with pytest.raises(RunError, match="ledger.csv:1: damaged: its columns are not time,step,"):
        csv_log.read_rows(out / file_layout.LEDGER)
    with pytest.raises(RunError, match="ledger.csv:1: damaged"):
        csv_log.ConservationLog(out, SerialCommunicator(), last_step=100)
    assert (out / file_layout.LEDGER).read_text(encoding="latin-1") == text


def test_a_table_without_checksums_is_refused(out):
    path = out / file_layout.LEDGER
    lines = [line.rpartition(",")[0] for line in path.read_text().splitlines()]
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(RunError, match="ledger.csv:1: damaged: its columns are not time,step,"):
        csv_log.read_rows(path)


def test_a_table_that_is_gone_is_told(out, caplog):
    (out / file_layout.LEDGER).unlink()
    csv_log.ConservationLog(out, SerialCommunicator(), last_step=100)
    assert "ledger.csv is not there: it begins behind step 100" in caplog.text


def test_people_read_a_table_with_numpy(out):
    found = np.genfromtxt(out / "probe_tap.csv", delimiter=",", names=True)
    assert found["step"].tolist() == [0, 100, 200] and found["velocity_z"][1] == 1 / 3 + 1


# ---- manifests ---------------------------------------------------------------------------------


ODD = {
    "a list": lambda said: [said],
    "no entries": lambda said: said | {"datasets": 3},
    "a list of entries": lambda said: said | {"datasets": list(said["datasets"])},
    "an odd entry": lambda said: said | {"datasets": said["datasets"] | {"group_000/x": "all"}},
    "a number for sums": lambda said: _entry(said, crc=3),
    "a text as a sum": lambda said: _entry(said, crc=["3"]),
    "a part of a row": lambda said: _entry(said, shape=[0.5, 3]),
    "no type": lambda said: _entry(said, dtype=None),
    "a size in words": lambda said: said | {"bytes": "many"},
    "truth as a size": lambda said: said | {"bytes": True},
    "a dataset less": lambda said: said | {"datasets": {"attrs": said["datasets"]["attrs"]}},
    "another step": lambda said: said | {"step": 100},
    "another time": lambda said: said | {"time": [1]},
}


def _entry(said, **change):
    x = said["datasets"]["group_000/x"] | change
    return said | {"datasets": said["datasets"] | {"group_000/x": x}}


@pytest.mark.parametrize("odd", ODD)
def test_odd_manifests_are_passed_over(out, caplog, odd):
    path = out / "checkpoints" / "checkpoint_000000200.json"
    path.write_text(json.dumps(ODD[odd](json.loads(path.read_text()))))
    assert checkpoint.latest_valid(path.parent).name == "checkpoint_000000100.h5"
    assert "passed over checkpoint_000000200.h5 (" in caplog.records[0].getMessage()
    with pytest.raises(checkpoint.CheckpointError):
        checkpoint.verify(path.with_suffix(".h5"))


def test_a_checkpoint_under_another_name_is_passed_over(out, caplog):
    folder = out / file_layout.CHECKPOINTS
    for end in ("h5", "json"):
        os.rename(folder / f"checkpoint_000000200.{end}", folder / f"checkpoint_000000300.{end}")
    assert checkpoint.latest_valid(folder).name == "checkpoint_000000100.h5"
    assert "checkpoint_000000300.h5 (it is of step 200, not 300)" in caplog.text


@pytest.mark.parametrize(
    "change, said",
    [
        (lambda f: f.create_dataset("group_000/color", data=np.zeros(3)), "color is not as the"),
        (lambda f: f.create_dataset("group_000/C", data=np.zeros((3, 9))), "has 3 rows instead of"),
        (lambda f: f.create_dataset("group_000/vol0", data=np.zeros(3)), "vol0 is not as the"),
    ],
)
def test_forms_of_a_checkpoint_are_looked_at(out, caplog, change, said):
    """Although its manifest agrees."""
    path = out / "checkpoints" / "checkpoint_000000200.h5"
    damaged_files.forge(path, change)
    assert checkpoint.latest_valid(path.parent).name == "checkpoint_000000100.h5"
    assert said in caplog.text or "rows instead of 3" in caplog.text
