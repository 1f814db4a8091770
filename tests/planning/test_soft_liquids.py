"""Liquids too soft for their depth are named by --plan and --check, with a key that helps.

Theory: the Tait equation with the weight of all liquid above; 1 m of water at K = 25 kPa. In a
closed box that is full, Taylor and Green's vortices have the pressure -rho U^2 / 2 where they turn.
"""

import re

import numpy as np
import pytest

from tests.support.simulate import advance, begin, by_id
from tests.support.small_scenes import scene
from vgmpi.commands import cli
from vgmpi.planning.cost.timestep_advice import soft_liquid_lines
from vgmpi.preprocess.initial_conditions import closed_box_tensions, liquid_weights
from vgmpi.preprocess.scene_builder import build_scene

HEAD = """
[accuracy]
pressure = "explicit"
[domain]
size = [0.4, 0.4, 1.2]
cell = 0.04
GRAVITY
[time]
end = 1
[material.water]
kind = "fluid"
STIFF
[material.oil]
kind = "fluid"
density = 800
tait_coefficient = "1 MPa"
"""
BOX = '[[object]]\nname = "{0}"\nmaterial = "{1}"\nshape = {{ box = [{2}, {3}] }}\n'
POOL = BOX.format("pool", "water", [0, 0, 0], [0.4, 0.4, 1.0])
HALF = BOX.format("half", "water", [0, 0, 0], [0.4, 0.4, 0.52])
ABOVE = BOX.format("above", "oil", [0, 0, 0.52], [0.4, 0.4, 1.0])
BESIDE = HALF.replace("0.4, 0.4, 0.52", "0.2, 0.4, 0.52") + BOX.format(
    "beside", "oil", [0.2, 0, 0.52], [0.4, 0.4, 1.0]
)


def told(folder, bodies, stiff="max_speed = 0.5", gravity=""):
    """Weights of the bodies [Pa], and lines."""
    text = HEAD.replace("STIFF", stiff).replace("GRAVITY", gravity) + bodies
    loaded = scene(folder, text)
    made = build_scene(loaded)
    weights = liquid_weights(loaded, made.objects, made.x)
    return weights, soft_liquid_lines(loaded, weights)


def test_the_weight_is_that_of_all_liquid_above(tmp_path):
    particle = 0.02  # [m] the outermost particles are half of it inside
    (pool,), _ = told(tmp_path, POOL)
    assert pool == pytest.approx(9800.0 * (1.0 - particle))
    (half, above), _ = told(tmp_path, HALF + ABOVE)
    assert above == pytest.approx(0.8 * 9800.0 * (0.48 - particle))
    assert half == pytest.approx(9800.0 * (0.52 - particle) + above)
    (half, _), _ = told(tmp_path, BESIDE)
    assert half == pytest.approx(9800.0 * (0.52 - particle))
    assert told(tmp_path, POOL, gravity="gravity = [0, 0, 0]")[0] == ()
    (pool,), _ = told(tmp_path, POOL, gravity="gravity = [3, 0, 0]")
    assert pool == pytest.approx(3000 * (0.4 - particle))
    upside_down, _ = told(tmp_path, HALF + ABOVE, gravity="gravity = [0, 0, 9.80665]")
    assert upside_down[1] > upside_down[0]


@pytest.mark.parametrize(
    "key, soft", [("max_speed", "0.5"), ("max_depth", "0.05"), ("tait_coefficient", "4e3")]
)
def test_the_value_that_is_told_is_stiff_enough(tmp_path, key, soft):
    _, (line,) = told(tmp_path, POOL, f"{key} = {soft}")
    found = re.search(rf"compresses it by (\S+) % at the bottom; at material.water.{key}"
                      r" \(.*:\d+\) = (\S+) (m/s|m|Pa) it is 1 %", line)  # fmt: skip
    assert found is not None, line
    weights, lines = told(tmp_path, POOL, f"{key} = {found[2]}")
    assert lines == []
    stiff = scene(tmp_path, HEAD.replace("STIFF", f"{key} = {found[2]}").replace("GRAVITY", "")
                  + POOL).material["water"]  # fmt: skip
    compression = 1.0 - np.exp(stiff.hydrostatic_theta(np.array([weights[0]]))[0])
    assert compression == pytest.approx(0.01, rel=0.1)


def test_paste_has_a_weight_too(tmp_path):
    """A liquid of another law."""
    text = HEAD.replace("STIFF", "max_speed = 0.5").replace("GRAVITY", "") + POOL
    paste = 'kind = "paste"\nyield_stress = 20\nconsistency_index = 1\nshear_modulus = 200'
    text = text.replace('kind = "fluid"', paste, 1)
    loaded = scene(tmp_path, text)
    made = build_scene(loaded)
    (line,) = soft_liquid_lines(loaded, liquid_weights(loaded, made.objects, made.x))
    assert line.startswith("water is soft: ")


