"""Initial velocity, volume and pressure of bodies.

The velocity is a translation, a rotation about the center of mass, and waves; its gradient is
computed too, since a step carries it along. A body may fill a fraction of its space, and begin in
hydrostatic equilibrium. Liquids have a pressure at the start: the weight on their bottom, and in a
closed box the tension that their motion may cause.
"""

from dataclasses import replace

import numpy as np

from vgmpi.scene.objects import Object
from vgmpi.scene.rigid_motion import course_of, spin_tensor
from vgmpi.scene.scene import Scene

from .built_object import BuiltObject
from .memory_estimate import spacing_of
from .motion_checks import extent
from .placement import PlacementError

FULL_BOX = 0.99  # [-] fraction of the domain that particles fill, above which it has no surface


def initial_velocity(
    obj: Object, x: np.ndarray, weights: np.ndarray, own: np.ndarray | None = None
) -> np.ndarray:
    """Return velocities (n, 3) [m/s] of a body's particles.

    Args:
        obj: The body.
        x: Its particles, shape (n, 3) [m].
        weights: Their masses, or volumes where all have one density, shape (n,).
        own: Velocity of each particle beside that of the body, shape (n, 3) [m/s], or None.
    """
    if obj.role == "body" and obj.motion is not None and len(x):
        course = course_of(obj.motion, *extent(x))
        speed, spin = course.rates(0.0)
        return speed + np.cross(spin, x - np.array(course.about))
    weights = weights / weights.sum()
    center = (x * weights[:, None]).sum(axis=0)
    v = np.asarray(obj.velocity) + np.cross(np.asarray(obj.angular_velocity), x - center)
    for mode in obj.velocity_mode:
        v += np.asarray(mode.amplitude) * np.sin(_angle(mode, x))[:, None]
    return v if own is None else v + own


def initial_velocity_gradient(scene: Scene, x: np.ndarray, owner: np.ndarray) -> np.ndarray | None:
    """Return the velocity gradient dv_a / dx_b (n, 9) [1/s], or None if no body rotates or waves.

    It depends on each particle alone, so that every rank computes its own: it is not stored in
    files. A body that began with C = 0 instead would lose the particles' own gradients in the first
    step.

    Args:
        scene: The scene.
        x: Particles, shape (n, 3) [m].
        owner: Row of each one's object, shape (n,).
    """
    spins = [_spin(body) for body in scene.object]
    if not any(any(s) or body.velocity_mode for s, body in zip(spins, scene.object, strict=True)):
        return None
    C = np.zeros((len(x), 9))
    for k, body in enumerate(scene.object):
        rows = owner == k
        if not (any(spins[k]) or body.velocity_mode) or not rows.any():
            continue
        rate = np.broadcast_to(np.reshape(spin_tensor(spins[k]), (3, 3)), (rows.sum(), 3, 3))
        for mode in body.velocity_mode:
            wave = np.outer(mode.amplitude, mode.wave_vector)
            rate = rate + np.cos(_angle(mode, x[rows]))[:, None, None] * wave
        C[rows] = rate.reshape(-1, 9)
    return C


def _spin(obj: Object) -> tuple[float, ...]:
    """Return the angular velocity [rad/s] at the start."""
    if obj.role != "body" or obj.motion is None:
        return obj.angular_velocity
    return tuple(course_of(obj.motion, (0.0,) * 3, (0.0,) * 3).rates(0.0)[1])


def _angle(mode, x: np.ndarray) -> np.ndarray:
    """Return the phase angle (n,) of a wave."""
    k = mode.wave_vector
    return k[0] * x[:, 0] + k[1] * x[:, 1] + k[2] * x[:, 2] + mode.phase_angle


def apply_initial_conditions(scene: Scene, obj: Object, piece: BuiltObject) -> BuiltObject:
    """Return the object with the rest volumes and volume ratios that the scene requests.

    Raises PlacementError if no particle is left.
    """
    if obj.volume_fraction_profile is not None:
        profile = obj.volume_fraction_profile
        along = piece.cloud.x[:, "xyz".index(profile.axis)]
        piece = _with_fractions(piece, np.interp(along, profile.positions, profile.values))
    elif obj.volume_fraction != 1.0:
        piece = _with_fractions(piece, np.full(len(piece.cloud), obj.volume_fraction))
    if obj.initial_pressure == "hydrostatic":
        piece = _compressed(scene, obj, piece)
    return piece


