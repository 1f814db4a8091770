"""A run's folder that is followed while it is written: frames as arrays of viser."""

import contextlib
import os
from pathlib import Path
from typing import NamedTuple

import numpy as np

from vgmpi.io import file_layout
from vgmpi.io.run_reader import RunError, RunReader

from ..frames.appearance import Appearance
from ..frames.field_values import list_fields, map_colors, scalars
from ..frames.frame_renderer import domain_box, visible_extent
from ..frames.render_config import LookSettings
from .gaussian_selection import GaussianSelection

FIELD_OPACITY = 0.6  # [-] least opacity of particles that are colored by a field

FileState = tuple[int, int, int] | None  # inode, time of change [ns], size [bytes]


class ShownFrame(NamedTuple):
    """Arrays of viser for one frame."""

    number: int  # number of the frame
    time: float  # simulated time [s]
    scenery: dict[str, np.ndarray]  # Gaussians without mass
    particles: dict[str, np.ndarray]  # all other Gaussians
    fields: list[str]  # fields that the frame can be colored by
    bounds: tuple[float, float] | None  # values of the first and last color, None without a field


class FollowedRun:
    """Files of a run that goes on, or has ended.

    Attributes:
        folder: Folder of the run.
        reader: Files of the run; None before its first frame is written.
        selection: Gaussians that are shown; None before the first frame.
    """

    def __init__(self, folder: Path, count: int, look: LookSettings):
        """Follow a folder; it is read by `refresh`.

        Args:
            folder: Output folder of the run.
            count: Largest number of Gaussians that are shown.
            look: Table [look] of render.toml.
        """
        self.folder, self.count, self.look = folder, count, look
        self.reader: RunReader | None = None
        self.selection: GaussianSelection | None = None
        self._gaussians_state: FileState = None
        self._frames_state: FileState = None
        self._bounds: dict[str, tuple[float, float]] = {}  # by field, of the frames shown so far

    def refresh(self) -> bool:
        """Read what is new in the folder.

        Returns:
            Whether there are other frames than before.

        Raises:
            RunError: There is no frame yet, or the files cannot be read.
            vgmpi.postprocess.frames.render_config.SettingsError: The settings do not fit the run.
        """
        frames_state = file_state(self.folder / file_layout.FRAMES)
        gaussians_state = file_state(self.folder / file_layout.GAUSSIANS)
        is_other_run = self.reader is None or gaussians_state != self._gaussians_state
        if not is_other_run and frames_state == self._frames_state:
            return False
        if is_other_run:
            self.reader = self.selection = None
            reader = RunReader(self.folder)
            self.selection = GaussianSelection(Appearance(reader, self.look), self.count)
            self.reader, self._bounds = reader, {}
        else:
            assert self.reader is not None
            try:
                self.reader.refresh()
            except RunError:
                self.reader = None
                raise
        self._frames_state, self._gaussians_state = frames_state, gaussians_state
        return True

    def numbers(self) -> list[int]:
        """Return the numbers of the frames in ascending order."""
        return [] if self.reader is None else sorted(self.reader.frames)

    def cell(self) -> float:
        """Return the edge of a grid cell [m], the unit of length of viser's scene."""
        assert self.selection is not None
        return self.selection.cell

    def extent(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the lower and upper corner of what is visible [m]."""
        assert self.reader is not None
        return visible_extent(self.reader)

    def domain(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the lower and upper corner of the domain [m]."""
        assert self.reader is not None
        return domain_box(self.reader)

    def read_frame(self, number: int, eye: np.ndarray, field: str | None) -> ShownFrame:
        """Return a frame for viser.

        Args:
            number: Number of the frame.
            eye: Point from which the colors are seen, shape (3,) [m].
            field: Field to color by (field_values.scalars), None for the run's colors. The bounds
                of its colors enclose the values of all frames that were read with it.

        Raises:
            RunError: The frame cannot be read, or lacks the field.
        """
        assert self.reader is not None and self.selection is not None
        frame = self.selection.look.frame(number)
        time = self.reader.time_and_step(number)[0]
        scenery, particles = self.selection.splats_of(frame, eye)
        bounds = None
        if field is not None:
            values = self.selection.values_of(frame, scalars(frame, field))
            bounds = self._enclosing_bounds(field, values)
            particles["rgbs"] = map_colors(values, *bounds).astype(np.float32)
            particles["opacities"] = np.maximum(particles["opacities"], FIELD_OPACITY)
        fields = list_fields({name: array for name, array in frame.items() if name != "sh"})
        return ShownFrame(number, time, scenery, particles, fields, bounds)

    def _enclosing_bounds(self, field: str, values: np.ndarray) -> tuple[float, float]:
        """Return the bounds of a field over the frames so far, with those of another frame."""
        values = values[np.isfinite(values)]
        low, high = self._bounds.get(field, (np.inf, -np.inf))
        if len(values):
            low, high = min(low, float(values.min())), max(high, float(values.max()))
        if low > high:
            return 0.0, 1.0
        self._bounds[field] = low, high
        return low, high


def file_state(path: Path) -> FileState:
    """Return what changes when a file or a folder is written anew; None if it is absent."""
    with contextlib.suppress(OSError):
        status = os.stat(path)
        return status.st_ino, status.st_mtime_ns, status.st_size
    return None
