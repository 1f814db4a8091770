"""A floor under the Gaussians with their soft shadow: a background picture for a camera.

The floor is the plane z = height, plain or in squares of two colours, seen from above. Its shadow
is made by splatting: every Gaussian above it is dropped onto the plane along the light, wider the
farther it falls (as the shadow of a lamp that is not a point), and what light they let through
together darkens the floor. It is laid behind everything: a Gaussian below the plane is drawn over
it.
"""

from dataclasses import dataclass, replace

import numpy as np

from vgmpi.splatting.camera import Camera
from vgmpi.splatting.paint import TILE, new_canvas, paint, picture
from vgmpi.splatting.project import drop
from vgmpi.splatting.splat import Splats

PIXELS = 256  # of a shadow, along its longer side
NEAR_BY = 0.05  # of the size of all that is there: what is that high darkens the floor by 1 / e
ALPHA_MIN = 1e-3  # of a shadow: blurred Gaussians are faint and many


@dataclass(frozen=True)
class Floor:
    """height: of the plane z = height [m]. color: 0..1, of all squares or every other one; None:
    it has no look of its own, only its shadow is seen, on what the background shows.

    squares: the colour of the others and the side [m], or None. light: the direction in which light
    travels, downwards. shadow: how much of the light is taken where nothing passes, 0..1. softness:
    standard deviation of the shadow's edge per m of height. contact: how much of the light is taken
    right below what stands there, whatever the light, 0..1.
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
    """What light reaches the plane: (rows, columns) of 0..1 along y and x, 1 beyond.

    lower: x and y of the corner of row 0, column 0 [m]. pixel: side [m].
    """

    light: np.ndarray
    lower: np.ndarray
    pixel: float


def cast(splats: Splats, floor: Floor) -> Shadow:
    """The shadow of the Gaussians on the floor; the same for all cameras of a frame."""
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
    dropped = drop(
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
    order = np.arange(len(dropped[0]))  # what passes is a product: any order will do
    paint(order, *dropped, canvas, -(-columns // TILE), False, None)
    light, colors = np.empty((rows, columns), np.float32), np.empty((rows, columns, 3), np.float32)
    picture(canvas, np.broadcast_to(np.float32(0), colors.shape), colors, light)
    return Shadow(light, lower, pixel)


def touch(splats: Splats, floor: Floor) -> Shadow:
    """What of the light from all sides what stands on the floor takes from it: the Gaussians are
    dropped straight down, the higher they are the fainter and the wider."""
    x = np.asarray(splats.x, dtype=np.float64)
    fall = x[:, 2] - floor.height
    there = np.isfinite(x).all(axis=1) & (fall >= 0)
    if not there.any() or floor.contact == 0:
        return Shadow(np.ones((1, 1), dtype=np.float32), np.zeros(2), 1.0)
    high = NEAR_BY * max(float(np.linalg.norm(np.ptp(x[there], axis=0))), 1e-12)
    near = there & (fall < 3 * high)
    low = Splats(
        x[near],
        splats.cov[near],
        splats.opacity[near] * np.exp(-fall[near] / high),
        splats.color[near],
    )
    return cast(low, replace(floor, light=(0.0, 0.0, -1.0), softness=0.7, shadow=floor.contact))


def _light(shadow: Shadow, at: np.ndarray) -> np.ndarray:
    """What comes to x, y (n, 2) [m], 0..1."""
    from scipy.ndimage import map_coordinates  # slow to load: only for those with a floor

    rows, columns = ((at[:, ::-1] - shadow.lower[::-1]) / shadow.pixel - 0.5).T
    return map_coordinates(
        shadow.light, [rows, columns], order=1, mode="constant", cval=1.0, output=np.float32
    )


def ground(
    floor: Floor,
    shadow: Shadow,
    camera: Camera,
    background: np.ndarray = (1.0, 1.0, 1.0),
    contact: Shadow | None = None,
) -> np.ndarray:
    """What stands behind the Gaussians: the floor, and `background` where it is not seen.

    background: one colour (3,) or a picture (height, width, 3). contact: of `touch`. Returns
    (height, width, 3) float32.
    """
    shape = (camera.height, camera.width, 3)
    out = np.array(np.broadcast_to(np.asarray(background, dtype=np.float32), shape))
    eye = camera.eye
    depth, drift, seen = _meets(floor, camera)
    down = -drift[..., 2]
    depth, drift = depth[seen], drift[seen]
    at = eye[:2] + depth[:, None] * drift[:, :2]
    # metres of floor in a pixel, the long way
    wide = depth * (drift**2).sum(axis=1) / (min(camera.fx, camera.fy) * down[seen])
    color = out[seen] if floor.color is None else _pattern(floor, at, wide)
    bright = 1 - floor.shadow * (1 - _light(shadow, at))
    if contact is not None:
        bright *= 1 - floor.contact * (1 - _light(contact, at))
    out[seen] = color * bright[:, None]
    return out


def depths(floor: Floor, camera: Camera) -> np.ndarray:
    """How far the floor is, float32 (height, width) [m] along the camera's axis; infinite where it
    is not seen."""
    depth, _, seen = _meets(floor, camera)
    return np.where(seen, depth, np.inf).astype(np.float32)


def _meets(floor: Floor, camera: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Depth [m] (height, width) at which each pixel's ray meets the floor, its way per m of depth
    (height, width, 3), and where it does."""
    u = (np.arange(camera.width) + 0.5 - camera.cx) / camera.fx
    v = (np.arange(camera.height) + 0.5 - camera.cy) / camera.fy
    rotation, eye = camera.world_to_camera[:3, :3], camera.eye
    drift = u[None, :, None] * rotation[0] + v[:, None, None] * rotation[1] + rotation[2]
    down = -drift[..., 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = (eye[2] - floor.height) / down
        seen = (down > 0) & (depth >= camera.near) & (depth < 1e6)
    return depth, drift, seen


def _pattern(floor: Floor, at: np.ndarray, wide: np.ndarray) -> np.ndarray:
    """Colours (n, 3) at x, y (n, 2) [m]; squares smaller than two pixels fade to their mean."""
    color = np.broadcast_to(np.asarray(floor.color, dtype=np.float32), (len(at), 3))
    if floor.squares is None:
        return color
    other, side = np.asarray(floor.squares[0], dtype=np.float32), floor.squares[1]
    odd = (np.floor(at / side).sum(axis=1) % 2).astype(np.float32)
    clear = np.clip(2 - 2 * wide / side, 0, 1).astype(np.float32)
    share = 0.5 + clear * (odd - 0.5)
    return color + share[:, None] * (other - color)
