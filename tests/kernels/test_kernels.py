"""The compiled engine agrees with the one in plain numpy (numpy_reference) to rounding.

Particles are moved off their lattice at random, so that no sum cancels by symmetry and no contact
hangs on a rounding error. tests/solver/test_engines.py has all laws and couplings; here are walls,
both precisions and the bound on the time step.
"""

import numpy as np
import pytest

from tests.support.engine_pair import TOLERANCE, beside, shaken, worst
from tests.support.small_scenes import scene
from vgmpi.materials.material import law_function
from vgmpi.preprocess.scene_builder import build_scene
from vgmpi.runtime.config.schema import SceneError
from vgmpi.solver.initial_particles import known_of, plan_for

HEAD = """
[domain]
size = [0.22, 0.2, 0.18]
cell = 0.02
gravity = [0.5, -0.3, -9.8]
boundary = { BOUNDARY }
[time]
end = 1
[accuracy]
pressure = "explicit"
precision = "PRECISION"
[material.water]
kind = "fluid"
tait_coefficient = 5e4
viscosity = 0.5
[material.rubber]
kind = "elastic"
density = 700
youngs_modulus = 2e5
"""
POOL = """
[[object]]
name = "pool"
material = "water"
shape = { box = [[0, 0, 0], [0.22, 0.2, 0.08]] }
position = [0.11, 0.1, 0]
velocity = [0.5, -0.4, -0.3]
"""
CUBE = """
[[object]]
name = "cube"
material = "rubber"
shape = { box = [[-0.06, -0.06, 0], [0.06, 0.06, 0.09]] }
position = [0.06, 0.08, PLACE]
velocity = [-1, 0.5, -1]
angular_velocity = [2, 0, 4]
"""
OTHER = """
[[object]]
name = "other"
material = "rubber"
shape = { box = [[-0.04, -0.04, 0], [0.04, 0.04, 0.06]] }
position = [0.166, 0.08, 0.0]
velocity = [-3, 1, 0]
"""
POST = """
[[object]]
name = "post"
role = "scenery"
collider = true
shape = { sphere = { center = [0, 0, 0], radius = 0.04 } }
position = [0.14, 0.08, 0.02]
"""
WALLS = {
    "stick": 'default = "stick"',
    "slip": 'default = "slip"',
    "separate": 'default = { kind = "separate", friction = 0.3 }',
    "mixed": 'default = "slip", bottom = "stick", west = { kind = "separate", friction = 0.2 }',
}


def pair(folder, objects, walls, precision, seed=0, head=HEAD):
    """(simulation, reference) of the same particles; the reference has a body per phase."""
    text = head.replace("BOUNDARY", WALLS[walls]).replace("PRECISION", precision)
    loaded = scene(folder, text + objects)
    made = build_scene(loaded)
    plan = plan_for(loaded, known_of(loaded, made))
    x, v = shaken(made, plan, seed)
    return beside(plan, made.colliders, x, v, made.vol0, made.object, surface=made.surface0)


def compare(simulation, reference, precision):
    found = worst(simulation, reference)
    print(found)
    assert max(found.values()) < TOLERANCE[precision]


@pytest.mark.parametrize("walls", WALLS)
@pytest.mark.parametrize("objects", [POOL, CUBE.replace("PLACE", "0.0")], ids=["fluid", "elastic"])
def test_one_body(objects, walls, tmp_path):
    simulation, reference = pair(tmp_path, objects, walls, "double")
    assert len(simulation.groups[0].code) >= 8, "too few blocks to test anything"
    dt = 0.5 * simulation.bound()
    simulation.advance(dt)
    reference.advance(dt)
    compare(simulation, reference, "double")
    for step in range(19):
        if step in (5, 12):
            simulation.sort()
            reference.sort()
        simulation.advance(dt)
        reference.advance(dt)
    compare(simulation, reference, "double")


