"""Cups: hollow bodies of revolution with their handles, and the liquids inside them.

The outer surface is that of `revolve`. The cavity follows it at the thickness of the wall and is
open at the top. Parts of the mask that the body of revolution does not cover, such as handles, are
inflated and set where they meet it.
"""

from typing import NamedTuple

import numpy as np
from scipy import ndimage

from vgmpi.preprocess.meshes.triangle_mesh import Mesh

from .grabcut import iou
from .mask_to_mesh import (
    CIRCLE_VERTICES,
    BodyError,
    Profile,
    eroded_mask,
    inflated_surface,
    revolution_profile,
)
from .photo_camera import View

WALL = 0.12  # [-] default thickness of the wall relative to the largest radius
CLEARANCE = 0.02  # [-] between a liquid and the wall, relative to the largest radius
MIN_HANDLE = 0.004  # [-] smaller parts are dropped, relative to the area of the mask
HANDLE_MARGIN = 2  # [pixels] parts this close to the body of revolution belong to its rim
JOINT = 5  # [pixels] length by which a handle reaches into the body
LEVELS = 60  # levels of the liquid that are compared
MIN_LIQUID_IOU = 0.5  # [-] a liquid whose surface agrees less is refused


class Cup(NamedTuple):
    """Hollow body about the eye, about 1 away."""

    profile: Profile  # of the outer surface
    wall: float  # thickness of the wall and of the base

    @property
    def cavity(self) -> Profile:
        """Return the profile of the cavity from its bottom to the rim."""
        axis, heights, radius = self.profile
        inside = heights >= heights[0] + self.wall
        inner = np.maximum(radius[inside] - self.wall, 1e-3 * self.wall)
        return Profile(axis, heights[inside], inner)


def cup(mask: np.ndarray, view: View, wall: float = WALL) -> Cup:
    """Return the hollow body of revolution that is seen as a mask.

    Args:
        mask: The object, shape (height, width) bool.
        view: Camera of the photograph.
        wall: Thickness of the wall relative to the largest radius.

    Raises:
        BodyError: No upright body of revolution is seen so, or the wall fills it.
    """
    profile = revolution_profile(eroded_mask(mask), view)
    hollow = Cup(profile, wall * float(profile.radius.max()))
    if len(hollow.cavity.heights) < 8 or hollow.cavity.radius[-1] < hollow.wall:
        raise BodyError(f"a wall of {wall:g} of its radius leaves no cavity: a smaller wall")
    return hollow


def cup_surface(hollow: Cup) -> Mesh:
    """Return the closed surface of a cup: outside, rim, cavity, and both bottoms."""
    outer, inner = hollow.profile, hollow.cavity
    radius = np.concatenate([[0.0], outer.radius, inner.radius[::-1], [0.0]])
    heights = np.concatenate(
        [outer.heights[:1], outer.heights, inner.heights[::-1], inner.heights[:1]]
    )
    return _turned(outer.axis, heights, radius)


def liquid_surface(hollow: Cup, level: float) -> Mesh:
    """Return the closed surface of the liquid in a cup up to a level (height about the eye)."""
    cavity, gap = hollow.cavity, CLEARANCE * float(hollow.profile.radius.max())
    low = cavity.heights[0] + gap
    heights = np.linspace(low, level, 80)
    radius = np.maximum(np.interp(heights, cavity.heights, cavity.radius) - gap, 0.1 * gap)
    return _turned(
        cavity.axis,
        np.concatenate([heights[:1], heights, heights[-1:]]),
        np.concatenate([[0.0], radius, [0.0]]),
    )


def liquid_level(hollow: Cup, mask: np.ndarray, view: View) -> tuple[float, float]:
    """Return the level at which the surface of a liquid is seen as a mask, and the agreement.

    Args:
        hollow: The cup.
        mask: The visible surface of the liquid, shape (height, width) bool.
        view: Camera of the photograph.

    Returns:
        Height about the eye, and the intersection over union of both areas.

    Raises:
        BodyError: No level gives a surface that is seen so.
    """
    cavity = hollow.cavity
    opening = _disc(cavity, len(cavity.heights) - 1, view)
    rows = np.linspace(1, len(cavity.heights) - 2, LEVELS).astype(int)
    agreement = [iou(_disc(cavity, int(k), view) & opening, mask) for k in rows]
    best = int(np.argmax(agreement))
    if agreement[best] < MIN_LIQUID_IOU:
        message = f"no level of a liquid is seen as its mask (agreement {agreement[best]:.2f})"
        raise BodyError(f"{message}: is it the surface of the liquid that is marked?")
    return float(cavity.heights[rows[best]]), float(agreement[best])


