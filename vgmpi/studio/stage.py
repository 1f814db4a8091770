"""All that a ray can meet in a picture."""

from typing import NamedTuple

import numpy as np

from vgmpi.splatting.camera import Camera
from vgmpi.studio.field import Field
from vgmpi.studio.grid import Grid
from vgmpi.studio.ground import Ground
from vgmpi.studio.lighting import Rig
from vgmpi.studio.occlusion import Occlusion


class View(NamedTuple):
    """What the camera sees without the liquid, as fine as it is painted.

    Attributes:
        light: (height, width, 3) linear, of what is opaque over ground and background.
        depth: (height, width) of what is opaque [m], infinite for none.
        behind: (height, width, 3) linear, ground and background alone.
        pose: (4, 4) from the world to the camera.
        lens: fx, fy, cx, cy, near.
        eye: (3,) [m].
        picture: whether the background is a picture or clear, and is seen where nothing is.
    """

    light: np.ndarray
    depth: np.ndarray
    behind: np.ndarray
    pose: np.ndarray
    lens: np.ndarray
    eye: np.ndarray
    picture: bool


class Medium(NamedTuple):
    """The liquid.

    Attributes:
        field: its density.
        tint: grid of (absorption [1/m] x 3, color x 3, foam, scattering [1/m]).
        index: of refraction.
        least: way through it that is seen behind a wall [m].
        uniform: whether it has one color.
        foam: most that foam covers, 0..1.
        mean: (8,) mean of tint.
    """

    field: Field
    tint: Grid
    index: float
    least: float
    uniform: bool
    foam: float
    mean: np.ndarray


class Stage(NamedTuple):
    """All that a ray can meet."""

    medium: Medium
    pyramid: Occlusion
    rig: Rig
    plane: Ground
    buffers: View


def view_of(camera: Camera) -> View:
    """An empty view of a camera, as large as its picture."""
    shape = (camera.height, camera.width)
    lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy, camera.near])
    pose = np.ascontiguousarray(camera.world_to_camera, dtype=np.float64)
    light, behind = (np.zeros((*shape, 3), np.float32) for _ in range(2))
    depth = np.full(shape, np.inf, np.float32)
    return View(light, depth, behind, pose, lens, np.ascontiguousarray(camera.eye), False)


def no_view() -> View:
    """The view of no camera: nothing is seen."""
    none = np.zeros((1, 1, 3), np.float32)
    depth = np.full((1, 1), np.inf, np.float32)
    return View(none, depth, none, np.eye(4), np.ones(5), np.zeros(3), False)
