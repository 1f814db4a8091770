"""Scene of a picture: everything that a ray can hit."""

from typing import NamedTuple

import numpy as np

from vgmpi.gaussians.camera import Camera

from .cone_occlusion import Occlusion
from .density_field import Field
from .light_rig import Rig
from .studio_ground import Ground
from .value_grid import Grid

CHANNELS = 9  # values of a liquid at a point, see Medium.tint


class View(NamedTuple):
    """Camera and its picture without the liquid, at the resolution of painting.

    Attributes:
        light: Linear light of opaque surfaces over the background, shape (height, width, 3).
        depth: Depth of opaque surfaces, shape (height, width) [m], infinite for none.
        background: Linear light of ground and background alone, shape (height, width, 3).
        pose: World to camera, shape (4, 4).
        lens: fx, fy, cx, cy, near.
        eye: Position of the camera, shape (3,) [m].
        picture: Whether the background is a picture or clear, and shows where nothing is hit.
    """

    light: np.ndarray
    depth: np.ndarray
    background: np.ndarray
    pose: np.ndarray
    lens: np.ndarray
    eye: np.ndarray
    picture: bool


class Medium(NamedTuple):
    """Optical properties of the liquid.

    Attributes:
        field: Its density.
        tint: Grid of (absorption [1/m] x 3, color x 3, foam, scattering [1/m], contained), where
            contained is the part of its light that the color contains, 0..1.
        index: Refractive index.
        min_path: Path length through it that is visible behind a wall [m].
        uniform: Whether it has one color.
        foam: Largest cover of foam, 0..1.
        mean: Mean of tint, shape (9,).
    """

    field: Field
    tint: Grid
    index: float  # type: ignore[assignment]  # hides a method of tuple
    min_path: float
    uniform: bool
    foam: float
    mean: np.ndarray


class Stage(NamedTuple):
    """Everything that a ray can hit: liquid, occlusion pyramid, lights, ground and view."""

    medium: Medium
    pyramid: Occlusion
    rig: Rig
    plane: Ground
    buffers: View


def view_of(camera: Camera) -> View:
    """Return an empty view of a camera, as large as its picture."""
    shape = (camera.height, camera.width)
    lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy, camera.near_plane])
    pose = np.ascontiguousarray(camera.world_to_camera, dtype=np.float64)
    light, background = (np.zeros((*shape, 3), np.float32) for _ in range(2))
    depth = np.full(shape, np.inf, np.float32)
    return View(light, depth, background, pose, lens, np.ascontiguousarray(camera.eye), False)


def no_view() -> View:
    """Return the view of no camera, which shows nothing."""
    none = np.zeros((1, 1, 3), np.float32)
    depth = np.full((1, 1), np.inf, np.float32)
    return View(none, depth, none, np.eye(4), np.ones(5), np.zeros(3), False)
