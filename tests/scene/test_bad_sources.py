"""Every error of a wrong source or sink names its line, its key, and what would be right.

As test_bad_scenes.py: a good scene gets more tables, and a piece of their text is another one.
"""

import pytest

from tests.support.wrong_scenes import GOOD
from vgmpi.preprocess.scene_builder import build_scene
from vgmpi.runtime.config.schema import SceneError
from vgmpi.scene.loader import load

SOURCE = """\
[[inlet]]
name = "tap"
material = "water"
disc = { center = [0.1, 0.16, 0.2], radius = "2 cm" }
direction = "x"
speed = "1 m/s"
"""
SINK = """\
[[outlet]]
name = "drain"
shape = { box = [[0.5, 0.1, 0.2], [0.6, 0.2, 0.3]] }
"""
POST = """\
[[object]]
name = "post"
role = "scenery"
collider = true
shape = { box = [[0.05, 0.1, 0.1], [0.08, 0.2, 0.3]] }
"""
PROBE = '[[probe]]\nname = "all"\nrate = 10\nwall = "all"\n'
DISC = 'disc = { center = [0.1, 0.16, 0.2], radius = "2 cm" }'

# old text, new text, key as reported, what the message must say
CASES = {
    "unknown material": (
        'material = "water"',
        'material = "watr"',
        "source.tap.material",
        "there is no [material.watr] (did you mean 'water'?); defined are water, rubber",
    ),
    "name of an object": ('"tap"', '"ball"', "source.ball.name", "an object has the same name"),
    "name of a source": ('"drain"', '"tap"', "sink.tap.name", "a source has the same name"),
    "two openings": (
        DISC,
        f"{DISC}\nrectangle = {{ center = [0.1, 0.1, 0.2], width = 0.1, height = 0.1 }}",
        "source.tap.rectangle",
        "disc and rectangle given at once: give exactly one",
    ),
    "no opening": (
        SOURCE,
        SOURCE.replace(DISC + "\n", ""),
        "source.tap",
        "has no mouth: give one of disc, rectangle",
    ),
    "no flow": (
        SOURCE,
        SOURCE.replace('velocity = "1 m/s"\n', ""),
        "source.tap",
        "has no flow: give one of velocity, rate, flow",
    ),
    "two flows": (
        'velocity = "1 m/s"',
        'velocity = "1 m/s"\nrate = 1',
        "inlet.tap.mass_flow_rate",
        "velocity and rate given at once: give exactly one",
    ),
    "rate in litres": (
        'velocity = "1 m/s"',
        'rate = "1 l/s"',
        "inlet.tap.mass_flow_rate",
        "'l/s' does not measure a mass per time; expected a number [kg/s]",
    ),
    "it does not pour": ('"1 m/s"', '"0 m/s"', "inlet.tap.speed", "must be > 0 m/s"),
    "no direction": (
        'direction = "x"',
        "direction = [0, 0, 0]",
        "source.tap.direction",
        "three numbers that are not all 0",
    ),
    "end before the start": (
        'velocity = "1 m/s"',
        'velocity = "1 m/s"\nstart = 0.5\nend = 0.5',
        "inlet.tap.end_time",
        "must be later than start = 0.5 s; got 0.5 s",
    ),
    "start after the run": (
        'velocity = "1 m/s"',
        'velocity = "1 m/s"\nstart = "2 s"',
        "inlet.tap.start_time",
        "nothing comes: the run ends at 1 s; got 2 s",
    ),
    "too small": (
        '"2 cm" }\ndirection',
        '"7 mm" }\ndirection',
        "source.tap.disc",
        "no particle fits in, their spacing is 0.01 m",
    ),
    "nozzle outside": (
        "[0.1, 0.16, 0.2]",
        "[0.03, 0.16, 0.2]",
        "source.tap.disc",
        "two cells behind its mouth it reaches x = -0.01 .. 0.03 m, the domain 0 .. 0.64 m",
    ),
    "opening outside": (
        "[0.1, 0.16, 0.2]",
        "[0.1, 0.01, 0.2]",
        "source.tap.disc",
        "reaches y = -0.01 .. 0.03 m",
    ),
    "particles per cell": (
        'velocity = "1 m/s"',
        'velocity = "1 m/s"\nparticles_per_cell = 4',
        "source.tap.particles_per_cell",
        "must be 1, 8, 27 or 64",
    ),
    "sink of two forms": (
        "shape = { box",
        "shape = { sphere = { center = [0, 0, 0], radius = 1 }, box",
        "sink.drain.shape",
        "has box and sphere: give exactly one",
    ),
    "sink without a shape": (
        SINK,
        SINK.replace("shape", "#"),
        "sink.drain.shape",
        "required key is missing: the region",
    ),
    "a balance": (
        SINK,
        SINK + PROBE,
        "probe.all.wall",
        "is not for scenes where particles come or go",
    ),
    "another phase's": (
        'velocity = "1 m/s"',
        'velocity = "1 m/s"\nphase = "ball"',
        "source.tap.phase",
        "'ball' already holds a solid, object 'ball', this is a fluid",
    ),
}

