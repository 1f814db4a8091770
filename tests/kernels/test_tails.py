"""Segments that do not fill their last vector or their last batch: right, and deaf to what lies in
the unused places.
"""

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.kernels import test_kernels
from tests.support.engine_pair import TOLERANCE, beside, worst
from tests.support.rank_states import different, joined, padding
from tests.support.small_scenes import scene
from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.planning.plan import make_plan
from vgmpi.solver.restart.state_io import save
from vgmpi.solver.simulation import Simulation

# vectors hold 16, batches 128
COUNTS = (1, 15, 16, 17, 31, 32, 33, 127, 128, 129)
HEAD = test_kernels.HEAD.replace("[0.22, 0.2, 0.18]", "[0.9, 0.24, 0.24]").replace(
    "BOUNDARY", 'default = "slip", bottom = "stick", north = { kind = "separate", friction = 0.3 }'
)
BODY = """
[[object]]
name = "MATERIAL body"
material = "MATERIAL"
shape = { box = [[0, 0, 0], [0.1, 0.1, 0.1]] }
position = [0.45, 0.12, 0]
"""
MATERIALS = ["water", "rubber", "water rubber"]


def make(folder, materials, precision, empty=""):
    """(plan, x, v, volume, thing): rows of blocks along x, away from walls and beside them, with
    each of COUNTS particles of the first material; the second lies in every other of the blocks, in
    falling numbers. empty: materials of objects without particles.
    """
    bodies = "".join(BODY.replace("MATERIAL", name) for name in f"{materials} {empty}".split())
    loaded = scene(Path(folder), HEAD.replace("PRECISION", precision) + bodies)
    random = np.random.default_rng(3)
    x, v, thing = [], [], []
    for k in range(len(materials.split())):
        for along, n in enumerate(COUNTS):
            for across in ((1, 1), (0, 0), (2, 1)):
                block = np.array([along + 1, *across])
                if k == 1 and sum(block) % 2:
                    continue
                n = n if k == 0 else COUNTS[-1 - along]
                low = np.maximum(4 * block - 0.5, 0.0) + 0.01  # [cells]
                high = np.minimum(4 * block + 3.5, [45, 12, 12]) - 0.01
                x.append(random.uniform(low, high, (n, 3)))
                v.append(random.normal(0.0, 0.3, 3) + random.normal(0.0, 0.1, (n, 3)))
                thing.append(np.full(n, k))
    x, v, thing = np.concatenate(x) * 0.02, np.concatenate(v), np.concatenate(thing)
    order = np.argsort(thing, kind="stable")
    volume = 0.01**3 * random.uniform(0.8, 1.2, len(x))
    count = np.bincount(thing, minlength=len(loaded.object)).tolist()
    plan = make_plan(loaded, count, [1e-3] * len(count), False)
    return plan, x[order], v[order], volume, thing[order]


@pytest.mark.parametrize("precision", ["single", "double"])
@pytest.mark.parametrize("materials", MATERIALS)
def test_every_count(materials, precision, tmp_path):
    plan, *particles = make(tmp_path, materials, precision)
    simulation, reference = beside(plan, [], *particles)
    for group in simulation.groups:
        assert set(group.count.tolist()) == set(COUNTS)
    seen = set()
    for step in range(12):
        dt = float(np.float32(0.5 * simulation.bound()))
        if step % 4 == 3:
            simulation.sort()
            seen |= {n for group in simulation.groups for n in (group.count % 16).tolist()}
        simulation.advance(dt)
        reference.advance(dt)
        if step == 0:
            assert max(worst(simulation, reference).values()) < TOLERANCE[precision]
    found = worst(simulation, reference)
    print(found)
    assert max(found.values()) < TOLERANCE[precision]
    assert {0, 1, 15} <= seen, "the sorts left no such tails"


def run(plan, particles, before, steps=9):
    """Rows after some steps with two sorts; before(simulation) is called before each."""
    x, v, volume, thing = particles
    simulation = Simulation(plan, SerialCommunicator())
    simulation.put(x, v, volume, np.arange(len(x)), thing)
    for step in range(steps):
        if step in (3, 6):
            simulation.sort()
        before(simulation)
        simulation.advance(simulation.bound())
    return joined([save(simulation)])


@pytest.mark.parametrize("precision", ["single", "double"])
def test_one_particle_in_every_cell(precision, tmp_path):
    """Alone, it goes on as it was, in each of the 4^3 cells of its block and one cell beyond: no
    node it touches is left out on the way to the grid and back."""
    plan, *_ = make(tmp_path, "water", precision)
    plan = replace(plan, gravity=plan.gravity._replace(vector=(0.0, 0.0, 0.0)))
    simulation = Simulation(plan, SerialCommunicator())
    v = np.array([[0.3, -0.2, 0.1]])
    middle = np.array([[21.5, 5.5, 5.5]]) * plan.dx
    simulation.put(middle, v, np.array([1e-6]), np.zeros(1, np.int64), np.zeros(1, np.int64))
    (group,) = simulation.groups
    (at,) = group.index()
    for cell in itertools.product(range(-3, 3), repeat=3):
        group.xi[:, at] = [int((c + 0.5) * 2.0**group.bits) for c in cell]
        group.f[0:3, at], group.f[3:12, at] = v[0], 0.0
        simulation.advance(1e-5)
        assert simulation.sorts == 1
        assert np.abs(group.f[0:3, at] - v[0]).max() < TOLERANCE[precision], cell
        assert np.abs(group.f[3:12, at]).max() < 100 * TOLERANCE[precision] / plan.dx, cell


RUBBISH = {
    "nan": [np.nan],
    "infinite": [np.inf, -np.inf],
    "huge": [1e30, -1e30],
    "tiny": [1e-40, -1e-40],
    "any": [np.nan, np.inf, -1e30, 1e-40, -0.0, 7.0],
}


@pytest.mark.parametrize("precision", ["single", "double"])
@pytest.mark.parametrize("rubbish", RUBBISH)
def test_unused_places_are_not_seen(rubbish, precision, tmp_path):
    """Behind the last particle of a segment may lie any numbers, and positions within the patch."""
    plan, *particles = make(tmp_path, "water rubber", precision)
    want = run(plan, particles, lambda simulation: None)
    random = np.random.default_rng(1)
    spoiled = []

    def spoil(simulation):
        for group in simulation.groups:
            places = padding(group)
            assert (group.ids[places] == -1).all()
            group.f[:, places] = random.choice(RUBBISH[rubbish], (group.channels, len(places)))
            # as far from the block's middle as a sort lets particles go
            most = int(simulation.max_stray * 2**group.bits) - 1
            group.xi[:, places] = random.integers(-most, most, (3, len(places)))
            spoiled.append(len(places))

    assert different(run(plan, particles, spoil), want) == []
    assert min(spoiled) > 50


@pytest.mark.parametrize("precision", ["single", "double"])
def test_an_object_without_particles(precision, tmp_path):
    """A phase that has none anywhere changes nothing, though contact is then looked for."""
    plan, *particles = make(tmp_path, "water", precision)
    want = run(plan, particles, lambda simulation: None)
    plan, *particles = make(tmp_path, "water", precision, empty="rubber")
    assert plan.contact.has_pairs and len(plan.groups) == 2
    rows = run(plan, particles, lambda simulation: None)
    assert not any(len(rows[f"group_001/{name}"]) for name in ("id", "block"))
    water = {name: rows[name] for name in want}
    assert different(water, want) == []
