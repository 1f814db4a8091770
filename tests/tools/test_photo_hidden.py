"""Parts of an object that another one hides: its mask holds them, its colors fill them."""

import numpy as np
import pytest
from PIL import Image

from vgmpi.gaussians.formats import registry
from vgmpi.tools.photo.__main__ import main

pytest.importorskip("cv2", reason="no OpenCV: pip install 'vgmpi[images]'")
Y, X = np.mgrid[:240, :320] + 0.5
DISH = ((X - 160) / 110) ** 2 + ((Y - 140) / 80) ** 2 < 1
BALL = (X - 165) ** 2 + (Y - 120) ** 2 < 45**2
GREEN, RED = np.array((40, 150, 60)), np.array((210, 50, 40))
LAYOUT = """[camera]
pitch = 45
[[object]]
name = "dish"
mask = "dish.png"
reconstruction = "inflate"
height = "5 cm"
[[object]]
name = "ball"
mask = "ball.png"
support = {support}
"""


def write(folder, support):
    rgb = np.where(DISH[..., None], GREEN, (120, 110, 100))
    rgb = np.where(BALL[..., None], RED, rgb).astype(np.uint8)
    Image.fromarray(rgb).save(folder / "photo.png")
    for name, mask in (("dish", DISH), ("ball", BALL)):
        Image.fromarray(np.where(mask, 255, 0).astype(np.uint8)).save(folder / f"{name}.png")
    (folder / "layout.toml").write_text(LAYOUT.format(support=support))
    return [str(folder / "photo.png"), str(folder / "layout.toml"), "-o", str(folder / "out")]


@pytest.mark.parametrize("support", ['"6 cm"', '"dish"'])
def test_what_hides_an_object_does_not_color_it(tmp_path, support, capsys):
    assert main(write(tmp_path, support)) == 0
    share = {}
    for name in ("dish", "ball"):
        color = registry.read(tmp_path / "out" / f"{name}.ply").rgb
        share[name] = float((color[:, 0] > color[:, 1]).mean())
    text = capsys.readouterr().out
    print(f"red: {share}")
    assert share["dish"] < 0.01 and share["ball"] > 0.95
    assert "'dish' and 'ball' share" in text and "the smaller one is taken as in front" in text
