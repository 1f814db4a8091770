"""Where bodies stand: on the floor or on each other, as large as they are seen.

A body that is made about the eye keeps its picture however far it is; what holds it up says how far
that is. All distances grow with the height of the eye, which one known length tells.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.gaussians.cloud import Cloud
from vgmpi.images.layout import FLOOR, ObjectTable

SAME = 0.02  # relative difference of two lengths about which nothing is said
SHARED = 0.02  # share of the smaller of two bodies that may lie in the other
_FINE = 16  # voxels along the smallest edge of two bodies
_PUSHES = 48  # steps of a voxel by which a body is moved away at the most


class PlacingError(ValueError):
    """An object that cannot be placed: the key that is to blame, and why."""

    def __init__(self, name: str, key: str, said: str):
        super().__init__(said)
        self.name, self.key = name, key


class Seen(NamedTuple):
    """An object before it has a place. cloud: about the eye, at any distance from it. asked: what
    the layout says of it."""

    asked: ObjectTable
    cloud: Cloud

    @property
    def low(self) -> np.ndarray:
        return self.cloud.x.min(axis=0)

    @property
    def high(self) -> np.ndarray:
        return self.cloud.x.max(axis=0)

    def front(self, forward: np.ndarray) -> float:
        """Depth of what of it is seen, about a quarter into it; forward: the camera's axis (3,)."""
        return float(np.quantile(self.cloud.x @ forward, 0.25))

    @property
    def tall(self) -> float:
        return float(self.high[2] - self.low[2])


class Stand(NamedTuple):
    """An object in its place. cloud: about the eye [m]."""

    cloud: Cloud

    def floor_box(self, eye: float) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper corner (3,) [m] above the floor."""
        up = np.array([0.0, 0.0, eye])
        return self.cloud.x.min(axis=0) + up, self.cloud.x.max(axis=0) + up

    def distance(self, forward: np.ndarray) -> float:
        """Of the middle of its extent along the camera's axis [m]; forward: that axis (3,)."""
        return float((self.cloud.x.min(axis=0) + self.cloud.x.max(axis=0)) / 2 @ forward)


class Placed(NamedTuple):
    """All objects in their places; eye: its height above the floor [m]; lines: what was decided."""

    stands: list[Stand]
    eye: float
    lines: list[str]


def place(seen: list[Seen], forward: np.ndarray, eye: float | None) -> Placed:
    """Places of all objects. forward: the camera's axis (3,) in upright axes; eye: its height above
    the floor [m] where it is known. Raises PlacingError."""
    order = _order(seen)
    lines: list[str] = []
    for one in order:
        if one.low[2] >= 0 and one.asked.distance is None and _on_floor(one.asked.support):
            said = "its lowest point is seen above the horizon, where no floor is: give another"
            raise PlacingError(
                one.asked.name, "support", f"{said} support, distance, or camera.pitch"
            )
    if eye is None:
        eye, said = _eye(seen, order)
        lines.append(said)
    stands: dict[str, Stand] = {}
    for one in order:
        held, name = one.asked.support, one.asked.name
        below = _top(held, stands, eye)
        far = _distance(one, below - eye, forward)
        stands[name] = Stand(_sized(one, far, below - eye, lines))
    for one in order:
        lines += _pushed(one, order, stands, forward)
    for one in order:
        lines += _held(one, stands, eye, forward)
    return Placed([stands[one.asked.name] for one in seen], eye, lines)


def _on_floor(support: str | float | None) -> bool:
    return support in (None, FLOOR, 0.0)


def _order(seen: list[Seen]) -> list[Seen]:
    """Those that hold up others first."""
    left, done, out = list(seen), {FLOOR}, []
    while left:
        ready = [
            one for one in left
            if not isinstance(one.asked.support, str) or one.asked.support in done
        ]  # fmt: skip
        out += ready
        done |= {one.asked.name for one in ready}
        left = [one for one in left if one.asked.name not in done]
    return out


def _top(support: str | float | None, stands: dict[str, Stand], eye: float) -> float:
    """Height above the floor [m] of what an object stands on."""
    if isinstance(support, str) and support != FLOOR:
        return float(stands[support].floor_box(eye)[1][2])
    return float(support) if isinstance(support, float) else 0.0


def _distance(one: Seen, below: float, forward: np.ndarray) -> float:
    """The factor from an object about the eye to its place. below: height of what it stands on
    above the eye [m]."""
    asked, lowest = one.asked, float(one.low[2])
    if asked.distance is not None:
        level = float((one.low + one.high)[:2] / 2 @ forward[:2])
        left = asked.distance - forward[2] * below
        if asked.height is not None:
            return (left - forward[2] * asked.height / 2) / level
        return left / (level + forward[2] * one.tall / 2)
    if below * lowest <= 0:
        where = "above" if lowest >= 0 else "below"
        said = f"its lowest point is seen {where} the eye, and what it stands on is not: give"
        raise PlacingError(
            asked.name, "support", f"{said} another support, distance, or camera.pitch"
        )
    return below / lowest


def _sized(one: Seen, far: float, below: float, lines: list[str]) -> Cloud:
    """An object in its place, as tall as it shall be, its lowest point on what it stands on."""
    asked, size = one.asked, far
    if asked.height is not None:
        size = asked.height / one.tall
        if abs(size / far - 1) > SAME:
            said = f"'{asked.name}': is drawn {size / far:.3g} times as large as it is seen"
            lines.append(f"{said}: its height and its place say so")
    if not (far > 0 and size > 0):
        raise PlacingError(asked.name, "distance", "puts it behind the camera")
    shift = (far - size) * (one.low + one.high) / 2
    shift[2] = below - size * one.low[2]
    return one.cloud.transformed(np.eye(3), size, shift)


