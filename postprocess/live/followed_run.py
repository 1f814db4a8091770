"""A run's folder that is followed while it is written: frames as arrays of viser.

Viewers show the same subset of its Gaussians in every frame.
"""

import contextlib
import os
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from vgmpi.io import file_layout
from vgmpi.io.run_reader import RunError, RunReader

from ..frames.appearance import Appearance, view_dependent_splats
from ..frames.field_values import list_fields, map_colors, scalars
from ..frames.frame_renderer import domain_box, visible_extent
from ..frames.render_config import LookSettings
from .viewer_scene import splat_arrays

MAX_GROWTH = 4.0  # [-] largest factor on the size of a Gaussian
SOLID_SHARE = 0.75  # [-] share of the shown Gaussians reserved for bodies and scenery
MIN_WEIGHT = 1e-300  # of an invisible Gaussian, which comes last
FIELD_OPACITY = 0.6  # [-] least opacity of particles that are colored by a field
FileState = tuple[int, int, int] | None  # inode, time of change [ns], size [bytes]


class GaussianSelection:
    """Subset of at most `count` Gaussians that is shown in every frame.

    Bodies and scenery come before liquids, whose Gaussians are many and similar: they get
    SOLID_SHARE of the subset if they need it. Within both, Gaussians are sampled with probability
    proportional to their area and opacity. growth: factor on the covariances, so that the subset
    covers the area of all. cell: edge of a grid cell [m], the unit of length of viser's arrays.
    """

    def __init__(self, look: Appearance, count: int, seed: int = 0):
        self.look, self.cell = look, look.cell_size()
        scenery = look.scenery.cov0 if look.scenery is not None else np.zeros((0, 6))
        riders = look.passive.cov0 if look.passive is not None else np.zeros((0, 6))
        ends = [len(scenery), len(scenery) + len(look.object)]
        # sum of the squared axes, for a disc proportional to its area
        area = np.concatenate([c[:, (0, 3, 5)].sum(1) for c in (scenery, look.cov0, riders)])
        parts = [look.scenery, look, look.passive]
        area *= np.concatenate([part.opacity for part in parts if part is not None])
        liquid = np.zeros(len(area), dtype=bool)
        liquid[ends[0] : ends[1]] = look.fluid
        self.all, total_count = len(area), min(count, len(area))
        solids = len(area) - int(liquid.sum())
        solid_count = min(
            solids, max(round(SOLID_SHARE * total_count), total_count - int(liquid.sum()))
        )
        # the first of an exponential race are a sample with probability proportional to weight
        race = np.random.default_rng(seed).exponential(size=len(area))
        race /= np.maximum(area, MIN_WEIGHT)
        is_shown, growth = np.zeros(len(area), dtype=bool), np.ones(len(area))
        for is_class, max_count in ((~liquid, solid_count), (liquid, total_count - solid_count)):
            candidates = np.flatnonzero(is_class)
            selected = candidates[np.argsort(race[candidates])[:max_count]]
            is_shown[selected] = True
            if len(selected) and area[selected].sum() > 0:
                growth[selected] = min(area[candidates].sum() / area[selected].sum(), MAX_GROWTH**2)
        self.count = int(is_shown.sum())
        self.still, self.moving, self.riding = np.split(is_shown, ends)
        self.growth = np.split(growth, ends)
        self._needed = self.moving.copy()  # particles without which a frame cannot be shown
        if look.passive is not None:
            self._needed[look.passive.carriers[self.riding]] = True

    def splats_of(self, frame: dict[str, np.ndarray], eye: np.ndarray) -> tuple[dict, dict]:
        """Return viser's arrays of a frame: of the scenery, and of all other Gaussians.

        Args:
            frame: Result of Appearance.frame.
            eye: Point from which the colors are seen, shape (3,) [m].
        """
        frame = self._needed_rows(frame)
        parts = self.look.parts(frame)
        still = np.flatnonzero(self.still)
        # scenery comes before the particles
        first = len(parts) - 1 - (self.look.passive is not None)
        ids = np.asarray(frame["id"])
        is_shown, growth = [self.moving[ids]], [self.growth[1][ids]]
        if self.look.passive is not None:  # the part holds Gaussians whose carriers are all present
            is_shown.append(self.riding[parts[-1].rows])
            growth.append(self.growth[2][parts[-1].rows])
        scenery_splats = (
            view_dependent_splats(parts[:1], eye) if first else view_dependent_splats(parts, eye)
        )
        rows = np.flatnonzero(np.concatenate(is_shown))
        return self._splat_arrays(scenery_splats, still, self.growth[0][still]), self._splat_arrays(
            view_dependent_splats(parts[first:], eye), rows, np.concatenate(growth)[rows]
        )

    def values_of(self, frame: dict[str, np.ndarray], values: np.ndarray) -> np.ndarray:
        """Return the values of the second arrays of `splats_of`, shape (shown,).

        A Gaussian that particles carry has the mean of their values.

        Args:
            frame: Arrays of a frame.
            values: Value of each particle of the frame, shape (n,).
        """
        ids = np.asarray(frame["id"])
        of_particles = np.asarray(values, dtype=np.float64)[self.moving[ids]]
        passive = self.look.passive
        if passive is None:
            return of_particles
        row = np.full(len(self.moving), -1)
        row[ids] = np.arange(len(ids))
        carrier_rows = row[passive.carriers]
        present = self.riding & (carrier_rows >= 0).all(axis=1)
        carried = (passive.weights[present] * values[carrier_rows[present]]).sum(axis=1)
        return np.concatenate([of_particles, carried])

    def _needed_rows(self, frame: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Return the frame without the particles that are not shown."""
        is_needed = self._needed[np.asarray(frame["id"])]
        if is_needed.all():
            return frame
        return {
            name: array if name == "poses" else np.asarray(array)[is_needed]
            for name, array in frame.items()
        }

    def _splat_arrays(
        self, splats: Any, rows: np.ndarray, growth: np.ndarray
    ) -> dict[str, np.ndarray]:
        """Return viser's arrays of some Gaussians."""
        cov = growth[:, None] * splats.cov[rows]
        color, opacity = splats.color[rows], splats.opacity[rows]
        return splat_arrays(splats.x[rows], cov, color, opacity, self.cell)


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
