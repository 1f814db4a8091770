"""Plan of loads: the particles on which they act, and force densities."""

from typing import Any, NamedTuple

import numpy as np

from vgmpi.planning.feature_plan import FeaturePlan
from vgmpi.preprocess.body_regions import densities_of, index_runs
from vgmpi.preprocess.object_builder import spacing_of
from vgmpi.preprocess.shape_sdf import contains
from vgmpi.scene.scene import Scene
from vgmpi.scene.scene_feature import InitialParticles

from .table import FACES, Load

Vector = tuple[float, float, float]


class ResolvedLoad(NamedTuple):
    """Load with its particles; equal on every rank."""

    load: Load
    ids: np.ndarray  # (m, 2) runs of particle ids, first and last, ascending
    # [N/m3 of rest volume, or N s/m3], 0 for loads that are equal for all
    density: Vector
    total: Vector  # [N, or N s] on all of them at full strength


class LoadsPlan(FeaturePlan):
    """Loads of a run."""

    name = "loads"
    drives_motion = True

    def __init__(self, loads: tuple[ResolvedLoad, ...]):
        """Take the loads."""
        self.loads = loads

    def for_compilation(self) -> "LoadsPlan":
        """Return the plan of no loads."""
        return LoadsPlan(())

    def start(self, context: Any) -> Any:
        """Return the loads as they act in a run.

        Args:
            context: See `FeaturePlan.start`.
        """
        from .coupling import Loads  # it compiles

        return Loads(self.loads, context)


def resolve_loads(scene: Scene, particles: InitialParticles) -> list[ResolvedLoad]:
    """Return the loads of a scene with their particles.

    Args:
        scene: The scene.
        particles: Particles at the start.

    Raises:
        SceneError: A load acts on no particle.
    """
    x, vol0, owner = particles.x, particles.vol0, particles.owner
    number = {o.name: k for k, o in enumerate(scene.object)}
    loads, errors, densities = [], [], densities_of(particles.entries, owner)
    for k, load in enumerate(scene.lists["load"]):
        chosen = np.isin(owner, [number[name] for name in load.object])
        spacing = max(spacing_of(scene, scene.object[number[name]]) for name in load.object)
        if load.region is not None:
            chosen[chosen] = contains(load.region, x[chosen], spacing)
        if not chosen.any():
            message = f"holds no particle of {', '.join(load.object)} at the start"
            errors.append((("load", k, "region" if load.region is not None else "object"), message))
            continue
        loads.append(_loaded(load, chosen, spacing, x, vol0, densities))
    if errors:
        raise scene.error(errors)
    return loads


def _loaded(load, chosen, spacing, x, vol0, densities) -> ResolvedLoad:
    """Return one load with its particles."""
    uniform = (
        load.acceleration
        or load.delta_velocity
        or ((load.delta_angular_velocity or load.damping) and (0.0, 0.0, 0.0))
    )
    if uniform is not None:
        mass = float((densities[chosen] * vol0[chosen]).sum())
        total = mass * uniform[0], mass * uniform[1], mass * uniform[2]
        return ResolvedLoad(load, index_runs(chosen), (0.0, 0.0, 0.0), total)
    total = load.force or load.impulse
    if load.pressure is not None:
        low, high = x[chosen].min(axis=0), x[chosen].max(axis=0)
        axis, side = FACES[load.face]
        edge = high - low + spacing  # of the box around the particles' own volumes
        push = [0.0, 0.0, 0.0]
        push[axis] = -side * load.pressure * float(np.delete(edge, axis).prod())
        total = push[0], push[1], push[2]
        face = high[axis] if side > 0 else low[axis]
        chosen = chosen & (np.abs(x[:, axis] - face) < spacing / 2)
    volume = float(vol0[chosen].sum())
    density = total[0] / volume, total[1] / volume, total[2] / volume
    return ResolvedLoad(load, index_runs(chosen), density, total)
