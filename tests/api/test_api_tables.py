"""A scene given to `vgmpi.load` as a nested dict is the same scene as its file."""

import copy
import tomllib
from pathlib import Path

import numpy as np
import pytest

import vgmpi
from vgmpi.scene import loader

TEXT = """
[accuracy]
precision = "double"
[domain]
size = [0.24, 0.24, 0.24]
cell = "2 cm"
[time]
end = 0.01
frames = 3
[material.rubber]
kind = "elastic"
youngs_modulus = "0.1 MPa"
[[object]]
name = "ball"
material = "rubber"
velocity = [0.1, 0, 0.30000000000000004]
shape = { sphere = { center = [0.12, 0.12, 0.12], radius = 0.05 } }
"""
TABLE = tomllib.loads(TEXT)


def changed(*path_and_value):
    """Return the table with another value at a path; None removes the key."""
    *path, last, value = path_and_value
    table = node = copy.deepcopy(TABLE)
    for key in path:
        node = node[key]
    if value is None:
        del node[last]
    else:
        node[last] = value
    return table


def message(table, overrides=()):
    with pytest.raises(vgmpi.SceneError) as caught:
        vgmpi.load(table, overrides)
    return str(caught.value)


def test_a_dict_is_the_scene_of_its_file(tmp_path):
    """Values, particles and files: NumPy's numbers and arrays and tuples stand for TOML's."""
    table = changed("domain", "size", np.full(3, 0.24))
    table["time"]["frames"] = np.int64(3)
    table["object"][0]["velocity"] = (np.float64(0.1), 0, 0.30000000000000004)
    before = copy.deepcopy(table)
    scene, of_file = vgmpi.load(table), vgmpi.load("a.toml", text=TEXT)
    assert scene.to_json() == of_file.to_json() and scene.folder == Path.cwd()
    for folder, one in (("table", scene), ("file", of_file)):
        assert vgmpi.run(one, tmp_path / folder).code == 0
    table, file = (vgmpi.read(tmp_path / folder).frame(-1) for folder in ("table", "file"))
    assert all((table[name] == file[name]).all() for name in file)
    assert all((before["domain"]["size"] == 0.24).tolist())  # what was given is as it was


def test_overrides_of_a_dict():
    scene = vgmpi.load(TABLE, {"domain.cell": "4 cm", "object.ball.velocity": np.ones(3)})
    assert scene.domain.cell == 0.04 and scene.object[0].velocity == (1.0, 1.0, 1.0)
    bigger = {"object.ball.shape": {"sphere": {"center": [0.12] * 3, "radius": "6 cm"}}}
    assert vgmpi.load(TABLE, bigger).object[0].shape.sphere.radius == 0.06
    assert TABLE == tomllib.loads(TEXT)
    again = loader.load_again(scene, ("domain.cell=2 cm",))  # for pilot runs
    assert again.domain.cell == 0.02 and again.object[0].velocity == (1.0, 1.0, 1.0)
    with pytest.raises(ValueError, match="a scene is either a dict or a text"):
        vgmpi.load(TABLE, text=TEXT)


@pytest.mark.parametrize(
    "path_and_value, line",
    [
        (("domain", "cell", -1), "domain.cell: must be > 0 m; got -1"),
        (("domain", "cel", 1), "domain.cel: unknown key (did you mean 'cell'?)"),
        (("objekt", []), "objekt: unknown key (did you mean 'object'?)"),
        (("time", None), "time: required table [time] is missing"),
        (("object", 0, "shape", "sphere", "radius", "5 kg"), "object.ball.shape.sphere.radius: 'kg'"
         " does not measure a length; expected a number [m] or a text such as '2 m' (units: m, km,"
         " cm, mm, um); got '5 kg'"),
        (("object", TABLE["object"] * 2), "object.ball.name: is taken: object.0.name has the same"
         " name"),
        (("object", 0, "velocity", [0, {1}, 0]), "object.ball.velocity.1: must be a number, a text,"
         " True or False, a list or a table; got set"),
        (("object", 0, 7, 1), "object.0: a key must be a text; got 7"),
        (("domain", "size", 2**70), "domain.size: must fit in 64 bits; got one of 71 bits"),
    ],
)  # fmt: skip
def test_a_message_names_the_path_of_the_key(path_and_value, line):
    assert message(changed(*path_and_value)) == line


def test_messages_come_in_the_order_of_the_dict():
    table = changed("object", 0, "velocity", None)
    table["object"][0]["density"] = 3
    table["domain"]["cell"] = 0
    assert [line.partition(":")[0] for line in message(table).splitlines()] == [
        "domain.cell",
        "object.ball.density",
    ]


def test_none_and_endless_tables():
    table = copy.deepcopy(TABLE)
    table["object"][0]["velocity"] = None
    assert message(table).endswith("a list or a table; got NoneType: leave the key out")
    table = copy.deepcopy(TABLE)
    table["domain"]["domain"] = table["domain"]
    assert message(table) == "domain.domain.domain: is nested more than 32 levels deep"


def test_an_override_is_named():
    assert message(TABLE, {"domain.cell": -1}) == (
        "--set domain.cell=-1: domain.cell: must be > 0 m; got -1"
    )
    assert message(TABLE, {"domain": {"cell": 1}}).startswith(
        "--set domain={cell = 1}: domain.size: required key is missing"
    )
