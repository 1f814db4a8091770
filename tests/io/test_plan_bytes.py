"""What a particle carries, in bytes: as the plan says, and nothing that holds for its object."""

import numpy as np
import pytest

from tests.support.simulate import begin
from tests.support.small_scenes import MIXED, SHARED, every_law
from vgmpi.io import file_layout

SCENES = {"mixed": MIXED, "shared": SHARED, "laws": every_law("PRECISION")}


@pytest.mark.parametrize("precision", ["single", "double"])
@pytest.mark.parametrize("name", SCENES)
def test_the_plan_counts_what_the_arrays_hold(tmp_path, name, precision):
    simulation, _ = begin(tmp_path, SCENES[name].replace("PRECISION", precision))
    for g, group in enumerate(simulation.groups):
        arrays = (group.xi, group.f, group.ids[None])
        held = sum(a.shape[0] * a.dtype.itemsize for a in arrays)
        fields = simulation.plan.fields(g)
        assert held == simulation.plan.bytes_per_particle(g) == sum(fields.values()), fields
        assert list(fields)[:4] == ["x", "v", "C", "vol0"] and fields["id"] == 8
        assert fields["x"] == 3 * np.dtype(simulation.plan.real).itemsize


def test_numbers_of_a_material_are_in_no_particle(tmp_path):
    """Density, stiffness and all else that an object or its material has stand once."""
    simulation, made = begin(tmp_path, MIXED.replace("PRECISION", "single"))
    rubber = [g for g, group in enumerate(simulation.plan.groups) if group.material == "rubber"]
    assert len(rubber) == 2
    for g in rubber:
        moving = {"x": 12, "v": 12, "C": 36, "vol0": 4, "H": 36}
        surface = {"surface": 40} if simulation.plan.groups[g].surface else {}
        assert simulation.plan.fields(g) == {**moving, **surface, "id": 8}
    assert any(group.surface for group in simulation.plan.groups)
    # in the file an object's number leads to what is written once, in the list of objects
    rows = {d.name for d in file_layout.GAUSSIAN}
    own = {"x0", "vol0", "object", "v0", "theta0", "surface0", "cov0", "opacity", "sh", "shade"}
    assert rows == own
    assert not rows & set(made.objects[0])
    assert {"density", "opacity_scale", "material", "phase"} <= set(made.objects[0])
