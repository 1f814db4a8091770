"""Every feature of the lists can be imported, and no list names one twice."""

import subprocess
import sys
from pathlib import Path

import vgmpi.features
from tests.support.simulate import begin
from vgmpi.scene.scene_feature import FEATURES, SceneFeature, features

SCENE = """
[domain]
size = [0.2, 0.2, 0.2]
cell = 0.02
[time]
end = 0.01
[material.water]
kind = "fluid"
tait_coefficient = 2e4
[[object]]
name = "drop"
material = "water"
shape = { box = [[0.02, 0.02, 0.02], [0.08, 0.08, 0.08]] }
release_time = "1 ms"
[[object]]
name = "paddle"
role = "scenery"
collider = true
shape = { box = [[0.12, 0.12, 0.02], [0.18, 0.18, 0.08]] }
motion = { velocity = [0, 0, 0.1] }
[[outlet]]
name = "drain"
shape = { box = [[0.1, 0, 0], [0.2, 0.02, 0.02]] }
"""
ROOM = Path(vgmpi.features.__file__).parent


def test_features_of_scenes_have_names_of_their_own():
    assert len(features()) == len(FEATURES) == len({each.name for each in features()})
    for folder, feature in zip(FEATURES, features(), strict=True):
        assert isinstance(feature, SceneFeature)
        assert feature.name == folder and feature.title
        keys = [key for other in features() for key in other.object_keys.model_fields]
        assert len(keys) == len(set(keys))


def test_lists_and_keys_of_sections_have_names_of_their_own():
    lists = [name for feature in features() for name in feature.lists]
    assert len(lists) == len(set(lists))
    keys = [
        (section, key)
        for feature in features()
        for section, table in feature.section_keys.items()
        for key in table.model_fields
    ]
    assert len(keys) == len(set(keys))


def test_features_of_a_run_act_in_the_order_of_the_list(tmp_path):
    """Whatever the order in which they plan: prescribed bodies plan first."""
    simulation, _ = begin(tmp_path, SCENE)
    names = ["moving_colliders", "prescribed_motion", "inlets_outlets", "releases", "shifting"]
    assert list(simulation.features) == names
    assert [plan.name for plan in simulation.plan.features] == [names[1], names[0], *names[2:]]


def test_every_folder_is_in_a_list():
    folders = {path.name for path in ROOM.iterdir() if (path / "__init__.py").exists()}
    assert folders == set(FEATURES)


def test_reading_a_scene_compiles_and_plans_nothing():
    """The keys of features are read without what acts in a run."""
    code = (
        "import sys; from vgmpi.scene.loader import load; load('runs/rubber_sheet/scene.toml');"
        "print([m for m in sys.modules if m == 'numba' or m.startswith('vgmpi.planning')])"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOM.parents[1], capture_output=True,
                          text=True)  # fmt: skip
    assert done.stdout.strip() == "[]", done.stderr
