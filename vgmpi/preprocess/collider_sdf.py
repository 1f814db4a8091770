"""Colliders: signed distance of scenery, exact for shapes, on voxels for clouds and meshes."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy

from vgmpi.gaussians import shape_distance
from vgmpi.preprocess.sampling.voxels import Voxels
from vgmpi.scene.rigid_motion import Motion, Trajectory
from vgmpi.scene.shapes import Shape

from . import shape_sdf
from .placement import SimilarityTransform, corners, rotate
from .sheet_collider import SheetCollider

FAR_DISTANCE = 1e6  # [own units] half the edge of a box that contains everything
SMOOTHING_SIGMA = 1.0  # [voxels] standard deviation of the filter that smooths a body's distances


@dataclass(frozen=True)
class ShapeCollider:
    """Collider of an exact shape.

    step: half the width [m] of the differences in `normal`. hull: the container itself, if `shape`
    is a container without its outer side that encloses all matter.
    """

    name: str
    shape: Shape
    placement: SimilarityTransform
    step: float
    course: Trajectory | None = None  # its motion; distances are those at the start
    body: Any = None  # its state at the start if a feature moves it
    hull: Shape | None = None
    detail: Any = None  # what a feature has found of its faces, see `MovingColliders`

    def ends(self) -> tuple[np.ndarray, np.ndarray]:
        """Return lower and upper corner (3,) [m] of a box that contains it."""
        shape = self.hull or self.shape
        low, high = corners(self.placement, lambda d: shape_sdf.support(shape, d))
        overhang = self.placement.scale * shape_sdf.blend_overhang(shape)
        return low - overhang, high + overhang

    def without_outer_side(self, x: np.ndarray, size: np.ndarray, dx: float) -> "ShapeCollider":
        """Return the collider without its outer side if a closed hollow holds all matter.

        Seen from inside its walls are then arbitrarily thick: at a node beyond the middle of a thin
        wall the nearest face is the outer one, which would not stop matter that comes from inside.

        Args:
            x: All matter, shape (n, 3) [m].
            size: Size of the domain, shape (3,) [m].
            dx: Cell size [m].
        """
        if self.shape.difference is None or self.detail is not None or not len(x):
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
            local = self.placement.to_local((layer + (k, 0, 0) + 0.5) * dx)
            free[k] = (shape_distance.distance(self.shape, local) > 0).reshape(free[k].shape)
            outside[k] = (shape_distance.distance(solid, local) > 0).reshape(free[k].shape)
        parts, _ = scipy.ndimage.label(free)
        occupied = parts[tuple(np.unique(index, axis=0).T)]
        if (occupied == 0).any() or np.isin(occupied, parts[free & outside]).any():
            return self
        outer_box = Shape(box=((-FAR_DISTANCE,) * 3, (FAR_DISTANCE,) * 3))
        sealed = self.shape.model_copy(update={"difference": (outer_box, *hollows)})
        return replace(self, shape=sealed, hull=self.shape)

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Return the signed distance (m,) [m] of `points` (m, 3) [m], negative inside."""
        return self.placement.scale * shape_distance.distance(
            self.shape, self.placement.to_local(points)
        )

    def normal(self, points: np.ndarray) -> np.ndarray:
        """Return outward unit normals (m, 3)."""
        step = self.step / self.placement.scale
        local = shape_distance.normals(self.shape, self.placement.to_local(points), step)
        return rotate(self.placement.rotation, local)


@dataclass(frozen=True)
class VoxelCollider:
    """Collider made of voxels; values: signed distance [m] at voxel centers, of shape voxels.shape.

    Beyond the box of voxels the distance to the box is added.
    """

    name: str
    voxels: Voxels
    values: np.ndarray
    course: Trajectory | None = None
    body: Any = None
    detail: Any = None

    def ends(self) -> tuple[np.ndarray, np.ndarray]:
        """Return lower and upper corner (3,) [m] of a box that contains it."""
        low = np.array(self.voxels.start) * self.voxels.spacing
        return low, low + np.array(self.voxels.shape) * self.voxels.spacing

    @classmethod
    def from_voxels(cls, name: str, voxels: Voxels, solid: np.ndarray) -> "VoxelCollider":
        """Return the collider of a mask of solid voxels.

        Args:
            name: Name of the object.
            voxels: Box of voxels.
            solid: Mask of solid voxels; the surface is halfway between the two kinds.
        """
        out = scipy.ndimage.distance_transform_edt(~solid)
        inside = scipy.ndimage.distance_transform_edt(solid)
        cells = np.where(solid, 0.5 - inside, out - 0.5)
        return cls(name, voxels, cells * voxels.spacing)

    def smoothed(self) -> "VoxelCollider":
        """Return the collider without the stairs of voxels, by a mean over neighbors."""
        return replace(self, values=scipy.ndimage.gaussian_filter(self.values, SMOOTHING_SIGMA))

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Return the signed distance (m,) [m] of `points` (m, 3) [m], negative inside.

        It is interpolated linearly.
        """
        position, beyond = self._voxel_coordinates(points)
        return (
            scipy.ndimage.map_coordinates(self.values, position.T, order=1, mode="nearest") + beyond
        )

    def normal(self, points: np.ndarray) -> np.ndarray:
        """Return outward unit normals (m, 3) by central differences over two voxels."""
        out = np.empty_like(points)
        for axis in range(3):
            shift = np.zeros(3)
            shift[axis] = self.voxels.spacing
            out[:, axis] = self.distance(points + shift) - self.distance(points - shift)
        size = np.sqrt((out**2).sum(axis=1))[:, None]
        return np.where(size > 0, out / np.maximum(size, 1e-300), (0.0, 0.0, 1.0))

    def _voxel_coordinates(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return fractional voxel numbers, and the distance [m] of points from the box."""
        position = points / self.voxels.spacing - 0.5 - self.voxels.start
        clamped = np.clip(position, 0.0, np.array(self.voxels.shape) - 1.0)
        return clamped, np.sqrt(((position - clamped) ** 2).sum(axis=1)) * self.voxels.spacing


Collider = ShapeCollider | VoxelCollider | SheetCollider


def with_motion(collider: Collider | None, motion: Motion | None) -> Collider | None:
    """Return the collider with its motion, by default about the center of its extent."""
    if collider is None or motion is None:
        return collider
    low, high = collider.ends()
    x, y, z = (float(m) for m in (low + high) / 2)
    return replace(collider, course=Trajectory(motion, motion.pivot or (x, y, z)))
