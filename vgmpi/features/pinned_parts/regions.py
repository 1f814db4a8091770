"""Pinned parts of bodies at the start: their particles, their surface and what holds them."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from vgmpi.features.rigid_bodies.free_bodies import RigidBody
from vgmpi.gaussians.shape_distance import distance
from vgmpi.preprocess.body_regions import index_runs
from vgmpi.preprocess.object_builder import spacing_of
from vgmpi.preprocess.shape_sdf import contains
from vgmpi.scene.rigid_motion import Trajectory
from vgmpi.scene.scene import Scene
from vgmpi.scene.scene_feature import InitialParticles

from .feature import WORLD, PinnedPart

log = logging.getLogger("vgmpi")
SURROUNDINGS_CELLS = 3  # [cells] around its particles within which a part has a surface
BURIED_CELLS = 0.5  # [cells] depth in what holds a part beyond which other particles are warned of
UNRELATED_CELLS = 2.0  # [cells] distance from what holds it beyond which a part is warned of


class MaterialParticles(NamedTuple):
    """Particles of one material in a pinned part."""

    material: str
    runs: np.ndarray  # (m, 2) runs of the particles' ids, first and last, ascending
    particles: int  # number of them


@dataclass(frozen=True)
class PinnedRegion:
    """Pinned part of a body; all ranks hold the same.

    The surface is that of the region in which the part lay at the start, as far as particles of the
    part are close to it.
    """

    name: str  # of the body
    object: int  # row of the body
    to: str  # what holds it
    holder: int  # number of the collider or rigid body that holds it, -1 for the world
    is_free: bool  # a free rigid body holds it
    shape: PinnedPart
    by_material: tuple[MaterialParticles, ...]  # its particles by material
    box: np.ndarray  # (2, 3) [m] lower and upper corner of the particles
    masses: RigidBody  # its mass, center of mass and inertia
    first: np.ndarray  # (3,) first cell of `close`
    close: np.ndarray  # (i, j, k) bool, cells close to a particle
    dx: float  # [m] cell size
    filled_nodes: tuple[np.ndarray, np.ndarray]  # at the start, and their filled parts [-]
    course: Trajectory | None = None  # its motion, if it is prescribed
    body: None = None  # it is no free body itself
    release_time: float = np.inf  # [s] at which it lets go

    @property
    def count(self) -> int:
        """Return the number of its particles."""
        return sum(part.particles for part in self.by_material)

    def ends(self) -> tuple[np.ndarray, np.ndarray]:
        """Return lower and upper corner (3,) [m] of a box that contains its particles."""
        return self.box[0], self.box[1]

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Return the signed distance (m,) [m] of `points` (m, 3) [m], negative inside."""
        outside = distance(self.shape, points)
        cell = np.floor(points / self.dx).astype(np.int64) - self.first
        inside = ((cell >= 0) & (cell < self.close.shape)).all(1)
        is_close = np.zeros(len(points), bool)
        is_close[inside] = self.close[tuple(cell[inside].T)]
        return np.where(is_close, outside, np.maximum(outside, UNRELATED_CELLS * self.dx))


def resolve_pinned_parts(
    scene: Scene, particles: InitialParticles, colliders: list
) -> list[PinnedRegion]:
    """Return the pinned parts of a scene with their particles.

    Args:
        scene: The scene.
        particles: Particles at the start.
        colliders: Colliders of the scene at the start.

    Raises:
        SceneError: A part holds no particle, or all of its body.
    """
    regions: list[PinnedRegion] = []
    errors: list[tuple[tuple, str]] = []
    x, owner = particles.x, particles.owner
    bodies: tuple[Any, ...] = scene.object
    for k, obj in enumerate(bodies):
        rows = np.flatnonzero(owner == k) if obj.pinned else np.zeros(0, np.int64)
        free, spacing = rows, spacing_of(scene, obj) if obj.pinned else 0.0
        for number, part in enumerate(obj.pinned):
            inside = contains(part, x[free], spacing)
            if not inside.any():
                message = f"holds no particle of '{obj.name}' at the start"
                errors.append((("object", k, "pinned", number), message))
                continue
            chosen, free = free[inside], free[~inside]
            regions.append(_region(scene, k, part, particles, chosen, colliders))
            _warn_of_buried_particles(obj.name, regions[-1], colliders, x[free])
        if obj.pinned and len(rows) and not len(free):
            message = f"holds all particles of '{obj.name}': use rigid = true, or motion"
            errors.append((("object", k, "pinned"), message))
    if errors:
        raise scene.error(errors)
    return regions


