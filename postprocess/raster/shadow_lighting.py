"""Directional light on Gaussians: shadows and shading by orientation.

The light renders a shadow map with a camera so far away that its rays are nearly parallel; the
map holds median depths. A Gaussian's shadow is the mean over a disc of that map, which grows with
the distance to the blockers (percentage-closer soft shadows).

References:
    R. Fernando. Percentage-closer soft shadows. 2005.
"""

from dataclasses import dataclass, replace

import numpy as np

from vgmpi.gaussians.camera import Camera, look_at
from vgmpi.runtime.compile_cache import njit_cached

from . import rasterize
from .rasterize import ProjectableGaussians

PIXELS = 640  # [pixels] side of the shadow map
CAMERA_DISTANCE = 30.0  # [radii of the scene] distance of the light's camera
RINGS = 3  # [-] rings of map samples in a filter disc
BIAS = 2.5  # [standard deviations] depth bias against self-shadowing of a Gaussian
CELL = 1.5  # [spacings] edge of the density cells that give the normals
SMOOTH = 1.2  # [cells] standard deviation of the density smoothing
MAX_CELLS = 3e7  # [cells] largest density grid
MIN_RADIUS = 1e-12  # [m] smallest radius of a scene, and near plane of the light's camera


@dataclass(frozen=True)
class Light:
    """Directional light and the strength of its effects.

    Attributes:
        direction: Direction in which the light travels.
        shadow: Fraction of the color removed in full shadow, 0..1.
        softness: Width of a shadow's edge per m of distance to the blocker.
        shade: Fraction removed from what faces away from the light, 0..1.
        contact: Fraction of the floor's light removed right below an object, 0..1.
    """

    direction: tuple[float, float, float] = (0.3, 0.2, -1.0)
    shadow: float = 0.5
    softness: float = 0.1
    shade: float = 0.3
    contact: float = 0.5


def shade(splats: ProjectableGaussians, light: Light, spacing: float) -> np.ndarray:
    """Return the factors in 0..1 (n,) by which this light dims the Gaussians' colors.

    Args:
        splats: The Gaussians.
        light: The light.
        spacing: Distance of neighbors inside of bodies [m].
    """
    factor = np.ones(len(splats.x))
    if not len(factor):
        return factor
    if light.shadow > 0:
        factor *= 1 - light.shadow * (1 - shadow_visibility(splats, light))
    if light.shade > 0:
        toward_light = -np.asarray(light.direction) / np.linalg.norm(light.direction)
        facing = outward_normals(splats.x, spacing) @ toward_light
        factor *= 1 - light.shade * 0.5 * (1 - facing)
    return factor


def shadow_visibility(splats: ProjectableGaussians, light: Light) -> np.ndarray:
    """Return the fraction of the light that reaches each Gaussian, 0..1 (n,)."""
    camera, depth = _map(splats, light)
    sd = np.sqrt(np.maximum(splats.cov[:, (0, 3, 5)].max(axis=1), 0.0))
    w2c = np.ascontiguousarray(camera.world_to_camera)
    out, x = np.ones(len(splats.x)), np.ascontiguousarray(splats.x, dtype=np.float64)
    # a map pixel adds its own footprint to the depth that a Gaussian hides of itself
    pixel = np.linalg.norm(camera.world_to_camera[:3, 3]) / camera.fx
    _reached(x, BIAS * sd + 2.0 * pixel, w2c, camera.fx, depth, light.softness, out)
    return out


