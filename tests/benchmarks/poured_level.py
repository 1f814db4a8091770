"""Water of a run by its level: what stands in the tank beside what was poured into it.

For columns of one cell that hold no particle of another material, the height at which the fullness
of the cells passes one half, from above, is the level. The volume below it, over the rest volume of
the water in the same columns, is 1 if nothing crowds and nothing is froth.
"""

from pathlib import Path

import numpy as np

from tests.benchmarks.liquid_volume import nodal_fullness
from vgmpi.io.run_reader import RunReader
from vgmpi.scene.loader import load


def column_levels(fullness: np.ndarray, dx: float) -> np.ndarray:
    """Return the height of the highest half-full place of each column of nodes [m], 0 if none.

    Args:
        fullness: Fullness at the nodes, shape (nx, ny, nz).
        dx: Cell size [m].
    """
    half = fullness > 0.5
    top = fullness.shape[2] - 1 - np.argmax(half[:, :, ::-1], axis=2)
    i, j = np.indices(top.shape)
    above = np.minimum(top + 1, fullness.shape[2] - 1)
    low, high = fullness[i, j, top], fullness[i, j, above]
    part = np.where(low > high, (low - 0.5) / np.where(low > high, low - high, 1.0), 0.0)
    return np.where(half.any(2), (top + np.clip(part, 0.0, 1.0)) * dx, 0.0)


def level_over_poured(scene_path: Path, folder: Path, frame: int, liquid: str) -> tuple:
    """Return the volume by level over the rest volume, and the share of columns that count.

    Args:
        scene_path: Scene of the run.
        folder: Folder of the run.
        frame: Number of the frame.
        liquid: Name of the liquid's material.
    """
    scene, run = load(scene_path), RunReader(folder)
    cells, dx = scene.domain.cells, scene.domain.cell
    state = run.frame(frame)
    x, volume, owner = state["positions"], run.gaussians.vol0, run.gaussians.object
    if "id" in state:
        volume, owner = volume[state["id"]], owner[state["id"]]
    material = np.array([entry.get("material") for entry in run.objects])[owner]
    water = material == liquid
    level = column_levels(nodal_fullness(x[water], volume[water], cells, dx), dx)
    column = np.rint(x[:, :2] / dx).astype(int)
    foreign = np.zeros(level.shape, bool)
    for di in (-1, 0, 1):
        for dj in (-1, 0, 1):
            near = np.clip(column[~water] + (di, dj), 0, np.array(level.shape) - 1)
            foreign[near[:, 0], near[:, 1]] = True
    held = np.zeros(level.shape)
    np.add.at(held, tuple(column[water].T), volume[water])
    area = np.full(level.shape, dx**2)
    area[[0, -1]] *= 0.5
    area[:, [0, -1]] *= 0.5
    return (level * area)[~foreign].sum() / held[~foreign].sum(), (~foreign).mean()


def run(scene_path: Path, folder: Path, liquid: str, count: int) -> None:
    """Print the last frames of a run.

    Args:
        scene_path, folder, liquid: See `level_over_poured`.
        count: Number of frames.
    """
    times = RunReader(folder).times
    for frame in range(max(len(times) - count, 0), len(times)):
        ratio, share = level_over_poured(scene_path, folder, frame, liquid)
        print(
            f"{times[frame]:.3f} s: by level {100 * (ratio - 1):+.1f} % of what was poured, in"
            f" {100 * share:.0f} % of the columns"
        )
