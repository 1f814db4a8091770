"""Drafts of videos: small, coarse, with one sample per pixel."""

from pathlib import Path

import imageio.v3 as iio
import numpy as np
import pytest

from tests.support import drawn_runs
from vgmpi.io.run_reader import RunReader
from vgmpi.postprocess.commands import render
from vgmpi.postprocess.frames import render_config
from vgmpi.postprocess.frames.frame_renderer import FrameRenderer
from vgmpi.postprocess.studio import studio_renderer

PICTURE = "[picture]\nwidth = 200\nheight = 150\nsupersample = 2\n[video]\nshutter = 0.5\n"


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    return drawn_runs.write(tmp_path_factory.mktemp("run") / "out", frames=3)


def painters(out, folder, text):
    """The renderer of the whole picture and that of a draft."""
    (folder / "render.toml").write_text(text)
    chosen = render_config.load(folder / "render.toml")
    run = RunReader(out)
    return [FrameRenderer(run, chosen, Path("."), draft=draft) for draft in (False, True)]


def samples(painter):
    """Rays or samples of an image, those of the studio's edges left out."""
    view = painter.views[0]
    return view.width * view.height * painter.supersample**2 * painter.samples


def test_a_draft_draws_a_small_part_of_the_samples(out, tmp_path):
    whole, draft = painters(out, tmp_path, drawn_runs.on_paper(PICTURE))
    assert (draft.views[0].width, draft.views[0].height) == (80, 60)
    assert samples(whole) / samples(draft) == pytest.approx(2.5**2 * 2**2 * 16)
    coarse = draft.draw(1).astype(float)
    fine = whole.draw(1).astype(float)
    small = fine[:150, :200].reshape(30, 5, 40, 5, 3).mean(axis=(1, 3))
    assert np.abs(small - coarse.reshape(30, 2, 40, 2, 3).mean(axis=(1, 3))).mean() < 6


def test_a_draft_in_the_studio_has_coarse_grids_and_no_refined_edges(out, tmp_path):
    whole, draft = painters(out, tmp_path, "[picture]\nwidth = 200\nheight = 150\n")
    assert samples(whole) / samples(draft) == pytest.approx(2.5**2)
    assert (whole.studio.edges, whole.studio.times, whole.studio.quick) == (3, 2, False)
    assert (draft.studio.edges, draft.studio.times, draft.studio.quick) == (1, 1, True)


def test_processes_draw_a_draft_too(out, tmp_path):
    (tmp_path / "render.toml").write_text(drawn_runs.on_paper(PICTURE))
    for jobs in (1, 2):
        words = [out, tmp_path / "render.toml", "-q", "--draft", "--jobs", jobs]
        assert render.main([str(w) for w in (*words, "-o", tmp_path / f"p{jobs}")]) == 0
    for k in range(3):
        one, two = (iio.imread(tmp_path / f"p{n}" / f"frame_0000{k}.png") for n in (1, 2))
        assert one.shape == (60, 80, 3) and (one == two).all()


@pytest.mark.parametrize("jobs, count", [(1, 1), (2, 0)])
def test_normals_at_rest_are_computed_by_processes_that_draw(
    out, tmp_path, monkeypatch, jobs, count
):
    calls, whole = [], studio_renderer.Bodies
    monkeypatch.setattr(studio_renderer, "Bodies", lambda look: calls.append(1) or whole(look))
    (tmp_path / "render.toml").write_text("[picture]\nwidth = 48\nheight = 40\n")
    words = [out, tmp_path / "render.toml", "-q", "-o", tmp_path / "p", "--jobs", jobs]
    assert render.main([str(word) for word in words]) == 0
    assert len(calls) == count and len(list((tmp_path / "p").iterdir())) == 3
