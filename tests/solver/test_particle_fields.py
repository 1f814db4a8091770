"""Optional fields of frames: what was not asked for is not there, and mixtures have the fractions
of what was put in."""

import numpy as np
import pytest

from tests.support.simulate import advance, begin
from tests.support.small_scenes import MIXED, SHARED, every_law, scene
from vgmpi.preprocess.scene_builder import build_scene
from vgmpi.runtime.config.schema import SceneError
from vgmpi.scene.resume_rules import forbidden_changes
from vgmpi.solver.initial_particles import known_of, plan_for
from vgmpi.solver.restart import state_io
from vgmpi.solver.restart.state_io import frame_rows

ALL = ("velocity", "J", "F", "stress", "pressure", "strain", "volume_fraction")
BED = """
[domain]
size = [0.08, 0.08, 0.12]
cell = 0.01
[time]
end = 1
[accuracy]
pressure = "explicit"
precision = "PRECISION"
[material.water]
kind = "fluid"
tait_coefficient = 5e4
[material.milk]
kind = "fluid"
tait_coefficient = 5e4
[material.grains]
kind = "sand"
porosity = 0.35
[[object]]
name = "bed"
material = "grains"
shape = { box = [[0, 0, 0], [0.08, 0.08, 0.06]] }
[[object]]
name = "pores"
material = "water"
volume_fraction = 0.35
shape = { box = [[0, 0, 0], [0.08, 0.08, 0.06]] }
[[object]]
name = "above"
material = "water"
volume_fraction = 0.7
shape = { box = [[0, 0, 0.06], [0.08, 0.08, 0.12]] }
[[object]]
name = "cream"
material = "milk"
volume_fraction = 0.3
shape = { box = [[0, 0, 0.06], [0.08, 0.08, 0.12]] }
[[coupling]]
between = ["water", "grains"]
kind = "drag"
hydraulic_conductivity = 1e-3
[[coupling]]
between = ["water", "milk"]
kind = "mixing"
diffusivity = 1e-6
"""


@pytest.mark.parametrize("engine", ["cpu", "numpy"])
@pytest.mark.parametrize("precision", ["single", "double"])
def test_fractions_are_those_that_were_put_in(tmp_path, precision, engine):
    """Away from the interface by what two stencils reach, also at the walls and in the corners."""
    simulation, _ = begin(tmp_path, BED.replace("PRECISION", precision), engine=engine)
    _, rows = frame_rows(simulation, ("volume_fraction",))
    z, fraction = rows["positions"][:, 2], rows["volume_fraction"]
    assert fraction.dtype == np.float32
    for k, want in enumerate((0.65, 0.35, 0.7, 0.3)):
        inner = (rows["object"] == k) & (np.abs(z - 0.06) > 0.0301)
        assert inner.any() and fraction[inner] == pytest.approx(want, abs=1e-5)


def test_fractions_follow_the_motion(tmp_path):
    """Water in the pores of sand that moves: the fraction is the porosity that the solver has."""
    text = SHARED.replace("PRECISION", "double")
    simulation, _ = begin(tmp_path, text)
    advance(simulation, 0.03)
    fractions = state_io.volume_fractions(simulation)
    for group, fraction in zip(simulation.groups, fractions, strict=True):
        assert fraction.max() <= 1.0 + 1e-12 and fraction.min() > 0.0
        if group.plan.material == "toy":
            assert (fraction == 1.0).all()
    (water,) = (k for k, g in enumerate(simulation.groups) if g.plan.material == "water")
    group = simulation.groups[water]
    deep = (group.positions()[:, 2] < 0.02) & (group.positions()[:, 0] < 0.1)
    porosity = group.get("share", group.index())[:, 0]
    # one step ago: the difference is that of a step
    assert fractions[water][deep] == pytest.approx(porosity[deep], abs=2e-3)
    assert np.ptp(porosity[deep]) > 0.02


@pytest.mark.parametrize("text", [MIXED, every_law("PRECISION")], ids=["mixed", "laws"])
def test_what_is_not_asked_for_is_not_there_and_changes_nothing(tmp_path, text):
    simulation, _ = begin(tmp_path, text.replace("PRECISION", "single"))
    advance(simulation, 0.01)
    ids, plain = frame_rows(simulation, ("velocity", "J", "F"))
    same, rows = frame_rows(simulation, ALL[:-1])
    assert set(plain) == {"positions", "velocity", "J", "F", "object", "phase"}
    assert set(rows) == set(plain) | {"stress", "pressure", "strain"}
    assert np.array_equal(ids, same)
    for name, values in plain.items():
        assert np.array_equal(values, rows[name])
    for name in ("stress", "pressure", "strain"):
        assert rows[name].dtype == np.float32 and np.isfinite(rows[name]).all()
        (only,) = set(frame_rows(simulation, (name,))[1]) - {"positions", "object", "phase"}
        assert only == name
    volume = rows["strain"][:, :3].sum(1)
    assert volume == pytest.approx(np.log(rows["J"]), abs=3e-6)


def test_fields_that_are_off_compute_nothing(tmp_path, monkeypatch):
    simulation, _ = begin(tmp_path, SHARED.replace("PRECISION", "single"))

    def fail(*arguments):
        raise AssertionError("computed")

    monkeypatch.setattr("vgmpi.solver.diagnostics.particle_fields.cauchy_stress", fail)
    monkeypatch.setattr("vgmpi.solver.diagnostics.particle_fields.logarithmic_strain", fail)
    monkeypatch.setattr(state_io, "volume_fractions", fail)
    frame_rows(simulation, ("velocity", "J", "F"))
    for name in ("stress", "strain", "volume_fraction"):
        with pytest.raises(AssertionError, match="computed"):
            frame_rows(simulation, (name,))


@pytest.mark.parametrize("between", ['"water", "rubber"', '"water", "ink"'])
def test_fractions_without_a_mixture_are_one_clear_line(tmp_path, between):
    """Nor do couplings count that name what no body is made of."""
    text = MIXED.replace("PRECISION", "single").replace(
        "[output]\n", '[output]\nfields = ["J", "volume_fraction"]\n'
    )
    text += f'[material.ink]\nkind = "fluid"\n[[coupling]]\nbetween = [{between}]\n'
    text += (
        'kind = "contact"\nfriction = 0.1\n'
        if "rubber" in between
        else 'kind = "mixing"\ndiffusivity = 1\n'
    )
    loaded = scene(tmp_path, text)
    made = build_scene(loaded)
    with pytest.raises(SceneError) as caught:
        plan_for(loaded, known_of(loaded, made))
    (line,) = caught.value.lines
    assert "scene.toml:" in line and "output.fields" in line and "[[coupling]]" in line


def test_a_resumed_run_may_ask_for_more(tmp_path):
    before = scene(tmp_path, MIXED.replace("PRECISION", "single")).to_json()
    text = MIXED.replace("[output]\n", f"[output]\nfields = {list(ALL[:-1])}\n")
    later = scene(tmp_path, text.replace("PRECISION", "single"))
    assert forbidden_changes(later, before) == []