def _region(
    scene: Scene, k: int, part: PinnedPart, particles: InitialParticles, chosen: np.ndarray,
    colliders: list,
) -> PinnedRegion:  # fmt: skip
    """Return one pinned part.

    Args:
        scene: The scene.
        k: Row of the body.
        part: The part.
        particles, colliders: See `resolve_pinned_parts`.
        chosen: Ids of its particles, shape (m,).
    """
    obj, dx, own, vol0 = scene.object[k], scene.domain.cell, particles.x[chosen], particles.vol0
    by_material, density = _particles_by_material(
        scene, particles.entries[k], chosen, len(particles.x)
    )
    cell = np.floor(own / dx).astype(np.int64)
    first = cell.min(0) - SURROUNDINGS_CELLS
    close = np.zeros(cell.max(0) + SURROUNDINGS_CELLS + 1 - first, bool)
    close[tuple((cell - first).T)] = True
    for axis in range(3):
        for _ in range(SURROUNDINGS_CELLS):
            moved, before = np.moveaxis(close, axis, 0), np.moveaxis(close.copy(), axis, 0)
            moved[1:] |= before[:-1]
            moved[:-1] |= before[1:]
    holder = -1 if part.to == WORLD else [c.name for c in colliders].index(part.to)
    masses = _point_masses(own, vol0[chosen], density.astype(vol0.dtype))
    cx, cy, cz = (float(c) for c in masses.center)
    course = None
    if part.motion is not None:
        course = Trajectory(part.motion, part.motion.pivot or (cx, cy, cz))
    elif holder >= 0:
        course = colliders[holder].course
        _warn_if_unrelated(obj.name, part, colliders[holder], own, dx)
    return PinnedRegion(
        obj.name, k, part.to, holder, holder >= 0 and colliders[holder].body is not None, part,
        by_material, np.array([own.min(0), own.max(0)]), masses, first, close,
        dx, _filled_nodes(own / dx, vol0[chosen] / dx**3), course,
        release_time=part.release_time or np.inf,
    )  # fmt: skip


def _particles_by_material(
    scene: Scene, entry: dict, chosen: np.ndarray, count: int
) -> tuple[tuple[MaterialParticles, ...], np.ndarray]:
    """Return the particles of a part by material, and their bulk densities (m,) [kg/m3].

    Args:
        scene: The scene.
        entry: Entry of the body in output files.
        chosen: Ids of the particles of the part, shape (m,).
        count: Number of all particles.
    """
    names, number = [entry["material"]], np.zeros(len(chosen), np.int64)
    for region in entry.get("regions", ()):
        if region["material"] not in names:
            names.append(region["material"])
        first = region["first_row"]
        is_inside = (chosen >= first) & (chosen < first + region["row_count"])
        number[is_inside] = names.index(region["material"])
    by_material = []
    for m in np.unique(number):
        mask = np.zeros(count, bool)
        mask[chosen[number == m]] = True
        by_material.append(MaterialParticles(names[m], index_runs(mask), int(mask.sum())))
    densities = np.array([scene.material[name].bulk_density for name in names], float)
    return tuple(by_material), densities[number]


