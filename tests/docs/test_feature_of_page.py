"""The feature of docs/developer/extending.md works as it stands there."""

import re

import numpy as np
import pytest

import vgmpi.features
from tests.support.launch import ROOT
from tests.support.simulate import advance, begin
from tests.support.small_scenes import write
from vgmpi.runtime.config.schema import SceneError
from vgmpi.scene import loader, scene_feature
from vgmpi.solver.restart.state_io import by_id

BALL = """
[domain]
size = [0.4, 0.4, 0.4]
cell = 0.02
gravity = [0, 0, 0]
[time]
end = 0.1
[material.rubber]
kind = "elastic"
youngs_modulus = 1e5
[[object]]
name = "ball"
material = "rubber"
shape = { sphere = { center = [0.2, 0.2, 0.2], radius = 0.06 } }
"""


@pytest.fixture
def lift(tmp_path, monkeypatch):
    """The feature in a folder beside the others, for one test."""
    page = (ROOT / "docs/developer/extending.md").read_text()
    code = re.search(r"## A feature\n.*?```python\n(.*?)```", page, re.S)[1]
    folder = tmp_path / "rooms" / "lift"
    folder.mkdir(parents=True)
    (folder / "__init__.py").touch()
    (folder / "feature.py").write_text(code)
    path = [*vgmpi.features.__path__, str(folder.parent)]
    monkeypatch.setattr(vgmpi.features, "__path__", path)
    monkeypatch.setattr(scene_feature, "FEATURES", (*scene_feature.FEATURES, "lift"))
    forget()
    yield
    monkeypatch.undo()
    forget()


def forget() -> None:
    """Read the list of features again."""
    scene_feature.features.cache_clear()
    scene_feature.object_table.cache_clear()


def test_a_body_with_lift_rises_and_one_without_does_not(lift, tmp_path):
    simulation, _ = begin(tmp_path, BALL + 'lift = "2 m/s2"\n')
    assert list(simulation.features) == ["lift"]
    advance(simulation, 0.05)
    (v,) = by_id(simulation, "v")
    np.testing.assert_allclose(v.mean(0), [0.0, 0.0, 2.0 * simulation.time], atol=1e-6)
    simulation, _ = begin(tmp_path, BALL)
    assert not simulation.features


def test_scenery_has_no_lift(lift, tmp_path):
    text = BALL + '[[object]]\nname = "wall"\nrole = "scenery"\nlift = 1\n'
    text += "shape = { box = [[0, 0, 0], [0.1, 0.1, 0.1]] }\n"
    with pytest.raises(SceneError, match="object.wall.lift: is not for scenery"):
        loader.load(write(tmp_path, text))


def test_without_the_name_in_the_list_the_key_is_unknown(tmp_path):
    with pytest.raises(SceneError, match="object.ball.lift: unknown key"):
        loader.load(write(tmp_path, BALL + "lift = 1\n"))
