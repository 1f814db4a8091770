"""Every error of a wrong inlet or outlet names its line, its key, and what would be right.

As test_bad_scenes.py: a good scene gets more tables, and a piece of their text is another one.
"""

import pytest

from tests.support.wrong_scenes import GOOD
from vgmpi.preprocess.scene_builder import build_scene
from vgmpi.runtime.config.schema import SceneError
from vgmpi.scene.loader import load

INLET = """\
[[inlet]]
name = "tap"
material = "water"
disc = { center = [0.1, 0.16, 0.2], radius = "2 cm" }
direction = "x"
speed = "1 m/s"
"""
OUTLET = """\
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
PROBE = '[[probe]]\nname = "all"\nsampling_rate = 10\nwall = "all"\n'
DISC = 'disc = { center = [0.1, 0.16, 0.2], radius = "2 cm" }'

# old text, new text, key as reported, what the message must say
CASES = {
    "unknown material": (
        'material = "water"',
        'material = "watr"',
        "inlet.tap.material",
        "there is no [material.watr] (did you mean 'water'?); defined are water, rubber",
    ),
    "name of an object": ('"tap"', '"ball"', "inlet.ball.name", "an object has the same name"),
    "name of an inlet": ('"drain"', '"tap"', "outlet.tap.name", "an inlet has the same name"),
    "two openings": (
        DISC,
        f"{DISC}\nrectangle = {{ center = [0.1, 0.1, 0.2], width = 0.1, height = 0.1 }}",
        "inlet.tap.rectangle",
        "disc and rectangle given at once: give exactly one",
    ),
    "no opening": (
        INLET,
        INLET.replace(DISC + "\n", ""),
        "inlet.tap",
        "has no mouth: give one of disc, rectangle",
    ),
    "no flow": (
        INLET,
        INLET.replace('speed = "1 m/s"\n', ""),
        "inlet.tap",
        "has no flow: give one of speed, mass_flow_rate, volume_flow_rate",
    ),
    "two flows": (
        'speed = "1 m/s"',
        'speed = "1 m/s"\nmass_flow_rate = 1',
        "inlet.tap.mass_flow_rate",
        "speed and mass_flow_rate given at once: give exactly one",
    ),
    "rate in litres": (
        'speed = "1 m/s"',
        'mass_flow_rate = "1 l/s"',
        "inlet.tap.mass_flow_rate",
        "'l/s' does not measure a mass per time; expected a number [kg/s]",
    ),
    "it does not pour": ('"1 m/s"', '"0 m/s"', "inlet.tap.speed", "must be > 0 m/s"),
    "no direction": (
        'direction = "x"',
        "direction = [0, 0, 0]",
        "inlet.tap.direction",
        "three numbers that are not all 0",
    ),
    "end before the start": (
        'speed = "1 m/s"',
        'speed = "1 m/s"\nstart_time = 0.5\nend_time = 0.5',
        "inlet.tap.end_time",
        "must be later than start_time = 0.5 s; got 0.5 s",
    ),
    "start after the run": (
        'speed = "1 m/s"',
        'speed = "1 m/s"\nstart_time = "2 s"',
        "inlet.tap.start_time",
        "nothing comes: the run ends at 1 s; got 2 s",
    ),
    "too small": (
        '"2 cm" }\ndirection',
        '"7 mm" }\ndirection',
        "inlet.tap.disc",
        "no particle fits in, their spacing is 0.01 m",
    ),
    "nozzle outside": (
        "[0.1, 0.16, 0.2]",
        "[0.03, 0.16, 0.2]",
        "inlet.tap.disc",
        "two cells behind its mouth it reaches x = -0.01 .. 0.03 m, the domain 0 .. 0.64 m",
    ),
    "opening outside": (
        "[0.1, 0.16, 0.2]",
        "[0.1, 0.01, 0.2]",
        "inlet.tap.disc",
        "reaches y = -0.01 .. 0.03 m",
    ),
    "particles per cell": (
        'speed = "1 m/s"',
        'speed = "1 m/s"\nparticles_per_cell = 4',
        "inlet.tap.particles_per_cell",
        "must be 1, 8, 27 or 64",
    ),
    "outlet of two forms": (
        "shape = { box",
        "shape = { sphere = { center = [0, 0, 0], radius = 1 }, box",
        "outlet.drain.shape",
        "has box and sphere: give exactly one",
    ),
    "outlet without a shape": (
        OUTLET,
        OUTLET.replace("shape", "#"),
        "outlet.drain.shape",
        "required key is missing: the region",
    ),
    "a balance": (
        OUTLET,
        OUTLET + PROBE,
        "probe.all.wall",
        "is not for scenes where particles come or go",
    ),
    "another phase's": (
        'speed = "1 m/s"',
        'speed = "1 m/s"\nphase = "ball"',
        "inlet.tap.phase",
        "'ball' already holds a solid, object 'ball', this is a fluid",
    ),
}

# found while the particles are made
BUILD_CASES = {
    "in a body": (
        "[0.1, 0.16, 0.2]",
        "[0.3, 0.16, 0.22]",
        "inlet.tap.disc",
        "body 'ball' lies in its nozzle, two cells behind its mouth",
    ),
    "in a collider": (
        OUTLET,
        OUTLET + POST,
        "inlet.tap.disc",
        "lies inside the collider 'post'",
    ),
    "in an outlet": (
        "[[0.5, 0.1, 0.2], [0.6, 0.2, 0.3]]",
        "[[0.05, 0.1, 0.1], [0.08, 0.2, 0.3]]",
        "inlet.tap.disc",
        "lies in the outlet 'drain': nothing would come",
    ),
    "in another inlet": (
        OUTLET,
        OUTLET + INLET.replace("tap", "tip").replace('"x"', '"y"'),
        "inlet.tip.disc",
        "lies in the nozzle of inlet 'tap'",
    ),
    "an outlet that removes": (
        "[[0.5, 0.1, 0.2], [0.6, 0.2, 0.3]]",
        "[[0.5, 0.1, 0.09], [0.6, 0.2, 0.3]]",
        "outlet.drain.shape",
        "an outlet that removes a body at the start: 'drain' holds particles of 'pool'",
    ),
    "a solid": (
        'material = "water"',
        'material = "rubber"',
        "inlet.tap.material",
        "'rubber' is a solid, of which contact knows the surface",
    ),
    "an end too early": (
        'speed = "1 m/s"',
        'speed = "1 m/s"\nend_time = "0.1 ms"',
        "inlet.tap.end_time",
        "it ends before the first particle has passed its mouth",
    ),
    "too many": (
        'speed = "1 m/s"',
        'speed = "1e12 m/s"',
        "inlet.tap",
        "GiB",
    ),
}


@pytest.mark.parametrize("name", [*CASES, *BUILD_CASES])
def test_error_has_its_line_key_and_advice(tmp_path, name):
    """The line is that of the key, or of the table's header where the key is not there."""
    old, new, key, says = {**CASES, **BUILD_CASES}[name]
    whole = GOOD + INLET + OUTLET
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
    (tmp_path / "scene.toml").write_text(GOOD + INLET + OUTLET)
    assert build_scene(load(tmp_path / "scene.toml")).objects[-1]["role"] == "source"


@pytest.mark.parametrize(
    "text, says",
    [
        ("inlet = 3", "must be a list of tables: [[inlet]]"),
        ("[[inlet]]\nmaterial = []", "inlet.0.material"),
        ("[[inlet]]\ndisc = 3", "must be a table of keys; got 3"),
        ("[[inlet]]\nname = []\nphase = 3", "must begin with a letter"),
        ("outlet = [1]", "must be a list of tables: [[outlet]]"),
        ("[[outlet]]\nshape = 3", "must be a table of keys; got 3"),
    ],
)
def test_nonsense_is_reported_not_raised(tmp_path, text, says):
    (tmp_path / "scene.toml").write_text(text)
    with pytest.raises(SceneError) as caught:
        load(tmp_path / "scene.toml")
    assert any(says in line for line in caught.value.lines), caught.value.lines
