"""Pose of a body from a file or a generator in the photograph.

The pose consists of the file axis that points up, the yaw, the size and the place. Candidate
rotations are drawn by the splatter, each where its outline fits the box of the mask; the rotation
whose outline and colors agree best is taken.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.gaussians import spherical_harmonics
from vgmpi.gaussians.cloud import GaussianCloud
from vgmpi.postprocess.raster import rasterize
from vgmpi.preprocess.placement import UP, axis_rotation

from .grabcut import Box, box_of, iou
from .photo_camera import View

YAW_COUNT = 36  # yaw angles of the coarse search
YAW_OFFSETS = (
    0.0,
    2.5,
    -2.5,
    5.0,
    -5.0,
    7.5,
    -7.5,
    10.0,
    -10.0,
)  # [degrees] fine search about the best of them
# Both searches: pixels along the longer side of the mask in the compared pictures, and Gaussians.
COARSE, FINE = (72, 6_000), (160, 30_000)
COLOR_WEIGHT = 1.0  # [-] weight of the mean color difference, 0..1, relative to the outlines
PLACE_ITERATIONS = 6  # iterations for the place of a body
UP_AXES = ("z", "-y", "y", "-z", "x", "-x")


class Pose(NamedTuple):
    """Orientation of a body and its agreement with the photograph."""

    up: str  # axis of the body's file that points up
    yaw: float  # [degrees] rotation about the vertical
    iou: float  # [-] intersection over union of the outlines
    color_error: float  # [-] mean color difference inside both outlines, 0..1

    @property
    def score(self) -> float:
        """Return the agreement, larger is better."""
        return self.iou - COLOR_WEIGHT * self.color_error


class AlignedBody(NamedTuple):
    """Body about the eye, about 1 away, placed as its mask is seen, with its pose."""

    cloud: GaussianCloud
    pose: Pose


def align_to_photo(
    body: GaussianCloud,
    rgb: np.ndarray,
    mask: np.ndarray,
    view: View,
    up: str | None = None,
    yaw: float | None = None,
) -> AlignedBody:
    """Return the body in the pose in which the photograph shows it.

    Args:
        body: Gaussians in their own units and axes.
        rgb: Photograph, shape (height, width, 3) uint8.
        mask: The object, shape (height, width) bool.
        view: Camera of the photograph.
        up: Axis of the file that points up, or None to search it.
        yaw: Rotation about the vertical [degrees], or None to search it.
    """
    coarse = _trial(body, rgb, mask, view, COARSE)
    ups = UP_AXES if up is None else (up,)
    yaws = [360 * k / YAW_COUNT for k in range(YAW_COUNT)] if yaw is None else [yaw]
    pose = _best(coarse, [(axis, turn) for axis in ups for turn in yaws])
    if yaw is None:
        fine = _trial(body, rgb, mask, view, FINE)
        pose = _best(fine, [(pose.up, pose.yaw + offset) for offset in YAW_OFFSETS])
    upright = _upright(body, pose.up, pose.yaw)
    placement = _fit_box(upright.x, view, box_of(mask))
    return AlignedBody(upright.transformed(np.eye(3), float(placement[3]), placement[:3]), pose)


class Trial(NamedTuple):
    """Body and a small picture with which its rotations are compared."""

    body: GaussianCloud
    view: View
    mask: np.ndarray  # (height, width) bool
    color: np.ndarray  # (height, width, 3) in 0..1


def _trial(
    body: GaussianCloud, rgb: np.ndarray, mask: np.ndarray, view: View, size: tuple[int, int]
) -> Trial:
    """Return a trial whose mask has size[0] pixels on its longer side, with size[1] Gaussians."""
    from PIL import Image

    box = box_of(mask)
    scale = min(1.0, size[0] / max(box.right - box.left, box.bottom - box.top))
    width, height = (max(16, round(n * scale)) for n in (view.width, view.height))
    shape, mean = (width, height), Image.Resampling.BOX
    levels = Image.fromarray(np.where(mask, 255, 0).astype(np.uint8)).resize(shape, mean)
    color = np.asarray(Image.fromarray(rgb).resize(shape, mean)) / 255.0
    small = View(width, height, view.fov, view.pitch)
    return Trial(_thinned(body, size[1]), small, np.asarray(levels) > 127, color)


def _best(trial: Trial, turns: list[tuple[str, float]]) -> Pose:
    """Return the best pose among pairs of up axis and yaw [degrees]."""
    poses = [_score(trial, up, yaw % 360) for up, yaw in turns]
    return max(poses, key=lambda pose: pose.score)


def _thinned(body: GaussianCloud, max_count: int) -> GaussianCloud:
    """Select at most max_count Gaussians at random, enlarged to cover the same area."""
    if len(body) <= max_count:
        return body
    rows = np.random.default_rng(0).choice(len(body), max_count, replace=False)
    some = body.select(np.sort(rows))
    enlargement = np.sqrt(len(body) / max_count)
    return GaussianCloud(some.x, some.quat, some.scale * enlargement, some.opacity, some.sh)


def _upright(body: GaussianCloud, up: str, yaw: float) -> GaussianCloud:
    """Return the body upright, rotated, of height 1, with the middle of its base at the origin."""
    rotation = axis_rotation((0.0, 0.0, 1.0), np.radians(yaw)) @ np.asarray(UP[up], dtype=float)
    rotated = body.transformed(rotation)
    low, high = rotated.x.min(axis=0), rotated.x.max(axis=0)
    base = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    size = 1 / max(float(high[2] - low[2]), 1e-12)
    return rotated.transformed(np.eye(3), size, -size * base)


def _fit_box(x: np.ndarray, view: View, box: Box) -> np.ndarray:
    """Return base point about the eye, 1 away, and size (4,) so that points (n, 3) fill a box."""
    ray = view.rays(np.array([(box.left + box.right) / 2, (box.top + box.bottom) / 2]))
    middle = ray / max(float(ray[1]), 0.05)
    wanted = np.array([box.right - box.left, box.bottom - box.top], dtype=np.float64)
    size = float(wanted[1] / view.focal * np.linalg.norm(middle))
    centre = (x.min(axis=0) + x.max(axis=0)) / 2
    base = middle - size * centre
    for _ in range(PLACE_ITERATIONS):
        pixels, depth = view.pixels(base + size * x)
        visible = np.isfinite(pixels).all(axis=1) & (depth > 1e-3)
        if visible.sum() < 2:
            break
        low, high = pixels[visible].min(axis=0), pixels[visible].max(axis=0)
        size *= float(wanted.sum() / max((high - low).sum(), 1e-9))
        pixels, depth = view.pixels(base + size * x)
        low, high = np.nanmin(pixels, axis=0), np.nanmax(pixels, axis=0)
        offset = np.array([box.left + box.right, box.top + box.bottom]) / 2 - (low + high) / 2
        distance = float(np.nanmean(depth))
        right, down, _ = view.rotation()
        base = base + distance / view.focal * (offset[0] * right + offset[1] * down)
        base, size = base / base[1], size / base[1]
    return np.append(base, size)


def _score(trial: Trial, up: str, yaw: float) -> Pose:
    """Draw the body in one orientation and measure its agreement with the photograph."""
    upright = _upright(trial.body, up, yaw)
    placed = _fit_box(upright.x, trial.view, box_of(trial.mask))
    cloud = upright.transformed(np.eye(3), float(placed[3]), placed[:3])
    camera = trial.view.camera(np.zeros(3), near_plane=0.02)
    splats = rasterize.ProjectableGaussians(
        cloud.x, cloud.cov(), cloud.opacity, spherical_harmonics.evaluate(cloud.sh, cloud.x)
    )
    drawn, transmittance = rasterize.render(splats, camera, np.zeros(3))
    outline = transmittance < 0.5
    both = outline & trial.mask
    color_error = (
        float(np.abs(np.clip(drawn, 0, 1) - trial.color)[both].mean()) if both.any() else 1.0
    )
    return Pose(up, yaw, iou(outline, trial.mask), color_error)
