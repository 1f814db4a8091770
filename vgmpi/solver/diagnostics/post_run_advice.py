"""Advice after a run: settings that would have made it cheaper, from observed speeds and rest."""

import math

from vgmpi.materials.newtonian_fluid import Fluid
from vgmpi.planning.cost.timestep_advice import MIN_STEP_GAIN, stiffness_key
from vgmpi.planning.plan import Plan, time_step_bounds
from vgmpi.runtime.config.toml_source import escape_control_characters
from vgmpi.scene.scene import Scene
from vgmpi.solver.simulation import Simulation

SPEED_MARGIN = 1.2  # [-] margin of a liquid's speed over the observed one
# A body counts as still if its displacement in the whole run and its strain stay below these.
MAX_DISPLACEMENT_CELLS, MAX_STRAIN = 0.1, 1e-3  # [cells], [-]
FRAMES = 5  # least number of observed frames


class RunObserver:
    """Observations of a run from which advice is made.

    `speed` [m/s] is an upper bound of all speeds. By name of the phase, on rank 0: largest kinetic
    and elastic energy [J], range of the potential energy [J], mass [kg].
    """

    def __init__(self):
        """Begin without observations."""
        self.speed = 0.0
        self.frames = 0
        self.kinetic: dict[str, float] = {}
        self.elastic: dict[str, float] = {}
        self.potential: dict[str, tuple[float, float]] = {}
        self.mass: dict[str, float] = {}

    def step(self, simulation: Simulation) -> None:
        """Record the speeds of a step; called after every step."""
        # the reach bounds the speed along one axis
        self.speed = max(self.speed, math.sqrt(3.0) * simulation.particle_maxima.speed)

    def frame(self, entries: list[dict]) -> None:
        """Record the conservation entries of a frame; called at every frame."""
        self.frames += 1
        for entry in entries:
            name, height = entry["phase"], entry["potential_energy"]
            self.kinetic[name] = max(self.kinetic.get(name, 0.0), entry["kinetic_energy"])
            self.elastic[name] = max(self.elastic.get(name, 0.0), entry["elastic_energy"])
            low, high = self.potential.get(name, (height, height))
            self.potential[name] = min(low, height), max(high, height)
            self.mass[name] = entry["mass"]


def advice(scene: Scene, plan: Plan, observed: RunObserver) -> list[str]:
    """Return lines of advice; none if nothing was observed, as on ranks other than 0."""
    if not observed.mass:
        return []
    return _stiffness_advice(scene, plan, observed) + _scenery_advice(scene, plan, observed)


def _stiffness_advice(scene: Scene, plan: Plan, observed: RunObserver) -> list[str]:
    """Advise to soften the liquid that limits the time step, if its motion allows it."""
    limits = time_step_bounds(scene, plan)
    dt, limit = limits[0]
    name = next((name for name in scene.material if limit == f"material {name!r}"), None)
    if name is None:
        return []
    material = scene.material[name]
    if plan.time_step.fixed or not isinstance(material, Fluid) or material.max_depth is not None:
        return []
    if any(group.stores_porosity for group in plan.groups if group.material == name):
        return []  # its waves travel in the sand as well
    allowed = material.max_compression
    speed = max(SPEED_MARGIN * observed.speed, 1e-3 * plan.dx / dt)
    modulus = material.tait_coefficient * material.tait_exponent  # [Pa]
    minimum_modulus = material.density * speed**2 / allowed
    for group in plan.groups:
        if group.material == name:  # the load on it compresses it as well
            minimum_modulus = max(
                minimum_modulus,
                modulus * _compression(plan, observed, group.phase, modulus) / allowed,
            )
    wave = math.sqrt(minimum_modulus / material.density)
    others = [bound for bound, source in limits if source != limit]
    longer = min([plan.time_step.cfl * plan.dx / (wave + speed), *others])
    if longer < MIN_STEP_GAIN * dt:
        return []
    key = stiffness_key(material)
    value = math.sqrt(allowed * minimum_modulus / material.density)
    unit = "m/s"
    if key == "tait_coefficient":
        value, unit = minimum_modulus / material.tait_exponent, "Pa"
    return [
        f"advice: nothing moved faster than {observed.speed:.2g} m/s:"
        f" {scene.place(('material', name, key))} could be {_round_up(value):g} {unit} instead of"
        f" {getattr(material, key):g}, and steps {longer / dt:.1f} times as long;"
        f" compression stays under {100 * allowed:g} %"
    ]


def _compression(plan: Plan, observed: RunObserver, phase: int, modulus: float) -> float:
    """Return the greatest relative compression [-] of a phase, from its elastic energy.

    The energy gives the root mean square; the bottom of a column has sqrt(3) times that.
    """
    name = plan.phases[phase].name
    volume = observed.mass[name] / max(g.density for g in plan.groups if g.phase == phase)
    return math.sqrt(3.0 * 2.0 * max(observed.elastic[name], 0.0) / max(modulus * volume, 1e-300))


def _scenery_advice(scene: Scene, plan: Plan, observed: RunObserver) -> list[str]:
    """Advise to turn bodies that neither moved nor deformed into scenery."""
    if observed.frames < FRAMES:
        return []
    end, weight = float(plan.times[-1]), math.hypot(*plan.gravity.vector)
    lines = []
    for p, phase in enumerate(plan.phases):
        mass = observed.mass.get(phase.name, 0.0)
        later = (feature.groups_after_release() for feature in plan.features)
        is_released = any(not groups.keys().isdisjoint(phase.objects) for groups in later)
        if phase.families != ("solid",) or is_released or mass <= 0.0:
            continue
        density = max(g.density for g in plan.groups if g.phase == p)
        displacement = math.sqrt(2.0 * max(observed.kinetic[phase.name], 0.0) / mass) * end
        low, high = observed.potential[phase.name]
        sank = (high - low) / (mass * weight) if weight else 0.0
        energy = 2.0 * max(observed.elastic[phase.name], 0.0) * density / mass  # [J/m3]
        strain = math.sqrt(energy / plan.contact.stiffness[p])
        if max(displacement, sank) < MAX_DISPLACEMENT_CELLS * plan.dx and strain < MAX_STRAIN:
            lines += [_as_scenery(scene, plan, k) for k in phase.objects]
    return lines


def _as_scenery(scene: Scene, plan: Plan, k: int) -> str:
    """Return the line that advises to make object number `k` scenery."""
    return (
        f"advice: body '{escape_control_characters(scene.entities[k].name)}' neither moved nor"
        f" deformed: as scenery with collider = true, {scene.place(('object', k))}, it would save"
        f" {plan.count[k]:,} of {plan.particles:,} particles"
    )


def _round_up(value: float) -> float:
    """Return the next larger number with two significant digits."""
    size = 10.0 ** (math.floor(math.log10(value)) - 1)
    return float(f"{math.ceil(value / size * (1 - 1e-9)) * size:.3g}")
