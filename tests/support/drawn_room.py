"""Drawn photographs of a room with boxes on a tiled floor, by cameras that are known."""

import numpy as np

from vgmpi.tools.photo.photo_camera import View

FINE = 2  # rays per pixel and axis
TILE = 0.3  # [m]
WALLS = -1.6, 1.8, 2.6  # [m] left and right (x), and behind (y), of an eye over the origin
BOXES = (  # lower and upper corners [m] in the axes of the room, and the color
    ((-0.5, 0.9, 0.0), (-0.1, 1.2, 0.35), (0.75, 0.3, 0.2)),
    ((0.2, 1.1, 0.0), (0.7, 1.4, 0.2), (0.2, 0.4, 0.65)),
    ((-0.1, 1.6, 0.0), (0.25, 1.9, 0.5), (0.85, 0.75, 0.4)),
)
FACES = (0.72, 0.85, 1.0)  # brightness of faces across x, y and z


def draw(
    view: View, yaw: float = 20.0, roll: float = 0.0, eye: float = 1.2, seed: int = 1,
    bend: float = 0.0, offset: float = 0.0,
) -> np.ndarray:  # fmt: skip
    """Draw the room, (height, width, 3) uint8.

    Args:
        view: Camera.
        yaw: Angle by which the room is turned against the camera [degrees].
        roll: Angle by which the picture is turned [degrees].
        eye: Height of the eye [m].
        seed: Of the noise.
        bend: Part by which the lens brings the corners nearer to the middle [-].
        offset: Of the lens's axis to the right and down, relative to the width [-].
    """
    rows, columns = np.mgrid[0 : view.height * FINE, 0 : view.width * FINE]
    middle = np.array([view.width / 2, view.height / 2])
    at = (np.stack([columns, rows], axis=-1) + 0.5) / FINE - middle
    at = at * (1 + bend * (at**2).sum(axis=-1, keepdims=True) / (middle**2).sum())
    at = at - offset * view.width
    ray = view.rays(at @ turn(roll)[:2, :2] + middle).reshape(-1, 3) @ turn(yaw)
    start = np.array([0.0, 0.0, eye])
    distance, color = np.full(len(ray), np.inf), np.zeros((len(ray), 3))
    surfaces = [floor, *(wall(axis, place) for axis, place in zip((0, 0, 1), WALLS))]
    with np.errstate(divide="ignore", invalid="ignore"):
        for hit in (*surfaces, *(box(*one) for one in BOXES)):
            t, paint = hit(start, ray)
            nearer = t < distance
            distance[nearer], color[nearer] = t[nearer], paint[nearer]
    mean = color.reshape(view.height, FINE, view.width, FINE, 3).mean(axis=(1, 3))
    noise = np.random.default_rng(seed).normal(0, 3 / 255, mean.shape)
    return np.clip(255 * (mean + noise) + 0.5, 0, 255).astype(np.uint8)


def turn(degrees: float) -> np.ndarray:
    """Return the rotation (3, 3) of row vectors about the third axis."""
    cos, sin = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])


def floor(start, ray):
    """Where rays meet the tiles, and their colors."""
    t = np.where(ray[:, 2] < 0, -start[2] / ray[:, 2], np.inf)
    x, y = (np.where(np.isfinite(t), t, 0)[:, None] * ray + start)[:, :2].T / TILE
    tone = 0.55 + 0.15 * ((np.floor(x) + np.floor(y)) % 2)
    return t, tone[:, None] * np.array([1.0, 0.95, 0.85])


def wall(axis, place):
    """A plain wall with a skirting board."""

    def hit(start, ray):
        t = (place - start[axis]) / ray[:, axis]
        t = np.where(t > 0, t, np.inf)
        z = start[2] + np.where(np.isfinite(t), t, 0) * ray[:, 2]
        tone = FACES[axis] * np.where(z < 0.1, 0.5, 0.9)
        return np.where(z > 0, t, np.inf), tone[:, None] * np.array([0.9, 0.95, 1.0])

    return hit


def box(low, high, paint):
    """A box of one color."""

    def hit(start, ray):
        first, second = ((np.asarray(corner) - start) / ray for corner in (low, high))
        near, far = np.minimum(first, second), np.maximum(first, second)
        t = near.max(axis=1)
        t = np.where((t <= far.min(axis=1)) & (t > 0), t, np.inf)
        return t, np.asarray(FACES)[near.argmax(axis=1)][:, None] * np.asarray(paint)

    return hit
