"""Mistakes in configurations of other programs: a line each, with file, key and what is allowed."""

import json

import pytest

from tests.support.foreign_configs import BOX, HOLD, ONE, several
from vgmpi.tools.convert.__main__ import main


@pytest.fixture
def refused(tmp_path, capsys):
    """The lines with which a text is refused."""

    def run(text, *more):
        config = tmp_path / "c.json"
        config.write_bytes(text if isinstance(text, bytes) else text.encode())
        assert main([str(config), "-o", str(tmp_path / "s.toml"), *more]) == 2
        lines = capsys.readouterr().err.splitlines()
        assert not (tmp_path / "s.toml").exists()
        return [line.removeprefix(f"{config}:").strip() for line in lines]

    return run


@pytest.mark.parametrize(
    "text, said",
    [
        ("{", "1: not valid JSON"),
        ('{"E": 1\n"nu": 2}', "2: not valid JSON"),
        ("[]", "must be an object of keys, {...}; got []"),
        (b"\xff\xfe", "not UTF-8 text"),
        ("[" * 100_000, "not valid JSON: nested too deeply"),
        (f'{{"E": {"9" * 5000}}}', "not valid JSON: an integer must fit in 64 bits"),
    ],
)
def test_what_is_no_configuration(refused, text, said):
    (line,) = refused(text)
    assert line.startswith(said)


@pytest.mark.parametrize(
    "change, said",
    [
        ({"E": "2e6"}, "E: must be a number; got '2e6'"),
        ({"E": True}, "E: must be a number; got true"),
        ({"E": float("nan")}, "E: must be > 0; got nan"),
        ({"E": float("inf")}, "E: must be > 0; got inf"),
        ({"E": 10**400}, "E: must be a number that fits in 64 bits"),
        ({"density": 0}, "density: must be > 0; got 0"),
        ({"nu": 0.5}, "nu: must be >= 0 and < 0.5; got 0.5"),
        ({"material": "jely"}, "material: must be one of jelly, metal, sand, foam, snow, plasticine"
         " (did you mean 'jelly'?); got 'jely'"),
        ({"material": "fluid"}, "material: must be one of"),
        ({"material": "metal"}, "yield_stress: must be > 0 for metal"),
        ({"material": "foam"}, "yield_stress: must be > 0 for foam"),
        ({"g": 9.8}, "g: must be a list; got 9.8"),
        ({"g": [0, 0]}, "g: has too few values; got [0, 0]"),
        ({"g": [0, 0, float("nan")]}, "g.2: must be finite; got nan"),
        ({"n_grid": 50.5}, "n_grid: must be a valid integer; got 50.5"),
        ({"n_grid": 3}, "n_grid: must be greater than or equal to 12; got 3"),
        ({"frame_num": 0}, "frame_num: must be >= 1"),
        ({"substep_dt": 1}, "substep_dt: must be at most frame_dt = 0.02; got 1"),
        ({"rotation_degree": [3]}, "rotation_axis: must have an axis for each of the 1 angles"),
        ({"rotation_degree": [3], "rotation_axis": [3]}, "rotation_axis.0: must be one of 0, 1, 2"),
        ({"boundary_conditions": {}}, "boundary_conditions: must be a list"),
        ({"boundary_conditions": [3]}, "boundary_conditions.0: must be an object of keys; got 3"),
        ({"boundary_conditions": [{"type": "bonding_box"}]}, "boundary_conditions.0.type: must be"
         " one of bounding_box, cuboid, surface_collider, particle_impulse"),
        ({"boundary_conditions": [{"type": "cuboid"}]}, "boundary_conditions.0.point: required"),
        ({"boundary_conditions": [BOX, HOLD | {"size": [1, 0, 1]}]},
         "boundary_conditions.1.size.1: must be > 0; got 0"),
        ({"boundary_conditions": [{"type": "add_plane"}]}, "boundary_conditions.0.type: must be"),
        ({"particle_filling": []}, "particle_filling: must be a table of keys; got []"),
        ({"particle_filling": {"smooth": "yes"}}, "particle_filling.smooth: must be true or false"),
    ],
)  # fmt: skip
def test_what_is_wrong_in_physgaussian(refused, change, said):
    lines = refused(json.dumps(ONE | change))
    assert lines[0].startswith(said)
    assert not [line for line in lines if "Traceback" in line]


def test_a_key_that_is_missing(refused):
    without = {key: value for key, value in ONE.items() if key != "g"}
    assert refused(json.dumps(without)) == ["g: required key is missing"]


@pytest.mark.parametrize(
    "config, said",
    [
        (several(({"material": "fluid"}, {})), "material_params.0.bulk_modulus: required key"),
        (several(({"material": "watr"}, {})), "material_params.0.material: must be one of jelly"),
        (several(({}, {}), object_num=2), "material_params: must have an item for each of"),
        ({"object_num": 1}, "material_params: required key is missing"),
        (several(({}, {"color": [0, 0, 300]})), "preprocess_params.0.color.2: must be >= 0 and"),
    ],
)
def test_what_is_wrong_in_versagauss(refused, config, said):
    assert refused(json.dumps(config))[0].startswith(said)


def test_all_mistakes_are_told_at_once(refused):
    lines = refused(json.dumps(ONE | {"E": -1, "boundary_conditions": [{"type": "cuboid"}]}))
    assert [line.split(":")[0] for line in lines] == [
        "E", *(f"boundary_conditions.0.{key}" for key in ("point", "size", "velocity")),
    ]  # fmt: skip


def test_files_that_are_not_there(refused, tmp_path):
    gone = tmp_path / "gone.ply"
    assert refused(json.dumps(ONE), "--gaussians", str(gone)) == [
        f"{gone}: there is no such Gaussian file"
    ]
    (tmp_path / "bad.ply").write_text("no header")
    (line,) = refused(json.dumps(ONE), "--gaussians", str(tmp_path / "bad.ply"))
    assert line.startswith(str(tmp_path / "bad.ply"))


def test_a_configuration_that_is_not_there(tmp_path, capsys):
    assert main([str(tmp_path / "no.json"), "-o", str(tmp_path / "s.toml")]) == 2
    assert "no.json: No such file" in capsys.readouterr().err


def test_more_files_than_bodies(refused, tmp_path):
    two = ["--gaussians", "a.ply", "--gaussians", "b.ply"]
    assert refused(json.dumps(ONE), *two) == [
        "--gaussians: must be given once for each body, of which there are 1; got 2"
    ]
