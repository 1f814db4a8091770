"""The compiled solver agrees with the slow reference (tests/reference.py) to rounding.

Particles are moved off their lattice at random, so that no sum cancels by symmetry and no contact
hangs on a rounding error. The reference takes the law's numbers and the particles; blocks, patches,
fixed-point positions, sorting and the exchange are the solver's own.
"""

import numpy as np
import pytest

from tests.beside import TOLERANCE, beside, worst
from tests.scenes import scene
from vgmpi.prepare.build import build
from vgmpi.solver.prepared import known_of, plan_for
from vgmpi.tables import SceneError

HEAD = """
[domain]
size = [0.22, 0.2, 0.18]
cell = 0.02
gravity = [0.5, -0.3, -9.8]
boundary = { BOUNDARY }
[time]
end = 1
[accuracy]
precision = "PRECISION"
[material.water]
kind = "fluid"
bulk_modulus = 5e4
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
spin = [2, 0, 4]
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
    "mixed": 'default = "slip", floor = "stick", west = { kind = "separate", friction = 0.2 }',
}


def pair(folder, objects, walls, precision, seed=0, head=HEAD):
    """(simulation, reference) of the same particles; the reference has a body per phase."""
    text = head.replace("BOUNDARY", WALLS[walls]).replace("PRECISION", precision)
    loaded = scene(folder, text + objects)
    made = build(loaded)
    plan = plan_for(loaded, known_of(loaded, made))
    random = np.random.default_rng(seed)
    size = np.array(plan.cells) * plan.dx
    x = made.x + random.uniform(-0.2, 0.2, made.x.shape) * plan.dx
    x = np.clip(x, 0.01 * plan.dx, size - 0.01 * plan.dx)
    v = made.v0 + random.normal(0.0, 0.1, made.x.shape)
    return beside(plan, made.colliders, x, v, made.vol0, made.object)


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
    reference.step(dt)
    compare(simulation, reference, "double")
    for step in range(19):
        if step in (5, 12):
            simulation.sort()
        simulation.advance(dt)
        reference.step(dt)
    compare(simulation, reference, "double")


@pytest.mark.parametrize("objects", [POOL, CUBE.replace("PLACE", "0.0")], ids=["fluid", "elastic"])
def test_single_precision(objects, tmp_path):
    simulation, reference = pair(tmp_path, objects, "mixed", "single")
    dt = float(np.float32(0.5 * simulation.bound()))
    for _ in range(20):
        simulation.advance(dt)
        reference.step(dt)
    compare(simulation, reference, "single")


@pytest.mark.parametrize("objects", [POOL, CUBE.replace("PLACE", "0.0")], ids=["fluid", "elastic"])
def test_splines(objects, tmp_path):
    """Strains and forces by the gradients of the B-splines, with PIC."""
    head = HEAD.replace(
        "[material.water]", 'transfer = "pic"\ngradient = "splines"\n[material.water]'
    )
    simulation, reference = pair(tmp_path, objects, "mixed", "double", head=head)
    reference.splines = True
    dt = 0.5 * simulation.bound()
    for _ in range(20):
        simulation.advance(dt)
        reference.step(dt)
    compare(simulation, reference, "double")


def test_splines_are_refused_with_apic(tmp_path):
    head = HEAD.replace("[material.water]", 'gradient = "splines"\n[material.water]')
    with pytest.raises(SceneError, match="splines are for pic and flip"):
        pair(tmp_path, POOL, "mixed", "double", head=head)


def changed_nodes(reference, name):
    """How many nodes the reference's contact changes, a number per step, as a list that grows."""
    counts, inner = [], getattr(reference, name)

    def counted(v, masses):
        grids = v if isinstance(v, list) else [v]
        before = grids[0].copy()
        inner(v, masses)
        counts.append(int((grids[0] != before).any(-1).sum()))

    setattr(reference, name, counted)
    return counts


@pytest.mark.parametrize("walls", ["slip", "mixed"])
@pytest.mark.parametrize(
    "objects, rule",
    [
        (POOL + CUBE.replace("PLACE", "0.085"), "_contact"),
        (CUBE.replace("PLACE", "0.0") + OTHER, "_contact"),
        (OTHER + POST, "_collide"),
    ],
    ids=["fluid and elastic", "two elastic with friction", "elastic and collider"],
)
def test_contact(objects, rule, walls, tmp_path):
    simulation, reference = pair(tmp_path, objects, walls, "double")
    dt = 0.5 * simulation.bound()
    met = changed_nodes(reference, rule)
    for _ in range(20):
        simulation.advance(dt)
        reference.step(dt)
    print(f"nodes in contact: {met}")
    assert max(met) > 20, "they hardly touched"
    compare(simulation, reference, "double")


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
        reference.step(dt)
        limits = reference.limits(simulation.plan.cfl)
        assert min(limits, key=limits.get) == decides
        assert 1.0 / simulation.rate == pytest.approx(limits[decides], rel=1e-10)
