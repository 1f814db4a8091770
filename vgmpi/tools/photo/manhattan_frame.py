"""Pitch and field of view from a frame of three orthogonal directions that segments follow.

Edges of rooms, tables, tiles and boxes follow the vertical and two level directions (Manhattan
world, Coughlan and Yuille 1999). Each direction has a vanishing point, on which its edges
converge; orthogonal ones tell the camera's rotation and focal length (Caprile and Torre 1990).
The pixels are square and the optical axis passes the middle of the picture.
"""

from typing import NamedTuple

import numpy as np
from scipy import optimize, stats

from .grabcut import opencv
from .photo_camera import View

MAX_SIDE = 1000  # [pixels] longer side of the picture in which segments are detected
MIN_LENGTH = 0.025  # [-] of a segment, relative to the diagonal
MAX_COUNT = 300  # the longest segments are kept
RIM = 0.01  # [-] of the diagonal: segments so close to an edge of the picture are its frame
# a camera is a row of four numbers: pitch, roll and yaw of the frame [rad], ln(focal length)
PITCH, ROLL, YAW, FOCAL = range(4)
MAX_LOG_FOCAL = 50.0  # bound of ln(focal length) in trial steps of the fit
SEED = 5
PAIRS = 1200  # pairs of segments that give hypotheses, for each field of view
FIELDS = 20.0, 28.0, 38.0, 50.0, 65.0, 85.0  # [degrees] vertical fields of view that are tried
LOWEST_PITCH, HIGHEST_PITCH = np.radians(-35.0), np.radians(90.0)  # of hypotheses
# of results: farther down, a floor looks like a wall in front of a turned camera
MIN_PITCH, MAX_PITCH = np.radians(-30.0), np.radians(65.0)
MAX_ROLL = np.radians(15.0)
MAX_ROLL_COST = 0.08  # [-] support that a camera of large roll lacks
# [-] spread of cameras about level ones of a usual lens, as people hold them
PRIOR = np.array([np.radians(30.0), np.radians(2.0), np.radians(30.0), 0.5])
WIDE, NARROW = np.radians(3.0), np.radians(1.5)  # between a segment and its vanishing point
ROUNDS = 8  # of assignment and least squares
MIN_SEGMENTS = 4  # of a direction
MAX_CHANCE = 1e-6  # number of frames that agree so well with segments at random
MAX_DIRECTION_CHANCE = 1e-3  # the same of directions
MIN_SHARE = 0.5  # [-] of the segments' length that agrees
MIN_REST = 0.2  # [-] the same of a direction, of what the others leave
MAX_RIVAL = 0.5  # [-] of the length that agrees with the best camera alone: with a rival alone
MIN_DIFFERENCE = 0.08  # [-] of the segments' length that agrees with the best camera alone
OTHER_PITCH = np.radians(12.0)  # difference from which on a pitch is another one
RIVAL_ROLL = np.radians(8.0)  # of a rival
# half intervals due to lenses that bend lines or whose axis passes beside the middle
LENS = np.array([np.radians(1.0), 0.0, 0.0, 0.04])
MIN_DEVIATION = 0.3  # [pixels] of the segments' ends
MAX_PITCH_INTERVAL = np.radians(2.5)
MAX_FOCAL_INTERVAL = 0.1  # [-] of ln(focal length)


class Segments(NamedTuple):
    """Segments about the middle of the picture, in pixels of the photograph."""

    middle: np.ndarray  # (n, 2) [pixels] x to the right, y down
    along: np.ndarray  # (n, 2) unit vectors
    length: np.ndarray  # (n,) [pixels]

    def select(self, chosen: np.ndarray) -> "Segments":
        """Return the segments of a mask or of indices."""
        return Segments(self.middle[chosen], self.along[chosen], self.length[chosen])


