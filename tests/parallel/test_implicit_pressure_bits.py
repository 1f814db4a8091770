"""An implicit pressure has the same bits in every file for any number of ranks and threads, and
after a restart."""

import numpy as np
import pytest

from tests.support.file_digests import (
    RANKS_AND_THREADS,
    assert_same_after_stop,
    assert_same_files,
    run_on_one_rank,
)
from tests.support.simulate import advance, begin, by_id
from tests.support.simulated_runs import run_here
from vgmpi.features.implicit_pressure import pressure_solver
from vgmpi.features.implicit_pressure.kernels import relaxation

# two columns that meet: both halves of the tank have moving blocks, and ranks exchange cells
SCENE = """
[domain]
size = [0.48, 0.16, 0.32]
cell = 0.02
boundary = { default = "slip", west = "stick" }
[time]
end = 0.2
frames = 3
[accuracy]
pressure = "implicit"
precision = "PRECISION"
[material.water]
kind = "fluid"
max_speed = 2
viscosity = 0.01
[[object]]
name = "left"
material = "water"
subtract = true
shape = { box = [[0, 0, 0], [0.14, 0.16, 0.24]] }
[[object]]
name = "right"
material = "water"
shape = { box = [[0.36, 0, 0], [0.48, 0.1, 0.2]] }
velocity = [-0.3, 0, 0]
subtract = true
[[object]]
name = "paddle"
role = "scenery"
collider = true
shape = { box = [[0.2, 0.04, -0.1], [0.26, 0.12, 0.1]] }
motion = { axis = [1, 2, 0], keyframes = [
  { time = "60 ms", translation = [-0.03, 0, 0] },
  { time = "155 ms", translation = [0.01, 0, 0.02], angle = "25 deg" },
] }
[[object]]
name = "post"
role = "scenery"
collider = true
shape = { cylinder = { endpoints = [[0.4, 0.1, -0.1], [0.4, 0.1, 0.5]], radius = 0.03 } }
[[probe]]
name = "push"
collider = "paddle"
sampling_rate = "100 Hz"
[[probe]]
name = "floor"
wall = "bottom"
sampling_rate = "100 Hz"
"""

# bodies that float, sink and hang from joints, a jet, walls that let go and open ones, and drops
# above the pool: ranks have nodes with liquid next to cells with pressure of other ranks
BODIES = """
[domain]
size = [0.48, 0.16, 0.40]
cell = 0.02
boundary = { default = "slip", bottom = { kind = "separate", friction = 0.4 }, east = "open" }
[time]
end = 0.15
frames = 3
[accuracy]
pressure = "implicit"
[material.water]
kind = "fluid"
max_speed = 2
[material.wood]
kind = "elastic"
density = 300
youngs_modulus = "1 MPa"
[[object]]
name = "pool"
material = "water"
subtract = true
shape = { box = [[0, 0, 0], [0.44, 0.16, 0.16]] }
[[object]]
name = "drops"
material = "water"
subtract = true
shape = { box = [[0.1, 0.04, 0.2], [0.4, 0.1, 0.24]] }
velocity = [0, 0, -1]
[[object]]
name = "block"
material = "wood"
rigid = true
rotation = { axis = [1, 1, 0], angle = "20 deg" }
position = [0.1, 0.08, 0.1]
shape = { box = [[-0.05, -0.04, -0.04], [0.05, 0.04, 0.04]] }
[[object]]
name = "paddle"
material = "wood"
rigid = true
shape = { box = [[0.24, 0.04, 0.02], [0.29, 0.12, 0.2]] }
[[object]]
name = "arm"
material = "wood"
rigid = true
shape = { box = [[0.3, 0.04, 0.12], [0.4, 0.12, 0.18]] }
[[inlet]]
name = "pipe"
material = "water"
disc = { center = [0.2, 0.08, 0.36], radius = 0.03 }
direction = [0, 0, -1]
volume_flow_rate = "4 l/s"
[[joint]]
kind = "hinge"
between = ["paddle"]
at = [0.26, 0.08, 0.18]
axis = "y"
[[joint]]
kind = "ball"
between = ["arm", "paddle"]
at = [0.295, 0.08, 0.15]
"""


