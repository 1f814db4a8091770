"""Throughput of this processor: cubes of a fluid and of an elastic solid, timed for a moment.

The result is kept in the user's cache folder.
"""

import json
import logging
import math
import statistics
import time
import zlib
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np

from vgmpi.io.hdf5_writer import replace_text
from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.planning.cost.throughput import ASSUMED_THROUGHPUT, Throughput
from vgmpi.planning.plan import Plan, make_plan
from vgmpi.runtime.cache_files import user_folder
from vgmpi.runtime.cpu_features import model
from vgmpi.runtime.user_files import MAX_TEXT_BYTES, read_regular_file
from vgmpi.scene.loader import load
from vgmpi.solver.compile_kernels import compile_kernels
from vgmpi.solver.simulation import Simulation

log = logging.getLogger("vgmpi")

SIDE = 20  # [cells] edge of a cube: 64,000 particles exceed the second-level cache
DOMAIN_CELLS = 44  # [cells] edge of the domain
CYCLES = 7  # number of timed cycles from sort to sort, some 20 steps each
CELLS_PER_STEP = 0.05  # [cells] displacement of the cube per step
LAWS = {
    "fluid": 'kind = "fluid"',
    "elastic": 'kind = "elastic"\ndensity = 1000\nyoungs_modulus = 1e6',
}
SCENE = """
[domain]
size = [{room!r}, {room!r}, {room!r}]
cell = 0.01
gravity = [0, 0, 0]
[time]
end = 1
[accuracy]
pressure = "explicit"
transfer = "apic"
volume_correction = "none"
precision = "{precision}"
[material.stuff]
{law}
[[object]]
name = "cube"
material = "stuff"
shape = {{ box = [[0, 0, 0], [0.2, 0.2, 0.2]] }}
position = [0.2, 0.2, 0.1]
"""


def host_throughput(precision: str, remeasure: bool = False) -> Throughput:
    """Return the throughput of this processor, from the cache or measured now.

    A throughput that cannot be measured is assumed, and a line is logged.

    Args:
        precision: `double` or `single`, as in the scene.
        remeasure: Measure even if the cache has a value.
    """
    cached = None if remeasure else cached_throughput(precision)
    if cached is not None:
        return cached
    log.info(
        "measuring this processor for --plan, %s precision: a second once the code is compiled",
        precision,
    )
    try:
        spent = {law: measure_throughput(law, precision) for law in LAWS}
    except Exception as error:  # a plan without a measurement is better than none
        log.warning("this processor cannot be measured: %s: %s", type(error).__name__, error)
        return ASSUMED_THROUGHPUT[precision]
    _store(precision, spent)
    return _throughput(spent, time.strftime("%Y-%m-%d"))


def cached_throughput(precision: str) -> Throughput | None:
    """Return the throughput that this version measured on such a processor, or None."""
    entry = _read_cache().get(_key(precision))
    if not isinstance(entry, dict):
        return None
    spent = {law: entry.get(law) for law in LAWS}
    is_valid = all(isinstance(ns, float) and 0.1 < ns < 1e6 for ns in spent.values())
    when = entry.get("when")
    if not is_valid or not isinstance(when, str) or len(when) != 10 or not when.isprintable():
        return None
    return _throughput(spent, when)


def measure_throughput(law: str, precision: str) -> float:
    """Return the time [ns] per particle and step of a cube in free flight, including its sorts.

    It is the CPU time on this core, the median of several cycles: other programs that share its
    caches make a run slower as well, and single disturbed cycles do not count. Kernels are compiled
    first if they must be.
    """
    keys = {"room": DOMAIN_CELLS / 100, "precision": precision, "law": LAWS[law]}
    scene = load(Path("calibration"), text=SCENE.format(**keys))
    x = _lattice(scene.domain.cell)
    plan = make_plan(scene, [len(x)], [len(x) * scene.domain.cell**3 / 8], False)
    compile_kernels(plan, SerialCommunicator())
    simulation, dt = _cube(plan, x)
    _cycle(simulation, dt)  # memory and code are warm, and the first sort is over
    return statistics.median(_cycle(simulation, dt) for _ in range(CYCLES))


def _lattice(dx: float) -> np.ndarray:
    """Return eight jittered positions per cell (n, 3) [m], so that cells hold unequal numbers."""
    line = (np.arange(2 * SIDE) + 0.5) * 0.5 + (DOMAIN_CELLS - SIDE) / 4
    x = np.stack(np.meshgrid(line, line, line, indexing="ij"), -1).reshape(-1, 3)
    return dx * (x + np.random.default_rng(7).uniform(-0.2, 0.2, x.shape))


def _cube(plan: Plan, x: np.ndarray) -> tuple[Simulation, float]:
    """Return a moving cube with some shear and compression, and its time step [s]."""
    simulation, n = Simulation(plan, SerialCommunicator()), len(x)
    ids, owners = np.arange(n), np.zeros(n, np.int64)
    volume = np.full(n, plan.dx**3 / 8)
    law = plan.groups[0]
    dt = 0.3 * plan.dx / math.sqrt(plan.contact.stiffness[0] / law.density)
    swirl = np.sin(2 * np.pi * x / (SIDE * plan.dx))
    v = CELLS_PER_STEP * plan.dx / dt * (np.array([0.9, 0.7, 0.5]) + 0.05 * swirl)
    simulation.put(x, v, volume, ids, owners)
    return simulation, dt


def _cycle(simulation: Simulation, dt: float) -> float:
    """Return the time [ns] per particle and step from one sort to the next."""
    sorts, steps, start = simulation.sorts, 0, time.thread_time()
    while simulation.sorts == sorts and steps < 100:
        simulation.advance(dt)
        steps += 1
    return 1e9 * (time.thread_time() - start) / steps / simulation.plan.particles


def _throughput(spent: dict, when: str) -> Throughput:
    """Return the throughput as a record with its origin."""
    return Throughput(spent["fluid"], spent["elastic"], f"measured on {model()}, {when}")


def _path() -> Path:
    """Return the path of the cache file."""
    return user_folder() / "pace.json"


def _key(precision: str) -> str:
    """Return the key of the cache for this processor, version, precision and measurement."""
    try:
        package_version = version("vgmpi")
    except PackageNotFoundError:
        package_version = "not installed"
    cube = zlib.crc32(SCENE.encode())
    return f"{model()}, vgmpi {package_version}, {precision}, cube {cube:08x}"


def _read_cache() -> dict:
    """Return the content of the cache; empty if the file is missing or damaged."""
    try:
        content = json.loads(read_regular_file(_path(), MAX_TEXT_BYTES))
    except (OSError, ValueError, RecursionError):
        return {}
    return content if isinstance(content, dict) else {}


def _store(precision: str, spent: dict[str, float]) -> None:
    """Add a measurement to the cache; a failure is only logged."""
    entry = {"when": time.strftime("%Y-%m-%d"), **spent}
    text = json.dumps(_read_cache() | {_key(precision): entry}, indent=1)
    try:
        _path().parent.mkdir(parents=True, exist_ok=True)
        replace_text(_path(), text + "\n")
    except OSError as error:
        log.info("what was measured cannot be kept: %s", error)