def detect_segments(rgb: np.ndarray) -> Segments:
    """Detect segments in a photograph (height, width, 3) uint8, the longest first.

    The detector is that of Grompone von Gioi et al. (2010).

    Raises:
        MaskError: OpenCV is missing.
    """
    cv2 = opencv()
    height, width = rgb.shape[:2]
    scale = min(1.0, MAX_SIDE / max(height, width))
    gray = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
    if scale < 1:
        size = (round(width * scale), round(height * scale))
        gray = cv2.resize(gray, size, interpolation=cv2.INTER_AREA)
    lines = cv2.createLineSegmentDetector().detect(gray)[0]
    if lines is None:
        return Segments(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0))
    ratio = np.array([width / gray.shape[1], height / gray.shape[0]])
    # the detector counts from the middle of the first pixel
    ends = (lines.reshape(-1, 2, 2).astype(np.float64) + 0.5) * ratio - (width / 2, height / 2)
    return _longest(ends, width, height)


def _longest(ends: np.ndarray, width: int, height: int) -> Segments:
    """Return the segments of ends (n, 2, 2) without short ones and without the picture's rim."""
    step = ends[:, 1] - ends[:, 0]
    length = np.hypot(*step.T)
    diagonal = np.hypot(width, height)
    gap = (width / 2, height / 2) - np.abs(ends)  # to the edges of the picture, (n, 2, 2)
    on_rim = (gap < RIM * diagonal).all(axis=1).any(axis=1)
    used = np.flatnonzero((length > MIN_LENGTH * diagonal) & ~on_rim)
    used = used[np.argsort(-length[used], kind="stable")][:MAX_COUNT]
    return Segments(ends[used].mean(axis=1), step[used] / length[used, None], length[used])


class Frame(NamedTuple):
    """Camera that agrees with the segments of a photograph."""

    pitch: float  # [rad] by which it looks down
    roll: float  # [rad] by which the picture is turned, clockwise
    focal: float  # [pixels]
    pitch_interval: float  # [rad] half interval that covers the truth in 95 of 100 cases
    focal_interval: float  # [-] the same of ln(focal length), 0 if it was given
    share: float  # [-] part of the segments' length that agrees


def fit_frame(
    segments: Segments, height: int, fov: float | None, pitch: float | None = None
) -> Frame | None:
    """Return the camera that agrees with segments, None if they do not tell it.

    Args:
        segments: Segments, the longest first.
        height: Height of the picture [pixels].
        fov: Vertical field of view [degrees], None to find it too.
        pitch: Pitch [degrees] if it is known.
    """
    if len(segments.length) < 2 * MIN_SEGMENTS:
        return None
    views = [View(height, height, field, 0.0) for field in (FIELDS if fov is None else (fov,))]
    cameras = np.concatenate([_hypotheses(segments, view.focal) for view in views])
    is_free = np.array([pitch is None, True, True, fov is None])
    if pitch is not None:
        cameras = cameras[np.abs(cameras[:, PITCH] - np.radians(pitch)) < OTHER_PITCH]
        cameras[:, PITCH] = np.radians(pitch)
    if len(cameras) == 0:
        return None
    support = _support(cameras, segments)
    best = _best_refined(cameras, support, segments, is_free)
    if _has_rival(cameras, support, best, segments, is_free):
        return None
    return _frame(best, segments, is_free)


def _directions(cameras: np.ndarray) -> np.ndarray:
    """Return the axes of frames (n, 4): directions (n, 3, 3), the third one up.

    Row i of a matrix is direction i: right, down and forward in the picture.
    """
    pitch, roll, yaw = cameras[:, PITCH], cameras[:, ROLL], cameras[:, YAW]
    zero = np.zeros(len(cameras))
    level = np.stack([np.cos(yaw), np.sin(yaw), zero], axis=-1)
    other = np.stack([-np.sin(yaw), np.cos(yaw), zero], axis=-1)
    axes = np.stack([level, other, np.stack([zero, zero, zero + 1], axis=-1)], axis=1)
    x, y, z = axes[..., 0], axes[..., 1], axes[..., 2]  # right, level away from the eye, up
    sin, cos = np.sin(pitch)[:, None], np.cos(pitch)[:, None]
    down, forward = -sin * y - cos * z, cos * y - sin * z
    sin, cos = np.sin(roll)[:, None], np.cos(roll)[:, None]
    return np.stack([cos * x - sin * down, sin * x + cos * down, forward], axis=-1)


