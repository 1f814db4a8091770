"""A body out of which others are cut, pushed along walls by a plate: the same bits in every file
for any number of ranks, and after a restart."""

import pytest

from tests.support.file_digests import assert_same_files, digests, frame_digests, run_on_one_rank
from tests.support.simulated_runs import run_here
from vgmpi.io.run_reader import RunReader

SCENE = """
[domain]
size = [0.4, 0.16, 0.16]
cell = 0.02
boundary = { default = { kind = "separate", friction = 0.5 } }
[time]
end = 0.1
frames = 3
[output]
checkpoint_interval_steps = 40
[material.sand]
kind = "sand"
[[object]]
name = "bed"
material = "sand"
subtract = true
shape = { box = [[0, 0, 0], [0.4, 0.16, 0.08]] }
[[object]]
name = "plate"
role = "scenery"
collider = true
shape = { box = [[0.02, -0.08, -0.08], [0.08, 0.24, 0.24]] }
motion = { velocity = [0.6, 0, 0], end_time = "0.1 s" }
[[object]]
name = "post"
role = "scenery"
collider = true
shape = { box = [[0.22, 0.06, -0.1], [0.28, 0.1, 0.12]] }
"""


@pytest.fixture(scope="module")
def one(tmp_path_factory):
    folder = tmp_path_factory.mktemp("subtract")
    return *run_on_one_rank(folder, SCENE), folder / "one"


def test_what_is_cut_out(one):
    """40 x 16 x 8 lattice points of 1 cm3, less those in the plate and the post."""
    files = RunReader(one[2])
    assert files.particle_count(0) == files.particle_count(2) == 8 * (40 * 16 - 6 * 16 - 6 * 4)


def test_three_ranks(one, tmp_path):
    scene, want, _ = one
    assert_same_files(scene, want, tmp_path, run_here, 3)


def test_stop_and_resume(one, tmp_path):
    scene, want, out = one
    stop = RunReader(out).time_and_step(2)[1] // 2
    run_here(scene, tmp_path, 3, "--stop-after", f"{stop} steps", code=75)
    run_here(scene, tmp_path, 2, "--resume")
    assert frame_digests(digests(tmp_path)) == frame_digests(want)