# the same in oil that sticks to the block and to the arm
STICKING = (
    BODIES.replace("max_speed = 2", "max_speed = 2\nviscosity = 2")
    .replace('name = "block"', 'name = "block"\nslip_length = 0')
    .replace('name = "arm"', 'name = "arm"\nslip_length = 0.01')
)


# a pool of oil and brine in one velocity field, water that mixes with dye, and a falling drop of
# oil of its own: nodes have one to four liquids, and ranks different ones
LIQUIDS = """
[domain]
size = [0.48, 0.16, 0.40]
cell = 0.02
boundary = { default = "slip", bottom = "separate", west = "stick" }
[time]
end = 0.12
frames = 3
[accuracy]
pressure = "implicit"
[material.oil]
kind = "fluid"
density = 800
max_speed = 1
[material.brine]
kind = "fluid"
density = 1200
max_speed = 2
[material.water]
kind = "fluid"
max_speed = 2
viscosity = 0.01
[material.dye]
kind = "fluid"
density = 1100
max_speed = 2
[[coupling]]
kind = "mixing"
between = ["water", "dye"]
diffusivity = 1e-3
slip_relaxation_time = "10 ms"
[[object]]
name = "oil"
material = "oil"
shape = { box = [[0, 0, 0.08], [0.24, 0.16, 0.16]] }
[[object]]
name = "brine"
material = "brine"
shape = { box = [[0, 0, 0], [0.24, 0.16, 0.08]] }
[[object]]
name = "water"
material = "water"
shape = { box = [[0.24, 0, 0], [0.48, 0.16, 0.1]] }
[[object]]
name = "dye"
material = "dye"
shape = { box = [[0.3, 0, 0.1], [0.48, 0.16, 0.2]] }
[[object]]
name = "drop"
material = "oil"
phase = "drop"
velocity = [0, 0, -1]
shape = { sphere = { center = [0.24, 0.08, 0.24], radius = 0.04 } }
[[object]]
name = "post"
role = "scenery"
collider = true
shape = { cylinder = { endpoints = [[0.4, 0.1, -0.1], [0.4, 0.1, 0.5]], radius = 0.03 } }
[[probe]]
name = "floor"
wall = "bottom"
sampling_rate = "100 Hz"
"""


# oil that sticks to a paddle and slips on a post, over a thin floor with air below
ADHESION = (
    SCENE.replace("PRECISION", "single")
    .replace('west = "stick"', 'west = "stick", bottom = "open"')
    .replace("viscosity = 0.01", "viscosity = 5")
    .replace('name = "paddle"', 'name = "paddle"\nslip_length = 0')
    .replace("[[0.2, 0.04, -0.1], [0.26, 0.12, 0.1]]", "[[0.2, 0.04, 0.11], [0.26, 0.12, 0.2]]")
    .replace('name = "post"', 'name = "post"\nslip_length = 0.01')
    .replace("[[probe]]", """[[object]]
name = "floor"
role = "scenery"
collider = true
slip_length = 0
shape = { box = [[-0.1, -0.1, 0], [0.6, 0.3, 0.05]] }
[[probe]]""", 1)
)  # fmt: skip
# the same with an implicit viscosity, to which forces are unknown
STUCK = ADHESION[: ADHESION.index("[[probe]]")].replace(
    'pressure = "implicit"', 'pressure = "implicit"\nviscosity = "implicit"'
).replace("slip_length = 0.01", "slip_length = 0")  # fmt: skip


