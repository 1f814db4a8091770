"""[picture] floor = {...} of render.toml: from the file to the picture, and its mistakes."""

import imageio.v3 as iio
import numpy as np
import pytest

from tests.support import drawn_runs
from vgmpi.postprocess.commands import render
from vgmpi.postprocess.frames import render_config

CAMERA = '[camera]\nkind = "fixed"\neye = [0.5, -2.5, 1.8]\ntarget = [0.5, 0.5, 0.2]\n'
SMALL = "[picture]\nwidth = 96\nheight = 80\n"
MAGENTA = "background = '#ff00ff'\n"


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    return drawn_runs.write(tmp_path_factory.mktemp("run") / "out", frames=2)


def picture(out, folder, text):
    (folder / "render.toml").write_text(drawn_runs.on_paper(CAMERA + SMALL + text))
    path = folder / "a.png"
    assert render.main([str(out), str(folder / "render.toml"), "-o", str(path), "-q"]) == 0
    return iio.imread(path).astype(int)


def test_a_floor_takes_the_place_of_the_background_and_carries_a_shadow(out, tmp_path):
    light = "light = [0.6, -0.2, -1]"
    key = f"{{ height = -0.3, color = '#80ff80', {light}, shadow = %s }}"
    floor = f"{MAGENTA}floor = {key}\n"
    lit, dark = (picture(out, tmp_path, floor % strength) for strength in (0, 0.8))
    plain = picture(out, tmp_path, MAGENTA)
    magenta = (plain == (255, 0, 255)).all(axis=-1)
    green = (lit == (128, 255, 128)).all(axis=-1)
    assert green.sum() > 500 and (magenta | ~green).all()  # only where nothing was drawn
    shaded = green & (dark[..., 1] < 150)
    assert 50 < shaded.sum() < 0.6 * green.sum()
    np.testing.assert_allclose(dark[shaded][:, 0] / dark[shaded][:, 1], 128 / 255, atol=0.03)


def test_squares_and_supersampling(out, tmp_path):
    key = "{ height = -0.3, checker_size = 0.2, checker_color = [0, 0, 0], shadow = 0 }"
    got = picture(out, tmp_path, f"supersample = 2\nfloor = {key}\n")
    near = got[-8:, :, 0]  # nearest to the camera, where squares are many pixels wide
    assert (near < 10).any() and (np.abs(near - 217) < 3).any()
    assert ((near > 30) & (near < 200)).any()  # edges are means


@pytest.mark.parametrize(
    "text, says",
    [
        ("floor = { light = [0, 0, 1] }", "points down"),
        ("floor = { color = 'red.png' }", "such as '#6fb7d6'"),
        ("floor = { shadow = 2 }", "less than or equal to 1"),
        ("floor = { checker_size = 0 }", "greater than 0"),
        ("floor = {}\nbackground = 'none'", "transparent"),
        ("floor = { heigth = 1 }", "picture.floor.heigth: unknown key"),
        ("floor = { heigth = 1 }", "did you mean 'height'"),
    ],
)
def test_mistakes_are_named_with_their_line(tmp_path, text, says):
    file = tmp_path / "render.toml"
    file.write_text("[picture]\n" + text)
    with pytest.raises(render_config.SettingsError) as caught:
        render_config.load(file)
    (said,) = caught.value.lines
    assert says in said and said.startswith(f"{file}:") and "\n" not in said


def test_over_a_picture_a_floor_is_its_shadow(out, tmp_path):
    """Unless it has a color; elsewhere the photograph stays as it is."""
    photograph = np.random.default_rng(2).integers(60, 255, (80, 96, 3), dtype=np.uint8)
    iio.imwrite(tmp_path / "photo.png", photograph)
    behind = "background = 'photo.png'\nfloor = { height = -0.3, light = [0.6, -0.2, -1], %s }\n"
    plain = picture(out, tmp_path, behind.partition("\n")[0] + "\n")
    dark = picture(out, tmp_path, behind % "shadow = 0.8")
    assert (dark == plain).all(axis=-1).mean() > 0.3
    nothing = (plain == photograph).all(axis=-1)  # drawn over it
    shaded = nothing & (dark[..., 1] < 0.5 * plain[..., 1])
    assert shaded.sum() > 50
    ratio = dark[shaded] / plain[shaded]
    assert np.ptp(ratio, axis=1).max() < 0.03  # darker, of the same color
    grey = picture(out, tmp_path, behind % "shadow = 0, color = '#80ff80'")
    assert (grey == (128, 255, 128)).all(axis=-1).sum() > 500
