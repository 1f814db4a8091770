"""Exported files say how their captures were trained, where their format can."""

import numpy as np
import pytest

from tests.support import captured_runs
from tests.support.captured_runs import PICTURE
from vgmpi.gaussians.formats import registry
from vgmpi.io.run_reader import RunReader
from vgmpi.postprocess.commands import export
from vgmpi.postprocess.export.export_moving import RunMotion
from vgmpi.postprocess.frames.appearance import Appearance
from vgmpi.postprocess.web import web_page


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    return captured_runs.write_runs(tmp_path_factory.mktemp("runs"))


def written(run, tmp_path, monkeypatch, *flags):
    """Cloud that `vgmpi export` hands to the writer."""
    clouds = []
    monkeypatch.setattr(registry, "write", lambda path, cloud, version: clouds.append(cloud))
    assert export.main([str(run), "-o", str(tmp_path / "g"), *flags]) == 0
    return clouds[0]


def test_an_export_carries_the_model_of_the_captures(runs, tmp_path, monkeypatch, caplog):
    assert not written(runs["classic"], tmp_path, monkeypatch).is_antialiased
    assert not caplog.records or "render model" not in caplog.text
    both = written(runs["antialiased"], tmp_path, monkeypatch)
    assert both.is_antialiased and both.lowpass == 0.3
    assert "written is antialiased" in caplog.text and "box (" in caplog.text
    assert "moon" not in caplog.text


def test_the_model_of_most_gaussians_is_written(runs, tmp_path, monkeypatch, caplog):
    """As many Gaussians in both captures: the filling of the body is not drawn."""
    got = written(runs["mixed"], tmp_path, monkeypatch)
    assert got.is_antialiased
    assert caplog.text.count("a file has one render model") == 1 and "mip)" in caplog.text
    caplog.clear()
    got = written(runs["mixed"], tmp_path, monkeypatch, "--no-scenery")
    assert got.lowpass == 0.3 and "mip" not in caplog.text


@pytest.mark.parametrize("suffix", ["ply", "compressed.ply", "spz", "sog"])
@pytest.mark.parametrize("name", ["classic", "mip"])
def test_an_exported_file_is_read_back_with_its_model(runs, tmp_path, suffix, name):
    argv = [str(runs[name]), "-o", str(tmp_path), "--format", suffix, "--no-scenery", "-q"]
    assert export.main(argv) == 0
    got = registry.read(tmp_path / f"frame_00000.{suffix}")
    assert got.is_antialiased == (name == "mip")


@pytest.mark.parametrize("suffix", ["splat", "glb"])
def test_a_format_without_a_model_says_so(runs, tmp_path, monkeypatch, caplog, suffix):
    written(runs["antialiased"], tmp_path, monkeypatch, "--format", suffix)
    assert caplog.text.count(f"a .{suffix} holds no render model") == 1
    assert "a file has one" not in caplog.text


def test_openusd_holds_no_model(runs, tmp_path, caplog):
    pytest.importorskip("pxr")
    for name, count in (("ball", 1), ("classic", 0)):
        caplog.clear()
        path = str(tmp_path / f"{name}.usda")
        assert export.main([str(runs[name]), "--format", "usd", "-o", path]) == 0
        assert caplog.text.count("OpenUSD holds no render model") == count
    assert "too opaque: ball" in caplog.text or count == 0


@pytest.mark.parametrize("text, want", [
    ("", [0.1, 0.3, 0]), ("lowpass = 0.2", [0.2, 0.2, 0]), ('mode = "classic"', [0, 0, 0]),
    ('mode = "mip"', [0, 0, 0]),
])  # fmt: skip
def test_a_page_plays_each_object_by_its_model(runs, tmp_path, text, want):
    (tmp_path / "render.toml").write_text(PICTURE + "[splatting]\n" + text)
    path = tmp_path / "page.html"
    argv = [str(runs["mixed"]), str(tmp_path / "render.toml"), "--format", "web", "-o", str(path)]
    assert export.main(argv) == 0
    reader = web_page.read_page(path)
    assert [group.name for group in reader.groups] == ["scenery", "ball", "box"]
    assert [group.compensated_lowpass for group in reader.groups] == want
    view = reader.header["view"]
    assert view["antialias"] == ("mip" in text)
    assert view["lowpass"] == (0.2 if "lowpass" in text else 0.1 if "mip" in text else 0.3)
    told = ["compensated_lowpass" in entry for entry in reader.header["groups"]]
    assert told == [bool(value) for value in want]


def test_scenery_of_two_models_becomes_two_groups(runs):
    look = Appearance(RunReader(runs["mixed"]))
    scenery = look.scenery
    scenery.compensated_lowpass = np.where(scenery.x0[:, 0] < 0.75, 0.0, 0.1)
    motion = RunMotion(look, 0)
    first, second = motion.groups[:2]
    assert (first.name, second.name) == ("scenery", "scenery")
    assert (first.compensated_lowpass, second.compensated_lowpass) == (0.0, 0.1)
    assert first.count + second.count == len(scenery.x0)
    assert (motion.rest_gaussians.x[: first.count, 0] < 0.75).all()
    assert (motion.rest_gaussians.x[first.count :][: second.count, 0] >= 0.75).all()
