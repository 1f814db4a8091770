"""A video of the target and of what was found, beside each other."""

from pathlib import Path

import numpy as np

from postprocess.video import Film, to_bytes

from .target import Target

BETWEEN = 2  # pixels


def write(target: Target, folder: Path, path: Path) -> None:
    """The target's pictures to the left, those of the run in `folder` to the right. Raises
    RunError, VideoError, postprocess.settings.SettingsError."""
    assert target.pictures is not None
    left, right = target.shown(), target.pictures.of(folder, target.frames)
    count, height, width = right.shape[:3]
    size = (2 * width + BETWEEN, height)
    film = target.pictures.chosen.video
    with Film(path, *size, film.fps, film.quality) as out:
        for one, other in zip(left, right):
            picture = np.zeros((height, size[0], 3))
            picture[:, :width], picture[:, width + BETWEEN :] = one, other
            out.add(to_bytes(picture))
