"""gaussians.h5, ledger.csv and the page that describes the files."""

import csv
from pathlib import Path

import numpy as np
import pytest

from tests.parallel.files_job import rest_rows, row
from tests.support.simulated_ranks import run
from vgmpi.io import csv_log, file_layout, initial_state, layout_reference
from vgmpi.io.run_reader import RunError, inspect, read_gaussians
from vgmpi.parallel.communicator import SerialCommunicator

OBJECTS = [{"name": "pool", "kind": "fluid", "first_row": 0, "row_count": 50}]


def scenery(n=4):
    return {k: v for k, v in rest_rows(n).items() if k != "vol0"}


def test_rest_state_comes_back(tmp_path):
    path = tmp_path / "gaussians.h5"
    rows = {**rest_rows(50), "shade": np.linspace(0.7, 1, 50)}

    def job(ranks):
        mine = rows if ranks.rank == 0 else None
        initial_state.write(path, ranks, mine, OBJECTS, scenery(), {"title": "t"}, "abc")
        return initial_state.read_slice(path, 10 * ranks.rank, 10 * ranks.rank + 10)

    slices = run(3, job)
    found = read_gaussians(path)
    for name, array in rows.items():
        read = getattr(found, name)
        assert np.array_equal(read, array.astype(read.dtype))
        assert np.array_equal(slices[2][name], read[20:30])
    assert found.v0 is None and "v0" not in slices[0]
    assert np.array_equal(found.scenery.x0, scenery()["x0"])
    assert found.x0.dtype == np.float64 and found.cov0.dtype == np.float32
    assert (found.objects, found.scene, found.digest) == (OBJECTS, {"title": "t"}, "abc")
    assert (
        initial_state.preparation_hash(path) == "abc"
        and initial_state.preparation_hash(tmp_path / "none.h5") == ""
    )
    assert "object 0: pool fluid, 50 rows from 0" in inspect(path)


def test_moving_bodies_and_no_scenery(tmp_path):
    path = tmp_path / "gaussians.h5"
    rows = {**rest_rows(5), "v0": np.ones((5, 3))}
    initial_state.write(path, SerialCommunicator(), rows, OBJECTS)
    found = read_gaussians(path)
    assert found.v0.tolist() == np.ones((5, 3)).tolist() and found.scenery is None


@pytest.mark.parametrize(
    "change, text",
    [
        ({"cov0": np.zeros((5, 9))}, "cov0"),
        ({"opacity": np.zeros(4)}, "opacity"),
        ({"color": np.zeros(5)}, "color"),
    ],
)
def test_wrong_rows_are_refused(tmp_path, change, text):
    with pytest.raises(ValueError, match=text):
        initial_state.write(
            tmp_path / "gaussians.h5", SerialCommunicator(), {**rest_rows(5), **change}, OBJECTS
        )


def test_other_schema_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(file_layout, "SCHEMA", 99)
    initial_state.write(tmp_path / "gaussians.h5", SerialCommunicator(), rest_rows(5), OBJECTS)
    monkeypatch.undo()
    with pytest.raises(RunError, match="gaussians.h5: its schema is 99"):
        read_gaussians(tmp_path / "gaussians.h5")


def test_rows_that_cannot_be_are_refused(tmp_path):
    for change, said in (
        ({"object": np.full(5, 2**30, np.int32)}, "object names objects that are not there"),
        ({"x0": np.full((5, 3), np.nan)}, "x0 holds what is no number"),
        ({"opacity": np.full(5, np.inf)}, "opacity holds what is no number"),
        ({"sh": np.zeros((5, 2, 3))}, "sh has 2 coefficients, not 1, 4, 9 or 16"),
        ({"shade": np.full(5, np.nan)}, "shade holds what is no number"),
        ({"shade": np.array([1, 1, 0, 1, 1])}, "shade holds what is not above 0 and at most 1"),
        ({"shade": np.array([1, 1, 1.01, 1, 1])}, "shade holds what is not above 0 and at most 1"),
    ):
        initial_state.write(
            tmp_path / "gaussians.h5", SerialCommunicator(), {**rest_rows(5), **change}, OBJECTS
        )
        with pytest.raises(RunError, match=said):
            read_gaussians(tmp_path / "gaussians.h5")


def test_carriers_that_are_not_there_are_refused(tmp_path):
    riders = {k: v for k, v in rest_rows(3).items() if k != "vol0"}
    riders |= {"carriers": np.full((3, 4), 5), "weights": np.full((3, 4), 0.25)}
    initial_state.write(
        tmp_path / "gaussians.h5",
        SerialCommunicator(),
        rest_rows(5),
        OBJECTS,
        scenery(),
        passive=riders,
    )
    with pytest.raises(RunError, match="passive/carriers names particles that are not there"):
        read_gaussians(tmp_path / "gaussians.h5")


def test_ledger(tmp_path):
    book = csv_log.ConservationLog(tmp_path, SerialCommunicator())
    for step in (0, 10, 20, 30):
        book.append([row(step), {**row(step), "phase": 'sand, "wet"', "mass": np.float64(1 / 3)}])
    with open(tmp_path / "ledger.csv", newline="") as f:
        assert next(csv.reader(f)) == [*csv_log.COLUMNS, "crc"]
    found = csv_log.read_rows(tmp_path / "ledger.csv")
    assert [r["step"] for r in found] == [0, 0, 10, 10, 20, 20, 30, 30]
    assert found[1]["phase"] == 'sand, "wet"' and found[1]["mass"] == 1 / 3


def test_ledger_of_a_resumed_run(tmp_path):
    csv_log.ConservationLog(tmp_path, SerialCommunicator()).append(
        [row(step) for step in (0, 10, 20)]
    )
    whole = (tmp_path / "ledger.csv").read_bytes()
    with open(tmp_path / "ledger.csv", "a") as f:
        f.write("0.03,30,water,15")  # cut off by a kill
    book = csv_log.ConservationLog(tmp_path, SerialCommunicator(), last_step=10)
    assert [r["step"] for r in csv_log.read_rows(book.path)] == [0, 10]
    book.append([row(20)])
    assert book.path.read_bytes() == whole
    csv_log.ConservationLog(tmp_path, SerialCommunicator())
    assert csv_log.read_rows(book.path) == []


def test_page_is_up_to_date():
    kept = Path(file_layout.__file__).parents[2] / "docs" / "reference" / "file-format.md"
    assert kept.read_text() == layout_reference.page(), "run `make docs`"


def test_shapes_of_the_layout():
    known = file_layout.named(file_layout.GAUSSIAN)
    assert file_layout.row_shape(known["sh"]) == (None, 3)
    assert file_layout.fits(known["sh"], np.zeros((2, 9, 3), np.float32))
    assert not file_layout.fits(known["sh"], np.zeros((2, 9, 3)))
    assert not file_layout.fits(known["x0"], np.zeros((2, 2)))
    assert not file_layout.fits(known["vol0"], np.zeros((2, 1)))
