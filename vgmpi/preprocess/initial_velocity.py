"""Initial velocity of a body: translation, rotation about its center of mass, and waves.

The gradient of the velocity is computed too, since a step carries it along.
"""

import numpy as np

from vgmpi.planning.prescribed_bodies import course_of
from vgmpi.scene.objects import Object
from vgmpi.scene.rigid_motion import spin_tensor
from vgmpi.scene.scene import Scene

from .motion_checks import extent


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
    if obj.driven and obj.motion is not None and len(x):
        course = course_of(obj, *extent(x))
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
    if not obj.driven or obj.motion is None:
        return obj.angular_velocity
    return tuple(course_of(obj, (0.0,) * 3, (0.0,) * 3).rates(0.0)[1])


def _angle(mode, x: np.ndarray) -> np.ndarray:
    """Return the phase angle (n,) of a wave."""
    k = mode.wave_vector
    return k[0] * x[:, 0] + k[1] * x[:, 1] + k[2] * x[:, 2] + mode.phase_angle
