"""render.toml: good ones, and one clear line for each mistake."""

import pytest

from tests.support import drawn_runs
from vgmpi.io.run_reader import RunReader
from vgmpi.postprocess.commands import render
from vgmpi.postprocess.frames import render_config
from vgmpi.postprocess.frames.frame_renderer import FrameRenderer
from vgmpi.runtime import process_limits

FULL = """
[camera]
kind = "orbit"
target = [0.5, 0.5, 0.3]
distance = 2.5
height = 1
revolutions = 0.5
azimuth = 30
fov = 35
up = [0, 0, 1]
near = 0.01

[picture]
width = 640
height = 360
background = [0.1, 0.2, 0.3]

[video]
fps = 30
quality = 7

[frames]
first = 1
last = 10
every = 2

[splatting]
mode = "mip"
alpha_min = 1e-4

[look]
color_transfer = "relax"
color_relaxation_time = 0.5
color_objects = ["milk"]
covariance = "fixed"
covariance_normalization = "radius"

[look.opacity_scale]
water = 0.02
"my duck" = 1
"""


def load(folder, text):
    path = folder / "render.toml"
    path.write_text(text)
    return render_config.load(path)


def test_everything_may_be_left_out(tmp_path):
    assert load(tmp_path, "") == render_config.load(None) == render_config.Settings()


def test_everything_may_be_said(tmp_path):
    s = load(tmp_path, FULL)
    assert s.camera[0].revolutions == 0.5 and s.camera[0].target == (0.5, 0.5, 0.3)
    assert s.picture.background == (0.1, 0.2, 0.3)
    assert s.splatting.options() == {"lowpass": 0.1, "antialias": True}
    assert (s.frames.first, s.frames.last, s.frames.every) == (1, 10, 2)
    assert s.look.opacity_scale == {"water": 0.02, "my duck": 1}
    told = {"color_transfer": "relax", "color_relaxation_time": 0.5, "color_objects": ("milk",)}
    assert s.look.colors() == told


def test_a_fixed_camera(tmp_path):
    s = load(tmp_path, '[camera]\nkind = "fixed"\neye = [1, 2, 3]')
    assert s.camera[0].eye == (1, 2, 3)
    assert s.splatting.options() == {"lowpass": None, "antialias": None}  # as each capture says


@pytest.mark.parametrize(
    "said, lowpass, antialias",
    [
        ('mode = "capture"', None, None),
        ("lowpass = 0.2", 0.2, None),
        ('mode = "classic"', 0.3, False),
        ('mode = "antialias"', 0.3, True),
        ('mode = "mip"', 0.1, True),
        ('mode = "mip"\nlowpass = 0.3', 0.3, True),
    ],
)
def test_a_mode_of_splatting_is_for_all_objects(tmp_path, said, lowpass, antialias):
    s = load(tmp_path, f"[splatting]\n{said}")
    assert s.splatting.options() == {"lowpass": lowpass, "antialias": antialias}


@pytest.mark.parametrize(
    "said, want", [("30", 30), ('"30 deg"', 30), ('"0.5 rad"', 28.647889756541), ('"33 deg"', 33)]
)
def test_angles_are_degrees_or_have_a_unit(tmp_path, said, want):
    s = load(tmp_path, f"[camera]\nazimuth = {said}\nfov = {said}")
    assert s.camera[0].azimuth == s.camera[0].fov == want


