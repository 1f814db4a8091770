"""How a body moves at the start: a translation, a turn about its centre of mass, and waves; the
velocity of its particles and, since a step carries it along, its gradient.
"""

import numpy as np

from vgmpi.planning.driven import course_of
from vgmpi.prepare.courses import extent
from vgmpi.scene.motion import turning
from vgmpi.scene.objects import Object
from vgmpi.scene.scene import Scene


def velocity(thing: Object, x: np.ndarray, volume: np.ndarray) -> np.ndarray:
    """Velocities [m/s] (n, 3) of a body's particles at x (n, 3) [m]; volume (n,) weighs them."""
    if thing.driven and thing.motion is not None and len(x):
        course = course_of(thing, *extent(x))
        speed, spin = course.rates(0.0)
        return speed + np.cross(spin, x - np.array(course.about))
    share = volume / volume.sum()
    middle = (x * share[:, None]).sum(axis=0)
    v = np.asarray(thing.velocity) + np.cross(np.asarray(thing.spin), x - middle)
    for mode in thing.mode:
        v += np.asarray(mode.amplitude) * np.sin(_angle(mode, x))[:, None]
    return v


def gradient(scene: Scene, x: np.ndarray, thing: np.ndarray) -> np.ndarray | None:
    """dv_a / dx_b [1/s] as rows (n, 9) at x (n, 3) [m], thing (n,) being rows of the scene's
    objects; None where no body turns or waves.

    Of each particle alone, so that every rank finds its own: it is not kept in files. A body that
    began with C = 0 instead would lose what its particles' own gradients carry in the first step.
    """
    spins = [_spin(body) for body in scene.object]
    if not any(any(s) or body.mode for s, body in zip(spins, scene.object, strict=True)):
        return None
    C = np.zeros((len(x), 9))
    for k, body in enumerate(scene.object):
        here = thing == k
        if not (any(spins[k]) or body.mode) or not here.any():
            continue
        rate = np.broadcast_to(np.reshape(turning(spins[k]), (3, 3)), (here.sum(), 3, 3))
        for mode in body.mode:
            wave = np.outer(mode.amplitude, mode.wave)
            rate = rate + np.cos(_angle(mode, x[here]))[:, None, None] * wave
        C[here] = rate.reshape(-1, 9)
    return C


def _spin(thing: Object) -> tuple[float, ...]:
    """Angular velocity [rad/s] at the start."""
    if not thing.driven or thing.motion is None:
        return thing.spin
    return tuple(course_of(thing, (0.0,) * 3, (0.0,) * 3).rates(0.0)[1])


def _angle(mode, x: np.ndarray) -> np.ndarray:
    k = mode.wave
    return k[0] * x[:, 0] + k[1] * x[:, 1] + k[2] * x[:, 2] + mode.phase
