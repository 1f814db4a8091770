"""Visual hull of a body from several pictures with known cameras, colored from them.

A point is inside if every picture shows it inside the object's outline.

References:
    Laurentini 1994.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from vgmpi.gaussians import camera_files
from vgmpi.gaussians.camera import Camera
from vgmpi.gaussians.camera_files import CameraFileError
from vgmpi.gaussians.cloud import GaussianCloud
from vgmpi.gaussians.spherical_harmonics import dc_from_rgb
from vgmpi.postprocess.raster import rasterize
from vgmpi.preprocess.meshes import surface_mesh
from vgmpi.preprocess.meshes.triangle_mesh import Mesh
from vgmpi.preprocess.placement import UP

from . import photograph
from .gaussian_colors import OPACITY, extend_colors, sample_picture
from .photograph import PhotographError

VOXELS = 128  # voxels along the longest edge
COARSE_VOXELS = 40  # voxels along each edge of the first, coarse pass
HULL_SMOOTHING = 1.0  # [voxels] smoothing of the hull, whose edges between views are artifacts
OUTLINE_SMOOTHING = 0.7  # [pixels] smoothing of the outlines
MAX_GAUSSIANS = 40_000  # upper limit of the Gaussians of a hull
FACING_POWER = 2  # [-] pictures count by this power of the cosine to the surface normal
MAX_TIP_LAYERS = 2  # [voxels] layers at a round tip that may grow more slowly than a cone
CONE_GROWTH = (
    0.85  # [-] growth relative to the line of sight's slope that marks the cone below a body
)
HIDDEN_DEPTH = 2.5  # [voxels] points this far behind the visible surface are hidden


class HullError(ValueError):
    """Error of pictures from which no body can be made; one line."""


class Shot(NamedTuple):
    """Picture of the body with its camera and mask."""

    camera: Camera
    rgb: np.ndarray  # (height, width, 3) uint8
    mask: np.ndarray  # (height, width) bool


class Volume(NamedTuple):
    """Voxel lattice of a hull, in the units of the cameras."""

    inside: np.ndarray  # (nx, ny, nz) coverage, 0.5 at the surface
    low: np.ndarray  # (3,) position of the first lattice point
    step: float  # spacing of the lattice


def read(path: Path) -> list[Shot]:
    """Return the pictures of a transforms.json of nerfstudio; their alpha masks the object.

    Raises:
        HullError: A picture is missing or does not fit its camera, or there are fewer than 3.
    """
    try:
        named = camera_files.transforms(path)
        shots = []
        for name, camera in named:
            file = path.parent / name
            if not file.suffix:
                file = file.with_suffix(".png")
            shot = photograph.read(file)
            size = shot.rgb.shape[1], shot.rgb.shape[0]
            if size != (camera.width, camera.height):
                message = "has {} x {} pixels, its camera {} x {}"
                raise HullError(f"{file}: {message.format(*size, camera.width, camera.height)}")
            if shot.alpha is None:
                raise HullError(f"{file}: is opaque: its alpha must say what the object is")
            shots.append(Shot(camera, shot.rgb, shot.alpha > 127))
    except (CameraFileError, PhotographError) as error:
        raise HullError(str(error)) from None
    if len(shots) < 3:
        raise HullError(f"{path}: {len(shots)} pictures; at least 3 are needed")
    return shots


def carve(shots: list[Shot], fine: int = VOXELS, up: str = "z") -> Volume:
    """Return the visual hull.

    Args:
        shots: Pictures with cameras and masks.
        fine: Voxels along the longest edge of the hull.
        up: Axis that points up. The body stands on something along it: the cone of lines of sight
            below the body is cut off.

    Raises:
        HullError: The outlines of the pictures have no common point.
    """
    middle, half = _bounding_cube(shots)
    coarse = _carve_lattice(
        shots, middle - half, 2 * half / (COARSE_VOXELS - 1), np.full(3, COARSE_VOXELS)
    )
    inside_voxels = np.argwhere(coarse.inside > 0.5)
    if not len(inside_voxels):
        raise HullError("no point lies inside the outlines of all pictures: are the cameras right?")
    low = coarse.low + coarse.step * (inside_voxels.min(axis=0) - 1.5)
    high = coarse.low + coarse.step * (inside_voxels.max(axis=0) + 1.5)
    step = float((high - low).max()) / (fine - 1)
    volume = _carve_lattice(shots, low, step, np.ceil((high - low) / step).astype(int) + 1)
    smooth = ndimage.gaussian_filter(volume.inside, HULL_SMOOTHING)
    return _cut_lower_cone(volume._replace(inside=smooth), shots, up)


def body(shots: list[Shot], seed: int = 1, up: str = "z") -> GaussianCloud:
    """Return Gaussians over the visual hull in the cameras' units and axes.

    Raises:
        HullError: The pictures give no hull.
    """
    return colored(shots, carve(shots, up=up), seed)


def colored(shots: list[Shot], volume: Volume, seed: int = 1) -> GaussianCloud:
    """Return Gaussians over a hull with the colors of its pictures.

    Raises:
        HullError: The hull is thinner than a voxel.
    """
    surface = _surface(volume)
    corner = surface.corners()
    cross = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    area = float(np.linalg.norm(cross, axis=1).sum() / 2)
    cloud = surface_mesh.sample(
        surface, 2 * np.sqrt(area / MAX_GAUSSIANS), (0.5, 0.5, 0.5), OPACITY, [seed]
    )
    out = _outward(volume, cloud)
    sh = dc_from_rgb(_colors(shots, cloud, out, volume.step))[:, None, :].astype(np.float32)
    return GaussianCloud(cloud.x, cloud.quat, cloud.scale, cloud.opacity, sh)


def _bounding_cube(shots: list[Shot]) -> tuple[np.ndarray, float]:
    """Return a cube that contains the body: its center (3,) and half its edge.

    The center is the point closest to the lines of sight through the middles of all outlines.
    """
    total, weighted, half_sizes = np.zeros((3, 3)), np.zeros(3), []
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
        weighted += across @ camera.eye
    if np.linalg.cond(total) > 1e6:
        raise HullError("the cameras look in one direction: a hull needs several")
    middle = np.linalg.solve(total, weighted)
    for shot in shots:
        camera = shot.camera
        rows, columns = np.nonzero(shot.mask)
        distance = np.linalg.norm(middle - camera.eye)
        reach = np.hypot((np.ptp(rows) + 2) / camera.fy, (np.ptp(columns) + 2) / camera.fx)
        half_sizes.append(distance * reach)
    return middle, 0.75 * float(np.median(half_sizes))


def _carve_lattice(shots: list[Shot], low: np.ndarray, step: float, counts: np.ndarray) -> Volume:
    """Evaluate the coverage of the hull on a lattice of the given corner, step and counts."""
    axes = [low[k] + step * np.arange(counts[k]) for k in range(3)]
    x = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    inside = np.ones(len(x), dtype=np.float32)
    remaining = np.arange(len(x))
    for shot in shots:
        soft = ndimage.gaussian_filter(shot.mask.astype(np.float32), OUTLINE_SMOOTHING)
        pixels, depth = shot.camera.pixels(x[remaining])
        coordinates = np.where(depth > 0, pixels.T - 0.5, -9.0)[::-1]
        inside[remaining] = np.minimum(
            inside[remaining], ndimage.map_coordinates(soft, coordinates, order=1)
        )
        remaining = remaining[inside[remaining] > 0.02]
    return Volume(inside.reshape(counts), low, step)


def _cut_lower_cone(volume: Volume, shots: list[Shot], up: str) -> Volume:
    """Cut off the cone below the hull where all cameras look down.

    From the tip of that cone, its width grows with height as fast as the lowest camera's line of
    sight is flat.
    """
    axis = np.asarray(UP[up], dtype=float)[2]
    up_index = int(np.argmax(np.abs(axis)))
    is_inside = volume.inside > 0.5
    places = volume.low + volume.step * np.argwhere(is_inside)
    lowest = places[np.argmin(places @ axis)]
    directions = [shot.camera.eye - lowest for shot in shots]
    rise = [float(aim @ axis / np.linalg.norm(aim - (aim @ axis) * axis)) for aim in directions]
    if min(rise) <= 0:
        return volume
    area = is_inside.sum(axis=tuple(k for k in range(3) if k != up_index))
    if axis[up_index] < 0:
        area = area[::-1]
    radius = ndimage.uniform_filter1d(np.sqrt(area / np.pi), 3, mode="nearest")
    grows = np.gradient(radius)
    first = int(np.flatnonzero(area)[0])
    foot = first
    for k in range(first, first + len(area) // 3):
        if grows[k] >= CONE_GROWTH / min(rise):
            foot = k + 1
        elif k > foot + MAX_TIP_LAYERS:
            break
    inside = np.moveaxis(volume.inside.copy(), up_index, 0)
    below = slice(0, foot) if axis[up_index] > 0 else slice(len(area) - foot, None)
    inside[below] = 0
    return volume._replace(inside=np.moveaxis(inside, 0, up_index))


def _surface(volume: Volume) -> Mesh:
    """Return the surface of coverage 0.5 (flying edges, as implemented in VTK)."""
    import pyvista

    padded = np.pad(volume.inside, 1)
    grid = pyvista.ImageData(dimensions=padded.shape, spacing=(volume.step,) * 3)
    grid.origin = volume.low - volume.step
    grid["inside"] = padded.ravel(order="F")
    contour = grid.contour([0.5], scalars="inside").triangulate()
    faces = np.asarray(contour.faces).reshape(-1, 4)[:, 1:]
    if not len(faces):
        raise HullError("the hull is thinner than a voxel: larger pictures?")
    return Mesh(np.asarray(contour.points, dtype=np.float64), faces)


def _outward(volume: Volume, cloud: GaussianCloud) -> np.ndarray:
    """Return outward unit normals (n, 3) at the Gaussians."""
    soft = ndimage.gaussian_filter(np.pad(volume.inside, 2), 1.0)
    coordinates = ((cloud.x - volume.low) / volume.step + 2).T
    gradient = [
        ndimage.map_coordinates(component, coordinates, order=1) for component in np.gradient(soft)
    ]
    normals = -np.stack(gradient, axis=-1)
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)


def _colors(
    shots: list[Shot], cloud: GaussianCloud, normals: np.ndarray, voxel: float
) -> np.ndarray:
    """Return mean colors (n, 3) over the pictures in which each Gaussian is visible.

    Pictures that face the surface have the largest weights.

    Args:
        shots: Pictures with cameras and masks.
        cloud: Gaussians.
        normals: Outward unit normals, shape (n, 3).
        voxel: Spacing of the lattice.
    """
    total, weight = np.zeros((len(cloud), 3)), np.full(len(cloud), 1e-12)
    splats = rasterize.ProjectableGaussians(
        cloud.x, cloud.cov(), cloud.opacity, np.zeros((len(cloud), 3))
    )
    for shot in shots:
        camera = shot.camera
        depth = rasterize.render(splats, camera, np.zeros(3), depth="median")[2]
        pixels, own_depth = camera.pixels(cloud.x)
        rows = np.clip(np.floor(pixels[:, 1]).astype(int), 0, camera.height - 1)
        columns = np.clip(np.floor(pixels[:, 0]).astype(int), 0, camera.width - 1)
        to_camera = camera.eye - cloud.x
        to_camera /= np.linalg.norm(to_camera, axis=1, keepdims=True)
        faces = np.clip((normals * to_camera).sum(axis=1), 0, 1) ** FACING_POWER
        is_visible = own_depth < depth[rows, columns] + HIDDEN_DEPTH * voxel
        picture_weight = np.where(is_visible, faces, 1e-6 * faces) + 1e-9
        total += picture_weight[:, None] * sample_picture(
            extend_colors(shot.rgb, shot.mask), pixels
        )
        weight += picture_weight
    return np.clip(total / weight[:, None], 0, 1)
