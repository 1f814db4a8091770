"""Particles on which loads act, and force densities."""

from typing import NamedTuple

import numpy as np

from vgmpi.scene.loads import FACES, Load
from vgmpi.scene.scene import Scene

from .body_regions import densities_of
from .object_builder import spacing_of
from .shape_sdf import contains

Vector = tuple[float, float, float]


class ResolvedLoad(NamedTuple):
    """Load with its particles; equal on every rank."""

    load: Load
    ids: np.ndarray  # (m, 2) runs of particle ids, first and last, ascending
    # [N/m3 of rest volume, or N s/m3], 0 for loads that are equal for all
    density: Vector
    total: Vector  # [N, or N s] on all of them at full strength


def resolve_loads(
    scene: Scene, x: np.ndarray, vol0: np.ndarray, owner: np.ndarray, objects: list[dict]
) -> list[ResolvedLoad]:
    """Return the loads of a scene with their particles.

    Args:
        scene: The scene.
        x: Particles at the start in the order of their ids, shape (n, 3) [m].
        vol0: Rest volumes, shape (n,) [m3].
        owner: Object of each particle, shape (n,).
        objects: Entries of the objects and inlets.

    Raises:
        SceneError: A load acts on no particle.
    """
    number = {o.name: k for k, o in enumerate(scene.object)}
    loads, errors, densities = [], [], densities_of(objects, owner) if scene.load else None
    for k, load in enumerate(scene.load):
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


def index_runs(chosen: np.ndarray) -> np.ndarray:
    """Return first and last index (m, 2) of each run of true values of `chosen` (n,)."""
    edges = np.diff(np.concatenate([[0], chosen.astype(np.int8), [0]]))
    return np.stack([np.flatnonzero(edges > 0), np.flatnonzero(edges < 0) - 1], 1)
