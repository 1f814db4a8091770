"""What the particles of a pinned part cost, as a part of a fluid's.

A slab of rubber lies on a held slab that moves. In one scene the held slab is thin, in the other
one it is thick: the difference is that of carried particles alone. Both are measured in turns with
a plain fluid, so that what else the machine does touches all alike.
"""

import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from tests.benchmarks.body_cost import CELL, PER_CELL
from tests.benchmarks.coupling_cost import ready, spent

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
pinned = {{ box = [[-1, -1, -1], [2, 2, {held!r}]], motion = {{ velocity = [0, 0, 0.01] }} }}
"""


def text_of(side: int, held: int, precision: str) -> str:
    """Return the scene of a held slab so many cells thick; of a plain fluid with 0."""
    keys = {
        "side": side * CELL, "top": (FREE + held) * CELL, "cell": CELL, "precision": precision,
        "high": (FREE + THICK + 4) * CELL, "material": "rubber" if held else "water",
        "held": held * CELL,
    }  # fmt: skip
    return (HEAD + HELD * bool(held)).format(**keys)


def measure(particles: int, rounds: int, precision: str, say: Callable) -> list[list[float]]:
    """Return per round the ns per particle and step of a fluid, and of carried particles.

    Args:
        particles: Carried particles of the thick slab.
        rounds: Number of rounds.
        precision: "single" or "double".
        say: Called with a progress line.
    """
    side = max(8, round((particles / PER_CELL / THICK) ** 0.5))
    tanks, rows = [], []
    with tempfile.TemporaryDirectory(prefix="vgmpi-bench-") as folder:
        for held in (0, THIN, THICK):
            path = Path(folder) / "scene.toml"
            path.write_text(text_of(side, held, precision))
            tanks.append(ready(path))
    count = [tank.plan.particles for tank in tanks]
    for k in range(rounds):
        say(f"round {k + 1} of {rounds}")
        fluid, thin, thick = (spent(tank)["time"] for tank in tanks)
        carried = (count[2] * thick - count[1] * thin) / (count[2] - count[1])
        rows.append([fluid, carried])
    return rows


def text(rows: list[list[float]]) -> str:
    """Return the line of the medians."""
    values = np.array(rows)
    fluid, carried = np.median(values, axis=0)
    ratio = np.median(values[:, 1] / values[:, 0])
    return f"ns per particle and step: fluid {fluid:.1f}, carried {carried:.1f}; ratio {ratio:.3f}"