# found while the particles are made
BUILD_CASES = {
    "in a body": (
        "[0.1, 0.16, 0.2]",
        "[0.3, 0.16, 0.22]",
        "source.tap.disc",
        "body 'ball' lies in its nozzle, two cells behind its mouth",
    ),
    "in a collider": (
        SINK,
        SINK + POST,
        "source.tap.disc",
        "lies inside the collider 'post'",
    ),
    "in a sink": (
        "[[0.5, 0.1, 0.2], [0.6, 0.2, 0.3]]",
        "[[0.05, 0.1, 0.1], [0.08, 0.2, 0.3]]",
        "source.tap.disc",
        "lies in the outlet 'drain': nothing would come",
    ),
    "in another source": (
        SINK,
        SINK + SOURCE.replace("tap", "tip").replace('"x"', '"y"'),
        "source.tip.disc",
        "lies in the nozzle of inlet 'tap'",
    ),
    "a sink that eats": (
        "[[0.5, 0.1, 0.2], [0.6, 0.2, 0.3]]",
        "[[0.5, 0.1, 0.09], [0.6, 0.2, 0.3]]",
        "sink.drain.shape",
        "an outlet that removes a body at the start: 'drain' holds particles of 'pool'",
    ),
    "a solid": (
        'material = "water"',
        'material = "rubber"',
        "source.tap.material",
        "'rubber' is a solid, of which contact knows the surface",
    ),
    "an end too early": (
        'velocity = "1 m/s"',
        'velocity = "1 m/s"\nend = "1 ms"',
        "inlet.tap.end_time",
        "it ends before the first layer has passed its mouth",
    ),
    "too many": (
        'velocity = "1 m/s"',
        'velocity = "1e12 m/s"',
        "source.tap",
        "GiB",
    ),
}


@pytest.mark.parametrize("name", [*CASES, *BUILD_CASES])
def test_error_has_its_line_key_and_advice(tmp_path, name):
    """The line is that of the key, or of the table's header where the key is not there."""
    old, new, key, says = {**CASES, **BUILD_CASES}[name]
    whole = GOOD + SOURCE + SINK
    at = whole.index(old, len(GOOD))
    text = whole[:at] + new + whole[at + len(old) :]
    path = tmp_path / "scene.toml"
    path.write_text(text)
    with pytest.raises(SceneError) as caught:
        load(path) if name in CASES else build_scene(load(path))
    (found,) = caught.value.lines
    assert f": {key}: " in found and says in found
    file, _, number = found.partition(f": {key}: ")[0].rpartition(":")
    assert file == str(path)
    table, thing, *inner = key.split(".")
    rows = text.splitlines()[: int(number)]
    header = max(k for k, row in enumerate(rows) if row.startswith("[["))
    assert rows[header] == f"[[{table}]]"
    assert text.splitlines()[header + 1] == f'name = "{thing}"'
    there = bool(inner) and "#" not in new
    assert rows[-1].startswith(f"{inner[0]} =") if there else header == len(rows) - 1


def test_the_good_scene_is_good(tmp_path):
    (tmp_path / "scene.toml").write_text(GOOD + SOURCE + SINK)
    assert build_scene(load(tmp_path / "scene.toml")).objects[-1]["role"] == "source"


@pytest.mark.parametrize(
    "text, says",
    [
        ("source = 3", "must be a list of tables: [[source]]"),
        ("[[inlet]]\nmaterial = []", "source.0.material"),
        ("[[inlet]]\ndisc = 3", "must be a table of keys; got 3"),
        ("[[inlet]]\nname = []\nphase = 3", "must begin with a letter"),
        ("sink = [1]", "must be a list of tables: [[sink]]"),
        ("[[outlet]]\nshape = 3", "must be a table of keys; got 3"),
    ],
)
def test_nonsense_is_reported_not_raised(tmp_path, text, says):
    (tmp_path / "scene.toml").write_text(text)
    with pytest.raises(SceneError) as caught:
        load(tmp_path / "scene.toml")
    assert any(says in line for line in caught.value.lines), caught.value.lines
