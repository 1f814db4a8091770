"""Gaussians of a frame before anybody looks at them: places, shapes, colours for any eye."""

from typing import NamedTuple

import numpy as np

from postprocess import shade
from vgmpi.gaussians import evolve
from vgmpi.gaussians import sh as harmonics

# how the Gaussians of a body follow their particles
FIXED = 0  # not at all: the shape at rest
FOLLOW = 1  # F cov0 F^T, colours turn along
SWELL = 2  # J^(2/3) cov0
BALL = 3  # balls of the particles' volume
ROUND = 4  # balls as large as the Gaussians at rest


class ViewColours:
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
    turned with the rotations in F (m, 9). bright: what colours are multiplied with, (n,).
    there, deformation: of riders, which of them these are and their F (n, 9).
    """

    x: np.ndarray
    cov: np.ndarray
    opacity: np.ndarray
    color: ViewColours
    rows: np.ndarray
    turning: np.ndarray = np.empty(0, dtype=np.int64)
    F: np.ndarray | None = None
    bright: np.ndarray | None = None
    there: np.ndarray | None = None
    deformation: np.ndarray | None = None

    def seen_from(self, eye: np.ndarray) -> tuple[np.ndarray, ...]:
        """The fields of Splats for an `eye` [m]."""
        directions = self.x - eye
        if len(self.turning):  # shows towards d what it showed at rest towards R^T d
            directions[self.turning] = shade.turn_back(self.F, directions[self.turning])
        color = self.color(self.rows, directions)
        if self.bright is not None:
            color = color * self.bright[:, None]
        return self.x, self.cov, self.opacity, color

    def brighter(self, factor: np.ndarray) -> "Part":
        """The same with colours multiplied by `factor` (n,)."""
        return self._replace(bright=factor if self.bright is None else self.bright * factor)

    def only(self, keep: np.ndarray) -> "Part":
        """Those for which `keep` (n,) is true."""
        those = keep[self.turning]
        place = np.cumsum(keep) - 1
        return Part(
            self.x[keep], self.cov[keep], self.opacity[keep], self.color, self.rows[keep],
            place[self.turning[those]], None if self.F is None else self.F[those],
            None if self.bright is None else self.bright[keep],
        )  # fmt: skip

    def only_rows(self, rows: np.ndarray) -> "Part":
        """Those of the rows (m,), in ascending order."""
        keep = np.zeros(len(self.x), bool)
        keep[rows] = True
        return self.only(keep)

    def coefficients(self) -> np.ndarray:
        """Colours for any eye, turned along (n, K, 3) float32."""
        sh = np.array(self.color.sh[self.rows], dtype=np.float32)
        if len(self.turning):
            sh[self.turning] = harmonics.rotate(sh[self.turning], evolve.rotation(self.F))
        return sh


class Scenery:
    """Gaussians without mass that stay where they are, or move as rigid bodies.

    rows: scenery of gaussians.h5. objects: as there. factor: for every object what opacities are
    multiplied with.
    """

    def __init__(self, rows, objects: list[dict], factor: np.ndarray):
        self.x0 = np.asarray(rows.x0, dtype=np.float64)
        self.cov0 = np.asarray(rows.cov0, dtype=np.float64)
        self.opacity = np.asarray(rows.opacity, dtype=np.float64) * factor[rows.object]
        self.color = ViewColours(np.asarray(rows.sh))
        self.moving = [np.flatnonzero(rows.object == k) for k in moving(objects)]

    def part(self, frame: dict[str, np.ndarray]) -> Part:
        """Where they are in a frame."""
        every = np.arange(len(self.x0))
        if not self.moving:
            return Part(self.x0, self.cov0, self.opacity, self.color, every)
        x, cov, turned, F = self.x0.copy(), self.cov0.copy(), [], []
        for at, pose in zip(self.moving, frame["poses"], strict=True):
            rotation = np.broadcast_to(pose[:3, :3].reshape(9), (len(at), 9))
            x[at] = self.x0[at] @ pose[:3, :3].T + pose[:3, 3]
            cov[at] = evolve.solid(self.cov0[at], rotation)
            turned.append(at[self.color.view_dependent[at]])
            F.append(rotation[: len(turned[-1])])
        turning = np.concatenate(turned)
        return Part(x, cov, self.opacity, self.color, every, turning, np.concatenate(F))


def moving(objects: list[dict]) -> list[int]:
    """Numbers of the objects that frames have poses of."""
    return [k for k, entry in enumerate(objects) if entry.get("moves")]


class Passive:
    """Gaussians without mass, moved by the particles that carry them.

    rest: as read from gaussians.h5. rules, turns, factor: for every object how shapes follow,
    whether colours turn, and what opacities are multiplied with.
    """

    def __init__(self, rest, rules: np.ndarray, turns: np.ndarray, factor: np.ndarray):
        riders = rest.passive
        self.count = len(rest.object)
        self.rule, self.turns = rules[riders.object], turns[riders.object]
        self.carriers = np.asarray(riders.carriers)
        self.weights = np.asarray(riders.weights, dtype=np.float64)
        self.offset = np.asarray(riders.x0)[:, None, :] - np.asarray(rest.x0)[self.carriers]
        self.cov0 = np.asarray(riders.cov0, dtype=np.float64)
        self.opacity = np.asarray(riders.opacity, dtype=np.float64) * factor[riders.object]
        self.color = ViewColours(np.asarray(riders.sh))
        self.carriers_sh = np.asarray(rest.sh)

    def part(self, frame: dict[str, np.ndarray]) -> Part:
        """Those whose carriers are all there."""
        row = np.full(self.count, -1)
        row[frame["id"]] = np.arange(len(frame["id"]))
        at = row[self.carriers]
        there = np.flatnonzero((at >= 0).all(axis=1))
        x, F = shade.carried(there, at, self.offset, self.weights, frame["x"], frame["F"])
        color, rows = self._colours(frame, there, at)
        turning = np.flatnonzero(self.turns[there] & color.view_dependent[rows])
        cov = self._covariances(there, F)
        opacity = self.opacity[there]
        return Part(x, cov, opacity, color, rows, turning, F[turning], None, there, F)

    def _colours(
        self, frame: dict, there: np.ndarray, at: np.ndarray
    ) -> tuple[ViewColours, np.ndarray]:
        """Colours, and which rows of them: they change as those of the carriers do."""
        if "sh" not in frame:
            return self.color, there
        change = np.asarray(frame["sh"]) - self.carriers_sh[frame["id"]]
        some = np.flatnonzero(change.any(axis=(1, 2))[at[there]].any(axis=1))
        if not len(some):
            return self.color, there
        sh, those = self.color.sh[there], there[some]
        more = np.einsum("pk,pkij->pij", self.weights[those], change[at[those]])
        sh[some] += more.astype(np.float32)
        return ViewColours(sh), np.arange(len(there))

    def _covariances(self, there: np.ndarray, F: np.ndarray) -> np.ndarray:
        """[m2], (n, 6); a rider has no volume of its own: as a ball it is as large as at rest."""
        cov, rule = self.cov0[there], self.rule[there]
        if len(of := np.flatnonzero(rule == FOLLOW)):
            shade.solid(self.cov0, there, of, F, cov)
        if len(of := np.flatnonzero(rule > FOLLOW)):
            J = np.linalg.det(F[of].reshape(-1, 3, 3))
            swells = rule[of] == SWELL
            cov[of[swells]] = evolve.solid(cov[of[swells]], evolve.swollen(J[swells]))
            cov[of[~swells]] = evolve.rounded(cov[of[~swells]], J[~swells])
        return cov
