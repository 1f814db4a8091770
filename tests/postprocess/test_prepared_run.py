"""A look at prepared particles, and calls that name the wrong files."""

import logging

import imageio.v3 as iio
import numpy as np
import pytest

from tests.support import drawn_runs
from vgmpi.postprocess.commands import render

SMALL = drawn_runs.on_paper("[picture]\nwidth = 96\nheight = 80\n")


@pytest.fixture
def out(tmp_path):
    return drawn_runs.write(tmp_path / "out", frames=2)


def draw(*words):
    return render.main([str(word) for word in words])


@pytest.fixture
def prepared(out):
    """What is there before the first frame."""
    for path in (out / "frames").iterdir():
        path.unlink()
    (out / "series.vtkhdf").unlink(missing_ok=True)
    return out


def test_a_preview_shows_prepared_particles_at_rest(out, tmp_path, caplog):
    (tmp_path / "render.toml").write_text(SMALL)
    first = tmp_path / "first.png"
    assert draw(out, tmp_path / "render.toml", "-q", "-o", first, "--preview", "--frame", 0) == 0
    for path in (out / "frames").iterdir():
        path.unlink()
    caplog.set_level(logging.INFO, "vgmpi")
    assert draw(out, tmp_path / "render.toml", "--preview") == 0
    assert caplog.messages.count(f"{out}: no frames yet: the prepared particles are drawn") == 1
    got, want = iio.imread(out / "preview.png").astype(int), iio.imread(first).astype(int)
    assert got.shape == want.shape == (80, 96, 3)
    assert np.ptp(got) > 60  # bodies are there
    assert np.abs(got - want).mean() < 8  # in the first frame they have hardly moved


def test_a_video_needs_frames(prepared, capsys):
    assert draw(prepared, "-q") == 2
    assert "its particles are prepared" in capsys.readouterr().err
    (prepared / "gaussians.h5").unlink()
    assert draw(prepared, "-q", "--preview") == 2
    assert "no frames in it" in capsys.readouterr().err


def test_swapped_and_missing_files_are_one_line(out, tmp_path, capsys):
    settings = tmp_path / "look.toml"
    settings.write_text(SMALL)
    for words, line in (
        ((settings, out), f"{out}: is a folder; the folder of the run comes first: "
         f"vgmpi render {out} {settings}"),
        ((settings,), f"{settings}: is a file; give the folder of a run first: "
         f"vgmpi render OUT {settings}"),
        ((out, tmp_path / "none.toml"),
         f"{tmp_path / 'none.toml'}: no such file; without it, the defaults are used"),
    ):  # fmt: skip
        assert draw(*words, "-q") == 2
        assert capsys.readouterr().err == f"{line}\n"
    (tmp_path / "render.toml").write_text(SMALL)  # beside the run
    assert draw(out, tmp_path / "none.toml", "-q") == 2
    said = capsys.readouterr().err
    assert said == f"{tmp_path / 'none.toml'}: no such file; there is {tmp_path / 'render.toml'}\n"
