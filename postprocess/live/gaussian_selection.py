"""Subset of a run's Gaussians that viewers show in every frame."""

from typing import Any

import numpy as np

from ..frames.appearance import Appearance, view_dependent_splats
from .viewer_scene import splat_arrays

MAX_GROWTH = 4.0  # [-] largest factor on the size of a Gaussian
SOLID_SHARE = 0.75  # [-] share of the shown Gaussians reserved for bodies and scenery
MIN_WEIGHT = 1e-300  # of an invisible Gaussian, which comes last


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

    def splats_at(self, index: int, eye: np.ndarray) -> tuple[dict, dict]:
        """Return viser's arrays of frame `index`: of the scenery, and of all other Gaussians.

        Args:
            index: Number of the frame.
            eye: Point from which the colors are seen, shape (3,) [m].
        """
        return self.splats_of(self.look.frame(index), eye)

    def splats_of(self, frame: dict[str, np.ndarray], eye: np.ndarray) -> tuple[dict, dict]:
        """Return viser's arrays of a frame (Appearance.frame), as `splats_at` does."""
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
