"""Who shares a velocity field, what particles weigh, whose normals count, what frames say of F."""

import numpy as np
import pytest

import vgmpi
from tests.support.simulate import advance, begin
from tests.support.small_scenes import ROOM, scene
from vgmpi.runtime.config.schema import SceneError
from vgmpi.solver.diagnostics.conservation import conservation_rows
from vgmpi.solver.restart.state_io import frame_rows

BOX = "shape = { box = [[0, 0, 0], [0.04, 0.04, 0.04]] }"
KINDS = {
    "one": 'kind = "sand"\ndensity = 2000\nporosity = 0.5',
    "two": 'kind = "sand"\nfriction = 0.9',
    "snow": 'kind = "snow"',
    "rubber": 'kind = "elastic"\nyoungs_modulus = 1e5',
    "tin": 'kind = "metal"\nyoungs_modulus = 1e6\nyield_stress = 1e4',
    "water": 'kind = "fluid"',
}


def text():
    out = '[accuracy]\npressure = "explicit"\nprecision = "double"\n'
    out += "[domain]\nsize = [0.48, 0.08, 0.08]\ncell = 0.02\n[time]\nend = 1\n"
    for k, (name, keys) in enumerate(KINDS.items()):
        out += f"[material.{name}]\n{keys}\n[[object]]\nname = 'a {name}'\nmaterial = '{name}'\n"
        out += f"{BOX}\nposition = [{0.02 + 0.08 * k:.2f}, 0.02, 0.02]\n"
    return out


@pytest.fixture(scope="module")
def simulation(tmp_path_factory):
    made, _ = begin(tmp_path_factory.mktemp("families"), text())
    advance(made, 1e-3)
    return made


def test_phases_and_whose_normals_count(simulation):
    phases = {phase.name: phase for phase in simulation.plan.phases}
    assert set(phases) == {"sand", "snow", "fluid", "a rubber", "a tin"}
    order = sorted(phases, key=lambda name: phases[name].contact_priority)
    # both bodies are of one volume: the one farther west comes first, not the heavier one
    assert order == ["a rubber", "a tin", "snow", "sand", "fluid"]


def test_particles_weigh_what_the_bulk_does(simulation):
    groups = {group.material: group.density for group in simulation.plan.groups}
    assert groups["one"] == 1000 and groups["snow"] == 400
    sand = next(row for row in conservation_rows(simulation) if row["phase"] == "sand")
    assert sand["mass"] == pytest.approx(0.04**3 * (1000 + 0.6 * 2650), rel=1e-12)
    lightest = next(phase for phase in simulation.plan.phases if phase.name == "sand").min_cell_mass
    assert lightest == pytest.approx(1000 * 0.02**3)


def test_fluids_slip_and_others_rub_with_the_larger_coefficient(simulation):
    plan = simulation.plan
    number = {phase.name: k for k, phase in enumerate(plan.phases)}
    assert plan.contact.friction[number["sand"]][number["snow"]] == 0.9
    assert plan.contact.friction[number["snow"]][number["a tin"]] == 0.3
    assert not any(plan.contact.friction[number["fluid"]])


def test_frames_say_f_of_what_carries_it(simulation):
    _, fields = frame_rows(simulation, ("J", "F"))
    plan = simulation.plan
    solids = [k for k, phase in enumerate(plan.phases) if phase.families == ("solid",)]
    isotropic = np.cbrt(fields["J"])[:, None] * np.eye(3, dtype=np.float32).ravel()
    others = ~np.isin(fields["phase"], solids)
    assert np.array_equal(fields["F"][others], isotropic[others])
    for solid in solids:
        here = fields["phase"] == solid
        assert not np.array_equal(fields["F"][here], isotropic[here])


def test_one_field_for_all_but_not_with_what_shares_space(tmp_path):
    """Methods with a single velocity field are `phase = "one"`; what mixes or flows has its own."""
    text = ROOM + (
        '[material.water]\nkind = "fluid"\n[material.oil]\nkind = "fluid"\ndensity = 900\n'
    )
    for name, of, x in (("pool", "water", 0.1), ("ball", "clay", 0.2), ("drop", "oil", 0.3)):
        text += (
            f'[[object]]\nname = "{name}"\nmaterial = "{of}"\nphase = "one"\n'
            f"shape = {{ box = [[0, 0, 0], [0.06, 0.06, 0.06]] }}\nposition = [{x}, 0.2, 0]\n"
        )
    (phase,) = vgmpi.plan(scene(tmp_path, text)).phases
    assert phase.name == "one" and phase.families == ("fluid", "solid")
    mixes = '[[coupling]]\nkind = "mixing"\nbetween = ["water", "oil"]\n'
    with pytest.raises(SceneError, match="'water' shares space with another phase by a coupling"):
        vgmpi.plan(scene(tmp_path, text + mixes))