@pytest.mark.parametrize("objects", [POOL, CUBE.replace("PLACE", "0.0")], ids=["fluid", "elastic"])
def test_single_precision(objects, tmp_path):
    simulation, reference = pair(tmp_path, objects, "mixed", "single")
    dt = float(np.float32(0.5 * simulation.bound()))
    for _ in range(20):
        simulation.advance(dt)
        reference.advance(dt)
    compare(simulation, reference, "single")


@pytest.mark.parametrize("objects", [POOL, CUBE.replace("PLACE", "0.0")], ids=["fluid", "elastic"])
def test_splines(objects, tmp_path):
    """Strains and forces by the gradients of the B-splines, with PIC."""
    head = HEAD.replace(
        "[material.water]", 'transfer = "pic"\ngradient = "bspline"\n[material.water]'
    )
    simulation, reference = pair(tmp_path, objects, "mixed", "double", head=head)
    dt = 0.5 * simulation.bound()
    for _ in range(20):
        simulation.advance(dt)
        reference.advance(dt)
    compare(simulation, reference, "double")


def test_splines_are_refused_with_apic(tmp_path):
    head = HEAD.replace("[material.water]", 'gradient = "bspline"\n[material.water]')
    with pytest.raises(SceneError, match="bspline is for pic and flip"):
        pair(tmp_path, POOL, "mixed", "double", head=head)


@pytest.mark.parametrize("walls", ["slip", "mixed"])
@pytest.mark.parametrize(
    "objects",
    [
        POOL + CUBE.replace("PLACE", "0.085"),
        CUBE.replace("PLACE", "0.0") + OTHER,
        OTHER + POST,
    ],
    ids=["fluid and elastic", "two elastic with friction", "elastic and collider"],
)
def test_contact(objects, walls, tmp_path):
    simulation, reference = pair(tmp_path, objects, walls, "double")
    dt = 0.5 * simulation.bound()
    met = []
    for _ in range(20):
        simulation.advance(dt)
        reference.advance(dt)
        met.append(reference.engine.contact_count)
    print(f"nodes in contact: {met}")
    assert max(met) > 20, "they hardly touched"
    compare(simulation, reference, "double")


def limits(simulation):
    """What limits the step [s]: waves, particles that fly too far, volumes that change too much."""
    (group,), plan = simulation.groups, simulation.plan
    at, law = group.index(), group.plan.law
    c = np.sqrt(law_function(law, "wave_speed2")(law, group.law_state(at)))
    speed = np.linalg.norm(group.get("v", at), axis=1)
    trace = np.abs(group.get("C", at)[:, [0, 4, 8]].sum(1))
    return {
        "wave": plan.time_step.cfl * plan.dx / (c + speed).max(),
        "speed": 0.3 * plan.dx / speed.max(),
        "volume": 0.1 / trace.max(),
    }


@pytest.mark.parametrize(
    "decides, modulus, speed",
    [("wave", "5e4", 0.1), ("speed", "1", 3.0), ("volume", "1e-2", 0.0)],
)
def test_time_step_bound(decides, modulus, speed, tmp_path):
    """Each of the three limits of the step, where it is the one that counts."""
    pool = POOL.replace("[0.5, -0.4, -0.3]", f"[{speed}, 0, 0]")
    pool = pool.replace("[0.22, 0.2, 0.08]", "[0.1, 0.1, 0.1]")  # away from the walls
    pool = pool.replace("[0.11, 0.1, 0]", "[0.11, 0.1, 0.04]")
    simulation, reference = pair(
        tmp_path, pool, "mixed", "double", head=HEAD.replace("5e4", modulus)
    )
    for _ in range(2):
        dt = 0.1 * simulation.bound()
        simulation.advance(dt)
        reference.advance(dt)
        found = limits(reference)
        assert min(found, key=found.get) == decides
        assert 1.0 / simulation.rate == pytest.approx(found[decides], rel=1e-10)
