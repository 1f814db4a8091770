"""Placement of objects on the floor or on each other, in the size in which they are seen.

A body about the eye keeps its picture at any distance; the support of the body determines that
distance. All distances are proportional to the height of the eye, which one known length
determines.

A monocular depth map tells the height of objects above the floor. Depth models return 1 / depth up
to a factor and an offset. The floor, whose depth follows from the pitch of the camera, determines
both; an object whose depth differs from the depth of a standing one is in the air.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.gaussians.cloud import GaussianCloud

from .layout_config import FLOOR, ObjectTable
from .photo_camera import View

DEPTH_TOLERANCE = 0.12  # [-] an object stands on the floor up to this relative difference of depths
MIN_FLOOR_PIXELS = 500  # [pixels] the fit needs at least this much visible floor
TRIMMED_FRACTION = (
    0.25  # [-] fraction of the floor pixels, the worst fitting ones, that the fit drops
)
FIT_ITERATIONS = 5  # the fit is repeated this often without its outliers
LENGTH_TOLERANCE = 0.02  # [-] smaller relative differences of lengths are not reported
MAX_SHARED_VOLUME = 0.02  # [-] two bodies may overlap by this fraction of the smaller one
_VOXELS_PER_EDGE = 16  # voxels along the smallest edge of two bodies
_MAX_PUSHES = 48  # [voxels] a body is moved away by at most this


class GroundFit(NamedTuple):
    """Linear map between the model's nearness and 1 / depth.

    With depths in eye heights, 1 / depth = (nearness - offset) / factor.
    """

    factor: float
    offset: float

    def depth(self, nearness: float) -> float:
        """Return the depth in eye heights."""
        return self.factor / max(nearness - self.offset, 1e-6)


def fit_ground_depth(nearness: np.ndarray, masks: list[np.ndarray], view: View) -> GroundFit | None:
    """Fit the depth map to the floor.

    The floor is taken from the lower part of the picture between the objects; the fit discards
    outliers repeatedly.

    Args:
        nearness: Depth map of the model, 1 / depth up to a linear map, shape (height, width).
        masks: Objects, each (height, width) bool.
        view: Camera of the photograph.

    Returns:
        The fit, or None if too little of the floor is visible.
    """
    pixels = (np.indices((view.width, view.height)).T + 0.5).astype(np.float64)
    true = -view.rays(pixels)[..., 2]  # 1 / depth of the floor in heights of the eye
    free = ~np.logical_or.reduce(masks) if masks else np.ones(true.shape, dtype=bool)
    below = np.zeros(true.shape, dtype=bool)
    below[int(0.6 * view.height) :] = True
    use = free & below & (true > 0.05) & np.isfinite(nearness)
    x, y = true[use], nearness[use].astype(np.float64)
    if len(x) < MIN_FLOOR_PIXELS or np.ptp(x) < 1e-3:
        return None
    inliers = np.ones(len(x), dtype=bool)
    factor, offset = 1.0, 0.0
    for _ in range(FIT_ITERATIONS):
        factor, offset = np.polyfit(x[inliers], y[inliers], 1)
        residual = np.abs(y - factor * x - offset)
        inliers = residual <= np.quantile(residual, 1 - TRIMMED_FRACTION)
    return GroundFit(float(factor), float(offset)) if factor > 0 else None


def height_above_ground(
    nearness: np.ndarray, mask: np.ndarray, low: float, middle: float, fit: GroundFit
) -> tuple[float, float] | None:
    """Return the height of an object's lowest point above the floor, and its depth.

    Args:
        nearness: Depth map of the model, shape (height, width).
        mask: The object, shape (height, width) bool.
        low: Height of the body's lowest point relative to the eye, for a body about 1 away.
        middle: Depth of the front of the same body.
        fit: Fit of the depth map to the floor.

    Returns:
        Height and depth in eye heights, or None if the object stands on the floor.
    """
    depth = fit.depth(float(np.median(nearness[mask])))
    factor = depth / middle
    standing_factor = -1 / low if low < 0 else np.inf
    if abs(factor / standing_factor - 1) <= DEPTH_TOLERANCE or factor > standing_factor:
        return None
    return 1 + factor * low, depth


class PlacingError(ValueError):
    """Error of an object that cannot be placed: its name, the key to blame, and the reason."""

    def __init__(self, name: str, key: str, message: str):
        super().__init__(message)
        self.name, self.key = name, key


class UnplacedObject(NamedTuple):
    """Object before its placement."""

    config: ObjectTable  # table of the layout
    cloud: GaussianCloud  # about the eye, at any distance from it

    @property
    def low(self) -> np.ndarray:
        """Return the lower corner, shape (3,)."""
        return self.cloud.x.min(axis=0)

    @property
    def high(self) -> np.ndarray:
        """Return the upper corner, shape (3,)."""
        return self.cloud.x.max(axis=0)

    def front(self, forward: np.ndarray) -> float:
        """Return the depth of the visible side: the lower quartile along the camera's axis (3,)."""
        return float(np.quantile(self.cloud.x @ forward, 0.25))

    @property
    def tall(self) -> float:
        """Return the height of the body."""
        return float(self.high[2] - self.low[2])


