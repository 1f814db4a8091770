"""Gaussians of a frame before anybody looks at them: places, shapes, colours for any eye."""

from typing import NamedTuple

import numpy as np

from postprocess import shade
from postprocess.settings import LookSettings
from vgmpi.gaussians import evolve
from vgmpi.gaussians import sh as harmonics


class Colors:
    """Colours of rows of coefficients; what does not depend on the view is worked out once."""

    def __init__(self, sh: np.ndarray):
        self.sh = sh
        self.plain = harmonics.evaluate(sh[:, :1], np.zeros((len(sh), 3)))
        self.view_dependent = np.zeros(len(sh), dtype=bool)
        if sh.shape[1] > 1:
            self.view_dependent = (sh[:, 1:] != 0).any(axis=(1, 2))

    def __call__(self, rows: np.ndarray, directions: np.ndarray) -> np.ndarray:
        color = self.plain[rows]
        shiny = np.flatnonzero(self.view_dependent[rows])
        if len(shiny):
            color[shiny] = shade.evaluate(self.sh, rows[shiny], directions[shiny])
        return color


class Part(NamedTuple):
    """Gaussians of a frame. x: (n, 3) [m]. cov: (n, 6) [m2]. opacity: (n,) in 0..1.

    color, rows: their coefficients are color.sh[rows], (n, K, 3). turning: which of them have
    turned with the rotations in F (m, 9).
    """

    x: np.ndarray
    cov: np.ndarray
    opacity: np.ndarray
    color: Colors
    rows: np.ndarray
    turning: np.ndarray = np.empty(0, dtype=np.int64)
    F: np.ndarray | None = None

    def seen_from(self, eye: np.ndarray) -> tuple[np.ndarray, ...]:
        """The fields of Splats for an `eye` [m]."""
        directions = self.x - eye
        if len(self.turning):  # shows towards d what it showed at rest towards R^T d
            directions[self.turning] = shade.turn_back(self.F, directions[self.turning])
        return self.x, self.cov, self.opacity, self.color(self.rows, directions)

    def coefficients(self) -> np.ndarray:
        """Colours for any eye, turned along (n, K, 3) float32."""
        sh = np.array(self.color.sh[self.rows], dtype=np.float32)
        if len(self.turning):
            sh[self.turning] = harmonics.rotate(sh[self.turning], evolve.rotation(self.F))
        return sh


class Passive:
    """Gaussians without mass, moved by the particles that carry them.

    factor: on the opacities of each object. chosen: whether shapes and colours follow.
    """

    def __init__(self, rest, factor: np.ndarray, chosen: LookSettings):
        riders = rest.passive
        self.count = len(rest.object)
        self.carriers = np.asarray(riders.carriers)
        self.weights = np.asarray(riders.weights, dtype=np.float64)
        self.offset = np.asarray(riders.x0)[:, None, :] - np.asarray(rest.x0)[self.carriers]
        self.cov0 = np.asarray(riders.cov0, dtype=np.float64)
        self.opacity = np.asarray(riders.opacity, dtype=np.float64) * factor[riders.object]
        self.color = Colors(np.asarray(riders.sh))
        self.evolves = chosen.covariance == "evolve"
        self.turns = chosen.harmonics == "rotate"

    def part(self, frame: dict[str, np.ndarray]) -> Part:
        """Those whose carriers are all there."""
        row = np.full(self.count, -1)
        row[frame["id"]] = np.arange(len(frame["id"]))
        at = row[self.carriers]
        there = np.flatnonzero((at >= 0).all(axis=1))
        at = at[there]
        x, F = evolve.carried(
            self.offset[there],
            self.weights[there],
            np.asarray(frame["x"], dtype=np.float64)[at],
            np.asarray(frame["F"])[at],
        )
        turning = np.flatnonzero(self.color.view_dependent[there] & self.turns)
        turned = F[turning].reshape(-1, 9)
        cov = self.cov0[there]
        if self.evolves:
            cov = evolve.solid(cov, F)
        return Part(x, cov, self.opacity[there], self.color, there, turning, turned)
