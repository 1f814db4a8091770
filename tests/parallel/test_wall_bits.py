"""Bodies at walls that let go have the same bits on any number of ranks and threads.

They leave walls without a kind, or are pressed against one that pushes them by contact.
"""

import pytest

from tests.support.file_digests import assert_same_files, run_on_one_rank

pytestmark = pytest.mark.mpi

SCENE = """
[domain]
size = [0.36, 0.2, 0.22]
cell = 0.02
gravity_keyframes = [
    { time = 0.02, gravity = [0, 0, -9.8] }, { time = 0.021, gravity = [0, 4, 9.8] },
]
[time]
end = 0.1
frames = 3
[material.jelly]
kind = "elastic"
youngs_modulus = 2e4
[material.grains]
kind = "sand"
[[object]]
name = "cube"
material = "jelly"
velocity = [0.5, 0, 0.4]
shape = { box = [[0.02, 0.02, 0], [0.16, 0.16, 0.1]] }
[[object]]
name = "heap"
material = "grains"
velocity = [0.2, -0.5, 0]
shape = { box = [[0.22, 0, 0], [0.32, 0.12, 0.06]] }
"""
PRESSED = """
[domain]
size = [0.36, 0.3, 0.2]
cell = 0.02
boundary = { default = "open", bottom = { kind = "separate", friction = 0.4 } }
[time]
end = 0.02
frames = 3
[material.rubber]
kind = "elastic"
youngs_modulus = 1e6
[[object]]
name = "pebble"
material = "rubber"
velocity = [1, 0, -4]
shape = { ellipsoid = { center = [0.17, 0.15, 0.08], radii = [0.1, 0.1, 0.06] } }
"""


@pytest.fixture(scope="module", params=[SCENE, PRESSED], ids=["leave", "pressed"])
def one(request, tmp_path_factory):
    return run_on_one_rank(tmp_path_factory.mktemp("walls"), request.param)


@pytest.mark.parametrize("ranks, flags", [(2, []), (3, []), (1, ["--threads", "2"])])
def test_any_ranks_and_threads(one, tmp_path, ranks, flags):
    assert_same_files(*one, tmp_path / "out", ranks, *flags)
