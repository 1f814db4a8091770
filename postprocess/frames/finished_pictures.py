"""Pictures of a video that an earlier, interrupted command has drawn, and that are still valid.

Each picture holds a digest of what it depends on besides its frame: the settings, the particles of
the run and the version of the program. A picture is finished if it holds the same digest and is
newer than its frame.
"""

import hashlib
from pathlib import Path

import numpy as np

from vgmpi.runtime import user_files
from vgmpi.runtime.versions import program_version

from . import image_io
from .frame_renderer import FrameRenderer


def find_finished(
    painter: FrameRenderer, frames: list[int], files: dict[int, list[list[Path]]]
) -> set[int]:
    """Return the frames whose files are all finished.

    Args:
        painter: Renderer.
        frames: Frames of the video.
        files: For each frame, for each camera: its picture, and what is written after it.
    """
    digest, finished = digest_of(painter), set()
    for index in frames:
        drawn_from = painter.run.path(index).stat().st_mtime_ns
        if all(_are_finished(group, digest, drawn_from) for group in files[index]):
            finished.add(index)
    return finished


def _are_finished(group: list[Path], digest: str, drawn_from: int) -> bool:
    """Return whether files exist, each no older than the one before it, from the time drawn_from.

    The first one is a picture that has to hold the digest.
    """
    times = [drawn_from]
    try:
        times += [path.stat().st_mtime_ns for path in group]
    except OSError:
        return False
    return times == sorted(times) and image_io.png_text(group[0]) == digest


def digest_of(painter: FrameRenderer) -> str:
    """Return a digest of all that the pictures of a renderer depend on besides their frames."""
    parts = (
        painter.chosen.model_dump_json(), painter.run.gaussians.digest, program_version(),
        [(view.name, view.width, view.height) for view in painter.views], painter.draft,
    )  # fmt: skip
    return hashlib.sha256(repr(parts).encode()).hexdigest()


def read_picture(path: Path) -> np.ndarray:
    """Read a picture (height, width, 3 or 4) uint8. Raises VideoError."""
    try:
        return user_files.read_image(path)
    except ValueError as error:
        raise image_io.VideoError(f"{path}: {error}") from None
