"""Scenes at the ends of what a scene may say: each row of `python -m tests.benchmarks extremes`.

Expected: what its row says; in every one no particle and no bit of a rest volume is lost, momentum
stays to 1e-12 of the largest sum m |v| where nothing pushes on it, nothing hangs.
"""

import contextlib
import dataclasses

import numpy as np
import pytest

from tests.benchmarks import limit_cases
from tests.benchmarks.__main__ import main
from tests.benchmarks.limit_scenes import rows

ROWS = {row.name: row for row in rows()}


@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=() if row.fast else pytest.mark.slow) for n, row in ROWS.items()],
)
def test_a_row(name):
    found = limit_cases.run_case(ROWS[name])
    assert found.good, limit_cases.line(found)


def test_the_names_are_unique():
    assert len(ROWS) == len(rows())


@pytest.mark.parametrize(
    "changes, said",
    [
        ({"code": 3}, "ran"),
        ({"says": ("no such words",)}, "does not say"),
        ({"check": lambda run, first: (False, "wrong place")}, "wrong place"),
        ({"steps": 3}, "hangs"),
    ],
)
def test_a_wrong_outcome_is_seen(changes, said):
    found = limit_cases.run_case(dataclasses.replace(ROWS["E = 1e3 Pa"], **changes))
    assert not found.good and said in found.summary


def test_lost_momentum_is_seen():
    """Weight that a row does not speak of."""
    row = ROWS["E = 1e3 Pa"]
    text = row.text.replace("gravity = [0, 0, -0.0]", "gravity = [0, 0, -1e-6]")
    assert text != row.text
    found = limit_cases.run_case(dataclasses.replace(row, text=text))
    assert not found.good and found.drift > limit_cases.MOMENTUM


def test_a_lost_particle_is_seen(monkeypatch):
    @contextlib.contextmanager
    def simulate(*given, **more):
        with real(*given, **more) as this:
            yield this
            group = this.simulation.groups[0]
            group.f[12, group.index()[0]] *= 1 + 2 * np.finfo(float).eps  # its rest volume

    real = limit_cases.simulate
    monkeypatch.setattr(limit_cases, "simulate", simulate)
    assert "lost" in limit_cases.run_case(ROWS["E = 1e3 Pa"]).summary


def test_the_command_fails_with_a_row(monkeypatch, capsys):
    row = ROWS["an object without particles"]
    monkeypatch.setattr(limit_cases, "rows", lambda: [row])
    assert main(["extremes", "without"]) == 0
    monkeypatch.setattr(limit_cases, "rows", lambda: [dataclasses.replace(row, code=0)])
    assert main(["extremes", "without"]) == 1
    assert "FAIL" in capsys.readouterr().out