def _eye(seen: list[Seen], order: list[Seen]) -> tuple[float, str]:
    """Height of the eye above the floor [m] from the heights that are known, and what is said.

    The distance of each object is a eye + b, as is the height of its upper end above the floor.
    """
    known: dict[str, tuple[float, float]] = {}  # of upper ends, as a eye + b
    told: list[tuple[float, str]] = []
    for one in order:
        asked, lowest = one.asked, float(one.low[2])
        held = asked.support
        a, b = known.get(held, (0.0, 0.0)) if isinstance(held, str) else (0.0, held or 0.0)
        if lowest == 0:
            continue
        far = ((a - 1) / lowest, b / lowest)
        if asked.height is not None and far[0]:
            height = (asked.height / one.tall - far[1]) / far[0]
            told.append((height, f"the height of '{asked.name}'"))
        upper = float(one.high[2])
        known[asked.name] = (1 + far[0] * upper, far[1] * upper)
    told = [(height, by) for height, by in told if np.isfinite(height) and height > 0]
    if not told:
        name = seen[0].asked.name
        said = "how large things are is not known: give the height of at least one object that"
        raise PlacingError(name, "height", f"{said} stands on something, or camera.height")
    heights = sorted(height for height, _ in told)
    eye = float(np.median(heights))
    by = " and ".join(by for _, by in told[:4])
    apart = heights[-1] / heights[0]
    differ = f"; they differ by a factor of {apart:.3g}" if apart > 1 + SAME else ""
    return eye, f"camera: {eye:.4g} m above the floor, by {by}{differ}"


def _held(one: Seen, stands: dict[str, Stand], eye: float, forward: np.ndarray) -> list[str]:
    """A line about what holds an object up, or that nothing does."""
    name, held = one.asked.name, one.asked.support
    low, high = stands[name].floor_box(eye)
    far = stands[name].distance(forward)
    at = f"'{name}': {high[2] - low[2]:.4g} m high, {far:.4g} m away"
    if isinstance(held, float) and held > 0:
        return [f"{at}, {held:g} m above the floor: nothing holds it up, it falls"]
    if not isinstance(held, str) or held == FLOOR:
        above = low[2] if abs(low[2]) > SAME * (high[2] - low[2]) else 0.0
        return [f"{at}, on the floor" if not above else f"{at}, {above:.3g} m above the floor"]
    under = stands[held].floor_box(eye)
    middle = (low + high)[:2] / 2
    if ((middle < under[0][:2]) | (middle > under[1][:2])).any():
        return [f"{at}, beside '{held}', which does not hold it up: it falls"]
    return [f"{at}, on '{held}'"]


def _pushed(
    one: Seen, order: list[Seen], stands: dict[str, Stand], forward: np.ndarray
) -> list[str]:
    """Move an object away from the eye out of those that are nearer; a line for each."""
    name, lines = one.asked.name, []
    for other in order:
        near = stands[other.asked.name]
        here = stands[name]
        if other is one or near.distance(forward) > here.distance(forward):
            continue
        moved = _apart(here.cloud, near.cloud)
        if moved is None:
            said = f"'{name}' and '{other.asked.name}' lie in each other and cannot be parted"
            lines.append(f"{said} by moving one away: give a distance or a support")
        elif moved.any():
            cloud = here.cloud.transformed(np.eye(3), 1.0, moved)
            stands[name] = Stand(cloud)
            by = f"moved {np.linalg.norm(moved):.3g} m away"
            lines.append(f"'{name}': lay in '{other.asked.name}', {by}")
    return lines


def _apart(cloud: Cloud, near: Cloud) -> np.ndarray | None:
    """How far (3,) [m] a body moves along its level direction from the eye until it no longer
    shares space with one that is nearer; None where that takes too long."""
    sizes = np.concatenate([np.ptp(cloud.x, axis=0), np.ptp(near.x, axis=0)])
    cell = float(max(sizes.min(), sizes.max() / 8)) / _FINE
    middle = (cloud.x.min(axis=0) + cloud.x.max(axis=0)) / 2
    away = np.array([middle[0], middle[1], 0.0])
    away /= max(float(np.linalg.norm(away)), 1e-12)
    taken = _columns(near.x, cell)
    own = _columns(cloud.x, cell)
    most = SHARED * min(_volume(own), _volume(taken))
    for k in range(_PUSHES):
        shift = k * cell * away
        if _shared(_columns(cloud.x + shift, cell) if k else own, taken) <= most:
            return shift
    return None


def _columns(x: np.ndarray, cell: float) -> dict[tuple[int, int], tuple[float, float]]:
    """By places on the floor, the lower and upper end of what stands there, in cells."""
    at = np.floor(x[:, :2] / cell).astype(np.int64)
    place, own = np.unique(at, axis=0, return_inverse=True)
    own = own.ravel()
    low, high = np.full(len(place), np.inf), np.full(len(place), -np.inf)
    np.minimum.at(low, own, x[:, 2] / cell)
    np.maximum.at(high, own, x[:, 2] / cell)
    return {(int(i), int(j)): (a, b) for (i, j), a, b in zip(place, low, high)}


def _volume(columns: dict) -> float:
    return sum(high - low for low, high in columns.values())


def _shared(a: dict, b: dict) -> float:
    """Volume that two bodies share [cells]."""
    both = a.keys() & b.keys()
    return sum(max(0.0, min(a[p][1], b[p][1]) - max(a[p][0], b[p][0])) for p in both)
