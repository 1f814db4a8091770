"""How a body moves at the start: a translation, a turn about its centre of mass, and waves; the
velocity of its particles and, since a step carries it along, its gradient.
"""

import numpy as np

from vgmpi.scene.objects import Object
from vgmpi.scene.scene import Scene


def velocity(thing: Object, x: np.ndarray, volume: np.ndarray) -> np.ndarray:
    """Velocities [m/s] (n, 3) of a body's particles at x (n, 3) [m]; volume (n,) weighs them."""
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
    if not any(any(body.spin) or body.mode for body in scene.object):
        return None
    C = np.zeros((len(x), 9))
    for k, body in enumerate(scene.object):
        here = thing == k
        if not (any(body.spin) or body.mode) or not here.any():
            continue
        wx, wy, wz = body.spin
        rate = np.broadcast_to([[0, -wz, wy], [wz, 0, -wx], [-wy, wx, 0]], (here.sum(), 3, 3))
        for mode in body.mode:
            wave = np.outer(mode.amplitude, mode.wave)
            rate = rate + np.cos(_angle(mode, x[here]))[:, None, None] * wave
        C[here] = rate.reshape(-1, 9)
    return C


def _angle(mode, x: np.ndarray) -> np.ndarray:
    k = mode.wave
    return k[0] * x[:, 0] + k[1] * x[:, 1] + k[2] * x[:, 2] + mode.phase
