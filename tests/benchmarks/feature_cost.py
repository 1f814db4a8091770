"""What may touch costs a particle at most a block from it, beside the same scene where it cannot.

A tank of slabs two blocks thick, so that most are. The two of a pair, and a plain fluid, are
measured in turns, so that what else the machine does touches all alike.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from tests.benchmarks.coupling_cost import MIXING, ready, spent
from vgmpi.solver.simulation import Simulation

THICK = 8  # cells of a slab
HEAD = """
[domain]
size = [{side!r}, {side!r}, {high!r}]
cell = 0.01
[time]
end = 1
[accuracy]
pressure = "explicit"
transfer = "apic"
precision = "{precision}"
[material.water]
kind = "fluid"
tait_coefficient = 1e5
[material.milk]
kind = "fluid"
density = 1030
tait_coefficient = 1e5
[material.clay]
kind = "elastic"
density = 1000
youngs_modulus = 2e5
"""
SLAB = """
[[object]]
name = "slab {k}"
shape = {{ box = [[0, 0, 0], [{side!r}, {side!r}, {thick!r}]] }}
position = [{half!r}, {half!r}, {z!r}]
{keys}
"""
PROBE = """
[[probe]]
name = "felt {k}"
collider = "slab {k}"
sampling_rate = 100
"""
CLAY, WATER, MILK = 'material = "clay"', 'material = "water"', 'material = "milk"'
PLATE = 'role = "scenery"\ncollider = true'
ONE = '\nphase = "one"'


class Case(NamedTuple):
    """The keys of the slabs, in turns from below, and what else the scene has."""

    slabs: tuple[str, ...]
    probe: str = ""  # of each slab that is a collider
    more: str = ""


class Feature(NamedTuple):
    """A pair of scenes that differ in one thing."""

    name: str
    without: Case
    having: Case


PAIRS = (
    Feature("contact of solids", Case((CLAY + ONE, CLAY + ONE)), Case((CLAY, CLAY))),
    Feature("contact of a fluid with a solid",
            Case((CLAY + ONE, WATER + ONE)), Case((CLAY, WATER))),
    Feature("mixing", Case((WATER, MILK)), Case((WATER, MILK), more=MIXING)),
    Feature("colliders in a fluid", Case((WATER, "")), Case((WATER, PLATE))),
    Feature("colliders that move",
            Case((WATER, PLATE)), Case((WATER, PLATE + "\nmotion = { velocity = [0.01, 0, 0] }"))),
    Feature("a probe of force on every collider",
            Case((WATER, PLATE)), Case((WATER, PLATE), probe=PROBE)),
)  # fmt: skip
PLAIN = Case((WATER,))


def measure(particles: int, rounds: int, precision: str, say: Callable) -> list[dict]:
    """Return a row per feature: ns per particle and step without it, with it, and of a plain fluid.

    Args:
        particles: Particles of a tank.
        rounds: Number of rounds.
        precision: "single" or "double".
        say: Called with a progress line.
    """
    cases = {"plain": PLAIN}
    for feature in PAIRS:
        cases |= {f"{feature.name} -": feature.without, f"{feature.name} +": feature.having}
    tanks = {}
    for name, case in cases.items():
        say(f"{name}: preparing")
        tanks[name] = ready(text_of(case, particles, precision))
    rows = [
        {"name": pair.name, "near": proximity_share(tanks[f"{pair.name} +"]), "rounds": []}
        for pair in PAIRS
    ]
    for k in range(rounds):
        say(f"round {k + 1} of {rounds}")
        for row in rows:
            names = ("plain", f"{row['name']} -", f"{row['name']} +")
            row["rounds"].append([spent(tanks[name])["time"] for name in names])
    return rows


def proximity_share(tank: Simulation) -> float:
    """Return the fraction of particles that are near enough for contact."""
    plan = tank.plan
    shares = [
        max(group.collider, *(phase.share for phase in group.phases), 0.0)
        for group in plan.measures.proximity
    ]
    return float(np.average(shares, weights=plan.count))


def text_of(case: Case, particles: int, precision: str) -> str:
    """The scene: as many slabs as make the tank about as high as wide, from one cell up."""
    side = max(8, round((particles / 8) ** (1 / 3)))
    count = max(2, round(side / THICK))
    keys = {"side": side / 100, "half": side / 200, "thick": THICK / 100}
    text = HEAD.format(
        high=(THICK * count + 8) / 100, precision=precision, **keys,
    )  # fmt: skip
    for k in range(count):
        own = case.slabs[k % len(case.slabs)]
        if own:
            text += SLAB.format(k=k, z=k * THICK / 100, keys=own, **keys)
            text += case.probe.format(k=k) if "collider" in own else ""
    return text + case.more


def text(rows: list[dict]) -> str:
    """The table: medians, and what it costs a particle that is near, in steps of a fluid's."""
    lines = [f"{'':38s} ns without   with   near   in steps of a fluid"]
    for row in rows:
        times = np.array(row["rounds"])
        more = (times[:, 2] - times[:, 1]) / times[:, 0] / row["near"]
        fluid, without, having = np.median(times, axis=0)
        lines.append(
            f"{row['name']:38s} {without:10.1f} {having:6.1f} {row['near']:6.2f}"
            f" {np.median(more):8.2f}  ({more.min():.2f} .. {more.max():.2f})"
        )
    return "\n".join([*lines, f"a plain fluid: {fluid:.1f} ns per particle and step"])
