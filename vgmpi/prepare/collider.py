"""Colliders: the signed distance of scenery, exact for shapes, on voxels for clouds and meshes."""

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from vgmpi.prepare import shapes
from vgmpi.prepare.place import Placement, corners, turn
from vgmpi.prepare.voxels import Voxels
from vgmpi.scene.forms import Shape
from vgmpi.scene.motion import Course, Motion

FAR = 1e6  # half the edge of a box beyond which nothing is, in a shape's own units
SMOOTH = 1.0  # standard deviation [voxels] over which the distances of a body's voxels are smoothed


@dataclass(frozen=True)
class ShapeCollider:
    """A shape that does not move. step: half the width [m] of the differences in `normal`. hull: of
    a container that holds all there is, the container itself; `shape` then has no outer side."""

    name: str
    shape: Shape
    placement: Placement
    step: float
    course: Course | None = None  # how it moves; distances are those at the start
    hull: Shape | None = None

    def ends(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper corner (3,) [m] of a box that holds it."""
        shape = self.hull or self.shape
        low, high = corners(self.placement, lambda d: shapes.reach(shape, d))
        more = self.placement.scale * shapes.bulge(shape)
        return low - more, high + more

    def around(self, x: np.ndarray, size: np.ndarray, dx: float) -> "ShapeCollider":
        """The same without its outer side, where all matter, at x (n, 3) [m], is in a hollow out of
        which no way leads; else itself. size: of the domain [m] (3,); dx: cells [m].

        Seen from inside its walls are then as thick as one likes: at a node beyond the middle of a
        thin one the nearest face is the outer one, which would hold nothing that comes from inside.
        """
        if self.shape.form != "difference" or not len(x):
            return self
        solid, *hollows = self.shape.difference
        low, high = self.ends()
        first = np.floor(np.maximum(low - 2 * dx, 0.0) / dx).astype(np.int64)
        last = np.ceil(np.minimum(high + 2 * dx, size) / dx).astype(np.int64)
        index = np.floor(x / dx).astype(np.int64) - first
        if (last <= first).any() or (index < 0).any() or (index >= last - first).any():
            return self
        free, outside = np.empty(last - first, bool), np.empty(last - first, bool)
        layer = np.indices((1, *(last - first)[1:])).reshape(3, -1).T + first
        for k in range(len(free)):
            own = self.placement.own((layer + (k, 0, 0) + 0.5) * dx)
            free[k] = (shapes.distance(self.shape, own) > 0).reshape(free[k].shape)
            outside[k] = (shapes.distance(solid, own) > 0).reshape(free[k].shape)
        parts, _ = ndimage.label(free)
        held = parts[tuple(np.unique(index, axis=0).T)]
        if (held == 0).any() or np.isin(held, parts[free & outside]).any():
            return self
        wide = Shape(box=((-FAR,) * 3, (FAR,) * 3))
        sealed = self.shape.model_copy(update={"difference": (wide, *hollows)})
        return replace(self, shape=sealed, hull=self.shape)

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Signed distance [m] (m,) of `points` (m, 3) [m], negative inside."""
        return self.placement.scale * shapes.distance(self.shape, self.placement.own(points))

    def normal(self, points: np.ndarray) -> np.ndarray:
        """Outward unit normals (m, 3)."""
        step = self.step / self.placement.scale
        own = shapes.normals(self.shape, self.placement.own(points), step)
        return turn(self.placement.rotation, own)


@dataclass(frozen=True)
class VoxelCollider:
    """A solid given by voxels; values: signed distance [m] at voxel centres, of shape voxels.shape.

    Beyond the box of voxels the distance to the box is added.
    """

    name: str
    voxels: Voxels
    values: np.ndarray
    course: Course | None = None

    def ends(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper corner (3,) [m] of a box that holds it."""
        low = np.array(self.voxels.start) * self.voxels.spacing
        return low, low + np.array(self.voxels.shape) * self.voxels.spacing

    @classmethod
    def of(cls, name: str, voxels: Voxels, solid: np.ndarray) -> "VoxelCollider":
        """solid: (shape) bool. The surface lies halfway between the two kinds of voxels."""
        out = ndimage.distance_transform_edt(~solid)
        inside = ndimage.distance_transform_edt(solid)
        cells = np.where(solid, 0.5 - inside, out - 0.5)
        return cls(name, voxels, cells * voxels.spacing)

    def smoothed(self) -> "VoxelCollider":
        """Without the stairs of voxels: a mean over a voxel and those beside it."""
        return replace(self, values=ndimage.gaussian_filter(self.values, SMOOTH))

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Signed distance [m] (m,) of `points` (m, 3) [m], negative inside; linear in between."""
        place, beyond = self._places(points)
        return ndimage.map_coordinates(self.values, place.T, order=1, mode="nearest") + beyond

    def normal(self, points: np.ndarray) -> np.ndarray:
        """Outward unit normals (m, 3) by central differences over two voxels."""
        out = np.empty_like(points)
        for axis in range(3):
            shift = np.zeros(3)
            shift[axis] = self.voxels.spacing
            out[:, axis] = self.distance(points + shift) - self.distance(points - shift)
        size = np.sqrt((out**2).sum(axis=1))[:, None]
        return np.where(size > 0, out / np.maximum(size, 1e-300), (0.0, 0.0, 1.0))

    def _places(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Fractional voxel numbers, and the distance [m] by which points are outside the box."""
        place = points / self.voxels.spacing - 0.5 - self.voxels.start
        near = np.clip(place, 0.0, np.array(self.voxels.shape) - 1.0)
        return near, np.sqrt(((place - near) ** 2).sum(axis=1)) * self.voxels.spacing


Collider = ShapeCollider | VoxelCollider


def moving(collider: Collider | None, motion: Motion | None) -> Collider | None:
    """The collider with its motion, which is about the middle of its extent where it says nothing
    else."""
    if collider is None or motion is None:
        return collider
    low, high = collider.ends()
    middle = motion.about or tuple(float(m) for m in (low + high) / 2)
    return replace(collider, course=Course(motion, middle))