def _with_fractions(piece: BuiltObject, fraction: np.ndarray) -> BuiltObject:
    """Return the object with volumes scaled by volume fractions (n,)."""
    is_filled = fraction > 0  # particles without mass are dropped
    if not is_filled.any():
        raise PlacementError(
            "volume_fraction_profile", "leaves no particle: its values are 0 everywhere"
        )
    return replace(piece, volume=piece.volume * fraction).select(is_filled)


def _compressed(scene: Scene, obj: Object, piece: BuiltObject) -> BuiltObject:
    """Return the object in equilibrium under gravity: its volume so far is the compressed one.

    Where the grid finds the pressure, volumes do not change with it.
    """
    material, z = scene.material_of(obj), piece.cloud.x[:, 2]
    top = z.max() + spacing_of(scene, obj) / 2
    weight = material.density * -scene.domain.gravity[2] * (top - z)
    if scene.is_free_of_waves:
        return replace(piece, theta=material.theta_at(weight, scene.largest_tait_coefficient))
    theta = material.hydrostatic_theta(weight)
    return replace(piece, volume=piece.volume * np.exp(-theta), theta=theta)


def liquid_weights(scene: Scene, objects: list[dict], x: np.ndarray) -> tuple[float, ...]:
    """Return the weight per area [Pa] on the bottom of each body of liquid, NaN for other objects.

    It is its own weight and that of the liquids above it; () without gravity or liquids.

    Args:
        scene: The scene.
        objects: Entries of the objects and particle sources.
        x: Positions of all particles, shape (n, 3) [m].
    """
    gravity = np.array(scene.domain.gravity)
    axis, strength = int(np.abs(gravity).argmax()), float(np.abs(gravity).max())
    liquids = [
        k for k, entry in enumerate(objects)
        if entry.get("family") == "fluid" and entry["role"] == "body" and entry["row_count"]
        and k < len(scene.object)
    ]  # fmt: skip
    if not liquids or strength == 0.0:
        return ()
    result = np.full(len(objects), np.nan)
    low, high = (np.full((len(objects), 3), np.nan) for _ in range(2))
    for k in liquids:
        entry = objects[k]
        particles = x[entry["first_row"] :][: entry["row_count"]]
        low[k], high[k] = particles.min(axis=0), particles.max(axis=0)
    if gravity[axis] > 0.0:  # up is along the axis from here on
        low[:, axis], high[:, axis] = -high[:, axis], -low[:, axis]
    across = [a for a in range(3) if a != axis]
    for k in liquids:
        above = [
            j for j in liquids
            if j != k and low[j, axis] > 0.5 * (low[k, axis] + high[k, axis])
            and (low[j, across] < high[k, across]).all()
            and (high[j, across] > low[k, across]).all()
        ]  # fmt: skip
        result[k] = strength * sum(
            scene.material_of(scene.object[j]).density * (high[j, axis] - low[j, axis])
            for j in (k, *above)
        )
    return tuple(result.tolist())


def closed_box_tensions(
    scene: Scene, objects: list[dict], x: np.ndarray, volume: np.ndarray
) -> tuple[float, ...]:
    """Return the tension [Pa] that the motion of each body of liquid may cause, NaN for others.

    In a closed box that is full, pressure has no free surface to start from: about a mean of 0 it
    falls by density v^2 / 2 where the liquid turns. () if the domain is not full, or open.

    Args:
        scene: The scene.
        objects: Entries of the objects and particle sources.
        x: Positions of all particles, shape (n, 3) [m].
        volume: Rest volumes of all particles, shape (n,) [m3].
    """
    if scene.changes_mass or volume.sum() < FULL_BOX * np.prod(scene.domain.size):
        return ()
    result = np.full(len(objects), np.nan)
    for k, body in enumerate(scene.object):
        first, count = objects[k]["first_row"], objects[k]["row_count"]
        if objects[k].get("family") != "fluid" or objects[k]["role"] != "body" or not count:
            continue
        rows = slice(first, first + count)
        v = initial_velocity(body, x[rows], volume[rows])
        result[k] = 0.5 * scene.material_of(body).density * float((v**2).sum(axis=1).max())
    return tuple(result.tolist())
