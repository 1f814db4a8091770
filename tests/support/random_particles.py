"""Clouds of particles at random, and ways to compute them, for properties that must always hold."""

import dataclasses
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from hypothesis import strategies as st

from tests.support.small_scenes import scene
from vgmpi.planning.plan import make_plan
from vgmpi.preprocess.scene_builder import build_scene

# two fluids in one phase, a solid in another, every kind of wall and a post; soft, so that
# particles that cross a cell in a few steps take no shorter ones for their waves
SOUP = """
[domain]
size = [0.72, 0.24, 0.24]
cell = 0.02
boundary = { default = "slip", bottom = "stick", east = { kind = "separate", friction = 0.2 } }
[time]
end = 1
[accuracy]
pressure = "explicit"
precision = "PRECISION"
[material.oil]
kind = "fluid"
density = 800
tait_coefficient = 1e3
viscosity = 0.1
[material.water]
kind = "fluid"
tait_coefficient = 2e3
[material.rubber]
kind = "elastic"
density = 700
youngs_modulus = 2e3
[[object]]
name = "slick"
material = "oil"
shape = { box = [[0, 0, 0], [0.04, 0.04, 0.04]] }
position = [0.06, 0.06, 0.06]
[[object]]
name = "pool"
material = "water"
shape = { box = [[0, 0, 0], [0.04, 0.04, 0.04]] }
position = [0.16, 0.06, 0.06]
[[object]]
name = "ball"
material = "rubber"
shape = { box = [[0, 0, 0], [0.04, 0.04, 0.04]] }
position = [0.06, 0.16, 0.06]
[[object]]
name = "post"
role = "scenery"
collider = true
shape = { box = [[-0.02, -0.02, 0], [0.02, 0.02, 0.1]] }
position = [0.36, 0.12, 0.0]
"""
OWNERS = ("by load", "cut anew once", "cut anew", "dealt out")


@dataclass(frozen=True)
class Case:
    """One cloud, and one way to compute it."""

    seed: int
    counts: tuple[int, int, int]  # particles of each object
    width: float  # [cells] of each object's cloud
    length: float  # the same along x
    on_lattice: bool  # positions at quarters of cells, where rounding and ties are
    reach: float  # [cells] from a block's middle at which particles are sorted
    steps: int
    sort_at: int  # step before which all are sorted whether they need it or not
    restart_at: int | None
    ranks: tuple[int, int]  # before the restart and after
    threads: tuple[int, ...]  # of each rank
    backwards: bool  # threads take turns, the last one first
    owners: str

    def __post_init__(self):
        assert self.owners in OWNERS


CASES = st.builds(
    Case,
    seed=st.integers(0, 2**32 - 1),
    counts=st.tuples(*[st.integers(0, 150)] * 3).filter(any),
    width=st.sampled_from([0.5, 1.5, 4.0]),
    length=st.sampled_from([1.0, 4.0, 12.0]),
    on_lattice=st.booleans(),
    reach=st.sampled_from([2.01, 2.2, 3.0]),
    steps=st.integers(4, 14),
    sort_at=st.integers(0, 12),
    restart_at=st.none() | st.integers(0, 12),
    ranks=st.tuples(st.integers(1, 5), st.integers(1, 5)),
    threads=st.tuples(*[st.integers(1, 3)] * 5),
    backwards=st.booleans(),
    owners=st.sampled_from(OWNERS),
)


@cache
def box(precision):
    """(plan, colliders) of the scene; the particles come from the case."""
    with TemporaryDirectory() as folder:
        loaded = scene(Path(folder), SOUP.replace("PRECISION", precision))
        made = build_scene(loaded)
    count = [thing["row_count"] for thing in made.objects]
    solid = [thing["family"] == "solid" for thing in made.objects]
    plan = make_plan(loaded, count, [0.04**3] * len(count), True, surface=solid)
    assert [phase.surface for phase in plan.phases] == [True, False]
    assert [group.phase for group in plan.groups] == [0, 1, 1], "two groups in one phase"
    return plan, made.colliders


def cloud(case, plan):
    """(plan with the case's numbers, x, v, volume, thing, surface): particles in the order of their
    ids."""
    random = np.random.default_rng(case.seed)
    count = (*case.counts, 0)
    first = np.concatenate([[0], np.cumsum(count)[:-1]])
    thing = np.repeat(np.arange(4), count)
    size = np.array(plan.cells)
    middle = size / 2 + random.uniform(-3, 3, (4, 3))
    around = random.normal(size=(len(thing), 3)) * [case.length, case.width, case.width]
    x = middle[thing] + around
    if case.on_lattice:
        x = np.round(4 * x) / 4
    x = np.clip(x, 0.05, size - 0.05) * plan.dx
    v = 3.0 * random.normal(size=(4, 3))[thing] + 0.3 * random.normal(size=x.shape)
    volume = (plan.dx / 2) ** 3 * random.uniform(0.5, 1.5, len(thing))
    plan = dataclasses.replace(plan, first_id=tuple(int(n) for n in first), count=count)
    return plan, x, v, volume, thing, outlines(random, len(x), plan.dx)


def outlines(random, n, dx):
    """Surfaces (n, 10) as contact would know them: of some bodies normals that agree, so that these
    meet by an elastic layer, of others any; distances and gradients within a cell."""
    normal = random.normal(size=3) + random.choice([0.0, 0.3, 3.0]) * random.normal(size=(n, 3))
    normal *= (random.choice([1.0, 0.5], n) / np.linalg.norm(normal, axis=1))[:, None]
    away, bend = random.normal(0.0, 0.5 * dx, n), random.uniform(-0.5, 0.5, (n, 6)) / dx
    return np.column_stack([normal, away, random.choice([0.0, 1.0]) * bend]).astype(np.float32)
