"""What free rigid bodies cost: many that touch nothing, and a steel ball in water.

The ball stands in the place of water. It is also measured with water inside, as where a scene's
shapes overlap: what is inside next to its surface costs as much as what is outside.

Each scene is measured in turns with the same water alone, so that what else the machine does
touches both alike.
"""

import re
import time
from collections.abc import Callable

import numpy as np

from tests.benchmarks.coupling_cost import ready
from vgmpi.parallel.exchange_topology import NEAR_BODIES
from vgmpi.solver.simulation import Simulation

CELL, PER_CELL = 0.01, 8  # [m], particles per cell
EDGE, GAP = 5, 12  # [cells] from a body to the next, and from the water to the first
RADIUS = 8  # cells of the ball in water
WATER = """
[accuracy]
pressure = "explicit"
[domain]
size = [{side!r}, {side!r}, {high!r}]
cell = {cell!r}
gravity = [0, 0, {gravity!r}]
boundary = "slip"
[time]
end = 10
[material.water]
kind = "fluid"
tait_coefficient = 1e5
[material.steel]
kind = "elastic"
density = 7800
youngs_modulus = 2e11
friction = 0.3
[[object]]
name = "pool"
material = "water"
shape = {{ box = [[0, 0, 0], [{side!r}, {side!r}, {side!r}]] }}
{pressure}
"""
BALL = """
[[object]]
name = "ball {k}"
material = "steel"
rigid = true
velocity = [{v!r}, 0, 0]
shape = {{ sphere = {{ center = [{x!r}, {y!r}, {z!r}], radius = {radius!r} }} }}
"""


def measure(count: int, particles: int, rounds: int, say: Callable) -> list[dict]:
    """Return a row per scene: seconds per step and per simulated second, beside water alone.

    Args:
        count: Number of bodies that touch nothing; 0 leaves this scene out.
        particles: Particles of the water.
        rounds: Number of rounds.
        say: Called with a progress line.
    """
    side = max(4 * RADIUS, round((particles / PER_CELL) ** (1 / 3)))
    still, pool = _water(side, count, 0.0), _water(side, 0, -9.81)
    ball, hole = _in_water(side), _without_ball(side, pool)
    scenes = {
        f"{count} bodies apart": (still, still + _apart(side, count)),
        "a steel ball in water": (pool, hole + ball),
        "a steel ball, water inside": (pool, pool + ball),
    }
    if not count:
        del scenes[f"{count} bodies apart"]
    rows = []
    for name, texts in scenes.items():
        tanks = []
        for text in texts:
            began = time.perf_counter()
            tanks.append(ready(text))
            say(f"{name}: {time.perf_counter() - began:.0f} s to prepare")
        rows.append({
            "name": name, "particles": tanks[0].plan.particles, "near": _close(tanks[1]),
            "rounds": [],
        })  # fmt: skip
        for k in range(rounds):
            say(f"{name}: round {k + 1} of {rounds}")
            rows[-1]["rounds"].append([_spent(tank) for tank in tanks])
    return rows


def _water(side: int, count: int, gravity: float) -> str:
    """Return the water, with room for so many bodies above it."""
    layers = -(-count // max(side // EDGE, 1) ** 2)
    return WATER.format(
        side=side * CELL, high=(side + EDGE * layers + GAP) * CELL, cell=CELL, gravity=gravity,
        pressure='initial_pressure = "hydrostatic"' if gravity else "",
    )  # fmt: skip


def _apart(side: int, count: int) -> str:
    """Return bodies of four cells above the water, in a lattice, that drift slowly."""
    row = max(side // EDGE, 1)
    places = [(k % row, k // row % row, k // row**2) for k in range(count)]
    return "".join(
        BALL.format(
            k=k, v=0.01, x=(EDGE * i + 2.5) * CELL, y=(EDGE * j + 2.5) * CELL,
            z=(side + GAP + EDGE * m + 2.5) * CELL, radius=2 * CELL,
        )
        for k, (i, j, m) in enumerate(places)
    )  # fmt: skip


def _in_water(side: int) -> str:
    """Return the ball in the middle of the water."""
    middle = 0.5 * side * CELL
    return BALL.format(k=0, v=0.0, x=middle, y=middle, z=middle, radius=RADIUS * CELL)


def _without_ball(side: int, water: str) -> str:
    """Return the water without what is in the place of the ball."""
    box, sphere = (re.search(rf"{kind} = .*(?= }})", text).group() for kind, text in
                   (("box", water), ("sphere", _in_water(side))))  # fmt: skip
    return water.replace(box, f"difference = [{{ {box} }}, {{ {sphere} }}]")


def _close(simulation: Simulation) -> int:
    """Return the number of particles at most a block from a body."""
    chosen = simulation.exchange.tables.contributes[NEAR_BODIES[0]]
    return int(np.concatenate([group.count for group in simulation.groups])[chosen].sum())


def _spent(simulation: Simulation, steps: int = 24) -> tuple[float, float]:
    """Return processor seconds per step, and per simulated second."""
    began, start = time.thread_time(), simulation.time
    for _ in range(steps):
        simulation.advance(simulation.bound())
    spent = time.thread_time() - began
    return spent / steps, spent / (simulation.time - start)


def text(rows: list[dict]) -> str:
    """Return the table: medians of the rounds' times on one core, and of their ratios.

    `cost` is what a particle at most a block from a body costs more, in steps of one of the water.
    """
    lines = [
        f"{'':30s} particles   ms per step: alone   with   more   ratio   per second"
        "   near bodies   cost"
    ]
    for row in rows:
        times = 1e3 * np.array(row["rounds"])  # rounds, scenes, (step, simulated second)
        alone, together = np.median(times[:, :, 0], axis=0)
        step, second = np.median(times[:, 1] / times[:, 0], axis=0)
        more = np.median(times[:, 1, 0] - times[:, 0, 0])
        cost = np.median((times[:, 1, 0] / times[:, 0, 0] - 1) * row["particles"]) / row["near"]
        lines.append(
            f"{row['name']:30s} {row['particles']:9,} {alone:20.2f} {together:6.2f} {more:6.2f}"
            f" {step:7.3f} {second:12.3f} {row['near']:13,} {cost:6.2f}"
        )
    return "\n".join(lines)