# a ball and a plank of rubber that float, meet each other, a rigid body and a post, and a block of
# snow on a separating wall: ranks have water at nodes whose solids are another rank's
SOLIDS = """
[domain]
size = [0.48, 0.16, 0.40]
cell = 0.02
boundary = { default = "slip", bottom = { kind = "separate", friction = 0.4 } }
[time]
end = 0.12
frames = 3
[accuracy]
pressure = "implicit"
[material.water]
kind = "fluid"
max_speed = 2
[material.rubber]
kind = "elastic"
density = 400
youngs_modulus = "0.1 MPa"
[material.snow]
kind = "snow"
density = 400
youngs_modulus = "60 kPa"
[[object]]
name = "pool"
material = "water"
subtract = true
velocity = [0.5, 0, 0]
shape = { box = [[0, 0, 0], [0.4, 0.16, 0.14]] }
[[object]]
name = "ball"
material = "rubber"
velocity = [0, 0, -1]
shape = { sphere = { center = [0.12, 0.08, 0.19], radius = 0.045 } }
[[object]]
name = "plank"
material = "rubber"
velocity = [-1, 0, 0]
shape = { box = [[0.18, 0.04, 0.12], [0.28, 0.12, 0.17]] }
[[object]]
name = "block"
material = "rubber"
rigid = true
shape = { box = [[0.3, 0.04, 0.06], [0.36, 0.12, 0.18]] }
[[object]]
name = "heap"
material = "snow"
shape = { box = [[0.42, 0, 0], [0.48, 0.16, 0.1]] }
[[object]]
name = "post"
role = "scenery"
collider = true
shape = { cylinder = { endpoints = [[0.05, 0.1, -0.1], [0.05, 0.1, 0.5]], radius = 0.03 } }
[[probe]]
name = "floor"
wall = "bottom"
sampling_rate = "100 Hz"
"""


# water runs against a plank across the tank that the world and a post hold, and one that lets go
PINNED = """
[domain]
size = [0.48, 0.16, 0.40]
cell = 0.02
boundary = "slip"
[time]
end = 0.12
frames = 3
[accuracy]
pressure = "implicit"
[material.water]
kind = "fluid"
max_speed = 2
[material.rubber]
kind = "elastic"
density = 400
youngs_modulus = "0.1 MPa"
[[object]]
name = "pool"
material = "water"
subtract = true
velocity = [0.5, 0, 0]
shape = { box = [[0, 0, 0], [0.48, 0.16, 0.14]] }
[[object]]
name = "plank"
material = "rubber"
shape = { box = [[0.06, 0.04, 0.08], [0.42, 0.12, 0.17]] }
pinned = [{ box = [[0.06, 0, 0], [0.14, 0.16, 0.4]] },
  { box = [[0.36, 0, 0], [0.44, 0.16, 0.4]], to = "post" }]
[[object]]
name = "flap"
material = "rubber"
shape = { box = [[0.2, 0.04, 0.22], [0.28, 0.12, 0.3]] }
pinned = { box = [[0.2, 0, 0.27], [0.3, 0.16, 0.3]], release_time = 0.05 }
[[object]]
name = "post"
role = "scenery"
collider = true
shape = { box = [[0.38, 0.06, -0.1], [0.42, 0.1, 0.14]] }
[[probe]]
name = "grip"
collider = "plank"
sampling_rate = "100 Hz"
"""


