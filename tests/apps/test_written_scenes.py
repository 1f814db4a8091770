"""Scenes that `vgmpi photo` writes run to their end, with exit code 0.

Scenes of the documentation: tests/docs/test_scenes_of_pages.py.
"""

import tomllib

import pytest
from PIL import Image

from tests.support import drawn_photograph
from vgmpi.apps.commands import main as vgmpi_main
from vgmpi.io.run_reader import RunReader

LAYOUT = """
[camera]
fov = {fov}
pitch = {pitch}
[scene]
end = "0.2 s"
frames = 5
cells = 24
[[object]]
name = "it"
box = {box}
{form}
height = "10 cm"
material = "{material}"
{support}
"""
IN_THE_AIR = 'support = "6 cm"'


def run_to_end(scene, *flags):
    """Run a scene; return the least height of its particles above the floor [cells]."""
    assert vgmpi_main([str(scene), "-q", *flags]) == 0
    known, keys = RunReader(scene.parent / "out"), tomllib.loads(scene.read_text())
    cell, time = keys["domain"]["cell"], keys["time"]
    assert len(known) == time["frames"] and known.times[-1] == pytest.approx(time["end"])
    return min(known.frame(k)["positions"][:, 2].min() for k in range(len(known))) / cell


@pytest.mark.parametrize(
    "thing, material, support",
    [(0, "jelly", ""), (1, "rubber", IN_THE_AIR)],
)
def test_a_photograph_becomes_a_scene_that_runs(tmp_path, thing, material, support):
    """A soft body stands on the floor, or falls onto it, and does not sink through it."""
    pytest.importorskip("cv2", reason="no OpenCV: pip install 'vgmpi[images]'")
    view = drawn_photograph.VIEW
    drawn = drawn_photograph.drawing.draw(
        [drawn_photograph.THINGS[thing]], view, drawn_photograph.EYE
    )
    Image.fromarray(drawn.rgb).save(tmp_path / "photo.png")
    box = [int(edge) for edge in drawn_photograph.around(drawn.masks[0])]
    form = drawn_photograph.FORMS[thing]
    (tmp_path / "layout.toml").write_text(
        LAYOUT.format(
            fov=view.fov, pitch=view.pitch, box=box, form=form, material=material, support=support
        )
    )
    folder = tmp_path / "scene"
    words = ["photo", str(tmp_path / "photo.png"), str(tmp_path / "layout.toml")]
    assert vgmpi_main([*words, "-o", str(folder)]) == 0
    assert run_to_end(folder / "scene.toml") > -0.1
