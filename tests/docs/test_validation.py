"""The page of validation is made right of what tests note: two rows, one of them known to fail."""

import pytest

from tests.benchmarks import validation
from tests.support.validation_record import held

HAND = f"# By hand\n\n{validation.BEGIN}\nold\n{validation.END}\n\n## Also by hand\n"
REPORT = """<testsuites><testsuite>
<testcase classname="tests.physics.test_mixing" name="test_slip[2]" time="12.34"/>
</testsuite></testsuites>"""


@pytest.fixture
def rows(tmp_path, monkeypatch):
    """As a test of the physics leaves them."""
    folder = tmp_path / "held"
    monkeypatch.setenv("VGMPI_HELD", str(folder))
    monkeypatch.setenv("PYTEST_CURRENT_TEST", "tests/physics/test_mixing.py::test_slip[2] (call)")
    curves = {"ours": ([0, 1, 2], [0.0, 1.1, 1.9]), "exact": ([0, 2], [0.0, 2.0])}
    say = {"unit": "m/s", "source": "Ren 2014", "note": "40 cells"}
    held("slip", 0.99, 1.0, 0.02, curves=curves, axes=("t [s]", "slip [m/s]"), **say)
    held("slip | as printed", 0.5, 1.0, 0.02, expected=False, **say)
    (folder / validation.REPORT).write_text(REPORT)
    return validation.collect(folder)


def test_page(rows, tmp_path):
    pictures = tmp_path / "pictures"
    pictures.mkdir()
    (pictures / "of-a-row-that-is-gone.png").touch()
    text = validation.page(HAND, validation.made(rows, pictures, fast=False))
    assert text.startswith("# By hand\n") and text.endswith("## Also by hand\n")
    assert "old" not in text and text.count("### ") == 1
    tail = "12.3 | Ren 2014; 40 cells | `test_mixing.py::test_slip[2]` |"
    corrected = f"| slip | 0.99 m/s | 1 m/s | 1 % | 2 % | held | {tail}"
    printed = f"| slip \\| as printed | 0.5 m/s | 1 m/s | 50 % | 2 % | fails, as it must | {tail}"
    assert "### Mixing\n\n| case |" in text and f"{corrected}\n{printed}\n" in text
    assert "![slip](pictures/slip.png)" in text
    assert [file.name for file in pictures.iterdir()] == ["slip.png"]
    assert 2000 < (pictures / "slip.png").stat().st_size < validation.LARGEST
    again = validation.page(text, validation.made(rows, pictures, fast=False))
    assert again == text


def test_a_missed_row_is_seen(rows, tmp_path):
    rows[0]["good"], rows[1]["good"] = False, True
    text = validation.made(rows, tmp_path, fast=True)
    assert "**missed**" in text and "**holds, but should not**" in text
    assert "Without the long tests" in text


def test_bounds(rows):
    below = rows[0] | {"kind": "below", "value": 1e-15, "reference": 0.0, "tolerance": 1e-12}
    assert validation.cells(below)[1:5] == ("1.0e-15 m/s", "0", "", "< 1.0e-12")
    above = rows[0] | {"kind": "above", "value": 1.98, "reference": 2.0, "tolerance": 1.8}
    assert validation.cells(above)[1:5] == ("1.98 m/s", "2", "", "> 1.8")


def test_files_find_their_field():
    for file, heading in (
        ("tests/physics/test_sand_column.py::test_run_out[1]", "Sand and snow"),
        ("tests/physics/test_hydrostatic.py::test_at_rest", "Liquids"),
        ("tests/physics/test_unheard_of.py::test_it", validation.OTHER),
    ):
        assert validation.field({"test": file}) == heading


def test_markers_must_be_there(rows, tmp_path):
    with pytest.raises(SystemExit, match="markers"):
        validation.page("# a page without them", "part")
