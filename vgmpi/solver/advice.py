"""What a run that has ended says would have made it cheaper: from how fast things moved, and from
what did not move at all.
"""

import math

from ..materials.fluid import Fluid
from ..planning.advice import WORTH, stiffness
from ..planning.plan import Plan, fastest
from ..scene.scene import Scene
from ..source import printable
from .step import Simulation

ROOM = 1.2  # times as fast as was seen a liquid may become
# a body stands still that would go less than this in the whole run, and whose strain is less
STILL, STIFF = 0.1, 1e-3  # [cells], [1]
FRAMES = 5  # of which as many are looked at, at least


class Seen:
    """What advice is made of. speed: [m/s] nothing was faster; of each phase, by its name, on
    rank 0: largest kinetic and elastic energy [J], range of the potential one [J], mass [kg]."""

    def __init__(self):
        self.speed = 0.0
        self.frames = 0
        self.kinetic: dict[str, float] = {}
        self.elastic: dict[str, float] = {}
        self.potential: dict[str, tuple[float, float]] = {}
        self.mass: dict[str, float] = {}

    def step(self, simulation: Simulation) -> None:
        """Called after every step."""
        # of one axis
        self.speed = max(self.speed, math.sqrt(3.0) * simulation.reach.speed)

    def frame(self, entries: list[dict]) -> None:
        """Called with the ledger of every frame."""
        self.frames += 1
        for entry in entries:
            name, height = entry["phase"], entry["potential"]
            self.kinetic[name] = max(self.kinetic.get(name, 0.0), entry["kinetic"])
            self.elastic[name] = max(self.elastic.get(name, 0.0), entry["elastic"])
            low, high = self.potential.get(name, (height, height))
            self.potential[name] = min(low, height), max(high, height)
            self.mass[name] = entry["mass"]


def advice(scene: Scene, plan: Plan, seen: Seen) -> list[str]:
    """Lines; none where nothing is known, as on other ranks."""
    if not seen.mass:
        return []
    return _softer(scene, plan, seen) + _still(scene, plan, seen)


def _softer(scene: Scene, plan: Plan, seen: Seen) -> list[str]:
    """The liquid that sets the time step, where it is stiffer than its motion asks for."""
    bounds = fastest(scene, plan)
    dt, what = bounds[0]
    name = next((name for name in scene.material if what == f"material {name!r}"), None)
    if name is None:
        return []
    material = scene.material[name]
    if plan.fixed_dt or not isinstance(material, Fluid) or material.depth is not None:
        return []
    if any(group.porous for group in plan.groups if group.material == name):
        return []  # its waves are those of the sand as well
    allowed = material.compression
    speed = max(ROOM * seen.speed, 1e-3 * plan.dx / dt)
    modulus = material.bulk_modulus * material.gamma  # [Pa]
    least = material.density * speed**2 / allowed
    for group in plan.groups:
        if group.material == name:  # what weighs on it compresses it as well
            least = max(least, modulus * _compressed(plan, seen, group.phase, modulus) / allowed)
    wave = math.sqrt(least / material.density)
    others = [bound for bound, of in bounds if of != what]
    longer = min([plan.cfl * plan.dx / (wave + speed), *others])
    if longer < WORTH * dt:
        return []
    key = stiffness(material)
    value = math.sqrt(allowed * least / material.density)
    unit = "m/s"
    if key == "bulk_modulus":
        value, unit = least / material.gamma, "Pa"
    return [
        f"advice: nothing moved faster than {seen.speed:.2g} m/s:"
        f" {scene.place(('material', name, key))} could be {_up(value):g} {unit} instead of"
        f" {getattr(material, key):g}, and steps {longer / dt:.1f} times as long;"
        f" compression stays under {100 * allowed:g} %"
    ]


def _compressed(plan: Plan, seen: Seen, phase: int, modulus: float) -> float:
    """Relative change of volume of a phase at its deepest [1], from its energy: that of a column is
    sqrt(3) times its root mean square."""
    name = plan.phases[phase].name
    volume = seen.mass[name] / max(g.density for g in plan.groups if g.phase == phase)
    return math.sqrt(3.0 * 2.0 * max(seen.elastic[name], 0.0) / max(modulus * volume, 1e-300))


def _still(scene: Scene, plan: Plan, seen: Seen) -> list[str]:
    """Bodies that neither moved nor deformed."""
    if seen.frames < FRAMES:
        return []
    end, weight = float(plan.times[-1]), math.hypot(*plan.gravity)
    found = []
    for p, phase in enumerate(plan.phases):
        mass = seen.mass.get(phase.name, 0.0)
        held = any(k in driven.things for driven in plan.driven for k in phase.objects)
        if phase.families != ("solid",) or held or mass <= 0.0:
            continue
        density = max(g.density for g in plan.groups if g.phase == p)
        goes = math.sqrt(2.0 * max(seen.kinetic[phase.name], 0.0) / mass) * end
        low, high = seen.potential[phase.name]
        sank = (high - low) / (mass * weight) if weight else 0.0
        energy = 2.0 * max(seen.elastic[phase.name], 0.0) * density / mass  # [J/m3]
        strain = math.sqrt(energy / plan.stiff[p])
        if max(goes, sank) < STILL * plan.dx and strain < STIFF:
            found += [_as_scenery(scene, plan, k) for k in phase.objects]
    return found


def _as_scenery(scene: Scene, plan: Plan, k: int) -> str:
    return (
        f"advice: body '{printable(scene.things[k].name)}' neither moved nor deformed: as scenery"
        f" with collider = true, {scene.place(('object', k))}, it would save"
        f" {plan.count[k]:,} of {plan.particles:,} particles"
    )


def _up(value: float) -> float:
    """The next number above with two digits."""
    size = 10.0 ** (math.floor(math.log10(value)) - 1)
    return float(f"{math.ceil(value / size * (1 - 1e-9)) * size:.3g}")