def join_surfaces(surfaces: list[Mesh]) -> Mesh:
    """Return several surfaces as one."""
    first = np.cumsum([0, *(len(surface.points) for surface in surfaces)])
    triangles = [surface.triangles + n for surface, n in zip(surfaces, first)]
    return Mesh(np.concatenate([surface.points for surface in surfaces]), np.concatenate(triangles))


def handles(hollow: Cup, mask: np.ndarray, view: View) -> list[tuple[Mesh, int]]:
    """Return the parts of a cup that its body of revolution does not cover.

    Args:
        hollow: The cup.
        mask: The object, shape (height, width) bool.
        view: Camera of the photograph.

    Returns:
        Surface and number of pixels of each part.
    """
    outline = np.zeros(mask.shape, dtype=bool)
    for k in range(0, len(hollow.profile.heights), 3):
        outline |= _disc(hollow.profile, k, view)
    extended = ndimage.binary_dilation(outline, iterations=HANDLE_MARGIN)
    remainder = ndimage.binary_opening(mask & ~extended)
    labels, count = ndimage.label(remainder)
    parts = []
    for number in range(1, count + 1):
        part = labels == number
        if part.sum() < MIN_HANDLE * mask.sum():
            continue
        reach = ndimage.binary_dilation(part, iterations=HANDLE_MARGIN + JOINT) & mask
        joint = np.argwhere(reach & outline)
        if not len(joint):
            continue
        surface = inflated_surface(reach, view)
        depth = _depth_at(hollow.profile, joint.mean(axis=0)[::-1], view)
        scale = depth / float(view.pixels(surface.points)[1].mean())
        parts.append((Mesh(surface.points * scale, surface.triangles), int(part.sum())))
    return parts


def _depth_at(profile: Profile, pixel: np.ndarray, view: View) -> float:
    """Return the depth along the camera's axis where a pixel sees a body of revolution, or nearly.

    Args:
        profile: The body.
        pixel: Position in the picture, shape (2,) [pixels].
        view: Camera of the photograph.
    """
    points = np.concatenate([_ring(profile, k) for k in range(0, len(profile.heights), 3)])
    pixels, depth = view.pixels(points)
    distance = np.hypot(*(pixels - pixel).T)
    closest = np.flatnonzero(distance <= distance.min() + 3)
    return float(depth[closest].min())  # the visible side


def _ring(profile: Profile, k: int) -> np.ndarray:
    """Return the vertices (n, 3) of a circle of a profile."""
    turn = 2 * np.pi * np.arange(CIRCLE_VERTICES) / CIRCLE_VERTICES
    r, z = profile.radius[k], profile.heights[k]
    return np.stack(
        [profile.axis + r * np.cos(turn), 1 + r * np.sin(turn), np.full(len(turn), z)], -1
    )


def _disc(profile: Profile, k: int, view: View) -> np.ndarray:
    """Return the pixels (height, width) bool of the disc inside a circle of a profile."""
    from PIL import Image, ImageDraw

    image = Image.new("L", (view.width, view.height))
    corners = [(float(x) - 0.5, float(y) - 0.5) for x, y in view.pixels(_ring(profile, k))[0]]
    ImageDraw.Draw(image).polygon(corners, fill=255, outline=255)
    return np.asarray(image) > 127


def _turned(axis: float, heights: np.ndarray, radius: np.ndarray) -> Mesh:
    """Return the surface of a curve that turns about an upright axis; its ends lie on the axis."""
    n, count = CIRCLE_VERTICES, len(heights)
    turn = 2 * np.pi * np.arange(n) / n
    points = np.stack(
        [
            axis + radius[:, None] * np.cos(turn),
            1 + radius[:, None] * np.sin(turn),
            np.broadcast_to(heights[:, None], (count, n)),
        ],
        -1,
    ).reshape(-1, 3)
    k, j = np.meshgrid(np.arange(count - 1), np.arange(n), indexing="ij")
    a, b = (k * n + j).ravel(), (k * n + (j + 1) % n).ravel()
    c, d = b + n, a + n
    triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    first, last = triangles // n == 0, triangles // n == count - 1
    triangles = np.where(first, 0, np.where(last, (count - 1) * n, triangles))  # one point each
    distinct = (triangles != np.roll(triangles, 1, axis=1)).all(axis=1)
    return Mesh(points, triangles[distinct])
