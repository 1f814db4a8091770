"""Pressures of liquids at the start: weight on their bottom, and tension in a closed box."""

import numpy as np

from vgmpi.scene.scene import Scene

from .initial_velocity import initial_velocity

FULL_BOX = 0.99  # [-] fraction of the domain that particles fill, above which it has no surface


def liquid_weights(scene: Scene, objects: list[dict], x: np.ndarray) -> tuple[float, ...]:
    """Return the weight per area [Pa] on the bottom of each body of liquid, NaN for other objects.

    It is its own weight and that of the liquids above it; () without gravity or liquids.

    Args:
        scene: The scene.
        objects: Entries of the objects and inlets.
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
        objects: Entries of the objects and inlets.
        x: Positions of all particles, shape (n, 3) [m].
        volume: Rest volumes of all particles, shape (n,) [m3].
    """
    if scene.is_open_system or volume.sum() < FULL_BOX * np.prod(scene.domain.size):
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