# water runs into a bank of coarse sand on fine sand, dry and wet, with a ball of rubber on it:
# ranks have water at nodes whose grains are another rank's
SEEPAGE = """
[domain]
size = [0.48, 0.16, 0.40]
cell = 0.02
boundary = { default = "slip", bottom = { kind = "separate", friction = 0.4 } }
[time]
end = 0.12
frames = 3
[accuracy]
pressure = "implicit"
[material.water]
kind = "fluid"
max_speed = 2
[material.coarse]
kind = "sand"
youngs_modulus = "0.2 MPa"
[material.fine]
kind = "sand"
porosity = 0.35
cohesion = 100
youngs_modulus = "0.2 MPa"
[material.rubber]
kind = "elastic"
density = 400
youngs_modulus = "0.1 MPa"
[[coupling]]
kind = "drag"
between = ["water", "coarse"]
hydraulic_conductivity = 1e-2
[[coupling]]
kind = "drag"
between = ["water", "fine"]
hydraulic_conductivity = 1e-5
[[object]]
name = "water"
material = "water"
velocity = [1, 0, 0]
shape = { box = [[0, 0, 0], [0.2, 0.16, 0.2]] }
[[object]]
name = "pores"
subtract = ["post"]
material = "water"
volume_fraction = 0.4
shape = { box = [[0.28, 0, 0.08], [0.4, 0.16, 0.16]] }
[[object]]
name = "bank"
subtract = ["post"]
material = "coarse"
phase = "coarse"
shape = { box = [[0.22, 0, 0.08], [0.4, 0.16, 0.2]] }
[[object]]
name = "ground"
subtract = ["post"]
material = "fine"
phase = "fine"
shape = { box = [[0.22, 0, 0], [0.48, 0.16, 0.08]] }
[[object]]
name = "ball"
material = "rubber"
velocity = [0, 0, -1]
shape = { sphere = { center = [0.3, 0.08, 0.24], radius = 0.04 } }
[[object]]
name = "post"
role = "scenery"
collider = true
shape = { cylinder = { endpoints = [[0.4, 0.1, -0.1], [0.4, 0.1, 0.5]], radius = 0.03 } }
[[probe]]
name = "floor"
wall = "bottom"
sampling_rate = "100 Hz"
"""


# a plate that is lifted off a pool, a plank that leaves it, and water that lets go of a roof, in
# thin air: cells open beside all of them and within the water
SUCTION = """
[domain]
size = [0.48, 0.16, 0.40]
cell = 0.02
ambient_pressure = 400
[time]
end = 0.12
frames = 3
[accuracy]
pressure = "implicit"
[material.water]
kind = "fluid"
max_speed = 2
[material.wood]
kind = "elastic"
density = 600
youngs_modulus = "1 MPa"
[[object]]
name = "pool"
material = "water"
subtract = true
shape = { box = [[0, 0, 0], [0.48, 0.16, 0.16]] }
[[object]]
name = "below the roof"
material = "water"
shape = { box = [[0.02, 0, 0.24], [0.22, 0.16, 0.34]] }
[[object]]
name = "roof"
role = "scenery"
collider = true
shape = { box = [[-0.1, -0.1, 0.34], [0.6, 0.3, 0.5]] }
[[object]]
name = "plate"
role = "scenery"
collider = true
shape = { box = [[0.06, 0.02, 0.13], [0.2, 0.12, 0.19]] }
motion = { keyframes = [{ time = "20 ms" }, { time = "120 ms", translation = [0, 0, 0.08] }] }
[[object]]
name = "plank"
material = "wood"
rigid = true
velocity = [0, 0, 1.5]
shape = { box = [[0.28, 0.03, 0.11], [0.44, 0.13, 0.17]] }
[[probe]]
name = "lift"
collider = "plate"
sampling_rate = "100 Hz"
"""


# snow that ends in blocks of which the water on another rank has nodes, without a row of the snow
APART = """
[domain]
size = [0.8, 0.24, 0.4]
cell = 0.04
[time]
end = 0.1
frames = 2
[accuracy]
pressure = "implicit"
[material.water]
kind = "fluid"
max_speed = 2.5
[material.snow]
kind = "snow"
density = 400
youngs_modulus = "60 kPa"
[[object]]
name = "water"
material = "water"
shape = { box = [[0, 0, 0], [0.26, 0.24, 0.26]] }
[[object]]
name = "wall"
material = "snow"
shape = { box = [[0.48, 0.02, 0], [0.58, 0.22, 0.14]] }
"""


