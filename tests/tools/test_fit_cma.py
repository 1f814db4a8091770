"""CMA-ES (Hansen 2016) as the search of a fit."""

import sys

import numpy as np
import pytest

from tests.support.fit_scenes import BALL, FIT, bits, reference, rows, write_fit
from tests.tools.test_fit import DENSITY
from vgmpi.scene.loader import load
from vgmpi.tools.fit import __main__ as fit
from vgmpi.tools.fit import optimizers

TEXT = FIT[: FIT.index("[target]")] + DENSITY + FIT[FIT.index("[target]") :]
TEXT = TEXT.replace('"center_z", "velocity_z"', '"center_z", "momentum_z"')
TEXT = TEXT.replace("max_runs = 40", 'algorithm = "cma"\nmax_runs = 110')
SHORT = BALL.replace("end = 0.06", "end = 0.04").replace("frames = 7", "frames = 5")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    found = tmp_path_factory.mktemp("cma")
    reference(found, SHORT)
    return found


def test_two_are_found(folder, capsys):
    pytest.importorskip("cmaes")
    scene, file = write_fit(folder, SHORT, TEXT)
    assert fit.main([str(scene), str(file), "-o", str(folder / "out")]) == 0
    found = load(folder / "out" / "fitted.toml").material["rubber"]
    assert found.youngs_modulus == pytest.approx(2e4, rel=0.02)
    assert found.density == pytest.approx(1000, rel=0.02)
    told = rows(folder / "out")
    assert len(told) <= 110 and sum(row["purpose"] == "search" for row in told) > 50
    before = bits(folder / "out")  # what is there is not made again, with the same bits
    stamps = {p: p.stat().st_mtime_ns for p in folder.glob("out/runs/*/fit.json")}
    assert fit.main([str(scene), str(file), "-o", str(folder / "out")]) == 0
    assert bits(folder / "out") == before
    assert all(p.stat().st_mtime_ns == stamp for p, stamp in stamps.items())


class Valleys:
    """A loss with two valleys, the deeper one elsewhere than where it begins."""

    target, axes = None, (None, None)

    def __init__(self):
        self.all, self.max_runs, self.reserved_runs, self.purpose = [], 400, 0, ""

    def evaluate(self, points):
        if len(self.all) + len(points) > self.max_runs:
            raise optimizers.BudgetExhausted
        made_ = [One(np.array(p)) for p in points]
        self.all += made_
        return made_

    def best(self):
        return min(self.all, key=lambda one: one.loss)


class One:
    class done:
        completed = True

    def __init__(self, u):
        deep, near = np.hypot(*(u - [0.7, 0.6])), np.hypot(*(u - [0.3, 0.3]))
        self.u, self.loss = u, min(deep, 0.15 + 3 * near)


def test_it_leaves_a_valley_that_is_not_the_deepest():
    pytest.importorskip("cmaes")
    trials = Valleys()
    found = optimizers.cma_es_fit(trials, np.array([0.3, 0.3]), 2)
    assert found == pytest.approx([0.7, 0.6], abs=2e-3)
    assert len(trials.all) < 300  # it ends by itself where it has become narrow


def test_seeds_are_kept():
    pytest.importorskip("cmaes")
    first, same, other = Valleys(), Valleys(), Valleys()
    for trials, seed in ((first, 2), (same, 2), (other, 3)):
        optimizers.cma_es_fit(trials, np.array([0.3, 0.3]), seed)
    points = [np.array([one.u for one in trials.all[:12]]) for trials in (first, same, other)]
    assert (points[0] == points[1]).all() and (points[0] != points[2]).any()


def test_without_the_package_a_line_says_so(folder, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "cmaes", None)
    scene, file = write_fit(folder, SHORT, TEXT)
    assert fit.main([str(scene), str(file), "-o", str(folder / "none")]) == 1
    assert capsys.readouterr().err.splitlines()[-1] == (
        "vgmpi: method.algorithm = 'cma' needs: pip install 'vgmpi[fit]'"
    )
