"""A run's folder from Python and in Jupyter: frames, tables, pictures; the tutorial runs."""

import base64
import io
import subprocess
import sys
import urllib.request
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import vgmpi
from tests.support.launch import until
from vgmpi.io.run_reader import RunError

NOTEBOOK = Path(__file__).parents[2] / "docs" / "tutorial" / "notebook.ipynb"
SCENE = """
[domain]
size = [0.32, 0.32, 0.32]
cell = "2 cm"
gravity = [0, 0, -9.8]
[time]
end = "20 ms"
frames = 3
[material.rubber]
kind = "elastic"
youngs_modulus = "0.1 MPa"
[[object]]
name = "ball"
material = "rubber"
shape = { sphere = { center = [0.16, 0.16, 0.16], radius = "5 cm" } }
[[object]]
name = "crate"
material = "rubber"
rigid = true
shape = { box = [[0.02, 0.02, 0.2], [0.1, 0.1, 0.28]] }
[[probe]]
name = "ball"
sampling_rate = "1 kHz"
object = "ball"
[[probe]]
name = "crate"
sampling_rate = "1 kHz"
object = "crate"
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    (folder / "scene.toml").write_text(SCENE)
    job = subprocess.run(
        [sys.executable, "-m", "vgmpi", str(folder / "scene.toml")],
        capture_output=True, text=True, timeout=600,
    )  # fmt: skip
    assert job.returncode == 0, job.stderr
    return folder / "out"


def test_frames(folder):
    """Arrays by particle, by negative numbers and slices, and as pyvista data."""
    run = vgmpi.open_run(folder)
    assert len(run.frames) == 3 and [frame.number for frame in run.frames] == [0, 1, 2]
    last, read = run.frames[-1], vgmpi.read(folder).frame(2)
    assert last.number == 2 and last.time == pytest.approx(0.02)
    assert (last.positions == read["positions"]).all() and (
        last.velocities == read["velocity"]
    ).all()
    assert (last["J"] == read["J"]).all() and set(last.names) == set(read)
    assert [frame.number for frame in run.frames[1:]] == [1, 2]
    fallen = run.frames[0].positions.mean(0) - last.positions.mean(0)
    assert fallen[2] == pytest.approx(0.5 * 9.8 * 0.02**2, rel=0.05)  # steps
    cloud = last.to_pyvista()
    assert cloud.n_points == len(last.ids) and "poses" not in cloud.array_names
    assert np.asarray(cloud.point_data["velocity"]) == pytest.approx(last.velocities)


def test_tables(folder):
    """Probes and the log by pandas; a rigid body's probe has its pose."""
    pandas = pytest.importorskip("pandas")
    run = vgmpi.open_run(folder)
    assert list(run.probes) == ["ball", "crate"] and len(run.probes) == 2
    ball, crate = run.probes["ball"], run.probes["crate"]
    assert isinstance(ball, pandas.DataFrame) and len(ball) == 21
    assert crate["velocity_z"].iloc[-1] == pytest.approx(-9.8 * 0.02, rel=1e-6)
    assert crate["rotation_w"].iloc[-1] == 1.0
    assert run.ledger["mass"].iloc[0] == pytest.approx(ball["mass"].iloc[0])


def test_tables_without_pandas(folder, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    table = vgmpi.open_run(folder).probes["ball"]
    assert isinstance(table, dict) and table["time"].shape == (21,)


def test_pictures(folder, monkeypatch):
    """A picture shows the ball; Jupyter gets a thumbnail and numbers."""
    run = vgmpi.open_run(folder)
    picture = run.picture(0, size=120)
    assert picture.dtype == np.uint8 and picture.shape[2] == 3 and max(picture.shape) == 120
    assert picture.astype(float).std(axis=(0, 1)).min() > 5  # something is there
    page = run._repr_html_()
    data = page.split("base64,")[1].split("'")[0]
    assert max(Image.open(io.BytesIO(base64.b64decode(data))).size) == 240
    assert "<td style='text-align:left'>ball, crate</td>" in page
    monkeypatch.setitem(sys.modules, "IPython.display", None)
    assert max(run.show(0, size=100).size) == 100


def test_what_is_missing(folder, tmp_path):
    run = vgmpi.open_run(folder)
    with pytest.raises(IndexError, match="no frame 3, there are 3"):
        run.frames[3]
    with pytest.raises(KeyError, match="no probe 'bell'; there are ball, crate"):
        run.probes["bell"]
    with pytest.raises(RunError, match=r"frame 1 has no array 'stress'; it has id, positions"):
        run.frames[1]["stress"]
    with pytest.raises(RunError, match="no such folder"):
        vgmpi.open_run(tmp_path / "absent")
    (folder.parent / "render.toml").write_text("[picture]\nwidht = 3\n")
    try:
        assert "<i>no picture: " in run._repr_html_() and "widht" in run._repr_html_()
    finally:
        (folder.parent / "render.toml").unlink()


def test_the_tutorial_notebook_runs(tmp_path):
    """All cells run in a fresh kernel; the last one has a picture, the second a thumbnail."""
    nbclient, nbformat = pytest.importorskip("nbclient"), pytest.importorskip("nbformat")
    pytest.importorskip("pandas")
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    nbformat.validate(notebook)
    assert not any(cell.get("outputs") for cell in notebook.cells)  # the file stays small
    client = nbclient.NotebookClient(
        notebook, timeout=600, resources={"metadata": {"path": str(tmp_path)}}
    )
    client.execute()
    outputs = [cell.outputs for cell in notebook.cells if cell.cell_type == "code"]
    picture = outputs[-1][0]["data"]["image/png"]
    assert max(Image.open(io.BytesIO(base64.b64decode(picture))).size) == 400
    assert "the last frame" in outputs[1][0]["data"]["text/html"]
    assert "center_z" in outputs[4][0]["data"]["text/html"]
    center = float(outputs[2][0]["text"].rsplit("[", 1)[1].split("]")[0].split()[2])
    assert 0.1 < center < 0.15  # half as heavy as water, the ball floats


def test_a_live_page_in_a_cell(folder):
    """The page answers while the cell is there, and ends with it."""
    pytest.importorskip("viser", reason="no viser: pip install 'vgmpi[live]'")
    cell = vgmpi.open_run(folder).show_live(particles=1000, height=400)
    assert f'<iframe src="{cell.address}"' in cell._repr_html_()
    assert "height: 400px" in cell._repr_mimebundle_()["text/html"]
    with urllib.request.urlopen(cell.address, timeout=60) as page:
        assert b"<html" in page.read(4000).lower()
    cell.close()
    until(lambda: not answers(cell.address), "the page ends")


def answers(address):
    try:
        urllib.request.urlopen(address, timeout=5).close()
    except OSError:
        return False
    return True


def test_a_live_page_that_cannot_start_is_one_line(folder):
    with pytest.raises(RunError, match=r"--particles: 0: allowed: 1 to 300000"):
        vgmpi.open_run(folder).show_live(particles=0)
