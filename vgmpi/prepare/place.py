"""Where an object stands: the similarity that takes its own coordinates into the domain."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from vgmpi.gaussians.cloud import Cloud
from vgmpi.scene.objects import Object
from vgmpi.scene.scene import Scene

# rows: the file's axes that become x, y and z
UP = {
    "z": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "-z": ((1, 0, 0), (0, -1, 0), (0, 0, -1)),
    "y": ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
    "-y": ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
    "x": ((0, 1, 0), (0, 0, 1), (1, 0, 0)),
    "-x": ((0, 1, 0), (0, 0, -1), (-1, 0, 0)),
}


FLAT = 1e-100  # extent of what has none, in its own units


class PlacementError(ValueError):
    """An object that cannot be placed: `key` of the scene and what is wrong with it."""

    def __init__(self, key: str, said: str):
        super().__init__(said)
        self.key = key


@dataclass(frozen=True)
class Placement:
    """x_domain = scale rotation x + shift. rotation: proper (3, 3); shift: (3,) [m]."""

    rotation: np.ndarray
    scale: float
    shift: np.ndarray

    def points(self, x: np.ndarray) -> np.ndarray:
        """Own coordinates (n, 3) -> domain coordinates [m].

        Written out: the rounding of a matrix product may depend on the threads of its library.
        """
        return self.scale * turn(self.rotation, x) + self.shift

    def own(self, x: np.ndarray) -> np.ndarray:
        """Domain coordinates (n, 3) [m] -> own coordinates."""
        return turn(self.rotation.T, (x - self.shift) / self.scale)

    def cloud(self, cloud: Cloud) -> Cloud:
        """The Gaussians in the domain."""
        moved = cloud.transformed(self.rotation, self.scale, self.shift)
        return replace(moved, x=self.points(cloud.x))

    def matrix(self) -> list[list[float]]:
        """The 4x4 matrix own -> domain, as nested lists."""
        out = np.eye(4)
        out[:3, :3] = self.scale * self.rotation
        out[:3, 3] = self.shift
        return out.tolist()


def turn(rotation: np.ndarray, x: np.ndarray) -> np.ndarray:
    """rotation (3, 3) applied to every row of x (n, 3)."""
    return np.stack([r[0] * x[:, 0] + r[1] * x[:, 1] + r[2] * x[:, 2] for r in rotation], axis=1)


def place(thing: Object, reach: Callable[[np.ndarray], float]) -> Placement:
    """The placement a scene asks for.

    reach(direction (3,)): largest x . direction over the object's points, in its own coordinates.
    Raises PlacementError where a flat object is to be scaled along its thickness.
    """
    up = np.asarray(UP[thing.up], dtype=float)
    scale = _scale(thing, up, reach)
    rotation = up
    for step in thing.rotation:
        rotation = axis_rotation(step.axis, step.angle) @ rotation
    if thing.position is None:
        return Placement(rotation, scale, np.asarray(thing.origin or (0.0, 0.0, 0.0)))
    high = scale * np.array([reach(row) for row in rotation])
    low = -scale * np.array([reach(-row) for row in rotation])
    base = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    return Placement(rotation, scale, np.asarray(thing.position) - base)


def upright(thing: Object, at: Placement) -> np.ndarray:
    """Unit vector (3,) that pointed up in the object's own file, in the domain."""
    return at.rotation @ np.asarray(UP[thing.up], dtype=float)[2]


def _scale(thing: Object, up: np.ndarray, reach: Callable[[np.ndarray], float]) -> float:
    for axis, key in enumerate(("width", "depth", "height")):
        wanted = getattr(thing, key)
        if wanted is not None:
            extent = reach(up[axis]) + reach(-up[axis])
            if not extent > FLAT:
                raise PlacementError(key, "the object is flat in this direction: no scale gives it")
            return wanted / extent
    return thing.scale or 1.0


def axis_rotation(axis: tuple, angle: float) -> np.ndarray:
    """Rotation matrix (3, 3) about a unit axis, right-handed, angle in rad (Rodrigues)."""
    x, y, z = axis
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * k + (1.0 - np.cos(angle)) * (k @ k)


def corners(at: Placement, reach: Callable[[np.ndarray], float]) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corner (3,) [m] of an object in the domain."""
    high = at.scale * np.array([reach(row) for row in at.rotation]) + at.shift
    low = -at.scale * np.array([reach(-row) for row in at.rotation]) + at.shift
    return low, high


def check_inside(
    scene: Scene, thing: Object, low: np.ndarray, high: np.ndarray, slack: float
) -> None:
    """Raises PlacementError where an object reaches out of the domain by more than `slack` [m]."""
    size = np.asarray(scene.domain.size)
    out = []
    for axis, name in enumerate("xyz"):
        if low[axis] < -slack or high[axis] > size[axis] + slack:
            reaches = f"{name} = {low[axis]:.4g} .. {high[axis]:.4g} m"
            out.append(f"it reaches {reaches}, the domain 0 .. {size[axis]:g} m")
    if out:
        if thing.source != "shape" and "up" not in thing.model_fields_set:
            out.append('if it lies on its side: most captures need up = "-y", most meshes "y"')
        raise PlacementError(
            where_placed(thing), f"the object lies outside the domain: {'; '.join(out)}"
        )


def where_placed(thing: Object) -> str:
    """The key that says where an object stands."""
    given = (key for key in ("position", "origin") if getattr(thing, key) is not None)
    return next(given, thing.source)