def _hypotheses(segments: Segments, focal: float) -> np.ndarray:
    """Return cameras (n, 4) of a focal length that agree with some of the segments.

    Two segments meet in a vanishing point. It is a level direction of a camera without roll, or a
    third segment follows another axis of its frame, any of which may be the vertical one.
    """
    random = np.random.default_rng(SEED)
    count = len(segments.length)
    weight = segments.length / segments.length.sum()
    first, second, third = random.choice(count, (3, PAIRS), p=weight)
    middle = np.concatenate([segments.middle / focal, np.ones((count, 1))], axis=1)
    along = np.concatenate([segments.along, np.zeros((count, 1))], axis=1)
    plane = np.cross(middle, along)  # normal of the plane through the eye and the segment
    point = np.cross(plane[first], plane[second])
    across = np.cross(point, plane[third])
    level_up = np.stack([0 * point[:, 0], point[:, 2], -point[:, 1]], axis=-1)
    frames = [
        (point, across),
        (across, point),
        (np.cross(point, across), point),
        (level_up, point),
    ]
    cameras = np.concatenate([_cameras(up, level, focal) for up, level in frames])
    return cameras[
        np.isfinite(cameras).all(axis=1)
        & (cameras[:, PITCH] > LOWEST_PITCH)
        & (cameras[:, PITCH] < HIGHEST_PITCH)
        & (np.abs(cameras[:, ROLL]) < MAX_ROLL)
    ]


def _cameras(up: np.ndarray, level: np.ndarray, focal: float) -> np.ndarray:
    """Return cameras (n, 4) that see vectors (n, 3) up and level: right, down and forward."""
    with np.errstate(divide="ignore", invalid="ignore"):
        up = up * np.where(up[:, 1:2] > 0, -1.0, 1.0) / np.linalg.norm(up, axis=1)[:, None]
    pitch = np.arcsin(np.clip(-up[:, 2], -1, 1))
    roll = np.arctan2(up[:, 0], -up[:, 1])
    upright = np.cos(roll) * level[:, 1] - np.sin(roll) * level[:, 0]  # down, roll taken back
    right = np.cos(roll) * level[:, 0] + np.sin(roll) * level[:, 1]
    yaw = np.arctan2(np.cos(pitch) * level[:, 2] - np.sin(pitch) * upright, right)
    return np.stack([pitch, roll, yaw, np.full(len(up), np.log(focal))], axis=-1)


def _sines(cameras: np.ndarray, segments: Segments) -> np.ndarray:
    """Return sines (n, 3, segments) between segments and the ways to the vanishing points."""
    axes = _directions(cameras)
    focal = np.exp(np.clip(cameras[:, FOCAL], -MAX_LOG_FOCAL, MAX_LOG_FOCAL))[:, None]
    (x, y), (along_x, along_y) = segments.middle.T, segments.along.T
    way_x = (focal * axes[..., 0])[..., None] - axes[..., 2:] * x
    way_y = (focal * axes[..., 1])[..., None] - axes[..., 2:] * y
    length = np.maximum(np.hypot(way_x, way_y), 1e-9)
    return (along_x * way_y - along_y * way_x) / length


