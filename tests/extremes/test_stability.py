"""The default time step stands under the largest stable one of every law.

Expected: steps of 1.8 times the default Courant factor are stable: kinetic and elastic energy stay
below 4 times what was put in; steps of four times the default are not. Couplings: 1.8 times the
step the solver chooses. Where motion is restored: one and a half times these.

A lone particle of a liquid in APIC vibrates as one mass on the nodes around it: with the pressure
K theta its rate of expansion changes by -(12 / dx^2) c^2 theta, so that symplectic steps would be
stable up to dt = 2 dx / (sqrt(12) c), a Courant factor of 1 / sqrt(3). In spray theta takes only
the part r = 0.3 of the divergence: 1 / sqrt(3 r) = 1.054.
`python -m tests.benchmarks stability` finds the limits themselves.
"""

import numpy as np
import pytest

from tests.benchmarks import stability_limits
from tests.benchmarks.stability_limits import COUPLED, Case, Column
from tests.support.simulate import begin, by_id
from tests.support.small_scenes import MIXES_WITH_MILK, SEEPS_THROUGH_GRAINS, WEIGHTLESS
from vgmpi.kernels.transfer import liquid_volume
from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.scene.scene import DEFAULT_CFL
from vgmpi.solver.engines.numpy_reference import liquid_volume as reference_volume
from vgmpi.solver.run_outcome import BlowUp
from vgmpi.solver.simulation import Simulation

MARGIN, RESTORED = 1.8, 1.5
LONE_DROP = (
    WEIGHTLESS
    + """
[accuracy]
pressure = "explicit"
transfer = "apic"
precision = "double"
volume_correction = "none"
[material.water]
kind = "fluid"
tait_coefficient = 1e5
[[object]]
name = "drop"
material = "water"
shape = { box = [[0.1, 0.1, 0.1], [0.11, 0.11, 0.11]] }
"""
)
OTHER = """
[[object]]
name = "other"
material = "{}"
shape = {{ box = [[0.15, 0.15, 0.15], [0.16, 0.16, 0.16]] }}
"""
MIXING = MIXES_WITH_MILK.replace('"fluid"', '"fluid"\ntait_coefficient = 1e5') + OTHER.format(
    "milk"
)
DRAG = SEEPS_THROUGH_GRAINS + OTHER.format("grains")
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
    return more * (1.0 if case.name in COUPLED else DEFAULT_CFL)


@pytest.mark.parametrize("material", ["fluid", "paste", "elastic", "mixing", "drag 1e-3"])
def test_the_default_is_that_of_all_materials(tmp_path, material):
    text = Case(material).text.replace(f"cfl = {Case(material).cfl}\n", "")
    simulation, _ = begin(tmp_path, text)
    assert simulation.plan.time_step.cfl == DEFAULT_CFL == 0.55
    own = [each.correction_interval for each in simulation.plan.features]
    own = [interval for interval in own if interval]  # of shifts
    assert (simulation.plan.correction_interval, own) == (2, [] if material == "elastic" else [4])


def test_a_fixed_step_is_bounded_by_the_smaller_number(tmp_path):
    text = Case("elastic").text.replace("cfl = 0.55", "dt = 1e-5")
    simulation, _ = begin(tmp_path, text)
    assert (simulation.plan.time_step.cfl, simulation.plan.correction_interval) == (0.4, 3)


def expansion_of_a_lone_drop(folder, factor, engine, other=""):
    """Largest rate of expansion of one particle of water over its first, in 400 steps.

    other: a particle far away, of a material that may share its space.
    """
    simulation, made = begin(folder, LONE_DROP + other)
    count = 2 if other else 1
    assert len(made.x) == count
    first = np.tile(1e-3 * np.eye(3).reshape(1, 9), (count, 1))
    simulation = Simulation(simulation.plan, SerialCommunicator(), engine=engine)
    simulation.put(
        made.x, np.zeros((count, 3)), made.vol0, np.arange(count), made.object, made.theta0, first
    )
    dt, largest = factor * simulation.bound() / simulation.plan.time_step.cfl, 0.0
    for _ in range(400):
        try:
            simulation.advance(dt)
        except BlowUp:
            return np.inf
        (C,) = by_id(simulation, "C")
        largest = max(largest, abs(C[0].reshape(3, 3).trace()))
    return largest / 3e-3


@pytest.mark.parametrize(
    "response, factor, stable",
    [(1.0, 0.56, True), (1.0, 0.6, False), (0.3, 0.6, True), (0.3, 1.03, True), (0.3, 1.08, False)],
)
def test_a_lone_drop_is_stable_up_to_the_bound_of_its_response(
    tmp_path, monkeypatch, response, factor, stable
):
    assert liquid_volume.LEAST_RESPONSE == 0.3
    monkeypatch.setattr(reference_volume, "LEAST_RESPONSE", response)
    growth = expansion_of_a_lone_drop(tmp_path, factor, "numpy")
    assert (growth < 10.0) == stable
    if response == liquid_volume.LEAST_RESPONSE:
        assert (expansion_of_a_lone_drop(tmp_path, factor, "cpu") < 10.0) == stable


@pytest.mark.parametrize("other", [MIXING, DRAG], ids=["mixing", "drag"])
@pytest.mark.parametrize("engine", ["numpy", "cpu"])
def test_a_lone_drop_is_as_stable_where_phases_share_space(tmp_path, engine, other):
    assert expansion_of_a_lone_drop(tmp_path, 1.03, engine, other) < 10.0
    if other is MIXING:  # water in pores bears no tension
        assert not expansion_of_a_lone_drop(tmp_path, 1.08, engine, other) < 10.0


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
    assert not Column(Case(name)).stable(4 * DEFAULT_CFL)


def test_the_limit_is_found(monkeypatch):
    monkeypatch.setattr(Column, "stable", lambda self, factor: factor < 1.3)
    assert 1.3 / 1.05 < stability_limits.largest_stable_factor(Case("fluid")) < 1.3


def test_what_is_stable_again_beyond_a_gap_is_not_taken_for_the_limit(monkeypatch):
    monkeypatch.setattr(Column, "stable", lambda self, f: f < 0.65 or 0.85 < f < 1.2)
    assert 0.65 / 1.05 < stability_limits.largest_stable_factor(Case("fluid")) < 0.65
