"""How fast this processor is: a cube of a fluid and one of an elastic solid, timed for a moment and
kept in the user's folder.
"""

import json
import logging
import math
import time
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np

from ..device.processor import model, user_folder
from ..domain.ranks import Alone
from ..output.store import replace_text
from ..planning.pace import ASSUMED, Pace
from ..planning.plan import Plan, make_plan
from ..scene.reader import load
from .step import Simulation
from .warm import warm

log = logging.getLogger("vgmpi")

SIDE = 20  # cells of a cube's edge: 64,000 particles, more than the second level cache holds
ROOM = 44  # cells of the domain's
CYCLES = 7  # from sort to sort, of some 20 steps each
FAR = 0.05  # cells that the cube moves per step
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
transfer = "apic"
precision = "{precision}"
[material.stuff]
{law}
[[object]]
name = "cube"
material = "stuff"
shape = {{ box = [[0, 0, 0], [0.2, 0.2, 0.2]] }}
position = [0.2, 0.2, 0.1]
"""


def pace(precision: str, anew: bool = False) -> Pace:
    """This processor's, as kept, or measured now where it is not or `anew`. What cannot be measured
    is assumed, and a line says so."""
    found = None if anew else kept(precision)
    if found is not None:
        return found
    log.info(
        "measuring this processor for --plan, %s precision: a second once the code is compiled",
        precision,
    )
    try:
        spent = {law: measure(law, precision) for law in LAWS}
    except Exception as error:  # a plan without it is worth more than none
        log.warning("this processor cannot be measured: %s: %s", type(error).__name__, error)
        return ASSUMED[precision]
    _keep(precision, spent)
    return _told(spent, time.strftime("%Y-%m-%d"))


def kept(precision: str) -> Pace | None:
    """What was measured on such a processor by this version, or None."""
    found = _read().get(_key(precision))
    if not isinstance(found, dict):
        return None
    spent = {law: found.get(law) for law in LAWS}
    sound = all(isinstance(ns, float) and 0.1 < ns < 1e6 for ns in spent.values())
    when = found.get("when")
    if not sound or not isinstance(when, str) or len(when) != 10 or not when.isprintable():
        return None
    return _told(spent, when)


def measure(law: str, precision: str) -> float:
    """ns per particle and step of a cube in free flight, sorts in their share; its own time on this
    core, the least of some cycles, so that what else the machine does counts little. Compiles first
    where it must."""
    keys = {"room": ROOM / 100, "precision": precision, "law": LAWS[law]}
    scene = load(Path("calibration"), text=SCENE.format(**keys))
    x = _lattice(scene.domain.cell)
    plan = make_plan(scene, [len(x)], [len(x) * scene.domain.cell**3 / 8], False)
    warm(plan, Alone())
    simulation, dt = _cube(plan, x)
    _cycle(simulation, dt)  # memory and code are warm, and the first sort is over
    return min(_cycle(simulation, dt) for _ in range(CYCLES))


def _lattice(dx: float) -> np.ndarray:
    """Eight places per cell (n, 3) [m], jittered, so that cells hold unequal numbers."""
    line = (np.arange(2 * SIDE) + 0.5) * 0.5 + (ROOM - SIDE) / 4
    x = np.stack(np.meshgrid(line, line, line, indexing="ij"), -1).reshape(-1, 3)
    return dx * (x + np.random.default_rng(7).uniform(-0.2, 0.2, x.shape))


def _cube(plan: Plan, x: np.ndarray) -> tuple[Simulation, float]:
    """The particles in motion, with some shear and compression, and their time step [s]."""
    simulation, n = Simulation(plan, Alone()), len(x)
    ids, things = np.arange(n), np.zeros(n, np.int64)
    volume = np.full(n, plan.dx**3 / 8)
    law = plan.groups[0]
    dt = 0.3 * plan.dx / math.sqrt(plan.stiff[0] / law.density)
    swirl = np.sin(2 * np.pi * x / (SIDE * plan.dx))
    v = FAR * plan.dx / dt * (np.array([0.9, 0.7, 0.5]) + 0.05 * swirl)
    simulation.put(x, v, volume, ids, things)
    return simulation, dt


def _cycle(simulation: Simulation, dt: float) -> float:
    """ns per particle and step from one sort to the next."""
    sorts, steps, began = simulation.sorts, 0, time.thread_time()
    while simulation.sorts == sorts and steps < 100:
        simulation.advance(dt)
        steps += 1
    return 1e9 * (time.thread_time() - began) / steps / simulation.plan.particles


def _told(spent: dict, when: str) -> Pace:
    return Pace(spent["fluid"], spent["elastic"], f"measured on {model()}, {when}")


def _path() -> Path:
    return user_folder() / "pace.json"


def _key(precision: str) -> str:
    try:
        own = version("vgmpi")
    except PackageNotFoundError:
        own = "not installed"
    return f"{model()}, vgmpi {own}, {precision}"


def _read() -> dict:
    """What is kept; nothing where the file is not there or damaged."""
    try:
        found = json.loads(_path().read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


def _keep(precision: str, spent: dict[str, float]) -> None:
    entry = {"when": time.strftime("%Y-%m-%d"), **spent}
    text = json.dumps(_read() | {_key(precision): entry}, indent=1)
    try:
        _path().parent.mkdir(parents=True, exist_ok=True)
        replace_text(_path(), text + "\n")
    except OSError as error:
        log.info("what was measured cannot be kept: %s", error)
