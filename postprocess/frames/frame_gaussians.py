"""Gaussians of a frame before projection: positions, shapes, and colors for any view."""

from typing import NamedTuple

import numpy as np

from vgmpi.gaussians import compiled_evolution, shape_evolution, spherical_harmonics

from ..raster.rasterize import ProjectableGaussians

# Rules by which the shapes of a body's Gaussians follow the particles.
FIXED = 0  # the shape at rest is kept
DEFORMED = 1  # F cov0 F^T; colors rotate with the body
SCALED = 2  # J^(2/3) cov0
VOLUME_SPHERE = 3  # spheres of the particles' volume
RADIUS_SPHERE = 4  # spheres as large as the Gaussians at rest


class ViewColors:
    """Colors of rows of coefficients, with their view-independent part computed once."""

    def __init__(self, sh: np.ndarray):
        self.sh = sh
        self.plain = spherical_harmonics.evaluate(sh[:, :1], np.zeros((len(sh), 3)))
        self.view_dependent = np.zeros(len(sh), dtype=bool)
        if sh.shape[1] > 1:
            self.view_dependent = (sh[:, 1:] != 0).any(axis=(1, 2))

    def __call__(self, rows: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Return the colors (n, 3) of rows, seen along directions (n, 3)."""
        color = self.plain[rows]
        shiny = np.flatnonzero(self.view_dependent[rows])
        if len(shiny):
            color[shiny] = compiled_evolution.evaluate(self.sh, rows[shiny], directions[shiny])
        return color


class GaussianBatch(NamedTuple):
    """Gaussians of a frame. x: (n, 3) [m]. cov: (n, 6) [m2]. opacity: (n,) in 0..1.

    color, rows: their coefficients are color.sh[rows], (n, K, 3). turning: indices of Gaussians
    whose colors have turned with the rotations in F (m, 9). bright: factor on the colors, (n,).
    rider_rows, deformation: for Gaussians carried by particles, their indices and their F (n, 9).
    compensated_lowpass: see ProjectableGaussians.
    """

    x: np.ndarray
    cov: np.ndarray
    opacity: np.ndarray
    color: ViewColors
    rows: np.ndarray
    turning: np.ndarray = np.empty(0, dtype=np.int64)
    F: np.ndarray | None = None
    bright: np.ndarray | None = None
    rider_rows: np.ndarray | None = None
    deformation: np.ndarray | None = None
    compensated_lowpass: np.ndarray | None = None

    def view_from(self, eye: np.ndarray) -> ProjectableGaussians:
        """Return the Gaussians as seen from an `eye` [m]."""
        directions = self.x - eye
        if len(self.turning):  # the color towards d is the rest color towards R^T d
            assert self.F is not None
            directions[self.turning] = compiled_evolution.rotate_view_directions(
                self.F, directions[self.turning]
            )
        color = self.color(self.rows, directions)
        if self.bright is not None:
            color = color * self.bright[:, None]
        lowpass = self.compensated_lowpass
        return ProjectableGaussians(self.x, self.cov, self.opacity, color, lowpass)

    def without_color(self) -> ProjectableGaussians:
        """Return the Gaussians in black."""
        black = np.zeros((len(self.x), 3))
        lowpass = self.compensated_lowpass
        return ProjectableGaussians(self.x, self.cov, self.opacity, black, lowpass)

    def scaled_brightness(self, factor: np.ndarray) -> "GaussianBatch":
        """Return the Gaussians with colors multiplied by `factor` (n,)."""
        return self._replace(bright=factor if self.bright is None else self.bright * factor)

    def subset(self, mask: np.ndarray) -> "GaussianBatch":
        """Return the Gaussians for which `mask` (n,) is true."""
        turning_mask = mask[self.turning]
        new_row = np.cumsum(mask) - 1
        return GaussianBatch(
            self.x[mask], self.cov[mask], self.opacity[mask], self.color, self.rows[mask],
            new_row[self.turning[turning_mask]], None if self.F is None else self.F[turning_mask],
            None if self.bright is None else self.bright[mask],
            compensated_lowpass=select_rows(self.compensated_lowpass, mask),
        )  # fmt: skip

    def subset_rows(self, rows: np.ndarray) -> "GaussianBatch":
        """Return the Gaussians of the rows (m,), in ascending order."""
        mask = np.zeros(len(self.x), bool)
        mask[rows] = True
        return self.subset(mask)

    def coefficients(self) -> np.ndarray:
        """Return the color coefficients, rotated with the bodies, (n, K, 3) float32."""
        sh = np.array(self.color.sh[self.rows], dtype=np.float32)
        if len(self.turning):
            assert self.F is not None
            sh[self.turning] = spherical_harmonics.rotate(
                sh[self.turning], shape_evolution.rotation(self.F)
            )
        return sh


class Scenery:
    """Gaussians without mass that are static or move as rigid bodies.

    rows: scenery of gaussians.h5. objects: entries of that file. factor: factor on the opacities of
    each object. lowpass: compensated variance of each object [pixels^2], or None.
    """

    def __init__(
        self, rows, objects: list[dict], factor: np.ndarray, lowpass: np.ndarray | None = None
    ):
        self.x0 = np.asarray(rows.x0, dtype=np.float64)
        self.cov0 = np.asarray(rows.cov0, dtype=np.float64)
        self.opacity = np.asarray(rows.opacity, dtype=np.float64) * factor[rows.object]
        self.color = ViewColors(np.asarray(rows.sh))
        self.compensated_lowpass = select_rows(lowpass, rows.object)
        self.moving = [np.flatnonzero(rows.object == k) for k in moving(objects)]

    def part(self, frame: dict[str, np.ndarray]) -> GaussianBatch:
        """Return the Gaussians at their positions in a frame."""
        all_rows = np.arange(len(self.x0))
        lowpass = self.compensated_lowpass
        if not self.moving:
            return GaussianBatch(
                self.x0, self.cov0, self.opacity, self.color, all_rows, compensated_lowpass=lowpass
            )
        x, cov, turned_rows, F = self.x0.copy(), self.cov0.copy(), [], []
        for members, pose in zip(self.moving, frame["poses"], strict=True):
            rotation = np.broadcast_to(pose[:3, :3].reshape(9), (len(members), 9))
            x[members] = self.x0[members] @ pose[:3, :3].T + pose[:3, 3]
            cov[members] = shape_evolution.deformed_covariance(self.cov0[members], rotation)
            turned_rows.append(members[self.color.view_dependent[members]])
            F.append(rotation[: len(turned_rows[-1])])
        turning = np.concatenate(turned_rows)
        return GaussianBatch(
            x, cov, self.opacity, self.color, all_rows, turning, np.concatenate(F),
            compensated_lowpass=lowpass,
        )  # fmt: skip


def select_rows(values: np.ndarray | None, rows: np.ndarray) -> np.ndarray | None:
    """Return the values of rows, if there are any."""
    return None if values is None else values[rows]


def moving(objects: list[dict]) -> list[int]:
    """Return the numbers of the objects whose poses are in the frames."""
    return [k for k, entry in enumerate(objects) if entry.get("is_moving")]


class Passive:
    """Gaussians without mass that are carried by particles."""

    def __init__(
        self, gaussians, rules: np.ndarray, turns: np.ndarray, factor: np.ndarray,
        lowpass: np.ndarray | None = None,
    ):  # fmt: skip
        """Precompute what does not depend on the frame.

        Args:
            gaussians: Gaussians at rest as read from gaussians.h5.
            rules: Shape rule of each object.
            turns: Whether the colors of each object turn with it.
            factor: Factor on the opacities of each object.
            lowpass: Compensated variance of each object [pixels^2], or None.
        """
        riders = gaussians.passive
        self.count = len(gaussians.object)
        self.rule, self.turns = rules[riders.object], turns[riders.object]
        self.carriers = np.asarray(riders.carriers)
        self.weights = np.asarray(riders.weights, dtype=np.float64)
        self.offset = np.asarray(riders.x0)[:, None, :] - np.asarray(gaussians.x0)[self.carriers]
        self.cov0 = np.asarray(riders.cov0, dtype=np.float64)
        self.opacity = np.asarray(riders.opacity, dtype=np.float64) * factor[riders.object]
        self.color = ViewColors(np.asarray(riders.sh))
        self.compensated_lowpass = select_rows(lowpass, riders.object)
        self.carriers_sh = np.asarray(gaussians.sh)

    def part(self, frame: dict[str, np.ndarray]) -> GaussianBatch:
        """Return the Gaussians whose carriers are all present in a frame."""
        row = np.full(self.count, -1)
        row[frame["id"]] = np.arange(len(frame["id"]))
        carrier_rows = row[self.carriers]
        present = np.flatnonzero((carrier_rows >= 0).all(axis=1))
        x, F = compiled_evolution.skin_to_carriers(
            present, carrier_rows, self.offset, self.weights, frame["positions"], frame["F"]
        )
        color, rows = self._colors(frame, present, carrier_rows)
        turning = np.flatnonzero(self.turns[present] & color.view_dependent[rows])
        cov = self._covariances(present, F)
        opacity = self.opacity[present]
        return GaussianBatch(
            x, cov, opacity, color, rows, turning, F[turning], None, present, F,
            select_rows(self.compensated_lowpass, present),
        )  # fmt: skip

    def _colors(
        self, frame: dict, present: np.ndarray, carrier_rows: np.ndarray
    ) -> tuple[ViewColors, np.ndarray]:
        """Return colors and the rows to use; they change with the colors of the carriers."""
        if "sh" not in frame:
            return self.color, present
        change = np.asarray(frame["sh"]) - self.carriers_sh[frame["id"]]
        changed = np.flatnonzero(change.any(axis=(1, 2))[carrier_rows[present]].any(axis=1))
        if not len(changed):
            return self.color, present
        sh, changed_rows = self.color.sh[present], present[changed]
        increment = np.einsum(
            "pk,pkij->pij", self.weights[changed_rows], change[carrier_rows[changed_rows]]
        )
        sh[changed] += increment.astype(np.float32)
        return ViewColors(sh), np.arange(len(present))

    def _covariances(self, present: np.ndarray, F: np.ndarray) -> np.ndarray:
        """Return the covariances [m2], (n, 6).

        A carried Gaussian has no volume of its own; as a sphere it keeps its size at rest.
        """
        cov, rule = self.cov0[present], self.rule[present]
        if len(selected := np.flatnonzero(rule == DEFORMED)):
            compiled_evolution.solid(self.cov0, present, selected, F, cov)
        if len(selected := np.flatnonzero(rule > DEFORMED)):
            J = np.linalg.det(F[selected].reshape(-1, 3, 3))
            is_scaled = rule[selected] == SCALED
            cov[selected[is_scaled]] = shape_evolution.deformed_covariance(
                cov[selected[is_scaled]], shape_evolution.isotropic_deformation(J[is_scaled])
            )
            cov[selected[~is_scaled]] = shape_evolution.equivalent_sphere_covariance(
                cov[selected[~is_scaled]], J[~is_scaled]
            )
        return cov
