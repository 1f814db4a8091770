"""Sizes of files that --plan tells, held against the files of a run."""

import h5py
import pytest

import vgmpi
from vgmpi.planning.cost.plan_report import checkpoint_bytes, file_size_line, frame_bytes
from vgmpi.preprocess.scene_builder import build_scene
from vgmpi.solver.initial_particles import known_of, plan_for

SCENE = """
[accuracy]
pressure = "explicit"
[domain]
size = [0.32, 0.16, 0.16]
cell = 0.01

[time]
end = 0.02
frames = 3

[output]
fields = [FIELDS]

[appearance]
color_transfer = "TRANSFER"

[material.water]
kind = "fluid"
max_speed = 2.0

[material.rubber]
kind = "elastic"
density = 900
youngs_modulus = 1e5

[[object]]
name = "pool"
material = "water"
shape = { box = [[0, 0, 0], [0.2, 0.16, 0.06]] }

[[object]]
name = "BODY"
material = "BODY"
shape = { sphere = { center = [0.25, 0.08, 0.1], radius = 0.04 } }
"""


def stored_bytes(path, particles: int) -> int:
    """Bytes of the datasets of a frame that have a row per particle."""
    sizes = []

    def add(_, item):
        if isinstance(item, h5py.Dataset) and item.shape and item.shape[0] >= particles:
            sizes.append(item.id.get_storage_size())

    with h5py.File(path) as file:
        file.visititems(add)
    return sum(sizes)


@pytest.mark.parametrize("body", ["water", "rubber"])
@pytest.mark.parametrize("fields", ["", '"velocity", "J", "F"', '"stress", "strain", "pressure"'])
@pytest.mark.parametrize("transfer", ["off", "step"])
def test_files_have_the_size_that_the_plan_tells(tmp_path, body, fields, transfer):
    text = SCENE.replace("FIELDS", fields).replace("BODY", body).replace("TRANSFER", transfer)
    (tmp_path / "scene.toml").write_text(text)
    scene = vgmpi.load(tmp_path / "scene.toml")
    prepared = build_scene(scene)
    plan = plan_for(scene, known_of(scene, prepared))
    out, count = tmp_path / "out", len(prepared.x)
    assert vgmpi.run(scene, out).code == 0
    frame = stored_bytes(out / "frames" / "frame_00001.vtkhdf", count)
    assert frame_bytes(scene, plan) == frame - 4  # a table of VTK has a row more
    (checkpoint,) = (out / "checkpoints").glob("*.h5")
    fixed = 60_000  # [bytes] tables of blocks, names, attributes
    assert 0 <= checkpoint.stat().st_size - checkpoint_bytes(plan) < fixed < count * 40
    assert "disk        3 frames of " in file_size_line(scene, plan)
