"""Frames hold the particles that are there, gaussians.h5 all that may come: a picture takes its
rows by their ids."""

from types import SimpleNamespace

import numpy as np
import pytest

from tests.support.small_scenes import scene
from vgmpi import api
from vgmpi.features.inlets_outlets import geometry
from vgmpi.io import csv_log
from vgmpi.io.run_reader import RunReader, inspect
from vgmpi.postprocess.frames.appearance import Appearance
from vgmpi.postprocess.frames.render_config import LookSettings
from vgmpi.postprocess.studio.lattice_deformation import stretches
from vgmpi.postprocess.studio.studio_bodies import tearing
from vgmpi.postprocess.studio.studio_renderer import STREAM_STRETCH

SCENE = """
[accuracy]
pressure = "explicit"
precision = "double"
[domain]
size = [0.2, 0.16, 0.16]
cell = 0.02
[time]
end = 0.05
frames = 3
[material.water]
kind = "fluid"
tait_coefficient = 2e4
[[object]]
name = "drop"
material = "water"
shape = { box = [[0.02, 0.02, 0.02], [0.06, 0.06, 0.06]] }
color = "#ff0000"
[[inlet]]
name = "tap"
material = "water"
disc = { center = [0.08, 0.1, 0.12], radius = 0.02 }
direction = "x"
speed = 1
start_time = 0.02
color = "#0000ff"
[[outlet]]
name = "east"
shape = { box = [[0.1, 0.08, 0.1], [0.2, 0.16, 0.14]] }
"""


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("poured")
    api.run(scene(folder, SCENE), folder / "out", engine="numpy")
    return RunReader(folder / "out")


@pytest.mark.parametrize("transfer", ["off", "frame", "relax"])
def test_a_picture_of_what_is_there(run, transfer):
    look = Appearance(run, LookSettings(color_transfer=transfer))
    eye, counts = np.array([1.0, -1.0, 0.5]), []
    for k in range(len(run)):
        frame = look.frame(k)
        splats = look.splats(frame, eye)
        counts.append(len(frame["id"]))
        assert len(splats.x) == counts[-1] < len(run.gaussians.x0)
        tap = run.gaussians.object[frame["id"]] == 1
        assert (frame["object"] == run.gaussians.object[frame["id"]]).all()
        blue = splats.color[:, 2] > splats.color[:, 0]
        assert (blue == tap).all()
    assert counts[0] < counts[-1] and tap.any()


def test_files_are_whole(run):
    """Also the series, whose frames are of several lengths, and the table."""
    for name in ("series.vtkhdf", "gaussians.h5", "frames/frame_00001.vtkhdf"):
        assert "NOT VALID" not in inspect(run.folder / name)
    for row in csv_log.read_rows(run.folder / "ledger.csv"):
        assert row["particles_in"] - row["particles_out"] == row["particles"]
    assert row["particles_out"] > 0
    assert run.objects[1]["role"] == "source" and run.objects[1]["row_count"] > 0


@pytest.mark.parametrize("direction", [[1, 0, 0], [1, 0, 1]])
def test_the_studio_knows_how_a_stream_is_drawn_out(tmp_path, direction):
    """Kernels of a stream that is drawn out sixfold have its stretch, those at its rim too."""
    text = SCENE.replace('direction = "x"', f"direction = {direction}")
    tap = scene(tmp_path, text).lists["inlet"][0]
    mouth, h = geometry.inlet_points(tap, 0.02), geometry.spacing(tap, 0.02)
    n, stretch, along = len(mouth), 6.0, np.array(tap.direction)
    count = 20 * n
    x0, ids = np.resize(mouth, (count, 3)), np.arange(count)
    entry = {"role": "source", "family": "fluid"}
    look = SimpleNamespace(
        run=SimpleNamespace(gaussians=SimpleNamespace(x0=x0, v0=0 * x0 + along, object=0 * ids)),
        vol0=np.full(count, h**3), object=0 * ids, objects=[entry],
    )  # fmt: skip
    x = (x0 - tap.disc.center) / stretch**0.5
    x = x - np.outer(stretch * h * (ids + 0.5) / n, along)
    torn, links = tearing(look, (2.0, 3.0))
    found = stretches(x, ids, ids, links, np.full(count, h), torn, *STREAM_STRETCH)
    V = stretch**-0.5 * (np.eye(3) - np.outer(along, along)) + stretch * np.outer(along, along)
    wanted = V[np.triu_indices(3)]
    inner = slice(2 * n, -2 * n)
    assert np.abs(found[inner] - wanted).max() < 0.02 * stretch
