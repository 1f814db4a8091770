"""The validation page is made from a CSV file, and that from the records of the physics tests."""

from dataclasses import replace

import pytest

from tests.benchmarks import validation_page as pages
from tests.benchmarks import validation_rows as table
from tests.benchmarks.validation_summary import SUMMARY, Effect
from tests.support.validation_record import held

SAY = {"unit": "m/s", "source": "Ren 2014", "note": "40 cells"}
REPORT = """<testsuites><testsuite>
<testcase classname="tests.physics.test_mixing" name="test_slip[2]" time="12.34"/>
</testsuite></testsuites>"""
DEVIATION = "1 is a known deviation"


@pytest.fixture
def records(tmp_path, monkeypatch):
    """Write the records of three results: a pass, a negative control, a known deviation."""
    folder = tmp_path / "held"
    monkeypatch.setenv("VGMPI_HELD", str(folder))
    test = "tests/physics/test_mixing.py::test_slip[two fluids] (call)"
    monkeypatch.setenv("PYTEST_CURRENT_TEST", test)
    curves = {"ours": ([0, 1, 2], [0.0, 1.1, 1.9]), "exact": ([0, 2], [0.0, 2.0])}
    held("slip", 0.99, 1.0, 0.02, curves=curves, axes=("t [s]", "slip [m/s]"), **SAY)
    held("slip | as printed", 0.5, 1.0, 0.02, expected=False, **SAY)
    held("slip, coarse", 0.9, 1.0, 0.02, expected=False, deviation=True, **SAY)
    return folder


@pytest.fixture
def rows(records):
    return table.collect(records)[0]


def line(case, text):
    return next(row for row in text.splitlines() if row.startswith(f"| {case} |"))


def test_records_become_rows(rows):
    assert [row.outcome for row in rows] == [table.PASS, table.CONTROL, table.DEVIATION]
    assert {row.topic for row in rows} == {"Mixing"}
    assert {row.test for row in rows} == {"tests/physics/test_mixing.py::test_slip[two fluids]"}
    assert [row.plot for row in rows] == ["slip.png", "", ""]


def test_outcomes():
    assert table.outcome(good=True, expected=True, deviation=True) == table.PASS
    assert table.outcome(good=True, expected=False, deviation=False) == table.UNEXPECTED
    assert table.outcome(good=False, expected=True, deviation=False) == table.FAIL
    assert table.outcome(good=False, expected=True, deviation=True) == table.DEVIATION  # xfail
    assert table.outcome(good=False, expected=False, deviation=False) == table.CONTROL


def test_csv_keeps_the_rows(rows, tmp_path):
    table.write(tmp_path / "data" / "rows.csv", rows)
    rounded = [replace(row, error=round(row.error, 6)) for row in rows]
    assert table.read(tmp_path / "data" / "rows.csv") == rounded
    assert table.read(tmp_path / "none.csv") == []


def test_rows_of_tests_that_did_not_run_stay(rows):
    old = [replace(rows[0], value=7.0), replace(rows[1], case="long test")]
    merged = table.merge(old, rows)
    assert [row.case for row in merged] == ["long test", *(row.case for row in rows)]
    assert merged[1].value == 0.99


def test_table(rows):
    text = pages.topics(rows)
    assert text.startswith("## Mixing\n\n| case | result |")
    assert line("slip", text) == "| slip | 0.99 m/s | 1 m/s | 1 % (2 %) | pass | Ren 2014 |"
    assert "as printed" not in text
    assert "| **known deviation** |" in line("slip, coarse", text)
    assert "![slip](../pictures/slip.png)" in text


def test_passing_rows_of_a_topic_become_the_line_closest_to_its_tolerance(rows):
    alike = [replace(rows[0], case=f"slip at {k} cells", error=k / 1e3) for k in (1, 4, 2)]
    shown = pages.lines([*alike, rows[2]])
    assert [cells[0] for cells in shown] == ["slip at 4 cells (closest of 3)", "slip, coarse"]
    failing = [replace(row, outcome=table.FAIL) for row in alike]
    assert len(pages.lines(failing)) == 3 and pages.lines(failing)[0][4] == "**fail**"


