"""What `vgmpi check` and the first lines of a run warn of, and of what they say nothing."""

import re

import pytest

from vgmpi.commands import cli

SCENE = """
[domain]
size = [SIZE]
cell = "2 cm"
[time]
end = "0.5 s"
frames = 3
[material]
water = { kind = "fluid", LIQUID }
solid = { kind = "elastic", density = 400, youngs_modulus = "MODULUS" }
[[object]]
name = "pool"
material = "water"
shape = { box = [[0, 0, 0], ["32 cm", "32 cm", "8 cm"]] }
[[object]]
name = "ball"
material = "solid"
shape = { sphere = { center = ["16 cm", "16 cm", "HEIGHT"], radius = "6 cm" } }
[accuracy]
pressure = "explicit"
"""
USUAL = {
    "SIZE": '"32 cm", "32 cm", "32 cm"', "LIQUID": 'max_speed = "2.5 m/s"', "MODULUS": "0.1 MPa",
    "HEIGHT": "22 cm",
}  # fmt: skip


def told(tmp_path, capsys, flag="--check", scene=SCENE, **keys):
    """What the command prints, on both streams."""
    text = scene
    for key, value in (USUAL | keys).items():
        text = text.replace(key, value)
    path = tmp_path / "scene.toml"
    path.write_text(text)
    code = cli.main([str(path), flag])
    out, err = capsys.readouterr()
    assert code == 0, err
    return out, err


def test_a_usual_scene_has_no_warning(tmp_path, capsys):
    out, err = told(tmp_path, capsys)
    assert out == f"{tmp_path / 'scene.toml'}: 0 errors, 0 warnings\n" and not err


def test_gravity_too_small_for_a_speed_is_none(tmp_path, capsys):
    """Its product with a length is 0 in double precision, and so is the speed of a fall."""
    scene = SCENE.replace("[domain]", "[domain]\ngravity = [0, 5e-324, 0]")
    out, _ = told(tmp_path, capsys, scene=scene)
    assert "0 errors" in out


@pytest.mark.parametrize("flag", ["--check", "--plan"])
def test_a_stiff_solid_is_told_with_its_steps(tmp_path, capsys, flag):
    out, _ = told(tmp_path, capsys, flag, MODULUS="210 GPa")
    (line,) = [s for s in out.splitlines() if "warning" in s and "0 errors" not in s]
    assert "steps of" in line and "set by material 'solid'" in line and "scene.toml:10" in line
    assert "rigid = true" in line
    if flag == "--check":
        assert out.endswith(": 0 errors, 1 warning\n")


def test_the_suggested_remedy_of_a_stiff_solid_helps(tmp_path, capsys):
    stiff = SCENE.replace('radius = "6 cm" } }', 'radius = "6 cm" } }\nrigid = true')
    for key, value in (USUAL | {"MODULUS": "210 GPa"}).items():
        stiff = stiff.replace(key, value)
    (tmp_path / "scene.toml").write_text(stiff)
    assert cli.main([str(tmp_path / "scene.toml"), "--check"]) == 0
    assert "steps of" not in capsys.readouterr().out


def test_a_liquid_stiffer_than_its_fall_asks_for(tmp_path, capsys):
    out, _ = told(tmp_path, capsys, LIQUID='max_speed = "60 m/s"')
    (line,) = [s for s in out.splitlines() if s.startswith("warning")]
    assert line.startswith("warning: water is stiff enough for 60 m/s, and what falls")
    assert "material.water.max_speed" in line and "scene.toml:9" in line
    suggested = line.split(") = ")[1].split(" m/s")[0]
    assert float(suggested) == pytest.approx(2.5, abs=0.1)  # sqrt(2 g 32 cm)
    out, _ = told(tmp_path, capsys, LIQUID=f'max_speed = "{suggested} m/s"')
    assert "0 warnings" in out


