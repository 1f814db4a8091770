"""Slip walls that also hold back bodies that pull away from them."""

import numpy as np

from vgmpi.scene.scene import Scene
from vgmpi.scene.sections import WALLS

TOUCHING_CELLS = 0.5  # [cells] distance of a particle from a wall that its body touches


def holding_walls(scene: Scene, objects: list[dict], x: np.ndarray) -> tuple[str, ...]:
    """Return the names of the slip walls that a body touches which is not a liquid.

    Args:
        scene: The scene.
        objects: Entries of the objects and inlets.
        x: Positions of the particles, shape (n, 3) [m].
    """
    reach, holding = TOUCHING_CELLS * scene.domain.cell, set()
    for k, entry in enumerate(objects):
        rows = x[entry["first_row"] :][: entry["row_count"]]
        if entry.get("family", "fluid") == "fluid" or not len(rows) or k >= len(scene.object):
            continue
        for wall, (kind, _) in enumerate(scene.walls_of_solids):
            axis, side = divmod(wall, 2)
            depth = (rows[:, axis] if side == 0 else scene.domain.size[axis] - rows[:, axis]).min()
            if kind == "slip" and depth < reach:
                holding.add(wall)
    return tuple(WALLS[wall] for wall in sorted(holding))