def test_how_much_of_its_tolerance_a_row_takes(rows):
    def used(kind, value, reference, tolerance):
        row = replace(rows[0], kind=kind, value=value, reference=reference, tolerance=tolerance)
        return pages.tolerance_used(row)

    assert pages.tolerance_used(rows[0]) == pytest.approx(0.5)
    assert used("below", 3.0, 1.0, 5.0) == pytest.approx(0.5)
    assert used("above", 0.95, 1.0, 0.9) == pytest.approx(0.5)
    assert used("below", 0.5, 1.0, 1.0) == pytest.approx(0.5)


def test_bounds(rows):
    assert pages.cells(rows[1])[0] == "slip \\| as printed"
    assert pages.cells(rows[1])[3:5] == ["50 % (2 %)", "negative control"]
    below = replace(rows[0], kind="below", value=1e-15, reference=0.0, tolerance=1e-12)
    assert pages.cells(below)[1:4] == ["1.0e-15 m/s", "0", "(< 1.0e-12)"]
    above = replace(rows[0], kind="above", value=1.98, reference=2.0, tolerance=1.8)
    assert pages.cells(above)[1:4] == ["1.98 m/s", "2", "(> 1.8)"]


def test_summary_fills_in_numbers(rows):
    effect = Effect("Slip", "Mixing", "two fluids", (("slip*", "off by {error}"),), "Ren 2014")
    cells = pages.effect_line(effect, rows)
    text = "off by 1 to 50 % (*1 of 3: known deviation*)"
    assert cells == ["[Slip](#mixing)", "two fluids", text, "Ren 2014"]
    with pytest.raises(ValueError, match="no row"):
        pages.effect_line(effect, [])
    assert DEVIATION in pages.counts(rows)


def test_plots(records, rows, tmp_path):
    _, by_case = table.collect(records)
    pictures = tmp_path / "pictures"
    pictures.mkdir()
    for name in ("gone.png", "of-another-page.png"):
        (pictures / name).touch()
    old = [replace(rows[0], case="gone", plot="gone.png")]
    pages.draw_all(rows, old, by_case, pictures)
    assert sorted(f.name for f in pictures.iterdir()) == ["of-another-page.png", "slip.png"]
    assert 2000 < (pictures / "slip.png").stat().st_size < pages.LARGEST


def test_seconds(tmp_path):
    (tmp_path / "report.xml").write_text(REPORT)
    found = table.durations(tmp_path / "report.xml")
    assert found == {"tests/physics/test_mixing.py::test_slip[2]": 12.34}


def test_files_find_their_topic():
    for file, heading in (
        ("tests/physics/test_sand_column.py::test_run_out[1]", "Granular materials"),
        ("tests/physics/test_hydrostatic.py::test_at_rest", "Liquids"),
        ("tests/physics/test_unheard_of.py::test_it", table.OTHER),
    ):
        assert table.topic(file) == heading


def test_published_numbers_stand_beside_both_pressures(rows):
    """A line for each number, with the values of all resolutions in the order of the cells."""
    runs = [(40, "explicit", 3.0), (20, "explicit", 2.0), (20, "implicit", 1.0)]
    chosen = [
        replace(rows[0], case=f"front, {n} cells per width, {pressure} pressure", value=value)
        for n, pressure, value in runs
    ]
    assert pages.beside_lines(chosen) == [["front", "1 m/s", "2, 3", "1, -", "20, 40", "Ren 2014"]]
    with pytest.raises(ValueError, match="cells"):
        pages.beside_lines(rows)


def test_a_row_without_a_tolerance_is_a_comparison():
    assert table.outcome(True, True, False, float("inf")) == table.COMPARISON


def test_markers_must_be_there(rows):
    with pytest.raises(SystemExit, match="markers"):
        pages.page("# a page without them", table.read(table.CSV))


def test_the_page_is_that_of_the_data():
    rows = table.read(table.CSV)
    text = pages.PAGE.read_text()
    assert pages.page(text, rows) == text, "python -m tests.benchmarks.validation --page"
    assert 18 <= len(SUMMARY) <= 26
    for row in rows:
        assert row.topic == table.topic(row.test)
        assert (table.ROOT / row.test.split("::")[0]).is_file()
        assert not row.plot or (pages.PICTURES / row.plot).is_file()
