"""Placement of an object: the similarity transform from its own coordinates into the domain."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from vgmpi.gaussians.cloud import GaussianCloud
from vgmpi.scene.objects import Object
from vgmpi.scene.scene import Scene

# Rows: the file's axes that become x, y and z.
UP = {
    "z": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "-z": ((1, 0, 0), (0, -1, 0), (0, 0, -1)),
    "y": ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
    "-y": ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
    "x": ((0, 1, 0), (0, 0, 1), (1, 0, 0)),
    "-x": ((0, 1, 0), (0, 0, -1), (-1, 0, 0)),
}


MIN_EXTENT = 1e-100  # [own units] extents up to this count as none
ROUNDING = 1e-6  # [cells] by which objects may end outside the domain


class PlacementError(ValueError):
    """Error for an object that cannot be placed: `key` of the scene and a message."""

    def __init__(self, key: str, message: str):
        super().__init__(message)
        self.key = key


@dataclass(frozen=True)
class SimilarityTransform:
    """Similarity transform x_domain = scale rotation x + shift.

    rotation: proper, shape (3, 3); shift: shape (3,) [m].
    """

    rotation: np.ndarray
    scale: float
    shift: np.ndarray

    def to_domain(self, x: np.ndarray) -> np.ndarray:
        """Return domain coordinates [m] of own coordinates (n, 3).

        The product is written out: the rounding of a matrix product may depend on the threads of
        its library.
        """
        return self.scale * rotate(self.rotation, x) + self.shift

    def to_local(self, x: np.ndarray) -> np.ndarray:
        """Return own coordinates of domain coordinates (n, 3) [m]."""
        return rotate(self.rotation.T, (x - self.shift) / self.scale)

    def cloud(self, cloud: GaussianCloud) -> GaussianCloud:
        """Return the Gaussians in the domain."""
        moved = cloud.transformed(self.rotation, self.scale, self.shift)
        return replace(moved, x=self.to_domain(cloud.x))

    def matrix(self) -> list[list[float]]:
        """Return the 4x4 matrix from own to domain coordinates, as nested lists."""
        out = np.eye(4)
        out[:3, :3] = self.scale * self.rotation
        out[:3, 3] = self.shift
        return out.tolist()


def rotate(rotation: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return rotation (3, 3) applied to every row of x (n, 3)."""
    return np.stack([r[0] * x[:, 0] + r[1] * x[:, 1] + r[2] * x[:, 2] for r in rotation], axis=1)


def placement(obj: Object, support: Callable[[np.ndarray], float]) -> SimilarityTransform:
    """Return the placement that a scene requests.

    support(direction (3,)): largest x . direction over the object's points, in its own coordinates.
    Raises PlacementError if a flat object is to be scaled along its thickness.
    """
    up = np.asarray(UP[obj.up], dtype=float)
    scale = _scale(obj, up, support)
    rotation = up
    for turn in obj.rotation:
        rotation = axis_rotation(turn.axis, turn.angle) @ rotation
    if obj.position is None:
        return SimilarityTransform(rotation, scale, np.asarray(obj.origin or (0.0, 0.0, 0.0)))
    high = scale * np.array([support(row) for row in rotation])
    low = -scale * np.array([support(-row) for row in rotation])
    base = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    return SimilarityTransform(rotation, scale, np.asarray(obj.position) - base)


def upright(obj: Object, transform: SimilarityTransform) -> np.ndarray:
    """Return the unit vector (3,), in the domain, that pointed up in the object's file."""
    return transform.rotation @ np.asarray(UP[obj.up], dtype=float)[2]


def _scale(obj: Object, up: np.ndarray, support: Callable[[np.ndarray], float]) -> float:
    """Return the linear scale of an object."""
    for axis, key in enumerate(("width", "depth", "height")):
        size = getattr(obj, key)
        if size is not None:
            extent = support(up[axis]) + support(-up[axis])
            if not extent > MIN_EXTENT:
                raise PlacementError(key, "the object is flat in this direction: no scale gives it")
            return size / extent
    return obj.scale or 1.0


def axis_rotation(axis: tuple, angle: float) -> np.ndarray:
    """Return the rotation matrix (3, 3) about a unit axis by an angle [rad] (Rodrigues).

    The rotation is right-handed.
    """
    x, y, z = axis
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * k + (1.0 - np.cos(angle)) * (k @ k)


def corners(
    transform: SimilarityTransform, support: Callable[[np.ndarray], float]
) -> tuple[np.ndarray, np.ndarray]:
    """Return lower and upper corner (3,) [m] of an object in the domain."""
    high = (
        transform.scale * np.array([support(row) for row in transform.rotation]) + transform.shift
    )
    low = (
        -transform.scale * np.array([support(-row) for row in transform.rotation]) + transform.shift
    )
    return low, high


def check_inside(scene: Scene, obj: Object, low: np.ndarray, high: np.ndarray) -> None:
    """Raise PlacementError if an object extends out of the domain by more than rounding.

    Args:
        scene: The scene.
        obj: The object.
        low: Its lower corner, shape (3,) [m].
        high: Its upper corner, shape (3,) [m].
    """
    size, slack = np.asarray(scene.domain.size), ROUNDING * scene.domain.cell
    problems = []
    for axis, name in enumerate("xyz"):
        if low[axis] < -slack or high[axis] > size[axis] + slack:
            reaches = f"{name} = {low[axis]:.4g} .. {high[axis]:.4g} m"
            problems.append(f"it reaches {reaches}, the domain 0 .. {size[axis]:g} m")
    if problems:
        if obj.source != "shape" and "up" not in obj.model_fields_set:
            problems.append('if it lies on its side: most captures need up = "-y", most meshes "y"')
        raise PlacementError(
            placement_key(obj), f"the object lies outside the domain: {'; '.join(problems)}"
        )


def placement_key(obj: Object) -> str:
    """Return the key that gives the position of an object."""
    present = (key for key in ("position", "origin") if getattr(obj, key) is not None)
    return next(present, obj.source)
