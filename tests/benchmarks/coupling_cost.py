"""What sharing space costs: fluids that mix, and sand that a fluid flows through, beside
the same tank filled with one fluid; and the same fluid with its motion corrected every few steps,
its density corrected, with AFLIP, and in two colors that travel with every step.

Each pair is measured in turns, so that what else the machine does touches both alike.
"""

import tempfile
import time
from pathlib import Path

import numpy as np

from tests.support.simulate import begin
from vgmpi.solver.simulation import Simulation
from vgmpi.tools.bench.vgmpi_contestant import Stages

TANK = """
[domain]
size = [{side!r}, {side!r}, {high!r}]
cell = 0.01
[time]
end = 1
[accuracy]
pressure = "explicit"
transfer = "{transfer}"
precision = "{precision}"
volume_correction = "{volume}"
[material.water]
kind = "fluid"
tait_coefficient = 1e5
[material.milk]
kind = "fluid"
density = 1030
tait_coefficient = 1e5
[material.sand]
kind = "sand"
youngs_modulus = 1e5
[[object]]
name = "water"
material = "water"
shape = {{ box = [[0, 0, {low!r}], [{side!r}, {side!r}, {top!r}]] }}
initial_pressure = "hydrostatic"
"""
LAYER = """
[[object]]
name = "layer"
material = "{made_of}"
shape = {{ box = [[0, 0, 0], [{side!r}, {side!r}, {low!r}]] }}
"""
PORES = """
[[object]]
name = "pores"
material = "water"
shape = {{ box = [[0, 0, 0], [{side!r}, {side!r}, {low!r}]] }}
volume_fraction = 0.4
"""
MIXING = """
[[coupling]]
between = ["water", "milk"]
kind = "mixing"
diffusivity = 1e-5
slip_relaxation_time = 0.01
"""
DRAG = """
[[coupling]]
between = ["water", "sand"]
kind = "drag"
hydraulic_conductivity = 1e-3
"""
COLORS = """
[appearance]
color_transfer = "step"
"""
AFLIP, CORRECTED, DENSITY = "with AFLIP", "with motion corrected", "with density corrected"
TRANSFERS = {AFLIP: "aflip", CORRECTED: "apic-corrected"}
SCENES = {  # name -> what lies below the water, couplings, depth of it as a share of the tank's
    "fluid": (LAYER.replace("{made_of}", "water"), 0.5),
    CORRECTED: (LAYER.replace("{made_of}", "water"), 0.5),
    DENSITY: (LAYER.replace("{made_of}", "water"), 0.5),
    AFLIP: (LAYER.replace("{made_of}", "water"), 0.5),
    "colors with every step": (
        LAYER.replace("{made_of}", 'water"\ncolor = "#ff8000') + COLORS,
        0.5,
    ),
    "mixing, two layers": (LAYER.replace("{made_of}", "milk") + MIXING, 0.5),
    "sand": (LAYER.replace("{made_of}", "sand"), 1.0),
    "drag, a bed of sand under water": (LAYER.replace("{made_of}", "sand") + PORES + DRAG, 0.25),
    "drag, wet sand throughout": (LAYER.replace("{made_of}", "sand") + PORES + DRAG, 1.0),
}
PURE = "fluid"


def measure(particles: int, rounds: int, precision: str, say) -> list[dict]:
    """Return a row per scene: name, particles, ns per particle and step by stage of each round.

    Args:
        particles: Particles of a tank.
        rounds: Number of rounds.
        precision: "single" or "double".
        say: Called with a progress line.
    """
    rows, tanks = [], []
    for name in SCENES:
        say(f"{name}: preparing")
        tanks.append(_tank(name, particles, precision))
        rows.append({"name": name, "particles": tanks[-1].plan.particles, "rounds": []})
    for k in range(rounds):
        say(f"round {k + 1} of {rounds}")
        for tank, row in zip(tanks, rows, strict=True):
            row["rounds"].append(spent(tank))
    return rows


def _tank(name: str, particles: int, precision: str) -> Simulation:
    """A tank twice as high as wide, filled to three quarters."""
    below, fraction = SCENES[name]
    side = max(8, round((particles / 8 / 1.5) ** (1 / 3)))
    depth = round(1.5 * side)
    low = round(fraction * depth)
    keys = {
        "side": side / 100, "high": 2 * side / 100, "low": low / 100, "top": depth / 100,
        "precision": precision, "transfer": TRANSFERS.get(name, "apic"),
        "volume": "density" if name == DENSITY else "none",
    }  # fmt: skip
    text = TANK if fraction < 1.0 else TANK[: TANK.index("[[object]]")]
    return ready((text + below).format(**keys))


def ready(text: str) -> Simulation:
    """The simulation of a scene's text, its first steps made."""
    with tempfile.TemporaryDirectory(prefix="vgmpi-bench-") as folder:
        simulation, _ = begin(Path(folder), text)
    for _ in range(3):
        simulation.advance(0.5 * simulation.bound())
    return simulation


def spent(simulation: Simulation, steps: int = 24) -> dict:
    """ns per particle and step by stage, sorting spread over the steps between two sorts."""
    clock = simulation.clock = Stages(time.thread_time)
    began = time.thread_time()
    for _ in range(steps):
        simulation.advance(0.5 * simulation.bound())
    stages = {"time": time.thread_time() - began, **clock.spent}
    simulation.clock = None
    return {k: 1e9 * v / steps / simulation.plan.particles for k, v in stages.items()}


def text(rows: list[dict]) -> str:
    """The table: medians, and the median of the rounds' ratios to the pure fluid's rate."""
    pure = next(row for row in rows if row["name"] == PURE)
    lines = [f"{'':34s} particles   ns  least   p2g  grid   g2p   rate beside a fluid's"]
    for row in rows:
        times = [r["time"] for r in row["rounds"]]
        ratio = np.median(
            [p["time"] / r["time"] for p, r in zip(pure["rounds"], row["rounds"], strict=True)]
        )
        stages = "".join(
            f"{np.median([r.get(s, 0.0) for r in row['rounds']]):6.1f}"
            for s in ("p2g", "grid", "g2p")
        )
        lines.append(
            f"{row['name']:34s} {row['particles']:9,} {np.median(times):5.1f} {min(times):5.1f}"
            f"{stages} {ratio:12.2f}"
        )
    return "\n".join(lines)