def test_a_liquid_that_cannot_follow_cells_is_named(tmp_path, capsys):
    """One that shares the space of another does not follow the dilatation by cells."""
    text = HEAD.replace("STIFF", "").replace("GRAVITY", "") + HALF + ABOVE
    text = text.replace("[accuracy]\n", '[accuracy]\ndilatation = "cells"\n')
    mixing = '[[coupling]]\nkind = "mixing"\nbetween = ["water", "oil"]\n'
    path = tmp_path / "scene.toml"
    path.write_text(text)
    assert cli.main([str(path), "--plan", "-v"]) == 0
    out = capsys.readouterr().out
    assert "dilatation by cells" in out and "  dilatation  " not in out
    path.write_text(text + mixing)
    assert cli.main([str(path), "--plan", "-v"]) == 0
    (line,) = [x for x in capsys.readouterr().out.splitlines() if "  dilatation  " in x]
    assert "by particles: only liquids that share no space with others follow cells" in line
    path.write_text(text.replace("[accuracy]\n", '[accuracy]\ntransfer = "aflip"\n'))
    assert cli.main([str(path), "--check"]) == 2
    error = capsys.readouterr().err
    assert "accuracy.dilatation" in error and "scene.toml:" in error
    assert "cells is for transfer = 'apic-corrected', 'apic' or 'pic'" in error


def test_check_and_plan_tell_it(tmp_path, capsys):
    told(tmp_path, POOL)
    path = str(tmp_path / "scene.toml")
    assert cli.main([path, "--check"]) == 0
    out = capsys.readouterr().out
    assert "warning: water is soft: the weight" in out and out.endswith(": 0 errors, 1 warning\n")
    assert cli.main([path, "--plan"]) == 0
    assert "  warning     water is soft: the weight" in capsys.readouterr().out
    told(tmp_path, POOL, "max_speed = 4")
    assert cli.main([path, "--check"]) == 0
    assert capsys.readouterr().out == f"{path}: 0 errors, 0 warnings\n"


VORTICES = """
[domain]
size = [0.32, 0.08, 0.32]
cell = 0.02
gravity = [0, 0, 0]
BOUNDARY
[time]
end = 1
[accuracy]
pressure = "explicit"
precision = "single"
[material.water]
kind = "fluid"
STIFF
[[object]]
name = "all"
material = "water"
shape = { box = [[0, 0, 0], [0.32, 0.08, TOP]] }
velocity_mode = [
  { amplitude = [0.5, 0, -0.5], wave_vector = [9.8174770, 0, 9.8174770] },
  { amplitude = [0.5, 0, 0.5], wave_vector = [9.8174770, 0, -9.8174770] },
]
"""


def stretch_told(folder, stiff, boundary="", top="0.32"):
    """Lines of --check on vortices of 1 m/s in a box."""
    text = VORTICES.replace("STIFF", stiff).replace("BOUNDARY", boundary).replace("TOP", top)
    loaded = scene(folder, text)
    made = build_scene(loaded)
    tensions = closed_box_tensions(loaded, made.objects, made.x, made.vol0)
    return soft_liquid_lines(loaded, (), tensions)


def test_a_liquid_too_soft_for_the_tension_in_a_closed_box_is_named(tmp_path, capsys):
    (line,) = stretch_told(tmp_path, "max_speed = 0.35")
    assert line.startswith("water is soft: it fills a closed box, where its motion at the")
    found = re.search(r"stretches it by (\S+) %; at material.water.max_speed \(.*:\d+\) = (\S+)"
                      r" m/s it is 1 %", line)  # fmt: skip
    assert found is not None, line
    assert float(found[1]) == pytest.approx(4.9, abs=0.1)  # of the Tait equation
    assert float(found[2]) == pytest.approx(0.5**0.5, rel=0.02)
    assert stretch_told(tmp_path, f"max_speed = {found[2]}") == []
    (line,) = stretch_told(tmp_path, "tait_coefficient = 400")
    assert "tears it; at material.water.tait_coefficient" in line
    assert stretch_told(tmp_path, 'max_speed = 0.35\ntension = "off"') == []
    assert stretch_told(tmp_path, "max_speed = 0.35", top="0.30") == []  # a free surface
    gate = 'boundary = { top = { kind = "slip", removal_time = 0.5 } }'
    assert stretch_told(tmp_path, "max_speed = 0.35", gate) == []
    stretch_told(tmp_path, "max_speed = 0.35")
    for flag in ("--check", "--plan"):
        assert cli.main([str(tmp_path / "scene.toml"), flag]) == 0
        assert "it fills a closed box" in capsys.readouterr().out


def test_the_stretch_that_is_told_is_that_of_a_run(tmp_path):
    """At the center of the vortices, mean over the time in which they turn by half a radian."""
    (line,) = stretch_told(tmp_path, "max_speed = 0.35")
    told_percent = float(re.search(r"by (\S+) %", line)[1])
    text = (tmp_path / "scene.toml").read_text()
    simulation, _ = begin(tmp_path, text)
    means = []
    for time in np.arange(0.01, 0.16, 0.01):
        advance(simulation, float(time))
        x, J = by_id(simulation, "x", "J")
        center = np.abs(x[:, ::2] - 0.16).max(axis=1) < 0.03
        means.append(100.0 * (J[center].mean() - 1.0))
    print(f"stretch {np.mean(means):.3f} %, told {told_percent} %")
    assert np.mean(means) == pytest.approx(told_percent, rel=0.1)