BAD = {
    "an angle in metres": ('[camera]\nfov = "3 m"', 2, "camera.fov", "or a text as '30 deg'"),
    "an angle too wide": ('[camera]\nfov = "3 rad"', 2, "camera.fov", "less than 170"),
    "an unknown table": ("[camara]\nfov = 3", 1, "camara", "did you mean 'camera'?"),
    "an unknown key": ("[camera]\n\nfovv = 3", 3, "camera.fovv", "did you mean 'fov'?"),
    "a key outside its table": ("\nfov = 3", 2, "fov", "known here: camera"),
    "a wrong kind": ('[camera]\nkind = "orbitt"', 2, "camera.kind", "did you mean 'orbit'?"),
    "a word for a number": ('[camera]\nfov = "wide"', 2, "camera.fov", "'wide'"),
    "out of range": ("[camera]\nrevolutions = 1\nfov = 190", 3, "camera.fov", "less than 170"),
    "not finite": ("[camera]\nheight = inf", 2, "camera.height", "finite"),
    "two numbers": ("[camera]\ntarget = [1, 2]", 2, "camera.target", "three numbers"),
    "a number for a direction": ("[camera]\nup = 3", 2, "camera.up", "three numbers"),
    "no direction": ("[camera]\nup = [0, 0, 0]", 2, "camera.up", "not zero"),
    "fixed without eye": ('\n[camera]\nkind = "fixed"', 2, "camera", "needs eye"),
    "orbit with eye": ("[camera]\neye = [1, 2, 3]", 1, "camera", "has no eye"),
    "fixed with revolutions": (
        '[camera]\nkind = "fixed"\neye = [1, 2, 3]\nrevolutions = 2',
        1,
        "camera",
        "has no revolutions",
    ),
    "too high": ("[camera]\ndistance = 1\nheight = 2", 1, "camera", "less than distance"),
    "eye at the target": (
        '[camera]\nkind = "fixed"\neye = [1, 2, 3]\ntarget = [1, 2, 3]',
        1,
        "camera",
        "same point",
    ),
    "colors at every step": (
        '[look]\ncolor_transfer = "step"',
        2,
        "look.color_transfer",
        "must be one of off, frame, relax; got 'step'",
    ),
    "a time of nothing": (
        "[look]\ncolor_relaxation_time = 0",
        2,
        "look.color_relaxation_time",
        "greater than 0",
    ),
    "a degree too high": ("[look]\ncolor_sh_degree = 4", 2, "look.color_sh_degree", "less than"),
    "an unknown look": ("[look]\nopacitie = 1", 2, "look.opacitie", "did you mean 'opacity'?"),
    "an unknown preset": (
        '[look]\npreset = "glass"',
        2,
        "look.preset",
        "must be one of studio, paper; got 'glass'",
    ),
    "less than air refracts": (
        "[liquid]\nrefractive_index = 0.9",
        2,
        "liquid.refractive_index",
        "equal to 1",
    ),
    "environment of no color": (
        '[liquid.environment]\nzenith = "blue"',
        2,
        "liquid.environment.zenith",
        "a color such as",
    ),
    "a light of no direction": ("[light]\ndirection = [0, 0, 0]", 2, "light.direction", "not zero"),
    "more shadow than light": ("[light]\nshadow = 1.5", 2, "light.shadow", "equal to 1"),
    "jitter above 1": (
        "[look.brightness_jitter]\nsand = 2",
        2,
        "look.brightness_jitter.sand",
        "equal to 1",
    ),
    "a scale above 1": (
        "[look]\n\n[look.opacity_scale]\nwater = 0.1\nmilk = 2",
        5,
        "look.opacity_scale.milk",
        "less than or equal to 1",
    ),
    "a scale above 1 in line": (
        "[look]\n\nopacity_scale = { milk = 2 }",
        3,
        "look.opacity_scale.milk",
        "less than or equal to 1",
    ),
    "a huge picture": ("[picture]\nwidth = 100000", 2, "picture.width", "8192"),
    "half a pixel": ("[picture]\nwidth = 100.5", 2, "picture.width", "integer"),
    "a color beyond white": (
        "[picture]\nbackground = [2, 0, 0]",
        2,
        "picture.background",
        "0 to 1",
    ),
    "half a color": ('[picture]\nbackground = "#12"', 2, "picture.background", "'#6fb7d6'"),
    "no frames a second": ("[video]\nfps = 0", 2, "video.fps", "greater than or equal to 1"),
    "frames backwards": ("[frames]\nevery = -1", 2, "frames.every", "-1"),
    "alpha_min zero": ("[splatting]\nalpha_min = 0", 2, "splatting.alpha_min", "0.00001"),
    "a mode that is not there": ('[splatting]\nmode = "raytrace"', 2, "splatting.mode", "mip"),
    "a table that is a number": ("picture = 3", 1, "picture", "must be a table of keys; got 3"),
    "a camera that is a number": ("camera = 3", 1, "camera", "must be a table [camera]"),
    "no camera": ("\ncamera = []", 2, "camera", "at least 1 item"),
    "a list that is a number": (
        "[camera]\n\nkeyframes = 3",
        3,
        "camera.keyframes",
        "must be a list; got 3",
    ),
    "part of a color": (
        "[picture]\nbackground = [1,\n 2]",
        2,
        "picture.background",
        "three numbers from 0 to 1, 'none', or the name of a picture; got [1, 2]",
    ),
    "one of a list": (
        '[look]\ncolor_objects = [\n"milk",\n3]',
        4,
        "look.color_objects.1",
        "a text",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_mistakes_are_named_with_their_line(tmp_path, name):
    text, line, key, says = BAD[name]
    with pytest.raises(render_config.SettingsError) as caught:
        load(tmp_path, text)
    for said in caught.value.lines:
        assert said.startswith(f"{tmp_path / 'render.toml'}:{line}: {key}: ")
        assert "\n" not in said
    assert any(says in said for said in caught.value.lines)


def test_all_mistakes_are_told_at_once(tmp_path):
    with pytest.raises(render_config.SettingsError) as caught:
        load(tmp_path, "[camera]\nfov = 0\n[video]\nfps = 0\nspeed = 2")
    assert len(caught.value.lines) == 3


@pytest.mark.parametrize("text, line", [("[camera\nfov = 3", ":1"), ("\nfov = = 3", ":2")])
def test_a_file_that_is_no_toml(tmp_path, text, line):
    with pytest.raises(render_config.SettingsError) as caught:
        load(tmp_path, text)
    assert len(caught.value.lines) == 1
    assert caught.value.lines[0].startswith(f"{tmp_path / 'render.toml'}{line}: ")


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(render_config.SettingsError, match="none.toml"):
        render_config.load(tmp_path / "none.toml")


def test_another_spelling_of_color_is_an_unknown_key(tmp_path):
    """A floor's; an object that is called so keeps its name."""
    text = "[picture]\n\nfloor = { color = '#ff0000' }\n[look.opacity_scale]\ncolour = 0.5\n"
    chosen = load(tmp_path, text)
    assert chosen.picture.floor.color == (1, 0, 0)
    assert chosen.look.opacity_scale == {"colour": 0.5}
    with pytest.raises(render_config.SettingsError) as caught:
        load(tmp_path, text.replace("{ color", "{ colour"))
    (line,) = caught.value.lines
    assert line.startswith(f"{tmp_path / 'render.toml'}:3: picture.floor.colour: unknown key")
    assert "did you mean 'color'?" in line
    with pytest.raises(
        render_config.SettingsError, match=":3: picture.floor.color: must be a color"
    ):
        load(tmp_path, text.replace("#ff0000", "ff0000"))


def test_pictures_that_do_not_fit(tmp_path, monkeypatch):
    """Told before anything is drawn, with the key that makes them large; a preview is small."""
    drawn_runs.write(tmp_path)
    run, large = RunReader(tmp_path), {"width": 8192, "height": 8192}
    paper = {"preset": "paper"}
    monkeypatch.setattr(process_limits, "available_memory", lambda swap=False: 20 << 30)
    finer = render_config.Settings(look=paper, picture=large | {"supersample": 4})
    with pytest.raises(
        render_config.SettingsError, match="picture.supersample: 4 draws 8192 x 8192"
    ):
        FrameRenderer(run, finer, tmp_path)
    with pytest.raises(
        render_config.SettingsError, match="picture.width: 8192 x 8192 pixels: at least"
    ):
        FrameRenderer(
            run, render_config.Settings(picture=large), tmp_path
        )  # the studio keeps more of a pixel
    painter = FrameRenderer(run, render_config.Settings(look=paper, picture=large), tmp_path)
    painter.afford(9)
    with pytest.raises(
        render_config.SettingsError, match="pixels, 16 pictures at once: at least 32 G"
    ):
        painter.afford(16)
    FrameRenderer(run, finer, tmp_path, longest=400)


def test_frames_are_shared_by_as_many_processes_as_cores_frames_and_memory_allow(
    tmp_path, monkeypatch
):
    drawn_runs.write(tmp_path)
    large = render_config.Settings(
        look={"preset": "paper"}, picture={"width": 8192, "height": 8192}
    )
    monkeypatch.setattr(process_limits, "available_memory", lambda swap=False: 20 << 30)
    painter = FrameRenderer(RunReader(tmp_path), large, tmp_path)
    monkeypatch.setattr(render, "available_cores", lambda: 16)
    assert render.process_count(painter, 100) == 10  # 2 GiB each
    assert render.process_count(painter, 12) == 3
    assert render.process_count(painter, 3) == 1
    monkeypatch.setattr(render, "available_cores", lambda: 2)
    assert render.process_count(painter, 100) == 2


def test_a_picture_too_large_is_one_line_and_exit_code_2(tmp_path, monkeypatch, capsys):
    drawn_runs.write(tmp_path)
    text = 'look.preset = "paper"\n[picture]\nwidth = 8192\nheight = 8192\n'
    (tmp_path / "render.toml").write_text(text)
    monkeypatch.setattr(process_limits, "available_memory", lambda swap=False: 3 << 30)
    command = [str(tmp_path), str(tmp_path / "render.toml"), "-q"]
    assert render.main([*command, "--jobs", "2"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "picture.width: 8192 x 8192 pixels, 2 pictures at once: at least 4 GiB; 3 GiB" in line


@pytest.mark.parametrize(
    "keys, says",
    [
        ("target = [1e160, 0, 0]", "camera.0.target: must be of numbers up to 1e+100 in size"),
        ("up = [0, 0, 1e-200]", "camera.0.up: must be a direction of a length from 1e-100"),
        ("distance = 1e160", "camera.0.distance: must be 0 or from 1e-100 to 1e+100 in size"),
        ("near = 5e-324", "camera.0.near: must be 0 or from 1e-100 to 1e+100 in size"),
    ],
)
def test_numbers_whose_squares_are_none(tmp_path, keys, says):
    with pytest.raises(render_config.SettingsError) as caught:
        load(tmp_path, f"[camera]\n{keys}")
    [line] = caught.value.lines
    assert line.startswith(f"{tmp_path / 'render.toml'}:2: ")
    assert says.replace(".0.", ".") in line.replace(".0.", ".")


@pytest.mark.parametrize(
    "text, studio, on_paper",
    [
        ("", True, False),
        ('[look]\npreset = "studio"', True, True),
        ('[look]\npreset = "paper"', False, False),
    ],
)
def test_who_draws(tmp_path, text, studio, on_paper):
    """The studio, unless the other preset is asked for; and where paper is the default."""
    chosen = load(tmp_path, text)
    assert chosen.studio == studio and chosen.on_paper().studio == on_paper


def test_the_background_is_white_where_none_is_said(tmp_path):
    assert load(tmp_path, "").background == "#ffffff"
    assert load(tmp_path, '[picture]\nbackground = "none"').background == "none"


@pytest.mark.parametrize("tear", ["[2, 1.5]", "[0.5, 3]", "[2, 30]"])
def test_a_tear_that_is_no_range(tmp_path, tear):
    with pytest.raises(render_config.SettingsError, match="look.tear: must be two numbers"):
        load(tmp_path, f"[look]\ntear = {tear}")
