"""A model that knows the answer: its guess is exact for a set of videos of a ball of the true
stiffness, in cells half as large, thrown at several speeds. The loss is least there, and descent
and the search along the loss find it from ten times off."""

import importlib.util

import numpy as np
import pytest

from tests.support import sds_fits
from tests.support.fit_scenes import reference, write_fit
from vgmpi.scene.loader import load
from vgmpi.tools.fit import __main__
from vgmpi.tools.fit.evaluations import Evaluations
from vgmpi.tools.fit.fit_config import FitFile, FitFileError
from vgmpi.tools.fit.run_pool import RunPool
from vgmpi.tools.fit.target_base import Pictures
from vgmpi.tools.fit.video_prior.denoising_target import DenoisingTarget
from vgmpi.tools.fit.workflow import run_fit

if importlib.util.find_spec("torch") is None:
    pytest.skip("no torch: pip install 'vgmpi[sds]'", allow_module_level=True)

import torch  # noqa: E402

COLUMN = """
[domain]
size = [0.1, 0.1, 0.24]
cell = 0.01
boundary = { default = "slip", bottom = "stick" }
[time]
end = 0.12
frames = 7
[accuracy]
precision = "single"
[material.rubber]
kind = "elastic"
density = 1000
youngs_modulus = 2e4
[[object]]
name = "column"
material = "rubber"
shape = { box = [[0.03, 0.03, 0], [0.07, 0.07, 0.16]] }
velocity = [0, 0, -0.6]
"""
TRUE, SIZE = 2e4, 48
KEY = sds_fits.KEYS[0]
SPEEDS, OTHERS = (-0.55, -0.6, -0.65), (5e3, 1e4, 4e4, 8e4, 2e5)


def code(folder, pictures):
    frames = pictures.frames(7)
    film = torch.from_numpy(pictures.render_run(folder, frames).astype(np.float32))
    film = film.permute(3, 0, 1, 2)[None] * 2 - 1
    return sds_fits.Knows(()).encode(film).double().reshape(-1)


@pytest.fixture(scope="module")
def known(tmp_path_factory):
    """A folder, and what the model knows without and with the prompt: codes of videos."""
    folder = tmp_path_factory.mktemp("known")
    sds_fits.rendered(folder, SIZE)
    pictures, fine = Pictures(folder / "render.toml"), {"domain.cell": 0.005}
    true, all_ = [], []
    for k, speed in enumerate(SPEEDS):
        changes = fine | {"object.column.velocity.2": speed, "seed": k + 2}
        true.append(code(reference(folder, COLUMN, changes, f"true{k}"), pictures))
    for k, stiffness in enumerate(OTHERS):
        changes = fine | {KEY: stiffness, "seed": k + 7}
        all_.append(code(reference(folder, COLUMN, changes, f"other{k}"), pictures))
    return folder, (torch.stack(true + all_), torch.stack(true))


def fitted(known, more="", method=""):
    """A fit by that model, and its runs."""
    folder, sets = known
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    scene, path = write_fit(folder, COLUMN, sds_fits.sds(more=more, method=method))
    file = FitFile(path, load(scene))
    target = DenoisingTarget(file, sds_fits.Knows(sets))
    runs = RunPool(file.scene, folder / "runs")
    for kept in folder.glob("runs/*/sds_*"):  # runs are shared by fits, what is said of them not
        kept.unlink()
    trials = Evaluations(runs, file.axes, target, file.settings.method.max_runs)
    try:
        return file, run_fit(file, trials), trials
    finally:
        torch.set_num_threads(threads)


def test_the_loss_is_least_at_the_truth(known):
    """Of runs spread around it, and that by far."""
    file, _, trials = fitted(known, method='algorithm = "cma"\nmax_runs = 60')
    (axis,) = file.axes
    stiff = np.geomspace(1e4, 4e4, 12)
    losses = [t.loss for t in trials.evaluate([np.array([axis.to_unit(e)]) for e in stiff])]
    best = int(np.argmin(losses))
    assert stiff[best] == pytest.approx(TRUE, rel=0.1)
    assert min(losses[0], losses[-1]) > 2 * losses[best]
    low = [t.values[0] for t in trials.all.values() if t.loss <= losses[best]]
    assert low == pytest.approx([TRUE] * len(low), rel=0.1)  # over the whole range


@pytest.mark.parametrize("more, near", [("guidance_scale = 1.0", 0.03), ("", 0.1)])
def test_descent_finds_it(known, more, near):
    """From ten times off, also with guidance away from videos of other stiffnesses."""
    file, found, trials = fitted(known, more)
    assert trials.all[next(iter(trials.all))].values[0] == pytest.approx(10 * TRUE)
    assert found.best.values[0] == pytest.approx(TRUE, rel=near)
    assert len(trials.all) <= 30 and not found.budget_exhausted
    asked = {t.number for t in trials.all.values() if not np.isnan(t.loss)}
    each = 2 * file.settings.sds.noise_samples  # both halves, of each run but those beside another
    assert trials.target.kind.calls == each * len(asked) < each * len(trials.all)
    report = __main__.format_report(file, found, trials)
    assert f"| {KEY} | {found.best.values[0]:.6g} | not known |" in report
    assert "How sure this is, is not known" in report and "## The model's gradient" in report


def test_the_loss_finds_it(known):
    """By a scalar search, which asks one half alone."""
    file, found, trials = fitted(known, method='algorithm = "cma"')
    assert found.best.values[0] == pytest.approx(TRUE, rel=0.05)
    assert len(trials.all) <= 20
    assert trials.target.kind.calls == file.settings.sds.noise_samples * len(trials.all)


def test_runs_that_are_spent_are_told(known):
    _, found, trials = fitted(known, method="max_runs = 15")
    assert found.budget_exhausted and len(trials.all) <= 15
    assert found.best.purpose == "descent"


def test_what_the_model_does_not_see_is_refused(known):
    folder, sets = known
    text = sds_fits.sds().replace(KEY, "domain.boundary.west.friction")
    text = text.replace('["4 kPa", "400 kPa"]\ninitial = "200 kPa"', "[0.01, 1]\ninitial = 0.1")
    walls = 'west = { kind = "separate", friction = 0.1 }, bottom'
    scene, path = write_fit(folder, COLUMN.replace("bottom", walls), text)
    file = FitFile(path, load(scene))
    trials = Evaluations(
        RunPool(file.scene, folder / "runs"),
        file.axes,
        DenoisingTarget(file, sds_fits.Knows(sets)),
        40,
    )
    with pytest.raises(FitFileError, match="nothing that the model sees changes"):
        run_fit(file, trials)
