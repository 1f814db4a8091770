"""How a body that somebody else made stands in the photograph: which of its axes points up, how it
is turned, how large it is and where it is seen.

Turns are tried one after the other: the body is drawn by the splatter where its outline fits the
mask, and the turn is taken at which outline and colours agree best.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.gaussians import sh as harmonics
from vgmpi.gaussians.cloud import Cloud
from vgmpi.images.masks import Box, box_of, iou
from vgmpi.images.view import View
from vgmpi.prepare.place import UP, axis_rotation
from vgmpi.splatting import splat

YAWS = 36  # turns that are tried
BESIDE = (0.0, 2.5, -2.5, 5.0, -5.0, 7.5, -7.5, 10.0, -10.0)  # degrees, beside the best of them
# pixels of the longer side of a mask on the pictures that are compared, and Gaussians on them
COARSE, FINE = (72, 6_000), (160, 30_000)
COLOUR = 1.0  # weight of the mean difference of colours, 0..1, against that of outlines
ROUNDS = 6  # in which a place is found
UPWARDS = ("z", "-y", "y", "-z", "x", "-x")


class Pose(NamedTuple):
    """up: the axis of its file that points up. yaw: turn about the vertical [degrees]. alike: of
    the outline, intersection over union; off: mean difference of colours in it, 0..1."""

    up: str
    yaw: float
    alike: float
    off: float

    @property
    def score(self) -> float:
        return self.alike - COLOUR * self.off


class Faced(NamedTuple):
    """A body about the eye, about 1 away, as the mask is seen; and how it stands."""

    cloud: Cloud
    pose: Pose


def face(
    body: Cloud,
    rgb: np.ndarray,
    mask: np.ndarray,
    view: View,
    up: str | None = None,
    yaw: float | None = None,
) -> Faced:
    """The body as it stands in the photograph.

    body: in its own units and axes. rgb: (height, width, 3) uint8; mask: (height, width) bool.
    up, yaw: where they are known.
    """
    coarse = _trial(body, rgb, mask, view, COARSE)
    ups = UPWARDS if up is None else (up,)
    yaws = [360 * k / YAWS for k in range(YAWS)] if yaw is None else [yaw]
    found = _best(coarse, [(one, turn) for one in ups for turn in yaws])
    if yaw is None:
        fine = _trial(body, rgb, mask, view, FINE)
        found = _best(fine, [(found.up, found.yaw + off) for off in BESIDE])
    stood = _stood(body, found.up, found.yaw)
    placed = _where(stood.x, view, box_of(mask))
    return Faced(stood.transformed(np.eye(3), float(placed[3]), placed[:3]), found)


class Trial(NamedTuple):
    """A body, and a small picture with which its turns are compared: mask (height, width) bool,
    colour (height, width, 3) in 0..1."""

    body: Cloud
    view: View
    mask: np.ndarray
    colour: np.ndarray


def _trial(
    body: Cloud, rgb: np.ndarray, mask: np.ndarray, view: View, size: tuple[int, int]
) -> Trial:
    """size: pixels of the longer side of the mask, and Gaussians."""
    from PIL import Image

    box = box_of(mask)
    by = min(1.0, size[0] / max(box.right - box.left, box.bottom - box.top))
    width, height = (max(16, round(n * by)) for n in (view.width, view.height))
    shape, mean = (width, height), Image.Resampling.BOX
    levels = Image.fromarray(np.where(mask, 255, 0).astype(np.uint8)).resize(shape, mean)
    colour = np.asarray(Image.fromarray(rgb).resize(shape, mean)) / 255.0
    small = View(width, height, view.fov, view.pitch)
    return Trial(_thinned(body, size[1]), small, np.asarray(levels) > 127, colour)


def _best(trial: Trial, turns: list[tuple[str, float]]) -> Pose:
    """The best of some axes and turns."""
    tried = [_tried(trial, up, yaw % 360) for up, yaw in turns]
    return max(tried, key=lambda pose: pose.score)


def _thinned(body: Cloud, most: int) -> Cloud:
    """Some of its Gaussians, as much larger as they are fewer."""
    if len(body) <= most:
        return body
    rows = np.random.default_rng(0).choice(len(body), most, replace=False)
    some = body.select(np.sort(rows))
    wide = np.sqrt(len(body) / most)
    return Cloud(some.x, some.quat, some.scale * wide, some.opacity, some.sh)


def _stood(body: Cloud, up: str, yaw: float) -> Cloud:
    """Upright, turned, the middle of its base at 0 and 1 high."""
    turn = axis_rotation((0.0, 0.0, 1.0), np.radians(yaw)) @ np.asarray(UP[up], dtype=float)
    turned = body.transformed(turn)
    low, high = turned.x.min(axis=0), turned.x.max(axis=0)
    base = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    size = 1 / max(float(high[2] - low[2]), 1e-12)
    return turned.transformed(np.eye(3), size, -size * base)


def _where(x: np.ndarray, view: View, box: Box) -> np.ndarray:
    """Where the middle of its base is about the eye, 1 away, and its size, (4,): so that its points
    (n, 3) fill the box in the picture."""
    seen = view.rays(np.array([(box.left + box.right) / 2, (box.top + box.bottom) / 2]))
    middle = seen / max(float(seen[1]), 0.05)
    wanted = np.array([box.right - box.left, box.bottom - box.top], dtype=np.float64)
    size = float(wanted[1] / view.focal * np.linalg.norm(middle))
    centre = (x.min(axis=0) + x.max(axis=0)) / 2
    base = middle - size * centre
    for _ in range(ROUNDS):
        at, depth = view.pixels(base + size * x)
        good = np.isfinite(at).all(axis=1) & (depth > 1e-3)
        if good.sum() < 2:
            break
        low, high = at[good].min(axis=0), at[good].max(axis=0)
        size *= float(wanted.sum() / max((high - low).sum(), 1e-9))
        at, depth = view.pixels(base + size * x)
        low, high = np.nanmin(at, axis=0), np.nanmax(at, axis=0)
        off = np.array([box.left + box.right, box.top + box.bottom]) / 2 - (low + high) / 2
        far = float(np.nanmean(depth))
        right, down, _ = view.rotation()
        base = base + far / view.focal * (off[0] * right + off[1] * down)
        base, size = base / base[1], size / base[1]
    return np.append(base, size)


def _tried(trial: Trial, up: str, yaw: float) -> Pose:
    """How well a turn agrees."""
    stood = _stood(trial.body, up, yaw)
    placed = _where(stood.x, trial.view, box_of(trial.mask))
    cloud = stood.transformed(np.eye(3), float(placed[3]), placed[:3])
    camera = trial.view.camera(np.zeros(3), near=0.02)
    splats = splat.Splats(
        cloud.x, cloud.cov(), cloud.opacity, harmonics.evaluate(cloud.sh, cloud.x)
    )
    drawn, left = splat.render(splats, camera, np.zeros(3))
    outline = left < 0.5
    both = outline & trial.mask
    off = float(np.abs(np.clip(drawn, 0, 1) - trial.colour)[both].mean()) if both.any() else 1.0
    return Pose(up, yaw, iou(outline, trial.mask), off)
