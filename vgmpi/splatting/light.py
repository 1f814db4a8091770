"""One light from far away on Gaussians: shadows that they throw on each other, and shades of what
is turned away.

The light looks at them through a camera of its own, so far off that its rays are all but parallel;
the picture's median depths say what it reaches. A Gaussian's shadow is a mean over a disc of that
map which is the larger the farther before it stands what is in the way (R. Fernando, "Percentage-
closer soft shadows", 2005).
"""

from dataclasses import dataclass, replace

import numpy as np

from vgmpi.caching import cached
from vgmpi.splatting import splat
from vgmpi.splatting.camera import Camera, look_at
from vgmpi.splatting.splat import Splats

PIXELS = 640  # of the light's picture
FAR = 30.0  # radii of what is lit: how far off its camera stands
RINGS = 3  # of places in a disc at which the map is read
BIAS = 2.5  # standard deviations of a Gaussian, by which it does not shadow itself
CELL = 1.5  # spacings: edge of the cells whose density tells where a Gaussian faces
SMOOTH = 1.2  # cells: by how much it is smoothed
MOST = 3e7  # cells
LEAST = 1e-12


@dataclass(frozen=True)
class Light:
    """direction: in which it travels. shadow: how much of the colour is taken where it does not
    come, 0..1. softness: width of a shadow's edge per m to what throws it. shade: how much is taken
    from what is turned away, 0..1. contact: how much of the floor's light is taken right below a
    thing, 0..1."""

    direction: tuple[float, float, float] = (0.3, 0.2, -1.0)
    shadow: float = 0.5
    softness: float = 0.1
    shade: float = 0.3
    contact: float = 0.5


def lit(
    splats: Splats, light: Light, spacing: float, liquid: np.ndarray | None = None
) -> np.ndarray:
    """By how much the Gaussians' colours are dimmed in this light, 0..1 (n,). spacing: of
    neighbours inside of bodies [m]. liquid: (n,) which are of a liquid with a surface: light passes
    them, and optics.py shades what it draws of them."""
    factor = np.ones(len(splats.x))
    if not len(factor):
        return factor
    if light.shadow > 0:
        throws = splats
        if liquid is not None:
            throws = replace(splats, opacity=np.where(liquid, 0.0, splats.opacity))
        factor *= 1 - light.shadow * (1 - reached(throws, light))
    there = np.arange(len(factor)) if liquid is None else np.flatnonzero(~liquid)
    if light.shade > 0 and len(there):
        way = -np.asarray(light.direction) / np.linalg.norm(light.direction)
        factor[there] *= 1 - light.shade * 0.5 * (1 - faces(splats.x[there], spacing) @ way)
    return factor


def reached(splats: Splats, light: Light) -> np.ndarray:
    """How much light comes to each of the Gaussians, 0..1 (n,)."""
    camera, depth = _map(splats, light)
    sd = np.sqrt(np.maximum(splats.cov[:, (0, 3, 5)].max(axis=1), 0.0))
    w2c = np.ascontiguousarray(camera.world_to_camera)
    out, x = np.ones(len(splats.x)), np.ascontiguousarray(splats.x, dtype=np.float64)
    # mean depth of what a Gaussian's own map pixel may hold of itself, beside its size
    pixel = np.linalg.norm(camera.world_to_camera[:3, 3]) / camera.fx
    _reached(x, BIAS * sd + 2.0 * pixel, w2c, camera.fx, depth, light.softness, out)
    return out


def _map(splats: Splats, light: Light) -> tuple[Camera, np.ndarray]:
    """The light's camera, and the depths it sees."""
    x = splats.x[np.isfinite(splats.x).all(axis=1)]
    low, high = np.percentile(x, [0.1, 99.9], axis=0)
    middle, radius = 0.5 * (low + high), max(0.55 * float(np.linalg.norm(high - low)), LEAST)
    way = np.asarray(light.direction, dtype=np.float64) / np.linalg.norm(light.direction)
    up = (0.0, 1.0, 0.0) if abs(way[1]) < 0.9 else (1.0, 0.0, 0.0)
    fov = 2 * np.degrees(np.arcsin(1.05 / FAR))
    eye = middle - FAR * radius * way
    camera = look_at(eye, middle, up, fov, PIXELS, PIXELS, near=LEAST)
    dark = Splats(splats.x, splats.cov, splats.opacity, np.zeros((len(splats.x), 3)))
    return camera, splat.render(dark, camera, depth="median")[2]


@cached(nogil=True, error_model="numpy")
def _reached(x, bias, w2c, focal, depth, softness, out):
    height, width = depth.shape
    nearest = depth.min()
    for i in range(len(x)):
        a, b, c = x[i, 0], x[i, 1], x[i, 2]
        z = w2c[2, 0] * a + w2c[2, 1] * b + w2c[2, 2] * c + w2c[2, 3]
        u = focal * (w2c[0, 0] * a + w2c[0, 1] * b + w2c[0, 2] * c + w2c[0, 3]) / z + 0.5 * width
        v = focal * (w2c[1, 0] * a + w2c[1, 1] * b + w2c[1, 2] * c + w2c[1, 3]) / z + 0.5 * height
        limit, pixel = z - bias[i], z / focal
        # what is in the way, within as far as an edge may reach, and how far before it is
        ahead, found = 0.0, 0
        disc = max(1.0, 0.5 * softness * (z - nearest) / pixel)
        for turn in range(2):
            lit, total = 0.0, 0
            for ring in range(RINGS + 1):
                places = 1 if ring == 0 else 8
                for place in range(places):
                    angle = (place + 0.5 * ring) * np.pi / 4.0
                    r = disc * ring / RINGS
                    j, k = int(v + r * np.sin(angle)), int(u + r * np.cos(angle))
                    total += 1
                    if not (0 <= j < height and 0 <= k < width) or depth[j, k] >= limit:
                        lit += 1.0
                    elif turn == 0:
                        ahead += z - depth[j, k]
                        found += 1
            if turn == 0:
                if found == 0:
                    break
                disc = max(1.0, softness * ahead / found / pixel)
        out[i] = lit / total


def faces(x: np.ndarray, spacing: float) -> np.ndarray:
    """Where Gaussians at x (n, 3) [m] face, (n, 3): away from where there are more of them, as long
    as 1 at a surface and less inside of bodies."""
    from scipy import ndimage  # slow to load: only for those with a light

    edge = CELL * spacing
    low = x.min(axis=0) - 3 * edge
    shape = ((x.max(axis=0) - low) / edge).astype(np.int64) + 4
    if np.prod(shape.astype(float)) > MOST:
        return np.zeros_like(x)
    at = (x - low) / edge
    flat = np.ravel_multi_index(at.astype(np.int64).T, shape)
    count = np.bincount(flat, minlength=int(np.prod(shape))).reshape(shape)
    dense = ndimage.gaussian_filter(count.astype(np.float32), SMOOTH)
    full = np.percentile(dense.ravel()[flat], 90)
    out = np.empty_like(x)
    for axis in range(3):
        slope = np.gradient(dense, axis=axis)
        out[:, axis] = -ndimage.map_coordinates(slope, at.T - 0.5, order=1)
    # of a flat surface
    most = 0.7 * full / (np.sqrt(2 * np.pi) * SMOOTH)
    return out / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), most)
