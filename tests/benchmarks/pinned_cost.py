"""What the particles of a pinned part cost, as a part of a fluid's.

A slab of rubber lies on a held slab, which moves or is at rest. In one scene the held slab is thin,
in the other one it is thick: the difference is that of held particles alone. All are measured in
turns with a plain fluid, so that what else the machine does touches all alike.
"""

from collections.abc import Callable

import numpy as np

from tests.benchmarks.body_cost import CELL, PER_CELL
from tests.benchmarks.coupling_cost import ready, spent

PARTICLES = 100_000  # of the thick held slab
FREE, THIN, THICK = 8, 4, 36  # [cells] of rubber, and of the held slabs
HEAD = """
[domain]
size = [{side!r}, {side!r}, {high!r}]
cell = {cell!r}
gravity = [0, 0, 0]
boundary = "slip"
[time]
end = 10
[accuracy]
pressure = "explicit"
transfer = "apic"
precision = "{precision}"
[material.water]
kind = "fluid"
tait_coefficient = 1e5
[material.rubber]
kind = "elastic"
youngs_modulus = 1e5
[[object]]
name = "slab"
material = "{material}"
shape = {{ box = [[0, 0, 0], [{side!r}, {side!r}, {top!r}]] }}
"""
HELD = """
pinned = {{ box = [[-1, -1, -1], [2, 2, {held!r}]]{motion} }}
"""
MOTIONS = {"at rest": "", "carried": ", motion = { velocity = [0, 0, 0.01] }"}


def text_of(side: int, held: int, precision: str, motion: str = "") -> str:
    """Return the scene of a held slab so many cells thick; of a plain fluid with 0."""
    keys = {
        "side": side * CELL, "top": (FREE + held) * CELL, "cell": CELL, "precision": precision,
        "high": (FREE + THICK + 4) * CELL, "material": "rubber" if held else "water",
        "held": held * CELL,
        "motion": motion,
    }  # fmt: skip
    return (HEAD + HELD * bool(held)).format(**keys)


def measure(rounds: int, say: Callable, precision: str = "single") -> list[list[float]]:
    """Return per round the ns per particle and step of a fluid, and of those of MOTIONS.

    Args:
        rounds: Number of rounds.
        say: Called with a progress line.
        precision: "single" or "double".
    """
    side = round((PARTICLES / PER_CELL / THICK) ** 0.5)
    cases = [(0, ""), *((held, more) for more in MOTIONS.values() for held in (THIN, THICK))]
    tanks = [ready(text_of(side, held, precision, motion)) for held, motion in cases]
    rows = []
    count = np.array([tank.plan.particles for tank in tanks])
    for k in range(rounds):
        say(f"round {k + 1} of {rounds}")
        time = np.array([spent(tank)["time"] for tank in tanks])
        total = time * count
        more = (total[2::2] - total[1::2]) / (count[2::2] - count[1::2])
        rows.append([time[0], *more])
    return rows


def text(rows: list[list[float]]) -> str:
    """Return the lines of the medians, and of the rounds' ratios to the fluid."""
    values = np.array(rows)
    ns, ratio = np.median(values, axis=0), np.median(values / values[:, :1], axis=0)
    names = ("fluid", *(f"pinned, {name}" for name in MOTIONS))
    return "\n".join(
        f"{name:18s} {ns[k]:6.1f} ns per particle and step, ratio {ratio[k]:.2f}"
        for k, name in enumerate(names)
    )