def test_objects_that_are_lost_in_the_domain(tmp_path, capsys):
    """A size without its unit; the domain may well be some times as large as what is in it."""
    out, err = told(tmp_path, capsys, SIZE="32, 32, 32")
    assert "is a unit missing?" in err and "domain.size" in err and "scene.toml:3" in err
    assert out.endswith(": 0 errors, 1 warning\n")
    out, err = told(tmp_path, capsys, SIZE="2, 2, 2", LIQUID='max_speed = "7 m/s"')
    assert "0 warnings" in out and not err


PILLAR = """
[domain]
size = [0.3, 0.3, 0.5]
cell = 0.02
[time]
end = 0.01
frames = 2
[material.soft]
kind = "elastic"
density = 1000
youngs_modulus = MODULUS
[[object]]
name = "pillar"
material = "soft"
shape = { cylinder = { endpoints = [[0.15, 0.15, 0.02], [0.15, 0.15, 0.42]], radius = 0.04 } }
"""


# 4 rho g h^3 / (7.837 r^2): h = 0.39 m between the outermost particles, rho g = 9800 N/m3
@pytest.mark.parametrize("modulus, warned", [(170e3, 1), (200e3, 0)])
def test_a_body_too_soft_to_stand_is_named(tmp_path, capsys, modulus, warned):
    """Greenhill's column: 185 kPa for 0.39 m with a radius of 4 cm."""
    out, err = told(tmp_path, capsys, scene=PILLAR, MODULUS=f"{modulus}")
    assert out.endswith(f": 0 errors, {warned} warning{'' if warned else 's'}\n")
    found = re.findall(r"toml:14\): 'pillar' will fold .* = \"(\d+) kPa\"", err)
    assert [float(value) for value in found] == pytest.approx([185.0] * warned, rel=0.06)


@pytest.mark.parametrize(
    "key, warned",
    [
        ("pinned = { box = [[0, 0, 0.4], [0.3, 0.3, 0.5]] }", 0),
        ("pinned = { box = [[0, 0, 0], [0.3, 0.3, 0.05]] }", 1),
        ("rigid = true", 0),
    ],
)
def test_what_is_held_from_above_or_rigid_cannot_fold(tmp_path, capsys, key, warned):
    _, err = told(tmp_path, capsys, scene=PILLAR + key, MODULUS="50e3")
    assert err.count("will fold") == warned


def test_overlaps_are_counted(tmp_path, capsys):
    out, err = told(tmp_path, capsys, HEIGHT="9 cm")
    assert "overlap by" in err and out.endswith(": 0 errors, 1 warning\n")


@pytest.mark.parametrize("letters", ["n" * 300, "\u00e4" * 61])
def test_a_name_too_long_for_a_file_is_refused(tmp_path, capsys, letters):
    """61 umlauts take 122 bytes."""
    text = SCENE.replace('name = "ball"', f'name = "{letters}"')
    for key, value in USUAL.items():
        text = text.replace(key, value)
    (tmp_path / "scene.toml").write_text(text)
    assert cli.main([str(tmp_path / "scene.toml"), "--check"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "scene.toml:16" in line and "at most 120 are possible" in line


def test_the_answer_comes_first_and_details_by_a_flag(tmp_path, capsys):
    """Time, memory and disk in the first lines; phases and prices only with -v."""
    out, _ = told(tmp_path, capsys, "--plan")
    names = [line.split()[0] for line in out.splitlines()[1:]]
    answers = [name for name in names if name != "ranks"]  # where there are several cores
    assert answers[:5] == ["time", "memory", "disk", "steps", "time"]
    assert not {"phase", "price", "walls", "bending"} & set(names)
    assert cli.main([str(tmp_path / "scene.toml"), "--plan", "-v"]) == 0
    more = [line.split()[0] for line in capsys.readouterr().out.splitlines()[1:]]
    assert more[: len(names)] == names and {"phase", "price", "walls"} <= set(more)
