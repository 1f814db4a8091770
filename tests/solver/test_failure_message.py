"""An overflow of any nodal field has a name in the message that ends a run."""

from types import SimpleNamespace

import numpy as np
import pytest

from tests.support.small_scenes import scene
from vgmpi.kernels.step_records import AccumulatorOverflow, StepReport
from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.parallel.exchange_topology import (
    NEAR_BODIES,
    FieldPlace,
    TopologyRequirements,
)
from vgmpi.preprocess.scene_builder import build_scene
from vgmpi.solver.failure_message import failure_message
from vgmpi.solver.initial_particles import known_of, plan_for

SCENE = """
[accuracy]
pressure = "explicit"
[domain]
size = [0.2, 0.2, 0.2]
cell = 0.02
[time]
end = 0.1
[material.water]
kind = "fluid"
[[object]]
name = "pool"
material = "water"
shape = { box = [[0, 0, 0], [0.2, 0.2, 0.1]] }
"""
NAMES = "shear", *NEAR_BODIES, "particle pressure", "rest volume", "color 0"
NEEDS = TopologyRequirements(
    np.zeros(1, np.int64), True, True, tuple(FieldPlace(n, np.ones(1, bool)) for n in NAMES)
)


@pytest.fixture(scope="module")
def plan(tmp_path_factory):
    loaded = scene(tmp_path_factory.mktemp("failure"), SCENE)
    return plan_for(loaded, known_of(loaded, build_scene(loaded)))


@pytest.mark.parametrize("field", NEEDS.layers)
def test_each_field_has_a_name(plan, field):
    simulation = SimpleNamespace(
        ranks=SerialCommunicator(),
        plan=plan,
        step=7,
        time=0.5,
        exchange=SimpleNamespace(needs=NEEDS),
    )
    overflow = AccumulatorOverflow((1, 1, 0), 0, field)
    report = StepReport(1.0, 0.0, (0.0, 0.0, 0.0), [], [overflow])
    line = failure_message(simulation, report)
    assert line.startswith("phase 'fluid', near (0.09, 0.09, 0.01) m, step 7, time 0.5 s: the ")
    assert line.endswith(" at a node is beyond what a sum can hold")
