"""Ground plane under the Gaussians with soft shadows, as a background picture of a camera.

The plane is z = height, plain or in squares of two colors, seen from above. Its shadow is made by
splatting: every Gaussian above the plane is projected onto it along the light and widened with its
height (as in the shadow of an area light), and their joint transmittance darkens the plane. The
plane is composited behind everything: a Gaussian below it is drawn over it.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from vgmpi.gaussians.camera import Camera

from .projection import project_to_plane
from .rasterize import ProjectableGaussians
from .tile_blend import TILE, blend_tiles, new_canvas, picture

PIXELS = 256  # [pixels] longer side of a shadow map
CONTACT_HEIGHT = 0.05  # [scene diagonals] height at which contact darkening falls to 1 / e
ALPHA_MIN = 1e-3  # [-] cutoff of a shadow, low since blurred Gaussians are faint and many


@dataclass(frozen=True)
class GroundPlane:
    """Horizontal plane with its color, light and shadow.

    Attributes:
        height: Height of the plane z = height [m].
        color: Color in 0..1 of all squares or of every other one. None: the plane has no color of
            its own, and only its shadow shows on the background.
        squares: Color of the other squares and their side [m], or None.
        light: Direction in which the light travels, downwards.
        shadow: Fraction of the light removed in full shadow, 0..1.
        softness: Standard deviation of the shadow's edge per m of height.
        contact: Fraction of the light removed right below objects for any light direction, 0..1.
    """

    height: float = 0.0
    color: tuple[float, float, float] | None = (0.85, 0.85, 0.85)
    squares: tuple[tuple[float, float, float], float] | None = None
    light: tuple[float, float, float] = (0.3, 0.2, -1.0)
    shadow: float = 0.6
    softness: float = 0.1
    contact: float = 0.0

    def __post_init__(self):
        if not self.light[2] < 0:
            raise ValueError("the light of a floor must point down: light[2] < 0")
        if not (0 <= self.shadow <= 1 and self.softness >= 0):
            raise ValueError("allowed: shadow 0..1, softness from 0")
        if self.squares is not None and not self.squares[1] > 0:
            raise ValueError("the squares of a floor need a side > 0")
        if self.squares is not None and self.color is None:
            raise ValueError("the squares of a floor need its color")


@dataclass(frozen=True)
class Shadow:
    """Transmittance of light on the plane, sampled on a grid of x and y.

    Attributes:
        light: Transmittance, shape (rows, columns) along y and x, 0..1; 1 outside of the grid.
        lower: x and y of the corner of row 0, column 0, shape (2,) [m].
        pixel: Side of a pixel [m].
    """

    light: np.ndarray
    lower: np.ndarray
    pixel: float


def cast_shadow(splats: ProjectableGaussians, floor: GroundPlane) -> Shadow:
    """Return the shadow of the Gaussians on the plane; it is shared by all cameras of a frame."""
    x, cov = np.asarray(splats.x, dtype=np.float64), np.asarray(splats.cov, dtype=np.float64)
    lean = -np.asarray(floor.light[:2], dtype=np.float64) / floor.light[2]
    fall = x[:, 2] - floor.height
    spread = np.sqrt(cov[:, (0, 3, 5)].max(axis=1, initial=0.0)) * (1 + np.linalg.norm(lean))
    reach = 3.5 * (spread + floor.softness * np.maximum(fall, 0))
    above = (fall >= 0) & np.isfinite(x).all(axis=1) & np.isfinite(reach)
    if not above.any() or floor.shadow == 0:
        return Shadow(np.ones((1, 1), dtype=np.float32), np.zeros(2), 1.0)
    middle = x[above, :2] + lean * fall[above, None]
    lower = (middle - reach[above, None]).min(axis=0)
    size = (middle + reach[above, None]).max(axis=0) - lower
    pixel = max(float(size.max()) / PIXELS, 1e-12)
    columns, rows = (int(n) + 1 for n in size / pixel)
    dropped = project_to_plane(
        np.ascontiguousarray(x),
        np.ascontiguousarray(cov),
        np.ascontiguousarray(splats.opacity, dtype=np.float64),
        lean,
        float(floor.height),
        lower,
        pixel,
        float(floor.softness),
        rows,
        columns,
        ALPHA_MIN,
    )
    canvas = new_canvas(rows, columns)
    order = np.arange(len(dropped[0]))  # transmittance is a product: any order is valid
    blend_tiles(order, *dropped, canvas, -(-columns // TILE), False, None, None)
    light, colors = np.empty((rows, columns), np.float32), np.empty((rows, columns, 3), np.float32)
    picture(canvas, np.broadcast_to(np.float32(0), colors.shape), colors, light)
    return Shadow(light, lower, pixel)


def contact_shadow(splats: ProjectableGaussians, floor: GroundPlane) -> Shadow:
    """Return the ambient-occlusion shadow of the Gaussians near the plane.

    The Gaussians are projected straight down, fainter and wider the higher they are.
    """
    x = np.asarray(splats.x, dtype=np.float64)
    fall = x[:, 2] - floor.height
    is_above = np.isfinite(x).all(axis=1) & (fall >= 0)
    if not is_above.any() or floor.contact == 0:
        return Shadow(np.ones((1, 1), dtype=np.float32), np.zeros(2), 1.0)
    decay_height = CONTACT_HEIGHT * max(float(np.linalg.norm(np.ptp(x[is_above], axis=0))), 1e-12)
    is_low = is_above & (fall < 3 * decay_height)
    near_splats = ProjectableGaussians(
        x[is_low],
        splats.cov[is_low],
        splats.opacity[is_low] * np.exp(-fall[is_low] / decay_height),
        splats.color[is_low],
    )
    return cast_shadow(
        near_splats, replace(floor, light=(0.0, 0.0, -1.0), softness=0.7, shadow=floor.contact)
    )


def _light(shadow: Shadow, points: np.ndarray) -> np.ndarray:
    """Return the transmittance at the points x, y (n, 2) [m], in 0..1."""
    from scipy.ndimage import map_coordinates  # slow to load, and needed for floors only

    rows, columns = ((points[:, ::-1] - shadow.lower[::-1]) / shadow.pixel - 0.5).T
    return map_coordinates(
        shadow.light, [rows, columns], order=1, mode="constant", cval=1.0, output=np.float32
    )


def composite_ground(
    floor: GroundPlane,
    shadow: Shadow,
    camera: Camera,
    background: ArrayLike = (1.0, 1.0, 1.0),
    contact: Shadow | None = None,
) -> np.ndarray:
    """Draw the plane over the background.

    Args:
        floor: The plane.
        shadow: Shadow of its light, see `cast_shadow`.
        camera: Camera of the picture.
        background: One color, shape (3,), or a picture, shape (height, width, 3), where the plane
            is not visible.
        contact: Contact shadow, see `contact_shadow`, or None.

    Returns:
        Background picture for the Gaussians, float32 (height, width, 3).
    """
    shape = (camera.height, camera.width, 3)
    out = np.array(np.broadcast_to(np.asarray(background, dtype=np.float32), shape))
    eye = camera.eye
    depth, drift, is_ground = _meets(floor, camera)
    down = -drift[..., 2]
    depth, drift = depth[is_ground], drift[is_ground]
    points = eye[:2] + depth[:, None] * drift[:, :2]
    # length of floor in a pixel along the line of sight [m]
    footprint = depth * (drift**2).sum(axis=1) / (min(camera.fx, camera.fy) * down[is_ground])
    color = out[is_ground] if floor.color is None else _pattern(floor, points, footprint)
    bright = 1 - floor.shadow * (1 - _light(shadow, points))
    if contact is not None:
        bright *= 1 - floor.contact * (1 - _light(contact, points))
    out[is_ground] = color * bright[:, None]
    return out


def _meets(floor: GroundPlane, camera: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Intersect the ray of each pixel with the plane.

    Returns:
        Depth of the intersection, shape (height, width) [m], displacement of the ray per m of
        depth, shape (height, width, 3), and whether the plane is visible, shape (height, width).
    """
    u = (np.arange(camera.width) + 0.5 - camera.cx) / camera.fx
    v = (np.arange(camera.height) + 0.5 - camera.cy) / camera.fy
    rotation, eye = camera.world_to_camera[:3, :3], camera.eye
    drift = u[None, :, None] * rotation[0] + v[:, None, None] * rotation[1] + rotation[2]
    down = -drift[..., 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = (eye[2] - floor.height) / down
        is_ground = (down > 0) & (depth >= camera.near_plane) & (depth < 1e6)
    return depth, drift, is_ground


def _pattern(floor: GroundPlane, points: np.ndarray, footprint: np.ndarray) -> np.ndarray:
    """Return the colors (n, 3) at the points x, y (n, 2) [m].

    Squares smaller than two pixel footprints fade to their mean.
    """
    color = np.broadcast_to(np.asarray(floor.color, dtype=np.float32), (len(points), 3))
    if floor.squares is None:
        return color
    other, side = np.asarray(floor.squares[0], dtype=np.float32), floor.squares[1]
    odd = (np.floor(points / side).sum(axis=1) % 2).astype(np.float32)
    contrast = np.clip(2 - 2 * footprint / side, 0, 1).astype(np.float32)
    fraction = 0.5 + contrast * (odd - 0.5)
    return color + fraction[:, None] * (other - color)