def _support(cameras: np.ndarray, segments: Segments) -> np.ndarray:
    """Return the agreeing part of the segments' length, less where it is inexact, shape (n,)."""
    weight = segments.length / segments.length.sum()
    square = (cameras[:, ROLL] / PRIOR[ROLL]) ** 2
    parts = []
    for some in np.array_split(cameras, 1 + len(cameras) * len(weight) // 300_000):
        sine = np.abs(_sines(some, segments)).min(axis=1) / np.sin(WIDE)
        parts.append(np.maximum(1 - sine**2, 0) @ weight)
    return np.concatenate(parts) - MAX_ROLL_COST * square / (square + 8)


def _best_refined(
    cameras: np.ndarray, support: np.ndarray, segments: Segments, is_free: np.ndarray
) -> np.ndarray:
    """Return the best camera (4,) of the best hypothesis of each focal length, refined."""
    refined = []
    for focal in np.unique(cameras[:, FOCAL]):
        of_focal = np.flatnonzero(cameras[:, FOCAL] == focal)
        start = cameras[of_focal[np.argmax(support[of_focal])]]
        refined.append(_refine(start, segments, is_free))
    return refined[int(np.argmax(_support(np.array(refined), segments)))]


def _refine(camera: np.ndarray, segments: Segments, is_free: np.ndarray,
            allowed: tuple[int, ...] = (0, 1, 2)) -> np.ndarray:  # fmt: skip
    """Return the camera (4,) after least squares over the segments of its allowed directions."""
    for limit in np.linspace(WIDE, NARROW, ROUNDS):
        which, agrees = _assign(camera, segments, limit, allowed)
        if not agrees.any():
            return camera
        camera = _fit_camera(camera, segments.select(agrees), which[agrees], is_free)
    return camera


def _fit_camera(
    camera: np.ndarray, segments: Segments, axis: np.ndarray, is_free: np.ndarray
) -> np.ndarray:
    """Return the camera (4,) whose directions, one for each segment, fit the segments best."""

    def insert_free(free: np.ndarray) -> np.ndarray:
        """Return the camera with other free numbers."""
        moved = camera.copy()
        moved[is_free] = free
        return moved

    result = optimize.least_squares(
        lambda free: _residuals(insert_free(free), segments, axis),
        camera[is_free],
        loss="soft_l1",
        max_nfev=30,
    )
    return insert_free(result.x)


def _assign(
    camera: np.ndarray, segments: Segments, limit: float, allowed: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the nearest allowed direction of each segment, and whether it is within a limit."""
    sine = np.full((3, len(segments.length)), np.inf)
    sine[list(allowed)] = np.abs(_sines(camera[None], segments))[0, list(allowed)]
    return sine.argmin(axis=0), sine.min(axis=0) < np.sin(limit)


def _residuals(camera: np.ndarray, segments: Segments, axis: np.ndarray) -> np.ndarray:
    """Return the distances [pixels] of the segments' ends from the ways, and that of the roll."""
    sine = _sines(camera[None], segments)[0, axis, np.arange(len(axis))]
    return np.append(0.5 * segments.length * sine, camera[ROLL] / PRIOR[ROLL])


def _has_rival(
    cameras: np.ndarray, support: np.ndarray, best: np.ndarray, segments: Segments,
    is_free: np.ndarray,
) -> bool:  # fmt: skip
    """Return whether a camera of another pitch agrees with almost as much of the segments.

    What both agree with, such as edges along the picture's rows, does not count.
    """
    if not is_free[PITCH]:
        return False
    is_far = np.abs(cameras[:, PITCH] - best[PITCH]) > OTHER_PITCH
    rivals = np.flatnonzero(is_far & (np.abs(cameras[:, ROLL]) < RIVAL_ROLL))
    if len(rivals) == 0:
        return False
    rival = _refine(cameras[rivals[np.argmax(support[rivals])]], segments, is_free)
    if abs(rival[PITCH] - best[PITCH]) < OTHER_PITCH:
        return False
    own, other = (_assign(camera, segments, NARROW, (0, 1, 2))[1] for camera in (best, rival))
    only_own, only_other = (segments.length[group].sum() for group in (own & ~other, other & ~own))
    is_weak = only_own < MIN_DIFFERENCE * segments.length.sum()
    return bool(is_weak or only_other > MAX_RIVAL * only_own)


def _frame(best: np.ndarray, segments: Segments, is_free: np.ndarray) -> Frame | None:
    """Return the frame of the directions that enough segments follow, None if it is uncertain."""
    allowed = _followed_directions(best, segments)
    camera = _refine(best, segments, is_free, allowed)
    which, agrees = _assign(camera, segments, NARROW, allowed)
    share = float(segments.length[agrees].sum() / segments.length.sum())
    if share < MIN_SHARE or not set(allowed) <= set(_followed_directions(camera, segments)):
        return None
    count = len(agrees)
    tried = float(count) ** int(is_free.sum())  # a segment fixes one number of a camera
    if _chance(int(agrees.sum()), count, len(allowed), tried) > MAX_CHANCE:
        return None
    interval = _intervals(camera, segments.select(agrees), which[agrees], is_free)
    if interval[PITCH] > MAX_PITCH_INTERVAL or interval[FOCAL] > MAX_FOCAL_INTERVAL:
        return None
    pitch, roll, _, focal = (float(c) for c in camera)
    if not MIN_PITCH <= pitch <= MAX_PITCH:
        return None
    pitch_interval, focal_interval = float(interval[PITCH]), float(interval[FOCAL])
    return Frame(pitch, roll, float(np.exp(focal)), pitch_interval, focal_interval, share)


def _chance(agreeing: int, count: int, direction_count: int, tried: float) -> float:
    """Return how many of the tried frames agree with so many of segments that lie at random.

    Much less than one tells that they do not (a contrario method, Desolneux, Moisan and Morel
    2000).
    """
    part = direction_count * 2 * NARROW / np.pi  # of all angles
    return tried * float(stats.binom.sf(agreeing - 1, count, part))


def _followed_directions(camera: np.ndarray, segments: Segments) -> tuple[int, ...]:
    """Return the directions that enough of the segments follow which the others leave."""
    allowed: tuple[int, ...] = (0, 1, 2)
    while allowed:
        which, agrees = _assign(camera, segments, NARROW, allowed)
        stray, stray_count = segments.length[~agrees].sum(), int((~agrees).sum())
        chances, shares = [], []
        for direction in allowed:
            follows = agrees & (which == direction)
            own, own_count = segments.length[follows].sum(), int(follows.sum())
            candidates = own_count + stray_count
            chances.append(_chance(own_count, candidates, 1, float(candidates) ** 2))
            shares.append(own / (own + stray) if own_count >= MIN_SEGMENTS else 0.0)
        is_bad = (np.array(shares) < MIN_REST) | (np.array(chances) > MAX_DIRECTION_CHANCE)
        if not is_bad.any():
            break
        worst = allowed[int(np.argmin(np.where(is_bad, shares, np.inf)))]
        allowed = tuple(direction for direction in allowed if direction != worst)
    return allowed


def _intervals(
    camera: np.ndarray, segments: Segments, axis: np.ndarray, is_free: np.ndarray
) -> np.ndarray:
    """Return half intervals (4,) of two standard deviations; 0 of what is given.

    Neighboring segments are often edges of one line: half of them count.
    """
    residual = _residuals(camera, segments, axis)
    step = 1e-5
    moved = [_residuals(camera + step * unit, segments, axis) for unit in np.eye(4)]
    slopes = ((np.array(moved) - residual) / step).T[:-1]
    residual = residual[:-1]
    weight = 1 / np.sqrt(1 + residual**2)
    variance = max((weight * residual**2).sum() / max(len(axis) - 4, 1), MIN_DEVIATION**2)
    information = (weight[:, None] * slopes).T @ slopes / (2 * variance) + np.diag(PRIOR**-2.0)
    free = np.flatnonzero(is_free)
    covariance = np.linalg.inv(information[np.ix_(free, free)])
    interval = np.zeros(4)
    interval[free] = 2 * np.sqrt(np.diag(covariance))
    return np.where(is_free, np.hypot(interval, LENS), 0.0)