def _map(splats: ProjectableGaussians, light: Light) -> tuple[Camera, np.ndarray]:
    """Return the light's camera and the depths of its shadow map."""
    x = splats.x[np.isfinite(splats.x).all(axis=1)]
    low, high = np.percentile(x, [0.1, 99.9], axis=0)
    middle, radius = 0.5 * (low + high), max(0.55 * float(np.linalg.norm(high - low)), MIN_RADIUS)
    direction = np.asarray(light.direction, dtype=np.float64) / np.linalg.norm(light.direction)
    up = (0.0, 1.0, 0.0) if abs(direction[1]) < 0.9 else (1.0, 0.0, 0.0)
    fov = 2 * np.degrees(np.arcsin(1.05 / CAMERA_DISTANCE))
    eye = middle - CAMERA_DISTANCE * radius * direction
    camera = look_at(eye, middle, up, fov, PIXELS, PIXELS, near_plane=MIN_RADIUS)
    dark = replace(splats, color=np.zeros((len(splats.x), 3)))
    return camera, rasterize.render(dark, camera, depth="median")[2]


@njit_cached(nogil=True, error_model="numpy")
def _reached(x, bias, w2c, focal, depth, softness, out):
    """Average the shadow map over a disc around each Gaussian, in two passes.

    The first pass finds the mean distance of the blockers, which sets the disc of the second.
    """
    height, width = depth.shape
    nearest = depth.min()
    for i in range(len(x)):
        a, b, c = x[i, 0], x[i, 1], x[i, 2]
        z = w2c[2, 0] * a + w2c[2, 1] * b + w2c[2, 2] * c + w2c[2, 3]
        u = focal * (w2c[0, 0] * a + w2c[0, 1] * b + w2c[0, 2] * c + w2c[0, 3]) / z + 0.5 * width
        v = focal * (w2c[1, 0] * a + w2c[1, 1] * b + w2c[1, 2] * c + w2c[1, 3]) / z + 0.5 * height
        limit, pixel = z - bias[i], z / focal
        # blockers within the reach of a shadow's edge, and the sum of their distances
        distance_sum, blocker_count = 0.0, 0
        disc = max(1.0, 0.5 * softness * (z - nearest) / pixel)
        for pass_index in range(2):
            lit_count, total = 0.0, 0
            for ring in range(RINGS + 1):
                places = 1 if ring == 0 else 8
                for place in range(places):
                    angle = (place + 0.5 * ring) * np.pi / 4.0
                    r = disc * ring / RINGS
                    j, k = int(v + r * np.sin(angle)), int(u + r * np.cos(angle))
                    total += 1
                    if not (0 <= j < height and 0 <= k < width) or depth[j, k] >= limit:
                        lit_count += 1.0
                    elif pass_index == 0:
                        distance_sum += z - depth[j, k]
                        blocker_count += 1
            if pass_index == 0:
                if blocker_count == 0:
                    break
                disc = max(1.0, softness * distance_sum / blocker_count / pixel)
        out[i] = lit_count / total


def outward_normals(x: np.ndarray, spacing: float) -> np.ndarray:
    """Return outward normals (n, 3) of Gaussians at x (n, 3) [m] from their density.

    They point away from denser regions. Their length is 1 at a surface and less inside of bodies.
    """
    from scipy import ndimage  # slow to load, and needed for lights only

    edge = CELL * spacing
    low = x.min(axis=0) - 3 * edge
    shape = ((x.max(axis=0) - low) / edge).astype(np.int64) + 4
    if np.prod(shape.astype(float)) > MAX_CELLS:
        return np.zeros_like(x)
    position = (x - low) / edge
    flat = np.ravel_multi_index(position.astype(np.int64).T, shape)
    count = np.bincount(flat, minlength=int(np.prod(shape))).reshape(shape)
    dense = ndimage.gaussian_filter(count.astype(np.float32), SMOOTH)
    full = np.percentile(dense.ravel()[flat], 90)
    out = np.empty_like(x)
    for axis in range(3):
        slope = np.gradient(dense, axis=axis)
        out[:, axis] = -ndimage.map_coordinates(slope, position.T - 0.5, order=1)
    # gradient at a flat surface
    surface_slope = 0.7 * full / (np.sqrt(2 * np.pi) * SMOOTH)
    return out / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), surface_slope)
