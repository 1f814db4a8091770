"""The default step keeps its margin where two bodies or materials meet that differ.

Expected: steps of 1.3 times the default are stable at the corners where `python -m
tests.benchmarks.__main__ stability --ratios` finds the least room: energy stays below 4 times the
most that it has with half the default step. Where particles are few, one to a cell, the default
itself is.
"""

import numpy as np
import pytest

from tests.benchmarks import contrast_stability
from tests.benchmarks.contrast_stability import MARGIN, Pair, TwoBodyBox
from vgmpi.materials import registry
from vgmpi.materials.material import law_function
from vgmpi.runtime.config.schema import SceneError
from vgmpi.solver.simulation import Simulation

SOLIDS, WET, MIXED = ("elastic", "elastic"), ("fluid", "sand"), ("fluid", "fluid")
CORNERS = {
    "elastic on elastic, 1000 times lighter": Pair(SOLIDS, density=1e3),
    "elastic on elastic, 1e4 times denser and stiffer": Pair(SOLIDS, 1e-4, 1e-4),
    "fluid on elastic, 100 times lighter and stiffer": Pair(("elastic", "fluid"), 1e2, 1e-2),
    "fluid on elastic, 100 times denser and stiffer": Pair(("elastic", "fluid"), 1e-2, 1e-2),
    "sand on elastic, 10 times denser": Pair(("elastic", "sand"), density=1e-1),
}
MIXTURES = {  # powers of ten of density and stiffness, slip time [s]
    "as one, 1e4 times denser and stiffer": (4, 4, 0.0),
    "slipping, 1e2 times denser and stiffer": (2, 2, contrast_stability.SLIP),
    "slipping a little, 1e2 times denser and stiffer": (2, 2, 1e-3),
    "slipping, 1e3 times denser": (3, 0, contrast_stability.SLIP),
}
FEW = [Pair(SOLIDS, per_cell=n) for n in ((64, 1), (1, 64))]


@pytest.mark.parametrize("name", CORNERS)
def test_the_default_has_a_margin_where_bodies_differ(name):
    assert TwoBodyBox(CORNERS[name]).stable(MARGIN)


@pytest.mark.parametrize("name", MIXTURES)
def test_the_default_has_a_margin_where_fluids_that_mix_differ(name):
    density, stiffness, slip_relaxation_time = MIXTURES[name]
    mixed = contrast_stability._mixing(0.0, slip_relaxation_time)
    assert TwoBodyBox(Pair(MIXED, 10.0**density, 10.0**stiffness, coupled=mixed)).stable(MARGIN)


def test_fluids_that_slip_and_differ_by_1e4_do_not_blow_up():
    """Of what is left of the stiff one's waves, 2500 times as fast, a step knows before it is
    taken."""
    joint = TwoBodyBox(
        Pair(MIXED, 1e4, 1e4, coupled=contrast_stability._mixing(0.0, contrast_stability.SLIP))
    )
    assert joint.plan.groups[0].wave.factor > 2000.0
    assert joint.stable(MARGIN)


@pytest.mark.parametrize("pair", FEW, ids=lambda pair: ":".join(map(str, pair.per_cell)))
def test_the_default_is_stable_with_one_particle_per_cell(pair):
    assert TwoBodyBox(pair).stable(1.0)


def test_a_longer_default_is_seen(monkeypatch):
    """Half as long again: what is left of the margin is too little."""
    bound = Simulation.bound
    monkeypatch.setattr(Simulation, "bound", lambda self: 1.5 * bound(self))
    joint = TwoBodyBox(CORNERS["elastic on elastic, 1000 times lighter"])
    assert joint.stable(0.5) and not joint.stable(MARGIN)


def test_a_scene_refuses_more_particles_per_cell():
    with pytest.raises(SceneError):
        contrast_stability.max_stable_step(Pair(SOLIDS, per_cell=(8, 8000)))


@pytest.mark.parametrize("kind", ["elastic", "fluid", "sand"])
def test_a_material_is_made_of_its_density_and_modulus(kind):
    material = registry[kind].model_validate(contrast_stability.made_of(kind, 30.0, 2e4))
    rest = tuple(v for values in material.carries.values() for v in values)
    wave2 = law_function(material.law(), "wave_speed2")(material.law(), rest)
    assert np.allclose([material.bulk_density, material.bulk_density * wave2], [30.0, 2e4])


def test_a_ratio_is_the_first_one_s_over_the_other_s():
    joint = TwoBodyBox(Pair(("elastic", "fluid"), density=1e-3, stiffness=1e2))
    one, two = joint.density
    assert np.isclose(one / two, 1e-3) and np.isclose(one * two, contrast_stability.DENSITY**2)
    assert np.isclose(joint._stiff[0] / joint._stiff[1], 1e2)


def test_the_table_says_where_the_margin_is_less(monkeypatch):
    found = iter([0.0, 1.2, 1.3, contrast_stability.STEP_LADDER[-1], *[2.0] * 5])
    monkeypatch.setattr(contrast_stability, "max_stable_step", lambda pair: next(found))
    row = list(contrast_stability.lines(["elastic on elastic: stiffness"], ["apic-corrected"]))[1]
    assert row.split()[4:] == ["<", "0.5", "1.20", "!", "1.30", ">=", "2.8", *["2.00"] * 5]


def test_every_row_has_its_columns():
    for transfer in ("apic-corrected", "apic"):
        for table in contrast_stability.tables(transfer):
            for pairs in table.rows.values():
                assert len(pairs) == len(table.columns)
                assert all(pair.transfer == transfer for pair in pairs)
