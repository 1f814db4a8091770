"""How exact single precision is beside double, where nodes are nearly empty or motion is slow: a
thin spray of two phases, particles of very different volumes, the same in both precisions.
"""

import tempfile
from pathlib import Path

import numpy as np

from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.planning.plan import make_plan
from vgmpi.scene.loader import load
from vgmpi.solver.restart.state_io import by_id
from vgmpi.solver.simulation import Simulation

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
tait_coefficient = 1e5
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
    """Return a simulation of random particles, half of them in each phase.

    Args:
        folder: Folder for the scene.
        precision: "single" or "double".
        particles: Number of particles.
        speed: Scale of the random velocities [m/s].
    """
    path = folder / f"{precision}.toml"
    path.write_text(SCENE.replace("PRECISION", precision))
    scene, random = load(path), np.random.default_rng(7)
    half = particles // 2
    plan = make_plan(scene, [half, half], [1e-4, 1e-4], False)
    x = random.uniform(0.05, 0.35, (2 * half, 3))
    v = speed * random.standard_normal((2 * half, 3))
    volume = plan.dx**3 / 8 * 10.0 ** random.uniform(-4, 0, 2 * half)
    simulation = Simulation(plan, SerialCommunicator())
    simulation.put(x, v, volume, np.arange(2 * half), np.repeat([0, 1], half))
    return simulation


def velocities(folder: Path, particles: int, speed: float) -> float:
    """Root mean square of the difference of velocities after STEPS steps, relative to their own."""
    single, double = (spray(folder, name, particles, speed) for name in ("single", "double"))
    dt = 0.5 * double.bound()
    for _ in range(STEPS):
        single.advance(dt)
        double.advance(dt)
    (v,), (exact,) = by_id(single, "v"), by_id(double, "v")
    return float(np.sqrt(((v - exact) ** 2).sum(1).mean() / (exact**2).sum(1).mean()))


def directions(folder: Path, particles: int) -> list[tuple[float, int, float]]:
    """Compare directions of offsets at nodes in single and double precision.

    Rows are (smallest weight [full cells], nodes, RMS angle [rad]) between one of WEIGHTS and the
    next.
    """
    offsets = []
    for name in ("single", "double"):
        simulation = spray(folder, name, particles, 1.0)
        engine = simulation.engine
        dt = 0.5 * simulation.bound()
        engine.begin(dt, np.zeros(3), simulation.plan.dx / dt)
        engine.fill(border=True)
        engine.fill(border=False)
        engine.update(border=False)
        nodes = engine.layers["offsets"].nodes[: len(simulation.tables.phase)]
        offsets.append(nodes.reshape(-1, 4).astype(np.float64))
    got, want = offsets
    weight = want[:, 3] / simulation.plan.dx**3
    length = [np.linalg.norm(vectors[:, :3], axis=1) for vectors in offsets]
    cross = np.linalg.norm(np.cross(got[:, :3], want[:, :3]), axis=1)
    nonzero = (length[1] > 0) & (length[0] > 0)
    angle = np.where(nonzero, cross / np.where(nonzero, length[0] * length[1], 1.0), 1.0)
    rows = []
    for low, high in zip(WEIGHTS, WEIGHTS[1:], strict=False):
        in_range = (weight >= low) & (weight < high) & (length[1] > 0)
        rows.append((low, int(in_range.sum()), float(np.sqrt((angle[in_range] ** 2).mean()))))
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
