"""render.toml, fit.toml and layout.toml in the words of earlier versions: they mean the same as in
today's words, and one line for each old word names the new one."""

import re

import pytest

from tests.support.fit_scenes import BALL, FIT, made
from vgmpi.apps.fit import fit_config
from vgmpi.apps.fit.fit_config import FitFile
from vgmpi.apps.fit.target_factory import target_of
from vgmpi.apps.photo import layout_config
from vgmpi.rendering import render_config
from vgmpi.runtime.config import renamed_keys
from vgmpi.runtime.config.toml_source import TomlSource
from vgmpi.scene.loader import load

RENDER = """
[[camera]]
name = "round"
turns = 0.5
angle = 30
[[camera]]
name = "along"
kind = "keyframes"
keys = [{ part = 0, eye = [3, 0, 1] }, { part = 1, eye = [0, 3, 1] }]
[picture]
tone = "none"
edges = 2
samples = 4
floor = { colour = "#aaaaaa", squares = 0.1, other = "#bbbbbb", tiles = 0.2 }
[liquid]
index = 1.4
clear = 0.3
scatter = 1.5
fine = 2
walls = false
surroundings = { zenith = "#73a6e6" }
[look]
children = 8
grain = { sand = 0.15 }
harmonics = "fixed"
normalise = "deformation"
colour_transfer = "relax"
colour_time = 0.5
colour_degree = 1
colour_bodies = ["water"]
"""
RENDER_NOW = """
[[camera]]
name = "round"
revolutions = 0.5
azimuth = 30
[[camera]]
name = "along"
kind = "keyframes"
keyframes = [{ progress = 0, eye = [3, 0, 1] }, { progress = 1, eye = [0, 3, 1] }]
[picture]
tone_mapping = "none"
edge_samples = 2
blur_samples = 4
floor = { color = "#aaaaaa", checker_size = 0.1, checker_color = "#bbbbbb", tile_size = 0.2 }
[liquid]
refractive_index = 1.4
absorption_length = 0.3
scattering_coefficient = 1.5
cells_per_spacing = 2
clip_at_walls = false
environment = { zenith = "#73a6e6" }
[look]
grains_per_particle = 8
brightness_jitter = { sand = 0.15 }
rotate_sh = false
covariance_normalization = "none"
color_transfer = "relax"
color_relaxation_time = 0.5
color_sh_degree = 1
color_objects = ["water"]
"""
PARAMETERS = """
[[parameter]]
key = "material.rubber.youngs_modulus"
range = ["4 kPa", "400 kPa"]
start = "200 kPa"
logarithmic = true
[[parameter]]
key = "object.ball.velocity.2"
range = [-2, 1]
logarithmic = false
"""
PARAMETERS_NOW = """
[[parameter]]
key = "material.rubber.youngs_modulus"
range = ["4 kPa", "400 kPa"]
initial = "200 kPa"
scale = "log"
[[parameter]]
key = "object.ball.velocity.2"
range = [-2, 1]
scale = "linear"
"""
METHOD = """
[method]
kind = "cma"
runs = 50
scan = 4
step = 0.03
grid = "finer"
"""
METHOD_NOW = """
[method]
algorithm = "cma"
max_runs = 50
scan_points = 4
fd_step = 0.03
discretization_check = "finer"
"""
FITS = {
    "table": (
        """[target]
table = "a.csv"
probe = "ball"
time_unit = 60.0
time_zero = 0.5
value_unit = 1e3
where = { series = "a" }
hold_out = 3
""",
        """[target]
table = "a.csv"
probe = "ball"
time_scale = 60.0
time_offset = 0.5
value_scale = 1e3
filter = { series = "a" }
holdout_every = 3
""",
    ),
    "run": (
        '[target]\nframes = "reference"\nboxes = [4, 8]\n',
        '[target]\nrun = "reference"\ndensity_bins = [4, 8]\n',
    ),
    "video": (
        '[target]\nvideo = "film.mp4"\nrender = "render.toml"\ncamera_shift = 3\n',
        '[target]\nvideo = "film.mp4"\nrender = "render.toml"\nmax_camera_shift = 3\n',
    ),
    "sds": (
        """[sds]
model = "model"
render = "render.toml"
image = "first.png"
guidance = 2.0
draws = 4
times = [0.1, 0.9]
motion = 60
""",
        """[sds]
model = "model"
render = "render.toml"
image = "first.png"
guidance_scale = 2.0
noise_samples = 4
noise_levels = [0.1, 0.9]
motion_bucket_id = 60
""",
    ),
}
LAYOUT = """
[masks]
by = "sam2"
[depth]
by = "depth-anything"
[materials]
by = "clip"
[bodies]
by = "form"
[[object]]
name = "cup"
box = [1, 2, 30, 40]
clicks = [[5, 5], [6, 6, "out"]]
form = "revolve"
[[object]]
name = "toy"
box = [50, 2, 70, 40]
views = "toy/transforms.json"
"""
LAYOUT_NOW = """
[masks]
method = "sam2"
[depth]
method = "depth-anything"
[materials]
method = "clip"
[bodies]
method = "mask"
[[object]]
name = "cup"
box = [1, 2, 30, 40]
point_prompts = [[5, 5], [6, 6, "out"]]
reconstruction = "revolve"
[[object]]
name = "toy"
box = [50, 2, 70, 40]
multi_view = "toy/transforms.json"
"""


