"""Every error of a wrong scene names its line, its key, and what would be right.

The table of wrong scenes is tests/support/wrong_scenes.py.
"""

import pytest

from tests.support.wrong_scenes import BUILD_CASES, CASES, ELSEWHERE, GOOD
from vgmpi.preprocess.scene_builder import build_scene
from vgmpi.runtime.config.schema import SceneError
from vgmpi.scene.loader import load


def broken(tmp_path, old, new):
    """The path of the changed scene and the lines that the change touches."""
    assert GOOD.count(old) >= 1
    folder = tmp_path / "scene"
    folder.mkdir()
    (tmp_path / "outside.ply").write_text("x")
    (folder / "inside.ply").write_text("x")
    (folder / "inside.obj").write_text("x")
    at = GOOD.index(old)
    path = folder / "scene.toml"
    path.write_text(GOOD[:at] + new + GOOD[at + len(old) :])
    first = GOOD[:at].count("\n") + 1
    return path, range(first, first + new.count("\n") + 1)


def lines(path, overrides=(), make=load):
    with pytest.raises(SceneError) as caught:
        make(path, overrides)
    return caught.value.lines


@pytest.mark.parametrize("name", CASES)
def test_error_has_its_line_key_and_advice(tmp_path, name):
    old, new, key, says = CASES[name]
    path, touched = broken(tmp_path, old, new)
    found = [line for line in lines(path) if f": {key}: " in line and says in line]
    assert len(found) == 1, lines(path)
    where, _, said = found[0].partition(f": {key}: ")
    file, _, number = where.rpartition(":")
    assert file == str(path)
    allowed = [ELSEWHERE[name]] if name in ELSEWHERE else touched
    assert int(number) in allowed, found[0]
    assert "\n" not in found[0] and len(said) > 10
    for word in ("pydantic", "Value error", "Input", "Traceback"):
        assert word not in found[0]


@pytest.mark.parametrize("name", BUILD_CASES)
def test_errors_found_while_making_particles(tmp_path, name):
    old, new, key, says = BUILD_CASES[name]
    path, touched = broken(tmp_path, old, new)
    found = lines(path, make=lambda path, _: build_scene(load(path)))
    assert len(found) == 1 and says in found[0], found
    where = found[0].partition(f": {key}: ")[0]
    assert where.startswith(f"{path}:") and int(where.rpartition(":")[2]) in touched


@pytest.mark.parametrize(
    "key, says",
    [
        ("gravity = [0, 0, 0]", "needs gravity along -z alone; it is [0.0, 0.0, 0.0]"),
        ("gravity = [1, 0, -9.8]", "needs gravity along -z alone; it is [1.0, 0.0, -9.8]"),
        (
            'gravity_ramp_time = "1 s"',
            "needs gravity from the start: domain.gravity_ramp_time is set",
        ),
    ],
)
def test_water_is_compressed_by_its_weight_only(tmp_path, key, says):
    path, _ = broken(tmp_path, 'cell = "2 cm"', f'cell = "2 cm"\n{key}')
    text = path.read_text().replace(
        'name = "pool"', 'name = "pool"\ninitial_pressure = "hydrostatic"'
    )
    path.write_text(text)
    line = text[: text.index("initial_pressure")].count("\n") + 1
    assert lines(path) == [f"{path}:{line}: object.pool.initial_pressure: {says}"]


FIRST = 'gravity_keyframes = [{ time = "1 s", gravity = [0, 0, -9.8] }'


@pytest.mark.parametrize(
    "key, where, says",
    [
        (
            FIRST + ', { time = "800 ms", gravity = [1, 0, 0] }]',
            "gravity_keyframes.1.time",
            "must be later than the keyframe before, 1 s; got 0.8 s",
        ),
        (
            FIRST.replace("1 s", "0 s") + "]",
            "gravity_keyframes.0.time",
            "must be > 0 s; got '0 s'",
        ),
        (
            FIRST.replace("gravity = [0,", "pull = [0,") + "]",
            "gravity_keyframes.0.gravity",
            "required key is missing: acceleration of gravity at that time",
        ),
        (
            FIRST + ']\ngravity_ramp_time = "1 s"',
            "gravity_ramp_time",
            "gravity_keyframes and gravity_ramp_time given at once: a ramp is a keyframe too",
        ),
    ],
)
def test_gravity_has_its_keyframes_in_order(tmp_path, key, where, says):
    path, _ = broken(tmp_path, 'cell = "2 cm"', f'cell = "2 cm"\n{key}')
    assert any(line.endswith(f"domain.{where}: {says}") for line in lines(path)), lines(path)


def test_there_are_at_least_twenty():
    assert len(CASES) + len(BUILD_CASES) >= 20


def test_the_good_scene_is_good(tmp_path):
    path, _ = broken(tmp_path, "frames = 11", "frames = 11")
    assert len(build_scene(load(path)).x) > 1000


def test_all_errors_at_once_in_the_order_of_the_file(tmp_path):
    path, _ = broken(tmp_path, "frames = 11", "frames = 11")
    text = GOOD.replace('"2 cm"', '"2 kg"').replace("frames = 11", "frames = 0\nspeed = 3")
    text = text.replace('material = "water"', 'material = "milk"').replace("friction = 0.1", "")
    path.write_text(text)
    found = lines(path, ["time.end=soon", "object.ball.height=-1 cm"])
    keys = [line.split(": ")[1] for line in found]
    assert keys == [
        "domain.cell",
        "time.frames",
        "time.speed",
        "object.pool.material",
        "coupling.0.friction",
        "time.end",
        "object.ball.height",
    ]
    assert found[5].startswith("--set time.end=soon: time.end: expected a number [s]")
    assert (
        found[6] == "--set object.ball.height=-1 cm: object.ball.height: must be > 0 m; got '-1 cm'"
    )


def test_overriding_what_is_wrong_makes_it_right(tmp_path):
    path, _ = broken(tmp_path, '"2 cm"', '"2 kg"')
    assert load(path, ["domain.cell=2 cm"]).domain.cell == 0.02
    assert len(lines(path)) == 1


@pytest.mark.parametrize(
    "text, says",
    [
        ("", "required table [domain] is missing"),
        ("object = 3", "must be a list of tables"),
        ("load = 3", "must be a list of tables: [[load]]"),
        ("[[load]]\nobject = 3", "load.0.object"),
        ("[[load]]\nobject = []\nforce = [0, 0, 1]", "names no object"),
        ("[[load]]\nregion = 3", "must be a table of keys; got 3"),
        ("probe = [1]", "must be a list of tables: [[probe]]"),
        ("[[probe]]\nname = []\nwall = 3", "must begin with a letter"),
        ("material = 3", "must hold tables"),
        ("domain = []", "must be a table of keys; got []"),
        ("[[coupling]]\n", "coupling.0.kind: required key is missing"),
        ("coupling = [1]", "must be a table of keys; got 1"),
        ("[[object]]\nshape = 3", "must be a table of keys; got 3"),
        ("[[object]]\nname = 3\nrole = 'scenery'", "at least one must be a body"),
        ("[[object]]\nselect = []\ngaussians = {}", "must be a table of keys; got []"),
        ("[[object]]\nshape = { union = [3, { box = 1 }] }", "must be a table of keys; got 3"),
        ("[material.a]\nkind = []", "must be one of corotated, elastic, fluid"),
    ],
)
def test_nonsense_is_reported_not_raised(tmp_path, text, says):
    path = tmp_path / "scene.toml"
    path.write_text(text)
    found = lines(path)
    assert any(says in line for line in found), found
    assert all(line.startswith(f"{path}:") for line in found)
