"""Which particles a load acts on, and how strongly."""

from typing import NamedTuple

import numpy as np

from vgmpi.prepare.pieces import spacing_of
from vgmpi.prepare.shapes import TIE, distance
from vgmpi.scene.loads import FACES, Load
from vgmpi.scene.scene import Scene


class Loaded(NamedTuple):
    """A load and its particles; the same on every rank."""

    load: Load
    ids: np.ndarray  # (m, 2) runs of particle ids, first and last, ascending
    # [N per m3 of rest volume, or N s per m3], 0 for what all get alike
    density: tuple[float, float, float]
    total: tuple[float, float, float]  # [N, or N s] on all of them at full strength


def find(scene: Scene, x: np.ndarray, vol0: np.ndarray, thing: np.ndarray) -> list[Loaded]:
    """The loads of a scene, by its particles at the start in the order of their ids.

    x: (n, 3) [m]; vol0: (n,) [m3]; thing: (n,) object of each. Raises SceneError where a load acts
    on no particle.
    """
    number = {o.name: k for k, o in enumerate(scene.object)}
    found, empty = [], []
    for k, load in enumerate(scene.load):
        chosen = np.isin(thing, [number[name] for name in load.object])
        spacing = max(spacing_of(scene, scene.object[number[name]]) for name in load.object)
        if load.region is not None:
            # a face that runs through a layer of particles takes them at its low side, as in shapes
            chosen[chosen] = distance(load.region, x[chosen] + TIE * spacing) < 0
        if not chosen.any():
            said = f"holds no particle of {', '.join(load.object)} at the start"
            empty.append((("load", k, "region" if load.region is not None else "object"), said))
            continue
        found.append(_loaded(scene, load, chosen, spacing, x, vol0, thing))
    if empty:
        raise scene.error(empty)
    return found


def _loaded(scene, load, chosen, spacing, x, vol0, thing) -> Loaded:
    alike = load.acceleration or load.velocity or (load.spin and (0.0, 0.0, 0.0))
    if alike is not None:
        made_of = [o.material and scene.material[o.material].bulk_density for o in scene.object]
        density = np.array([rho or 0.0 for rho in made_of])
        mass = float((density[thing[chosen]] * vol0[chosen]).sum())
        total = tuple(mass * a for a in alike)
        return Loaded(load, runs(chosen), (0.0, 0.0, 0.0), total)
    total = load.force or load.impulse
    if load.pressure is not None:
        low, high = x[chosen].min(axis=0), x[chosen].max(axis=0)
        axis, side = FACES[load.face]
        edge = high - low + spacing  # of the box around the particles' own volumes
        push = [0.0, 0.0, 0.0]
        push[axis] = -side * load.pressure * float(np.delete(edge, axis).prod())
        total = tuple(push)
        face = high[axis] if side > 0 else low[axis]
        chosen = chosen & (np.abs(x[:, axis] - face) < spacing / 2)
    volume = float(vol0[chosen].sum())
    return Loaded(load, runs(chosen), tuple(f / volume for f in total), total)


def runs(chosen: np.ndarray) -> np.ndarray:
    """(m, 2) first and last of each run of consecutive places where `chosen` (n,) is true."""
    edges = np.diff(np.concatenate([[0], chosen.astype(np.int8), [0]]))
    return np.stack([np.flatnonzero(edges > 0), np.flatnonzero(edges < 0) - 1], 1)
