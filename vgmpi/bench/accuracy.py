"""How exact single precision is beside double, where nodes are nearly empty or motion is slow: a
thin spray of two phases, particles of very different volumes, the same in both precisions.
"""

import tempfile
from pathlib import Path

import numpy as np

from ..domain.ranks import Alone
from ..planning.plan import make_plan
from ..scene.reader import load
from ..solver.state import by_id
from ..solver.step import Simulation

SCENE = """
[domain]
size = [0.4, 0.4, 0.4]
cell = 0.01
gravity = [0, 0, 0]
[time]
end = 1
[accuracy]
precision = "PRECISION"
[material.water]
kind = "fluid"
bulk_modulus = 1e5
[material.rubber]
kind = "elastic"
youngs_modulus = 1e5
[[object]]
name = "spray"
material = "water"
shape = { box = [[0, 0, 0], [0.1, 0.1, 0.1]] }
[[object]]
name = "crumbs"
material = "rubber"
shape = { box = [[0.2, 0, 0], [0.3, 0.1, 0.1]] }
"""
SPEEDS = (1.0, 1e-3, 1e-6)  # [m/s]
STEPS = 60
WEIGHTS = 2.0 ** np.array([-45.0, -33.0, -27.0, -21.0, -15.0, -9.0, 9.0])  # of a full cell


def spray(folder: Path, precision: str, particles: int, speed: float) -> Simulation:
    """Particles at random, half of each phase."""
    path = folder / f"{precision}.toml"
    path.write_text(SCENE.replace("PRECISION", precision))
    scene, random = load(path), np.random.default_rng(7)
    half = particles // 2
    plan = make_plan(scene, [half, half], [1e-4, 1e-4], False)
    x = random.uniform(0.05, 0.35, (2 * half, 3))
    v = speed * random.standard_normal((2 * half, 3))
    volume = plan.dx**3 / 8 * 10.0 ** random.uniform(-4, 0, 2 * half)
    made = Simulation(plan, Alone())
    made.put(x, v, volume, np.arange(2 * half), np.repeat([0, 1], half))
    return made


def velocities(folder: Path, particles: int, speed: float) -> float:
    """Root mean square of the difference of velocities after STEPS steps, relative to their own."""
    one, two = (spray(folder, name, particles, speed) for name in ("single", "double"))
    dt = 0.5 * two.bound()
    for _ in range(STEPS):
        one.advance(dt)
        two.advance(dt)
    (v,), (exact,) = by_id(one, "v"), by_id(two, "v")
    return float(np.sqrt(((v - exact) ** 2).sum(1).mean() / (exact**2).sum(1).mean()))


def directions(folder: Path, particles: int) -> list[tuple[float, int, float]]:
    """(least weight [full cells], nodes, root mean square of the angle [rad] between directions of
    offsets) of the nodes between one of WEIGHTS and the next."""
    found = []
    for name in ("single", "double"):
        made = spray(folder, name, particles, 1.0)
        engine = made.engine
        dt = 0.5 * made.bound()
        engine.begin(dt, np.zeros(3), made.plan.dx / dt)
        engine.fill(border=True)
        engine.fill(border=False)
        engine.update(border=False)
        nodes = engine.layers["offsets"].nodes[: len(made.tables.phase)]
        found.append(nodes.reshape(-1, 4).astype(np.float64))
    got, want = found
    weight = want[:, 3] / made.plan.dx**3
    length = [np.linalg.norm(one[:, :3], axis=1) for one in found]
    cross = np.linalg.norm(np.cross(got[:, :3], want[:, :3]), axis=1)
    some = (length[1] > 0) & (length[0] > 0)
    angle = np.where(some, cross / np.where(some, length[0] * length[1], 1.0), 1.0)
    rows = []
    for low, high in zip(WEIGHTS, WEIGHTS[1:], strict=False):
        here = (weight >= low) & (weight < high) & (length[1] > 0)
        rows.append((low, int(here.sum()), float(np.sqrt((angle[here] ** 2).mean()))))
    return rows


def text(particles: int) -> str:
    """The tables."""
    with tempfile.TemporaryDirectory(prefix="vgmpi-bench-") as name:
        folder = Path(name)
        lines = [f"single beside double, a spray of {particles:,} particles in {40**3:,} cells:"]
        for speed in SPEEDS:
            error = velocities(folder, particles, speed)
            lines.append(
                f"  {speed:g} m/s: velocities after {STEPS} steps {error:.1e} of their own"
            )
        lines.append("  directions of offsets at nodes, by the node's share of a full cell:")
        for low, count, angle in directions(folder, particles):
            lines.append(f"    from 2^{np.log2(low):.0f}: {angle:.1e} rad ({count:,} nodes)")
    return "\n".join(lines)
