"""Side-by-side video of the target and of the fitted run."""

from pathlib import Path

import numpy as np

from vgmpi.postprocess.frames.image_io import Film, to_bytes

from .target_base import Target

GAP_WIDTH = 2  # [pixels] gap between the two images


def write(target: Target, folder: Path, path: Path) -> None:
    """Write a video with the target on the left and the run in `folder` on the right.

    Raises RunError, VideoError, vgmpi.postprocess.frames.render_config.SettingsError.
    """
    assert target.pictures is not None
    left, right = target.images(), target.pictures.render_run(folder, target.frames)
    count, height, width = right.shape[:3]
    size = (2 * width + GAP_WIDTH, height)
    video_settings = target.pictures.chosen.video
    with Film(path, *size, video_settings.fps, video_settings.quality) as out:
        for target_image, run_image in zip(left, right):
            picture = np.zeros((height, size[0], 3))
            picture[:, :width], picture[:, width + GAP_WIDTH :] = target_image, run_image
            out.add(to_bytes(picture))