# by name: the scene, and the step after which it stops and goes on
SCENES = {
    "suction": (SUCTION, 9),
    "several liquids": (LIQUIDS, 9),
    "adhesion": (ADHESION, 11),
    "adhesion with implicit viscosity": (STUCK, 11),
    "bodies and walls": (BODIES, 9),
    "bodies that oil sticks to": (STICKING, 9),
    "deformable solids": (SOLIDS, 11),
    "pinned parts": (PINNED, 11),
    "sand with drag": (SEEPAGE, 11),
    "snow apart from water": (APART, 9),
}


@pytest.fixture(scope="module", params=SCENES)
def scene_of(request, tmp_path_factory):
    text, stop = SCENES[request.param]
    return run_on_one_rank(tmp_path_factory.mktemp("scene"), text), stop


@RANKS_AND_THREADS
def test_scenes_on_any_ranks_and_threads(scene_of, tmp_path, start, ranks, flags):
    run, _ = scene_of
    assert_same_files(*run, tmp_path / "out", start, ranks, *flags)


def test_scenes_after_a_restart(scene_of, tmp_path):
    run, stop = scene_of
    assert_same_after_stop(*run, tmp_path / "out", stop)


def test_ranks_without_nodes_on_a_separating_wall(tmp_path):
    """A deep pool: the upper ranks do what the others do there, too."""
    text = SCENE[: SCENE.index("[[object]]")].replace("PRECISION", "single")
    text = text.replace("0.32]", "1.28]").replace('west = "stick"', 'bottom = "separate"')
    text = text.replace("0.48", "0.16").replace("end = 0.2", "end = 0.02")
    text += """
[[object]]
name = "pool"
material = "water"
shape = { box = [[0, 0, 0], [0.16, 0.16, 1.2]] }
"""
    assert_same_files(*run_on_one_rank(tmp_path, text), tmp_path / "out", run_here, 4)


@pytest.fixture(scope="module", params=["single", pytest.param("double", marks=pytest.mark.slow)])
def one(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp("implicit")
    return run_on_one_rank(folder, SCENE.replace("PRECISION", request.param))


@RANKS_AND_THREADS
def test_any_ranks_and_threads(one, tmp_path, start, ranks, flags):
    assert_same_files(*one, tmp_path / "out", start, ranks, *flags)


def test_a_restart(one, tmp_path):
    assert_same_after_stop(*one, tmp_path / "out", 11)


@pytest.mark.parametrize("limit, rows", [(0, {2}), (10**9, set())])
def test_few_blocks_are_swept_by_one_thread_with_the_same_bits(tmp_path, monkeypatch, limit, rows):
    """Two threads share the sweeps, or one makes them all, in one call."""
    text, seen = SCENE.replace("PRECISION", "single"), set()
    alone, _ = begin(tmp_path, text)
    advance(alone, 0.02)
    each = pressure_solver.PressureSolver.each

    def record_relaxations(self, shares, kernel, *arguments):
        if kernel is relaxation.relax:
            seen.add(len(shares))
        each(self, shares, kernel, *arguments)

    monkeypatch.setattr(pressure_solver, "SHARED_BLOCKS", limit)
    monkeypatch.setattr(pressure_solver.PressureSolver, "each", record_relaxations)
    both, _ = begin(tmp_path, text, threads=2)
    advance(both, 0.02)
    assert seen == rows
    for quantity in ("x", "v"):
        assert np.array_equal(*(by_id(run, quantity)[0] for run in (alone, both)))


@pytest.mark.parametrize("key", ["ambient_pressure = 400", ""])
def test_cells_open_in_the_scene_with_suction(tmp_path, key):
    """Beside what is lifted, and, if the key says so, elsewhere."""
    simulation, _ = begin(tmp_path, SUCTION.replace("ambient_pressure = 400", key))
    suction, opened = simulation.features["implicit_pressure"].suction, 0
    while simulation.time < 0.08:
        simulation.advance(simulation.bound())
        opened += suction.is_open.any()
    assert opened >= 4
