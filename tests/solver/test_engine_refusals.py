"""An engine that lacks what a scene has says so in one line that names it, and ends with code 2.

No graphics card is asked, and nothing is computed before.
"""

import pytest

from vgmpi.commands import cli

SCENE = """
[domain]
size = [0.4, 0.2, 0.4]
cell = 0.02
[time]
end = 0.1
[material.honey]
kind = "fluid"
viscosity = 10
[material.oak]
kind = "elastic"
density = 700
youngs_modulus = 1e6
[[object]]
name = "pool"
material = "honey"
shape = { box = [[0, 0, 0.04], [0.4, 0.2, 0.1]] }
[[object]]
name = "post"
role = "scenery"
collider = true
THIN
SLIP
shape = { box = [[0, 0, 0], [0.4, 0.2, 0.04]] }
[[object]]
name = "beam"
material = "oak"
shape = { box = [[0.1, 0.06, 0.12], [0.3, 0.14, 0.2]] }
PINNED
[[object]]
name = "ball"
material = "oak"
RIGID
shape = { sphere = { center = [0.2, 0.1, 0.3], radius = 0.06 } }
JOINT
"""
KEYS = {
    "RIGID": "rigid = true",
    "SLIP": "slip_length = 0",
    "PINNED": "pinned = { box = [[0.08, 0.04, 0.1], [0.16, 0.16, 0.22]] }",
    "THIN": "thin = true",
    "JOINT": '[[joint]]\nname = "axle"\nkind = "hinge"\nbetween = "ball"\n'
    'at = [0.2, 0.1, 0.3]\naxis = "y"',
}
LACKS = {  # engine, keys -> features that its line names, and where
    ("cuda", "RIGID"): {"RIGID": "no free rigid bodies: object.ball.rigid"},
    ("cuda", "SLIP"): {"SLIP": "no slip lengths: object.post.slip_length"},
    ("cuda", "PINNED"): {"PINNED": "no pinned parts: object.beam.pinned"},
    ("cuda", "THIN"): {"THIN": "no thin walls: object.post.thin"},
    ("cuda", "RIGID JOINT"): {
        "JOINT": "no joints: joint.axle",
        "RIGID": "no free rigid bodies: object.ball.rigid",
    },
}


def written(folder, keys):
    """Path of the scene with some of the keys."""
    text = SCENE
    for name, lines in KEYS.items():
        text = text.replace(name, lines if name in keys.split() else "")
    (folder / "scene.toml").write_text(text)
    return str(folder / "scene.toml")


@pytest.mark.parametrize("flags", [[], ["--plan"]], ids=["run", "plan"])
@pytest.mark.parametrize("engine, keys", LACKS)
def test_one_line_names_what_an_engine_lacks(tmp_path, capsys, engine, keys, flags):
    scene = written(tmp_path, keys)
    code = cli.main([scene, "--engine", engine, *flags, "-o", str(tmp_path / "out")])
    assert code == 2
    text = (tmp_path / "scene.toml").read_text()
    number = {key: text[: text.index(KEYS[key])].count("\n") + 1 for key in LACKS[engine, keys]}
    names = [f"{name} ({scene}:{number[key]})" for key, name in LACKS[engine, keys].items()]
    printed = capsys.readouterr()
    (line,) = printed.err.strip().splitlines()
    assert not printed.out
    assert line == f"--engine {engine} has {', '.join(names)}; engine cpu has"
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("keys", ["RIGID JOINT", "SLIP", "PINNED", "THIN"])
def test_the_numpy_engine_computes_them(tmp_path, keys):
    argv = [written(tmp_path, keys), "--engine", "numpy", "-q", "-o", str(tmp_path / "out")]
    assert cli.main([*argv, "--set", "time.end=1e-5", "--set", "time.frames=4"]) == 0
    assert (tmp_path / "out" / "frames").is_dir()


@pytest.mark.parametrize("engine", ["cuda", "numpy"])
@pytest.mark.parametrize("system", ["pressure", "viscosity"])
def test_one_line_names_an_implicit_system(tmp_path, capsys, engine, system):
    text = f'[accuracy]\n{system} = "implicit"\n' + SCENE
    for key in KEYS:
        text = text.replace(key, "")
    (tmp_path / "scene.toml").write_text(text)
    scene = str(tmp_path / "scene.toml")
    assert cli.main([scene, "--engine", engine, "-o", str(tmp_path / "out")]) == 2
    name = f"no implicit {system}: accuracy.{system} ({scene}:2)"
    assert capsys.readouterr().err.strip() == f"--engine {engine} has {name}; engine cpu has"
