"""The default time step stands under the largest stable one of every law.

Expected: steps of 1.8 times the default Courant factor are stable: kinetic and elastic energy stay
below 4 times what was put in; steps of three times the default are not. Couplings: 1.8 times the
step the solver chooses. Where motion is restored every second step: one and a half times these.
`python -m tests.benchmarks stability` finds the limits themselves.
"""

import pytest

from tests.benchmarks import stability_limits
from tests.benchmarks.stability_limits import COUPLED, DEFAULT, Case, Column
from vgmpi.scene.sections import Time

MARGIN, RESTORED = 1.8, 1.5
ALL = stability_limits.cases(
    [], list(stability_limits.TRANSFERS), list(stability_limits.PRECISIONS)
)
QUICK = [
    Case(name, transfer)
    for name in ("elastic", "fluid", "snow", "drag 1e-12", "mixing at limit")
    for transfer in ("apic", "apic-corrected")
]


def margin(case):
    more = RESTORED if case.transfer == "apic-corrected" else MARGIN
    return more * (1.0 if case.name in COUPLED else DEFAULT)


def test_the_default_is_the_scene_s():
    assert Time.model_fields["cfl"].default == DEFAULT


@pytest.mark.parametrize("case", QUICK, ids=lambda case: f"{case.name}-{case.transfer}")
def test_the_default_has_a_margin(case):
    assert Column(case).stable(margin(case))


@pytest.mark.slow
@pytest.mark.parametrize(
    "case", ALL, ids=lambda case: f"{case.name}-{case.transfer}-{case.precision}"
)
def test_every_default_has_a_margin(case):
    assert Column(case).stable(margin(case))


@pytest.mark.parametrize("name", ["elastic", "fluid"])
def test_a_step_too_long_is_seen(name):
    assert not Column(Case(name)).stable(3 * DEFAULT)


def test_the_limit_is_found(monkeypatch):
    monkeypatch.setattr(Column, "stable", lambda self, factor: factor < 1.3)
    assert 1.3 / 1.05 < stability_limits.largest_stable_factor(Case("fluid")) < 1.3


def test_what_is_stable_again_beyond_a_gap_is_not_taken_for_the_limit(monkeypatch):
    monkeypatch.setattr(Column, "stable", lambda self, f: f < 0.65 or 0.85 < f < 1.2)
    assert 0.65 / 1.05 < stability_limits.largest_stable_factor(Case("fluid")) < 0.65
