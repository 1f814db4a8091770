"""Every complete scene of the pages runs to its end, with exit code 0.

That of docs/tutorial/python.md runs in tests/api/test_api.py. A scene that is fine and long is run
in coarser cells.
"""

import re
from pathlib import Path

import pytest

from tests.support.foreign_configs import egg
from vgmpi.commands.command_table import main
from vgmpi.io.run_reader import RunReader
from vgmpi.scene.loader import load

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted(ROOT.glob("docs/**/*.md"))]
COARSER = {
    "docs/how-to/paraview-and-blender.md": ["domain.cell=0.02"],
    "docs/reference/scene.md": ["domain.cell=5 cm"],
}


def scenes():
    """Page and text of each fenced block with a domain and an object."""
    return [
        (str(page.relative_to(ROOT)), block)
        for page in PAGES
        for block in re.findall(r"^```toml\n(.*?)^```", page.read_text(), re.M | re.S)
        if "[domain]" in block and "[[object]]" in block
    ]


def test_the_scenes_are_found():
    assert {"README.md", "docs/tutorial/first-scene.md", *COARSER} <= {page for page, _ in scenes()}


@pytest.mark.parametrize("page, text", [pytest.param(*one, id=one[0]) for one in scenes()])
def test_a_scene_of_a_page_runs(tmp_path, page, text):
    for name in re.findall(r'gaussians = "(.*?)"', text):
        egg(tmp_path).rename(tmp_path / name)
    scene, out = tmp_path / "scene.toml", tmp_path / "out"
    scene.write_text(text)
    changes = [word for value in COARSER.get(page, []) for word in ("--set", value)]
    assert main([str(scene), "-q", "-o", str(out), *changes]) == 0
    known, time = RunReader(out), load(scene).time
    assert len(known) == time.frames and known.times[-1] == pytest.approx(time.end)
