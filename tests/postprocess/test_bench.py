"""The renderer's benchmark: its object is solid and fills the picture; it says what it found."""

import numpy as np
import pytest

from tests.benchmarks import render_speed
from vgmpi.postprocess.raster import rasterize


def test_the_object_is_opaque_and_fills_most_of_the_picture():
    subject = render_speed.Subject(5000)
    for number in (0, 5):
        camera = subject.camera(number)
        splats = subject.look.splats(subject.frame, camera.eye)
        assert len(splats.x) == 5000
        image, left = rasterize.render(splats, camera)
        assert (left < 0.5).mean() > 0.7
        middle = left[300:500, 300:500]
        assert middle.max() < 0.01  # no hole
        assert min(left[0, 0], left[-1, 0], left[0, -1], left[-1, -1]) > 0.99  # and it is round


def test_the_object_is_the_same_each_time_and_half_of_it_is_inside():
    (first, x), (second, _) = render_speed.lumpy_ball(3000), render_speed.lumpy_ball(3000)
    for name in vars(first):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
    thin = np.linalg.eigvalsh(first.cov0[:, (0, 1, 2, 1, 3, 4, 2, 4, 5)].reshape(-1, 3, 3))
    disc = thin[:, 0] < 0.05 * thin[:, 1]
    assert disc.sum() == 1500
    assert np.linalg.norm(x[~disc], axis=1).max() < np.linalg.norm(x[disc], axis=1).max()


def test_the_table_names_the_kernels_and_the_papers_time(capsys):
    assert render_speed.main(["--kernels", "2000", "71000", "--rounds", "1"]) == 0
    lines = capsys.readouterr().out.splitlines()[-2:]
    assert [line.split()[0] for line in lines] == ["2000", "71000"]
    assert lines[0].split()[-1] == "-" and lines[1].split()[-1] == "0.07"
    both = float(lines[1].split()[3])
    assert both == pytest.approx(sum(map(float, lines[1].split()[1:3])), rel=0.2)


def test_two_processes_are_compared_with_one(capsys):
    assert render_speed.main(["--kernels", "2000", "--rounds", "1", "--jobs", "2"]) == 0
    assert "2 processes" in capsys.readouterr().out


def test_a_wrong_size_is_one_line(capsys):
    assert render_speed.main(["--kernels", "10"]) == 2
    assert "allowed" in capsys.readouterr().err


def test_a_fluid_hides_nothing(capsys):
    subject = render_speed.Subject(3000, fluid=True)
    assert subject.alpha_min == pytest.approx(1e-4) and (subject.look.opacity < 0.021).all()
    camera = subject.camera(0)
    _, left = rasterize.render(subject.look.splats(subject.frame, camera.eye), camera)
    assert left.min() > 0.3
    assert render_speed.main(["--kernels", "2000", "--rounds", "1", "--fluid"]) == 0
    assert capsys.readouterr().out.splitlines()[-1].split()[0] == "2000"
