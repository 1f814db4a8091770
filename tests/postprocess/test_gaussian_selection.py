"""The Gaussians that the live page shows of a run that has more."""

import numpy as np
import pytest

from tests.support import drawn_runs
from vgmpi.io.run_reader import RunReader
from vgmpi.postprocess.frames.appearance import Appearance
from vgmpi.postprocess.live.followed_run import GaussianSelection


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    return drawn_runs.write(tmp_path_factory.mktemp("run") / "out", frames=4)


def test_the_same_gaussians_are_shown_at_every_frame(out):
    look = Appearance(RunReader(out))
    chosen = GaussianSelection(look, 100)
    total = len(look.object) + len(look.scenery.x0)
    assert (chosen.all, chosen.count) == (total, 100)
    assert chosen.still.sum() + chosen.moving.sum() == 100
    rest = np.asarray(RunReader(out).gaussians.x0)[chosen.moving]
    for index in (0, 3):
        still, moving = chosen.splats_of(chosen.look.frame(index), np.array([3.0, 0, 1]))
        assert len(still["centers"]) == chosen.still.sum()
        x = drawn_runs.frame_fields(drawn_runs.rest_state()[0], index, 4)["positions"][
            chosen.moving
        ]
        np.testing.assert_allclose(chosen.cell * moving["centers"], x, atol=1e-6)
        assert len(moving["centers"]) == len(rest)
        assert moving["opacities"].shape == (len(rest), 1)


def test_bodies_go_before_liquids_and_large_before_small(out):
    """What is left covers as much as all; of bodies nothing is lost while there are places."""
    look = Appearance(RunReader(out))
    liquid = int(look.fluid.sum())
    chosen = GaussianSelection(look, 600)
    kept = chosen.moving & look.fluid
    assert chosen.still.all() and chosen.moving[~look.fluid].all() and kept.sum() < liquid
    area = look.cov0[:, (0, 3, 5)].sum(axis=1)
    assert chosen.growth[1][kept] @ area[kept] == pytest.approx(area[look.fluid].sum())
    assert (chosen.growth[1][~look.fluid] == 1).all() and (chosen.growth[0] == 1).all()
    look.cov0[look.fluid] *= np.where(np.arange(liquid) % 2, 100.0, 1.0)[:, None]
    kept = GaussianSelection(look, 400).moving[look.fluid]
    assert kept[1::2].sum() > 5 * kept[::2].sum()


def test_few_places_are_shared(out):
    look = Appearance(RunReader(out))
    chosen = GaussianSelection(look, 40)
    assert (chosen.moving & look.fluid).sum() == 10 and chosen.count == 40


def test_all_of_a_small_run_is_shown_as_it_is(out):
    look = Appearance(RunReader(out))
    chosen = GaussianSelection(look, 10**6)
    assert chosen.count == chosen.all and all((g == 1).all() for g in chosen.growth)
    still, _ = chosen.splats_of(chosen.look.frame(0), np.array([3.0, 0, 1]))
    cov = chosen.cell**2 * still["covariances"][0]
    np.testing.assert_allclose(cov, np.diag([9e-4, 9e-4, 1e-6]), rtol=1e-5)
