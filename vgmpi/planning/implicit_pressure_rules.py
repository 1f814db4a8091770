"""Scenes with an implicit pressure: what they may contain, and the bound of their steps."""

import math

from vgmpi.scene.gravity import gravity_keys
from vgmpi.scene.scene import Scene
from vgmpi.scene.scene_feature import features

from .phases_and_groups import GroupPlan, PhasePlan

WALL_KINDS = ("slip", "stick")
RIGID_STEPS = 10.0  # [-] steps of rigid bodies alone in the time in which a drop falls `cfl` cells


def is_implicit(scene: Scene) -> bool:
    """Return whether the grid finds the pressure of the scene's liquid."""
    return scene.accuracy.pressure == "implicit"


def falling_rate(scene: Scene) -> float:
    """Return the least 1 / dt [1/s] that gravity asks for where no waves bound the step, else 0.

    With an implicit pressure a drop at rest falls by less than `cfl` cells in a step. In a scene of
    rigid bodies alone a step is RIGID_STEPS times shorter, for the error of their way: it is half
    the way of a step. Without gravity the time between two frames takes the place of this one.
    """
    if not is_implicit(scene) and scene.has_particles:
        return 0.0
    keys = [scene.domain.gravity, *(gravity for _, gravity in gravity_keys(scene.domain))]
    gravity = max(math.sqrt(sum(g * g for g in key)) for key in keys)
    falling = math.sqrt(2.0 * gravity / scene.domain.cell) / scene.courant_number
    falling = falling or (scene.time.frames - 1) / scene.time.end
    return falling if scene.has_particles else RIGID_STEPS * falling


def check_implicit_pressure(
    scene: Scene, groups: tuple[GroupPlan, ...], phases: tuple[PhasePlan, ...]
) -> None:
    """Raise SceneError if a scene with an implicit pressure has more than one liquid and walls."""
    wrong = obstacles(scene, groups, phases) if is_implicit(scene) else []
    if wrong:
        raise scene.error(wrong)


def suits_implicit_pressure(
    scene: Scene, groups: tuple[GroupPlan, ...], phases: tuple[PhasePlan, ...]
) -> bool:
    """Return whether a scene could have an implicit pressure, and has not chosen otherwise."""
    chosen = {"pressure", "transfer", "volume_correction", "dilatation"}
    if chosen & scene.accuracy.model_fields_set:
        return False
    return not obstacles(scene, groups, phases)


def obstacles(
    scene: Scene, groups: tuple[GroupPlan, ...], phases: tuple[PhasePlan, ...]
) -> list[tuple[tuple, str]]:
    """Return (path of a key, message) of all that an implicit pressure does not know.

    Args:
        scene: The scene.
        groups: All groups.
        phases: All phases.
    """
    wrong: list[tuple[tuple, str]] = []

    def _refuse(path: tuple, feature: str) -> None:
        wrong.append((path, f"accuracy.pressure = 'implicit' is not for {feature}"))

    for name in dict.fromkeys(group.material for group in groups):
        if scene.material[name].kind != "fluid":  # type: ignore[attr-defined]
            _refuse(("material", name, "kind"), "materials that are no fluid")
    if len(phases) > 1 or len({group.density for group in groups}) > 1:
        _refuse(("accuracy", "pressure"), "several phases or densities")
    for k, obj in enumerate(scene.object):
        values = {
            "collider": obj.collider, "rigid": obj.rigid, "motion": obj.motion,
            "release_time": obj.release_time,
            **{key: True for feature in features() for key in feature.keys_of(obj)},
        }  # fmt: skip
        for key, value in values.items():
            if value:
                _refuse(("object", k, key), "colliders and bodies that are held or moved")
    for name, items in (("inlet", scene.inlet), ("outlet", scene.outlet)):
        if items:
            _refuse((name, 0), "inlets and outlets")
    for k, probe in enumerate(scene.probe):
        if probe.feels:
            key = "wall" if probe.wall else "collider"
            _refuse(("probe", k, key), "probes of forces on a wall or collider")
    kinds = {kind for kind, _ in scene.domain.walls}
    if not kinds <= set(WALL_KINDS) or any(time is not None for time in scene.domain.opens):
        _refuse(("domain", "boundary"), "walls other than slip and stick")
    return wrong
