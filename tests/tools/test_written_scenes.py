"""Scenes that `vgmpi photo` and `vgmpi convert` write run to their end, with exit code 0.

Scenes of the documentation: tests/docs/test_scenes_of_pages.py.
"""

import json
import re
import tomllib

import pytest

from tests.support.foreign_configs import BOX, ONE, egg, several
from vgmpi.commands.command_table import main as vgmpi_main
from vgmpi.io.run_reader import RunReader
from vgmpi.tools.photo import example_photographs


def run_to_end(scene, *flags):
    """Run a scene; return the least height of its particles above the floor [cells]."""
    assert vgmpi_main([str(scene), "-q", *flags]) == 0
    known, keys = RunReader(scene.parent / "out"), tomllib.loads(scene.read_text())
    cell, time = keys["domain"]["cell"], keys["time"]
    assert len(known) == time["frames"] and known.times[-1] == pytest.approx(time["end"])
    return min(known.frame(k)["positions"][:, 2].min() for k in range(len(known))) / cell


# dB of the worst object and of the whole picture
AGREEMENT = {
    "coffee": (26, 29), "chelsea": (35, 35), "rocket": (25, 35), "milk": (32, 40),
    "tower": (31, 42), "balls": (31, 42),
}  # fmt: skip


@pytest.mark.parametrize("name", example_photographs.SUMMARIES)
def test_an_example_of_photographs_runs(tmp_path, name, capfd):
    """It looks like its photograph, and runs in coarse cells for 0.2 s."""
    pytest.importorskip("cv2", reason="no OpenCV: pip install 'vgmpi[images]'")
    if not (example_photographs.FOLDER / name / "photo.jpg").exists():
        pytest.importorskip("skimage", reason="scikit-image has the photograph")
    _, layout = example_photographs.write_example(name, tmp_path)
    text = layout.read_text()
    for key, value in {"end": '"0.2 s"', "frames": "5", "cells": "24"}.items():
        text, count = re.subn(rf"^{key} = [^#\n]*", f"{key} = {value}", text, flags=re.M)
        assert count == 1, key
    layout.write_text(text)
    assert vgmpi_main(["photo", "--demo", name, "-o", str(tmp_path)]) == 0  # with that layout
    agreement = [float(v) for v in re.findall(r"to ([\d.]+) dB", capfd.readouterr().out)]
    *inside, total = agreement
    assert len(inside) == len(tomllib.loads((tmp_path / "scene.toml").read_text())["object"])
    print(name, agreement)
    assert min(inside) > AGREEMENT[name][0] and total > AGREEMENT[name][1]
    assert run_to_end(tmp_path / "scene.toml") > -0.1


WALLS = {"boundary_conditions": [BOX]}
ON_THE_FLOOR = {
    "type": "surface_collider", "point": [1, 1, 0.5], "normal": [0, 0, 1], "surface": "separate",
    "friction": 0.3, "start_time": 0, "end_time": 1e3,
}  # fmt: skip
HIGH = {"center_point": [2, 2, 2.4]}
CONFIGS = {
    "PhysGaussian, jelly": ONE | {"boundary_conditions": [ON_THE_FLOOR]},
    "PhysGaussian, sand": ONE | {"material": "sand", "friction_angle": 30} | WALLS,
    "PhysGaussian, metal": ONE | {"material": "metal", "yield_stress": 1e3} | WALLS,
    "PhysGaussian, no walls": ONE,
    "VersaGauss, two bodies": several(({}, {}), ({"material": "sand"}, HIGH), **WALLS),
}


@pytest.mark.parametrize("name", CONFIGS)
def test_a_converted_configuration_runs(tmp_path, name):
    config, scene = tmp_path / "config.json", tmp_path / "scene.toml"
    config.write_text(json.dumps(CONFIGS[name]))
    bodies = [str(egg(tmp_path))] * CONFIGS[name].get("object_num", 1)
    words = ["convert", str(config), "-o", str(scene)]
    assert vgmpi_main([*words, *(word for path in bodies for word in ("--gaussians", path))]) == 0
    assert run_to_end(scene) > -0.1