def _point_masses(x: np.ndarray, volume: np.ndarray, density: np.ndarray) -> RigidBody:
    """Return mass and inertia of particles as a body at rest.

    Args:
        x: Positions, shape (n, 3) [m].
        volume: Rest volumes, shape (n,) [m3].
        density: Densities, shape (n,) [kg/m3].
    """
    mass = density * volume
    center = (mass[:, None] * x).sum(0) / mass.sum()
    r = x - center
    second_moment = (mass[:, None, None] * r[:, :, None] * r[:, None, :]).sum(0)
    second_moment += np.eye(3) * (mass * np.cbrt(volume) ** 2).sum() / 12.0  # particles are cubes
    inertia = np.trace(second_moment) * np.eye(3) - second_moment
    return RigidBody(float(mass.sum()), center, inertia, 0.0, 0.0, (0.0,) * 3, (0.0,) * 3)


def _filled_nodes(x: np.ndarray, volume: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the nodes (n, 3) that particles fill by quadratic B-splines, and filled parts (n,).

    Args:
        x: Positions, shape (n, 3) [cells].
        volume: Volumes, shape (n,) [cells].
    """
    base = np.floor(x - 0.5).astype(np.int64)
    r = x - base
    weights = 0.5 * (1.5 - r) ** 2, 0.75 - (r - 1.0) ** 2, 0.5 * (r - 0.5) ** 2
    first = base.min(0)
    parts = np.zeros(base.max(0) + 3 - first)
    for i, j, k in np.ndindex(3, 3, 3):
        part = volume * weights[i][:, 0] * weights[j][:, 1] * weights[k][:, 2]
        np.add.at(parts, tuple((base + (i, j, k) - first).T), part)
    places = np.nonzero(parts)
    return np.stack(places, 1) + first, parts[places]


def _warn_if_unrelated(name: str, part: PinnedPart, collider, x: np.ndarray, dx: float) -> None:
    """Warn of a part that does not touch what holds it."""
    gap = float(collider.distance(x).min())
    if gap > UNRELATED_CELLS * dx:
        log.warning(
            "'%s': the pinned part begins %.3g m from '%s', which holds it", name, gap, part.to
        )


def _warn_of_buried_particles(
    name: str, region: PinnedRegion, colliders: list, x: np.ndarray
) -> None:
    """Warn of particles inside what holds a part that do not belong to it.

    Args:
        name: Name of the body.
        region: The part.
        colliders: Colliders at the start.
        x: Particles of the body that are not pinned, shape (n, 3) [m].
    """
    if region.holder < 0:
        return
    count = int((colliders[region.holder].distance(x) < -BURIED_CELLS * region.dx).sum())
    if count:
        log.warning(
            "'%s': %d particles that are not pinned lie inside '%s', which pushes them out: enlarge"
            " the pinned part",
            name, count, region.to,
        )  # fmt: skip


def with_pinned_masses(colliders: list, regions: Sequence[PinnedRegion]) -> list:
    """Return the colliders; free rigid bodies include the masses of the parts that they hold.

    Args:
        colliders: Colliders at the start.
        regions: Pinned parts.
    """
    heavier = list(colliders)
    for region in regions:
        if region.is_free:
            collider = heavier[region.holder]
            heavier[region.holder] = replace(collider, body=_joined(collider.body, region.masses))
    return heavier


def _joined(body: RigidBody, part: RigidBody) -> RigidBody:
    """Return a rigid body together with a part that moves with it."""
    mass = body.mass + part.mass
    center = (body.mass * body.center + part.mass * part.center) / mass
    inertia = np.zeros((3, 3))
    for other in (body, part):
        r = other.center - center
        inertia += other.inertia + other.mass * ((r**2).sum() * np.eye(3) - r[:, None] * r)
    shift = np.cross(body.angular_velocity, center - body.center)
    velocity = tuple(float(v) for v in np.array(body.velocity) + shift)
    return body._replace(mass=mass, center=center, inertia=inertia, velocity=velocity)
