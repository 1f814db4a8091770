"""Reading a scene: values, defaults, overrides, files, and that the reference is up to date."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from vgmpi.runtime.config.schema import SceneError
from vgmpi.scene import markdown_reference
from vgmpi.scene.loader import load
from vgmpi.scene.scene import phase_of
from vgmpi.scene.scene_feature import object_table, section_tables
from vgmpi.scene.sections import Domain

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = sorted(p.parent.name for p in (ROOT / "runs").glob("*/scene.toml"))

ASSETS = {
    "ablation": {"duck": "duck"},  # bodies of the examples and what make_assets.py makes for them
    "splash": {"duck": "duck"},
    "capture": {"capture": "duck"},
    "balls_duck": {"duck": "duck", "left ball": "ball", "right ball": "ball"},
    **dict.fromkeys(
        ("faucet", "faucet_ducks"),
        {f"{which} duck": "duck" for which in ("first", "second", "third")},
    ),
}

SMALL = """
title = "small"
[domain]
size = ["64 cm", 0.32, 0.32]
cell = "2 cm"
boundary = { default = "slip", bottom = { kind = "separate", friction = 0.4 }, east = "stick" }
[time]
end = "1 s"
[material.water]
kind = "fluid"
[material.rubber]
kind = "elastic"
youngs_modulus = "0.1 MPa"
[[object]]
name = "ball"
material = "rubber"
shape = { sphere = { center = [0, 0, 0], radius = "4 cm" }, color = "#ff8000" }
position = [0.3, 0.16, 0.2]
rotation = { axis = [0, 0, 2], angle = "90 deg" }
[[object]]
name = "pool"
material = "water"
opacity_scale = 0.01
shape = { box = [[0, 0, 0], [0.64, 0.32, 0.1]] }
"""


@pytest.fixture
def small(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(SMALL)
    return path


def test_values_are_si_and_defaults_are_filled_in(small):
    scene = load(small)
    assert scene.domain.size == (0.64, 0.32, 0.32) and scene.domain.cells == (32, 16, 16)
    assert scene.domain.gravity == (0.0, 0.0, -9.8)
    assert scene.time.frames == 50 and scene.time.dt == 0.0
    assert scene.material["rubber"].youngs_modulus == 1e5
    ball = scene.object[0]
    assert ball.shape.color == (1.0, 128 / 255, 0.0)
    assert ball.rotation[0].axis == (0.0, 0.0, 1.0)
    assert ball.rotation[0].angle == pytest.approx(1.5707963267948966, rel=1e-15)
    assert [thing.alpha_threshold for thing in scene.object] == [1 / 255, 1e-4]
    assert scene.text == SMALL and scene.folder == small.parent


def test_walls_in_the_order_of_the_solver(small):
    assert load(small).domain.walls == [
        ("slip", 0.0),
        ("stick", 0.0),
        ("slip", 0.0),
        ("slip", 0.0),
        ("separate", 0.4),
        ("slip", 0.0),
    ]
    whole = Domain(size=[1, 1, 1], cell=0.1, boundary="stick")
    assert whole.walls == [("stick", 0.0)] * 6


def test_cells_are_counted_not_truncated():
    assert Domain(size=["0.584 m", "0.0584 m", "0.4088 m"], cell="0.0073 m").cells == (80, 8, 56)


def test_phases(small):
    scene = load(small, ["object.pool.phase=brine"])
    ball, pool = scene.object
    assert phase_of(ball, "solid") == "ball"
    assert phase_of(pool, "fluid") == "brine"
    assert phase_of(load(small).object[1], "fluid") == "fluid"


def test_resolved_is_json_and_makes_the_same_scene(small, tmp_path):
    scene = load(small, ["domain.cell=1 cm"])
    resolved = json.loads(json.dumps(scene.to_json()))
    assert resolved["domain"]["cell"] == 0.01 and resolved["output"]["checkpoint_interval"] == 600.0
    assert [object_table().model_validate(item) for item in resolved["object"]] == [*scene.object]
    domain = section_tables()["domain"].model_validate({**resolved["domain"], "boundary": "slip"})
    assert domain.size == (0.64, 0.32, 0.32)


def test_files_below_the_scene_outside_and_from_the_command_line(small, tmp_path, monkeypatch):
    shape = 'shape = { sphere = { center = [0, 0, 0], radius = "4 cm" }, color = "#ff8000" }'
    outside = tmp_path / "elsewhere" / "ball.ply"
    outside.parent.mkdir()
    outside.write_text("x")
    folder = tmp_path / "scene"
    folder.mkdir()
    path = folder / "scene.toml"
    path.write_text(SMALL.replace(shape, 'gaussians = "../elsewhere/ball.ply"'))
    with pytest.raises(SceneError, match="outside the scene's folder"):
        load(path)
    path.write_text("allow_outside = true\n" + path.read_text())
    assert load(path).files == {"ball": outside}
    path.write_text(SMALL.replace(shape, 'gaussians = "assets/ball.ply"'))
    with pytest.raises(SceneError, match="there is no file"):
        load(path)
    assert load(path, [f"object.ball.gaussians={outside}"]).files == {"ball": outside}
    monkeypatch.chdir(outside.parent)  # as the shell completes it
    assert load(path, ["object.ball.gaussians=ball.ply"]).files == {"ball": outside}
    inside = folder / "assets" / "ball.ply"
    inside.parent.mkdir()
    shutil.copy(outside, inside)
    assert load(path).files == {"ball": inside}


def test_a_link_out_of_the_folder_is_outside(small, tmp_path):
    outside = tmp_path / "outside.ply"
    outside.write_text("x")
    folder = tmp_path / "scene"
    folder.mkdir()
    (folder / "link.ply").symlink_to(outside)
    path = folder / "scene.toml"
    shape = 'shape = { sphere = { center = [0, 0, 0], radius = "4 cm" }, color = "#ff8000" }'
    path.write_text(SMALL.replace(shape, 'gaussians = "link.ply"'))
    with pytest.raises(SceneError, match="outside the scene's folder"):
        load(path)


@pytest.mark.parametrize("name", EXAMPLES)
def test_examples_load(name, tmp_path):
    path = ROOT / "runs" / name / "scene.toml"
    assets = tmp_path / "assets"
    things = ASSETS.get(name, {})
    if things:
        script = ROOT / "runs" / "assets" / "make_assets.py"
        words = [sys.executable, script, assets, "--things", *set(things.values())]
        subprocess.run(words, check=True, capture_output=True)
    scene = load(
        path,
        [f'object."{body}".gaussians={assets / thing}.ply' for body, thing in things.items()],
    )
    assert scene.title
    assert (path.parent / "README.md").exists() and (path.parent / "render.toml").exists()


def test_assets_are_the_same_bytes_every_time(tmp_path):
    script = ROOT / "runs" / "assets" / "make_assets.py"
    for name in ("a", "b"):
        subprocess.run([sys.executable, script, tmp_path / name], check=True, capture_output=True)
    first, second = ((tmp_path / name / "duck.ply").read_bytes() for name in ("a", "b"))
    assert first == second and 25_000 < len(first) / 100 < 45_000


def test_reference_is_up_to_date():
    text = (ROOT / "docs" / "reference" / "scene.md").read_text()
    assert text == markdown_reference.scene_reference(), (
        "run: python -m vgmpi.scene > docs/reference/scene.md"
    )
    assert "| `particles_per_cell` |" in text and "kg/m3 (g/cm3" in text


def test_another_spelling_of_color_is_an_unknown_key(small):
    """With a suggestion: in objects, in regions of loads, and by --set."""
    text = small.read_text()
    small.write_text(text.replace("color = ", "colour = "))
    line = text[: text.index("color = ")].count("\n") + 1
    with pytest.raises(SceneError) as caught:
        load(small)
    (said,) = caught.value.lines
    assert said.startswith(f"{small}:{line}: object.ball.") and "colour: unknown key" in said
    assert said.endswith("did you mean 'color'?)")
    small.write_text(text)
    for key, hint in (("object.pool", "(did you mean 'color'?)"), ("domain", "")):
        with pytest.raises(SceneError, match=f"{key}.colour: unknown key") as caught:
            load(small, [f"{key}.colour=1"])
        assert str(caught.value).endswith(hint)
