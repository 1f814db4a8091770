"""Weight that compresses the bottom of each body of liquid at the start."""

import numpy as np

from vgmpi.scene.scene import Scene


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