class PlacedObject(NamedTuple):
    """Object in its place; its cloud is about the eye [m]."""

    cloud: GaussianCloud

    def floor_box(self, eye: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the lower and the upper corner (3,) [m] above the floor."""
        up = np.array([0.0, 0.0, eye])
        return self.cloud.x.min(axis=0) + up, self.cloud.x.max(axis=0) + up

    def distance(self, forward: np.ndarray) -> float:
        """Return the depth [m] of the middle of the body along the camera's axis (3,)."""
        return float((self.cloud.x.min(axis=0) + self.cloud.x.max(axis=0)) / 2 @ forward)


class Placement(NamedTuple):
    """All objects in their places."""

    objects: list[PlacedObject]
    eye: float  # [m] height of the eye above the floor
    lines: list[str]  # decisions, for messages


def place(unplaced: list[UnplacedObject], forward: np.ndarray, eye: float | None) -> Placement:
    """Place all objects.

    Args:
        unplaced: The objects.
        forward: Camera's axis in upright axes, shape (3,).
        eye: Height of the eye above the floor [m], or None if it is unknown.

    Raises:
        PlacingError: An object has no place, or no length is known.
    """
    order = _support_order(unplaced)
    lines: list[str] = []
    contents = [obj for obj in order if obj.config.inside is not None]
    order = [obj for obj in order if obj.config.inside is None]
    for obj in order:
        if obj.low[2] >= 0 and obj.config.distance is None and _on_floor(obj.config.support):
            message = "its lowest point is seen above the horizon, where no floor is: give another"
            raise PlacingError(
                obj.config.name, "support", f"{message} support, distance, or camera.pitch"
            )
    if eye is None:
        eye, message = _eye_height(unplaced, order)
        lines.append(message)
    placed: dict[str, PlacedObject] = {}
    for obj in order:
        support, name = obj.config.support, obj.config.name
        below = _top(support, placed, eye)
        scale = _distance(obj, below - eye, forward)
        placed[name] = PlacedObject(_scaled(obj, scale, below - eye, lines))
    for obj in order:
        lines += _resolve_overlap(obj, order, placed, forward)
    for obj in contents:
        cup = next(item for item in order if item.config.name == obj.config.inside)
        cloud = _moved_with(obj.cloud, cup.cloud, placed[cup.config.name].cloud)
        placed[obj.config.name] = PlacedObject(cloud)
        lines.append(f"'{obj.config.name}': in '{cup.config.name}'")
    for obj in order:
        lines += _support_line(obj, placed, eye, forward)
    return Placement([placed[obj.config.name] for obj in unplaced], eye, lines)


def _moved_with(
    cloud: GaussianCloud, container: GaussianCloud, placed: GaussianCloud
) -> GaussianCloud:
    """Return a cloud that is scaled and moved as its container was."""
    low, high = container.x.min(axis=0), container.x.max(axis=0)
    size = float((placed.x[:, 2].max() - placed.x[:, 2].min()) / (high[2] - low[2]))
    return cloud.transformed(np.eye(3), size, placed.x.min(axis=0) - size * low)


def _on_floor(support: str | float | None) -> bool:
    """Return whether a support means the floor."""
    return support in (None, FLOOR, 0.0)


def _support_order(unplaced: list[UnplacedObject]) -> list[UnplacedObject]:
    """Return the objects in an order in which supports precede the objects on them."""
    remaining, done, ordered = list(unplaced), {FLOOR}, []
    while remaining:
        ready = [
            obj for obj in remaining
            if not isinstance(obj.config.support, str) or obj.config.support in done
        ]  # fmt: skip
        ordered += ready
        done |= {obj.config.name for obj in ready}
        remaining = [obj for obj in remaining if obj.config.name not in done]
    return ordered


def _top(support: str | float | None, placed: dict[str, PlacedObject], eye: float) -> float:
    """Return the height above the floor [m] of the surface on which an object stands."""
    if isinstance(support, str) and support != FLOOR:
        return float(placed[support].floor_box(eye)[1][2])
    return float(support) if isinstance(support, float) else 0.0


def _distance(obj: UnplacedObject, below: float, forward: np.ndarray) -> float:
    """Return the factor that moves an object about the eye to its place.

    below: height [m] of the support relative to the eye.
    """
    config, lowest = obj.config, float(obj.low[2])
    if config.distance is not None:
        level = float((obj.low + obj.high)[:2] / 2 @ forward[:2])
        remaining = config.distance - forward[2] * below
        if config.height is not None:
            return (remaining - forward[2] * config.height / 2) / level
        return remaining / (level + forward[2] * obj.tall / 2)
    if below * lowest <= 0:
        side = "above" if lowest >= 0 else "below"
        message = f"its lowest point is seen {side} the eye, and what it stands on is not: give"
        raise PlacingError(
            config.name, "support", f"{message} another support, distance, or camera.pitch"
        )
    return below / lowest


def _scaled(obj: UnplacedObject, scale: float, below: float, lines: list[str]) -> GaussianCloud:
    """Return an object in its place, of its given height, its lowest point on its support.

    Args:
        obj: The object.
        scale: Factor of the distance.
        below: Height of the support relative to the eye [m].
        lines: Messages, to which a line is added if the sizes disagree (in/out).
    """
    config, size = obj.config, scale
    if config.height is not None:
        size = config.height / obj.tall
        if abs(size / scale - 1) > LENGTH_TOLERANCE:
            message = f"'{config.name}': is drawn {size / scale:.3g} times as large as it is seen"
            lines.append(f"{message}: its height and its place say so")
    if not (scale > 0 and size > 0):
        raise PlacingError(config.name, "distance", "puts it behind the camera")
    shift = (scale - size) * (obj.low + obj.high) / 2
    shift[2] = below - size * obj.low[2]
    return obj.cloud.transformed(np.eye(3), size, shift)


def _eye_height(unplaced: list[UnplacedObject], order: list[UnplacedObject]) -> tuple[float, str]:
    """Return the height of the eye above the floor [m] from known heights, and a message.

    The distance of each object is a * eye + b, and so is the height of its top above the floor.
    """
    tops: dict[str, tuple[float, float]] = {}  # height of each top: a, b of a * eye + b
    estimates: list[tuple[float, str]] = []
    for obj in order:
        config, lowest = obj.config, float(obj.low[2])
        support = config.support
        a, b = tops.get(support, (0.0, 0.0)) if isinstance(support, str) else (0.0, support or 0.0)
        if lowest == 0:
            continue
        scale = ((a - 1) / lowest, b / lowest)
        if config.height is not None and scale[0]:
            height = (config.height / obj.tall - scale[1]) / scale[0]
            estimates.append((height, f"the height of '{config.name}'"))
        upper = float(obj.high[2])
        tops[config.name] = (1 + scale[0] * upper, scale[1] * upper)
    estimates = [
        (height, origin) for height, origin in estimates if np.isfinite(height) and height > 0
    ]
    if not estimates:
        name = unplaced[0].config.name
        message = "how large things are is not known: give the height of at least one object that"
        raise PlacingError(name, "height", f"{message} stands on something, or camera.height")
    heights = sorted(height for height, _ in estimates)
    eye = float(np.median(heights))
    origin = " and ".join(origin for _, origin in estimates[:4])
    spread = heights[-1] / heights[0]
    differ = f"; they differ by a factor of {spread:.3g}" if spread > 1 + LENGTH_TOLERANCE else ""
    return eye, f"camera: {eye:.4g} m above the floor, by {origin}{differ}"


def _support_line(
    obj: UnplacedObject, placed: dict[str, PlacedObject], eye: float, forward: np.ndarray
) -> list[str]:
    """Return a line about the support of an object, or about its absence."""
    name, support = obj.config.name, obj.config.support
    low, high = placed[name].floor_box(eye)
    distance = placed[name].distance(forward)
    prefix = f"'{name}': {high[2] - low[2]:.4g} m high, {distance:.4g} m away"
    if isinstance(support, float) and support > 0:
        return [f"{prefix}, {support:g} m above the floor: nothing holds it up, it falls"]
    if not isinstance(support, str) or support == FLOOR:
        above = low[2] if abs(low[2]) > LENGTH_TOLERANCE * (high[2] - low[2]) else 0.0
        return [
            f"{prefix}, on the floor" if not above else f"{prefix}, {above:.3g} m above the floor"
        ]
    under = placed[support].floor_box(eye)
    middle = (low + high)[:2] / 2
    if ((middle < under[0][:2]) | (middle > under[1][:2])).any():
        return [f"{prefix}, beside '{support}', which does not hold it up: it falls"]
    return [f"{prefix}, on '{support}'"]


def _resolve_overlap(
    obj: UnplacedObject,
    order: list[UnplacedObject],
    placed: dict[str, PlacedObject],
    forward: np.ndarray,
) -> list[str]:
    """Move an object away from the eye until it leaves nearer objects; return a line for each."""
    name, lines = obj.config.name, []
    for other in order:
        blocker = placed[other.config.name]
        current = placed[name]
        if other is obj or blocker.distance(forward) > current.distance(forward):
            continue
        moved = _separation(current.cloud, blocker.cloud)
        if moved is None:
            message = f"'{name}' and '{other.config.name}' lie in each other and cannot be parted"
            lines.append(f"{message} by moving one away: give a distance or a support")
        elif moved.any():
            cloud = current.cloud.transformed(np.eye(3), 1.0, moved)
            placed[name] = PlacedObject(cloud)
            motion = f"moved {np.linalg.norm(moved):.3g} m away"
            lines.append(f"'{name}': lay in '{other.config.name}', {motion}")
    return lines


def _separation(cloud: GaussianCloud, blocker: GaussianCloud) -> np.ndarray | None:
    """Return the shift (3,) [m] that separates a body from a nearer one.

    The body moves along its level direction from the eye; None if _MAX_PUSHES steps are not enough.
    """
    sizes = np.concatenate([np.ptp(cloud.x, axis=0), np.ptp(blocker.x, axis=0)])
    cell = float(max(sizes.min(), sizes.max() / 8)) / _VOXELS_PER_EDGE
    middle = (cloud.x.min(axis=0) + cloud.x.max(axis=0)) / 2
    direction = np.array([middle[0], middle[1], 0.0])
    direction /= max(float(np.linalg.norm(direction)), 1e-12)
    blocker_columns = _column_extents(blocker.x, cell)
    columns = _column_extents(cloud.x, cell)
    max_shared = MAX_SHARED_VOLUME * min(_volume(columns), _volume(blocker_columns))
    for k in range(_MAX_PUSHES):
        shift = k * cell * direction
        if (
            _shared(_column_extents(cloud.x + shift, cell) if k else columns, blocker_columns)
            <= max_shared
        ):
            return shift
    return None


def _column_extents(x: np.ndarray, cell: float) -> dict[tuple[int, int], tuple[float, float]]:
    """Return the lower and the upper end of the body over each floor cell, in cells."""
    floor_cells = np.floor(x[:, :2] / cell).astype(np.int64)
    unique_cells, owner = np.unique(floor_cells, axis=0, return_inverse=True)
    owner = owner.ravel()
    low, high = np.full(len(unique_cells), np.inf), np.full(len(unique_cells), -np.inf)
    np.minimum.at(low, owner, x[:, 2] / cell)
    np.maximum.at(high, owner, x[:, 2] / cell)
    return {(int(i), int(j)): (a, b) for (i, j), a, b in zip(unique_cells, low, high)}


def _volume(columns: dict) -> float:
    """Return the volume of a body [cells]."""
    return sum(high - low for low, high in columns.values())


def _shared(a: dict, b: dict) -> float:
    """Return the volume that two bodies share [cells]."""
    both = a.keys() & b.keys()
    return sum(max(0.0, min(a[p][1], b[p][1]) - max(a[p][0], b[p][0])) for p in both)
