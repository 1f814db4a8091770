"""A body from several pictures of it with known cameras: the visual hull, coloured from them.

A point is inside if every picture shows it inside the object's outline (Laurentini 1994).
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from vgmpi import camerafiles
from vgmpi.camerafiles import CameraFileError
from vgmpi.gaussians.cloud import Cloud
from vgmpi.gaussians.sh import dc_from_rgb
from vgmpi.images import photograph
from vgmpi.images.colours import OPACITY, look_up, own_colours
from vgmpi.images.photograph import PhotographError
from vgmpi.prepare import mesh
from vgmpi.prepare.mesh import Mesh
from vgmpi.prepare.place import UP
from vgmpi.splatting import splat
from vgmpi.splatting.camera import Camera

FINE = 128  # voxels along the longest edge
FIRST = 40  # of the first, coarse look
EDGES = 1.0  # voxels over which the hull is smoothed: edges between its views are none of the body
SOFT = 0.7  # pixels over which an outline is smoothed
MOST = 40_000  # Gaussians
FACING = 2  # power of the cosine by which pictures that face a place count
MISSED = 2  # layers of voxels at a tip, which is round, that may not grow so
STEEP = 0.85  # of a line of sight's slope from which on what grows so is the cone below a body
HIDDEN = 2.5  # voxels behind what is seen from where on a place is hidden


class HullError(ValueError):
    """Pictures from which no body comes; one line."""


class Shot(NamedTuple):
    """A picture. rgb: (height, width, 3) uint8; mask: (height, width) bool."""

    camera: Camera
    rgb: np.ndarray
    mask: np.ndarray


class Volume(NamedTuple):
    """inside: shares (nx, ny, nz), a half at the surface, at places `low` + step * index [of the
    cameras' units]."""

    inside: np.ndarray
    low: np.ndarray
    step: float


def read(path: Path) -> list[Shot]:
    """The pictures that a transforms.json of nerfstudio names, whose alpha says what is the object.
    Raises HullError."""
    try:
        named = camerafiles.transforms(path)
        shots = []
        for name, camera in named:
            file = path.parent / name
            if not file.suffix:
                file = file.with_suffix(".png")
            shot = photograph.read(file)
            size = shot.rgb.shape[1], shot.rgb.shape[0]
            if size != (camera.width, camera.height):
                said = "has {} x {} pixels, its camera {} x {}"
                raise HullError(f"{file}: {said.format(*size, camera.width, camera.height)}")
            if shot.alpha is None:
                raise HullError(f"{file}: is opaque: its alpha must say what the object is")
            shots.append(Shot(camera, shot.rgb, shot.alpha > 127))
    except (CameraFileError, PhotographError) as error:
        raise HullError(str(error)) from None
    if len(shots) < 3:
        raise HullError(f"{path}: {len(shots)} pictures; at least 3 are needed")
    return shots


def carve(shots: list[Shot], fine: int = FINE, up: str = "z") -> Volume:
    """The visual hull; fine: voxels along its longest edge.

    up: the axis that points up, along which it stands on something: the cone of lines of sight
    below that is cut off. Raises HullError.
    """
    middle, half = _about(shots)
    first = _carved(shots, middle - half, 2 * half / (FIRST - 1), np.full(3, FIRST))
    held = np.argwhere(first.inside > 0.5)
    if not len(held):
        raise HullError("no point lies inside the outlines of all pictures: are the cameras right?")
    low = first.low + first.step * (held.min(axis=0) - 1.5)
    high = first.low + first.step * (held.max(axis=0) + 1.5)
    step = float((high - low).max()) / (fine - 1)
    found = _carved(shots, low, step, np.ceil((high - low) / step).astype(int) + 1)
    smooth = ndimage.gaussian_filter(found.inside, EDGES)
    return _footed(found._replace(inside=smooth), shots, up)


def body(shots: list[Shot], seed: int = 1, up: str = "z") -> Cloud:
    """Gaussians over the visual hull, in the cameras' units and axes. Raises HullError."""
    return coloured(shots, carve(shots, up=up), seed)


def coloured(shots: list[Shot], volume: Volume, seed: int = 1) -> Cloud:
    """Gaussians over a hull, with the colours of its pictures. Raises HullError."""
    surface = _surface(volume)
    corner = surface.corners()
    cross = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    area = float(np.linalg.norm(cross, axis=1).sum() / 2)
    cloud = mesh.sample(surface, 2 * np.sqrt(area / MOST), (0.5, 0.5, 0.5), OPACITY, [seed])
    out = _outward(volume, cloud)
    sh = dc_from_rgb(_colours(shots, cloud, out, volume.step))[:, None, :].astype(np.float32)
    return Cloud(cloud.x, cloud.quat, cloud.scale, cloud.opacity, sh)


def _about(shots: list[Shot]) -> tuple[np.ndarray, float]:
    """A point that the middles of all outlines look at (3,), and half the edge of a box around it
    that holds what they show."""
    total, aim, wide = np.zeros((3, 3)), np.zeros(3), []
    for shot in shots:
        if not shot.mask.any():
            raise HullError("a picture shows nothing: its alpha is empty")
        camera, (v, u) = shot.camera, np.argwhere(shot.mask).mean(axis=0) + 0.5
        ray = camera.world_to_camera[:3, :3].T @ [
            (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, 1.0
        ]  # fmt: skip
        ray /= np.linalg.norm(ray)
        across = np.eye(3) - np.outer(ray, ray)
        total += across
        aim += across @ camera.eye
    if np.linalg.cond(total) > 1e6:
        raise HullError("the cameras look in one direction: a hull needs several")
    middle = np.linalg.solve(total, aim)
    for shot in shots:
        camera = shot.camera
        rows, columns = np.nonzero(shot.mask)
        far = np.linalg.norm(middle - camera.eye)
        reach = np.hypot((np.ptp(rows) + 2) / camera.fy, (np.ptp(columns) + 2) / camera.fx)
        wide.append(far * reach)
    return middle, 0.75 * float(np.median(wide))


def _carved(shots: list[Shot], low: np.ndarray, step: float, counts: np.ndarray) -> Volume:
    axes = [low[k] + step * np.arange(counts[k]) for k in range(3)]
    x = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    inside = np.ones(len(x), dtype=np.float32)
    left = np.arange(len(x))
    for shot in shots:
        soft = ndimage.gaussian_filter(shot.mask.astype(np.float32), SOFT)
        at, depth = _pixels(shot.camera, x[left])
        where = np.where(depth > 0, at.T - 0.5, -9.0)[::-1]
        inside[left] = np.minimum(inside[left], ndimage.map_coordinates(soft, where, order=1))
        left = left[inside[left] > 0.02]
    return Volume(inside.reshape(counts), low, step)


def _footed(volume: Volume, shots: list[Shot], up: str) -> Volume:
    """The hull without the cone below what it stands on, where all cameras look down: from its tip
    on, its width grows with its height as fast as the lowest camera's line of sight is flat."""
    axis = np.asarray(UP[up], dtype=float)[2]
    at = int(np.argmax(np.abs(axis)))
    held = volume.inside > 0.5
    places = volume.low + volume.step * np.argwhere(held)
    lowest = places[np.argmin(places @ axis)]
    aims = [shot.camera.eye - lowest for shot in shots]
    rise = [float(aim @ axis / np.linalg.norm(aim - (aim @ axis) * axis)) for aim in aims]
    if min(rise) <= 0:
        return volume
    area = held.sum(axis=tuple(k for k in range(3) if k != at))
    if axis[at] < 0:
        area = area[::-1]
    radius = ndimage.uniform_filter1d(np.sqrt(area / np.pi), 3, mode="nearest")
    grows = np.gradient(radius)
    first = int(np.flatnonzero(area)[0])
    foot = first
    for k in range(first, first + len(area) // 3):
        if grows[k] >= STEEP / min(rise):
            foot = k + 1
        elif k > foot + MISSED:
            break
    inside = np.moveaxis(volume.inside.copy(), at, 0)
    below = slice(0, foot) if axis[at] > 0 else slice(len(area) - foot, None)
    inside[below] = 0
    return volume._replace(inside=np.moveaxis(inside, 0, at))


def _pixels(camera: Camera, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places in the picture (n, 2) [pixels] and depths (n,) of points (n, 3)."""
    seen = x @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    depth = seen[:, 2]
    safe = np.where(depth > 0, depth, 1.0)
    flat = seen[:, :2] / safe[:, None] * (camera.fx, camera.fy) + (camera.cx, camera.cy)
    return flat, depth


def _surface(volume: Volume) -> Mesh:
    """Where the share is a half (flying edges, as VTK has them)."""
    import pyvista

    held = np.pad(volume.inside, 1)
    grid = pyvista.ImageData(dimensions=held.shape, spacing=(volume.step,) * 3)
    grid.origin = volume.low - volume.step
    grid["inside"] = held.ravel(order="F")
    found = grid.contour([0.5], scalars="inside").triangulate()
    faces = np.asarray(found.faces).reshape(-1, 4)[:, 1:]
    if not len(faces):
        raise HullError("the hull is thinner than a voxel: larger pictures?")
    return Mesh(np.asarray(found.points, dtype=np.float64), faces)


def _outward(volume: Volume, cloud: Cloud) -> np.ndarray:
    """Directions out of the body (n, 3) at its Gaussians."""
    soft = ndimage.gaussian_filter(np.pad(volume.inside, 2), 1.0)
    where = ((cloud.x - volume.low) / volume.step + 2).T
    slope = [ndimage.map_coordinates(one, where, order=1) for one in np.gradient(soft)]
    out = -np.stack(slope, axis=-1)
    return out / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-12)


def _colours(shots: list[Shot], cloud: Cloud, out: np.ndarray, voxel: float) -> np.ndarray:
    """Mean colours (n, 3) of the pictures that see each Gaussian, the most of those it faces."""
    total, weight = np.zeros((len(cloud), 3)), np.full(len(cloud), 1e-12)
    splats = splat.Splats(cloud.x, cloud.cov(), cloud.opacity, np.zeros((len(cloud), 3)))
    for shot in shots:
        camera = shot.camera
        depth = splat.render(splats, camera, np.zeros(3), depth="median")[2]
        at, own = _pixels(camera, cloud.x)
        rows = np.clip(np.floor(at[:, 1]).astype(int), 0, camera.height - 1)
        columns = np.clip(np.floor(at[:, 0]).astype(int), 0, camera.width - 1)
        toward = camera.eye - cloud.x
        toward /= np.linalg.norm(toward, axis=1, keepdims=True)
        faces = np.clip((out * toward).sum(axis=1), 0, 1) ** FACING
        seen = own < depth[rows, columns] + HIDDEN * voxel
        count = np.where(seen, faces, 1e-6 * faces) + 1e-9
        total += count[:, None] * look_up(own_colours(shot.rgb, shot.mask), at)
        weight += count
    return np.clip(total / weight[:, None], 0, 1)
