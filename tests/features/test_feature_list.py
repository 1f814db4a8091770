"""Every feature of the lists can be imported, and no list names one twice."""

import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

import vgmpi.features
from vgmpi.features import start_features
from vgmpi.scene.scene_feature import FEATURES, SceneFeature, features

ROOM = Path(vgmpi.features.__file__).parent
STARTS = start_features.STARTS


def test_features_of_scenes_have_names_of_their_own():
    assert len(features()) == len(FEATURES) == len({each.name for each in features()})
    for folder, feature in zip(FEATURES, features(), strict=True):
        assert isinstance(feature, SceneFeature)
        assert feature.name == folder and feature.title and not set(STARTS) & {folder}
        keys = [key for other in features() for key in other.object_keys.model_fields]
        assert len(keys) == len(set(keys))


def test_features_of_a_run_act_in_the_order_of_the_list():
    order = start_features.order_of_features()
    assert len(set(order)) == len(order)
    places = [order.index(name) for name in FEATURES]
    assert places == sorted(places)
    assert [name for name in order if name in start_features.STARTS] == list(start_features.STARTS)


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


@pytest.mark.parametrize("name", STARTS)
def test_a_feature_of_a_run_has_a_function_that_starts_it(name):
    module, function, _ = STARTS[name]
    assert callable(getattr(import_module(f"vgmpi.features.{module}"), function))


def test_every_folder_is_in_a_list():
    folders = {path.name for path in ROOM.iterdir() if (path / "__init__.py").exists()}
    assert folders == {*FEATURES, *(module.split(".")[0] for module, *_ in STARTS.values())}


def test_reading_a_scene_compiles_and_plans_nothing():
    """The keys of features are read without what acts in a run."""
    code = (
        "import sys; from vgmpi.scene.loader import load; load('runs/rubber_sheet/scene.toml');"
        "print([m for m in sys.modules if m == 'numba' or m.startswith('vgmpi.planning')])"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOM.parents[1], capture_output=True,
                          text=True)  # fmt: skip
    assert done.stdout.strip() == "[]", done.stderr