def read_both(tmp_path, caplog, read, old, new):
    """What is read of a file in old words, and what is said of them; in new words nothing is."""
    path = tmp_path / "now.toml"
    path.write_text(new)
    want = read(path)
    assert not caplog.records
    path = tmp_path / "old.toml"
    path.write_text(old)
    assert read(path) == want
    lines = [r.getMessage() for r in caplog.records]
    assert all(line.startswith(f"{path}:") for line in lines)
    caplog.clear()
    return [line.removeprefix(f"{path}:") for line in lines]


def told_names(table):
    """Each old key of a table with its new one, as a warning tells them."""
    return {(r.path.split(".")[-1], r.key) for _, r in table._patterns}


def names_in(lines):
    """Old and new key of each line."""
    found = set()
    for line in lines:
        match = re.search(r"^\d+: '?(\w+)'? .*is the old (?:name|form) of ([\w.]+)", line)
        assert match, line
        found.add((match[1], match[2].split(".")[-1]))
    assert len(found) == len(lines), "a word is told twice"
    return found


def test_every_old_word_of_render_toml(tmp_path, caplog):
    lines = read_both(tmp_path, caplog, render_config.load, RENDER, RENDER_NOW)
    assert names_in(lines) == told_names(renamed_keys.RENDER)
    assert "11: 'tone' is the old name of picture.tone_mapping" in lines
    assert any(line.endswith("look.rotate_sh = false") for line in lines)
    assert any(line.endswith('look.covariance_normalization = "none"') for line in lines)


def read_fit(path):
    source = TomlSource(path, renames=renamed_keys.FIT)
    return fit_config.Settings.model_validate(source.data)


def test_every_old_word_of_fit_toml(tmp_path, caplog):
    found = set()
    for old, new in FITS.values():
        lines = read_both(
            tmp_path, caplog, read_fit,
            PARAMETERS + old + METHOD, PARAMETERS_NOW + new + METHOD_NOW,
        )  # fmt: skip
        # true and false are two words
        logarithmic = [line for line in lines if "logarithmic" in line]
        assert [line.partition(" of ")[2] for line in logarithmic] == [
            'parameter.0.scale = "log"', 'parameter.1.scale = "linear"',
        ]  # fmt: skip
        lines.remove(logarithmic[0])
        found |= names_in(lines)
    assert found == told_names(renamed_keys.FIT)


def test_numbers_are_no_truths(tmp_path):
    """1 is not taken for true, though they are equal."""
    path = tmp_path / "fit.toml"
    for number in ("1", "0", "1.0"):
        path.write_text(f"[[parameter]]\nlogarithmic = {number}\n")
        value = TomlSource(path, renames=renamed_keys.FIT).data["parameter"][0]["scale"]
        assert value == float(number) and not isinstance(value, bool | str)


def test_every_old_word_of_layout_toml(tmp_path, caplog):
    lines = read_both(
        tmp_path, caplog, lambda path: layout_config.read(path).layout, LAYOUT, LAYOUT_NOW
    )
    method = [line for line in lines if line.startswith("3: 'by' ")]
    assert method == ["3: 'by' is the old name of masks.method (so are those at 5, 7)"]
    assert '9: by = "form" is the old form of bodies.method = "mask"' in lines
    lines.remove(method[0])
    assert names_in(lines) == told_names(renamed_keys.LAYOUT)


OLD_SCENE_KEYS = {
    "material.water.bulk_modulus": "material.water.tait_coefficient",
    "object.drop.spin.2": "object.drop.angular_velocity.2",
    "source.tap.rate": "inlet.tap.mass_flow_rate",
}
SCENE = (
    BALL
    + """
[material.water]
kind = "fluid"
tait_coefficient = 1e4
[[object]]
name = "drop"
material = "water"
shape = { sphere = { center = [0.12, 0.12, 0.17], radius = 0.03 } }
angular_velocity = [0, 0, 1]
[[inlet]]
name = "tap"
material = "water"
disc = { center = [0.06, 0.06, 0.18], radius = 0.03 }
direction = [0, 0, -1]
mass_flow_rate = 0.5
"""
)


@pytest.mark.parametrize("old", OLD_SCENE_KEYS)
def test_an_old_key_of_a_scene_is_fitted(tmp_path, caplog, old):
    """One line tells its new name, and the scene is asked by that."""
    new = OLD_SCENE_KEYS[old]
    text = FIT.replace("material.rubber.youngs_modulus", old)
    text = text.replace('range = ["4 kPa", "400 kPa"]\ninitial = "200 kPa"', "range = [0.1, 1e5]")
    scene, path = made(tmp_path, SCENE, text)
    (axis,) = FitFile(path, load(scene)).axes
    assert axis.key == new
    assert [r.getMessage() for r in caplog.records] == [
        f"{path}:2: {old!r} is the old name of {new}"
    ]


LEVEL = '[[probe]]\nname = "gauge"\nsurface_height = [0.12, 0.12]\nsampling_rate = 200\n'


def test_an_old_column_of_a_probe_is_fitted(tmp_path, caplog):
    (tmp_path / "a.csv").write_text("time,level\n0,0.1\n0.05,0.2\n")
    wanted = '[target]\ntable = "a.csv"\nprobe = "gauge"\n'
    for more, told in (("", []), ('columns = ["level"]\n', ["level"])):
        head, _, rest = FIT.partition("[target]")
        text = head + wanted + more + rest[rest.index("[method]") :]
        scene, path = made(tmp_path, SCENE + LEVEL, text)
        assert target_of(FitFile(path, load(scene))).pairs == {"surface_height": "level"}
        assert [r.getMessage() for r in caplog.records] == [
            f"{path}:8: {old!r} is the old name of the column surface_height" for old in told
        ]
