"""Pictures of Gaussians of which some are a liquid with a surface.

Three layers, from the same Gaussians and without a mesh: what stands before the liquid's front at a
pixel, the liquid, and what lies behind it. The first and the last are splatted as ever, each
Gaussian to the side of the front on which its middle is (paint.Side); front.py finds the front, and
optics.py what the liquid shows.
"""

import copy
from dataclasses import dataclass

import numpy as np

from vgmpi.splatting import front, optics
from vgmpi.splatting.camera import Camera
from vgmpi.splatting.paint import TILE, Side, depths_of, new_canvas, paint, picture, tiled
from vgmpi.splatting.project import by_depth, project
from vgmpi.splatting.splat import Splats

BYTES = 150  # of a pixel that is drawn, at least
SPRAY = 0.04, 0.14  # of the particles around one inside: with fewer it is a drop, with more not
FAINTEST, DENSEST = 0.3, 0.8  # opacity of drops


@dataclass(frozen=True)
class Liquid:
    """x: (n, 3) [m]. spacing: (n,) [m] of neighbours. color: (n, 3). opacity: (n,) in 0..1, of each
    as a Gaussian."""

    x: np.ndarray
    spacing: np.ndarray
    color: np.ndarray
    opacity: np.ndarray


class Layers:
    """Gaussians on a picture, drawn whole or on one side of a surface."""

    def __init__(self, splats: Splats, camera: Camera, lowpass, antialias, alpha_min):
        self.shape = (camera.height, camera.width)
        lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy, camera.near])
        kept = np.empty(len(splats.x), np.int64)
        *self.rows, z = project(
            *(np.ascontiguousarray(getattr(splats, f)) for f in ("x", "cov", "opacity", "color")),
            np.ascontiguousarray(camera.world_to_camera, dtype=np.float64),
            lens.astype(np.float64),
            *self.shape,
            float(lowpass),
            bool(antialias),
            float(alpha_min),
            kept,
        )
        self.kept = kept[: len(z)]
        self.order, self.z = by_depth(z), z.astype(np.float32)

    def with_colors(self, color: np.ndarray) -> "Layers":
        """The same Gaussians in other colors (n, 3); projection and order are shared."""
        other = copy.copy(self)
        looks = self.rows[1].copy()
        looks[:, 2:5] = color[self.kept]
        other.rows = [self.rows[0], looks, self.rows[2]]
        return other

    def _painted(self, looks, side: Side | None, depths: bool) -> np.ndarray:
        canvas = new_canvas(*self.shape)
        ellipses, _, bounds = self.rows
        paint(self.order, ellipses, looks, bounds, canvas, -(-self.shape[1] // TILE), depths, side)
        return canvas

    def picture(self, background: np.ndarray, limit=None, behind=True) -> tuple:
        """Picture (height, width, 3) and what comes through (height, width)."""
        side = None if limit is None else Side(self.z, tiled(limit), behind)
        image, left = np.empty((*self.shape, 3), np.float32), np.empty(self.shape, np.float32)
        picture(self._painted(self.rows[1], side, False), background, image, left)
        return image, left

    def depth(self, limit=None) -> np.ndarray:
        """Of what brings the light to a half, float32 (height, width) [m], infinite for none; where
        there is a limit, of what lies behind."""
        side = None if limit is None else Side(self.z, tiled(limit), True)
        looks = self.rows[1].copy()
        looks[:, 2] = self.z
        mean, median = (np.empty(self.shape, np.float32) for _ in range(2))
        depths_of(self._painted(looks, side, True), mean, median)
        return median


def drops(liquid: Liquid, spacing: float) -> tuple[Liquid, Splats]:
    """The liquid without its spray, and the spray as Gaussians: particles that have few others
    around them, smaller balls and fainter Gaussians in between. spacing: the usual one [m]."""
    few, many = SPRAY
    alone = np.clip((many - front.crowd(liquid.x, spacing)) / (many - few), 0.0, 1.0)
    spray = np.flatnonzero(alone > 0)
    radius = front.RADIUS * liquid.spacing[spray]
    cov = np.zeros((len(spray), 6))
    cov[:, (0, 3, 5)] = (0.5 * radius**2)[:, None]
    opacity = alone[spray] * np.clip(liquid.opacity[spray], FAINTEST, DENSEST)
    rest = np.flatnonzero(alone < 1)
    size = liquid.spacing[rest] * (1 - alone[rest])
    opaque = liquid.opacity[rest] * (1 - alone[rest])
    kept = Liquid(liquid.x[rest], size, liquid.color[rest], opaque)
    return kept, Splats(liquid.x[spray], cov, opacity, liquid.color[spray])


def joined(one: Splats, two: Splats) -> Splats:
    """Gaussians of both."""
    return Splats(
        *(np.concatenate([getattr(one, f), getattr(two, f)]) for f in one.__dataclass_fields__)
    )


def render(
    splats: Splats,
    liquid: Liquid,
    camera: Camera,
    background: np.ndarray,
    ground: np.ndarray,
    sky: optics.Sky,
    medium: optics.Medium,
    *,
    lowpass: float,
    antialias: bool,
    alpha_min: float,
    asked: bool = False,
) -> tuple[np.ndarray, ...]:
    """Picture (height, width, 3) float32, what comes through (height, width), and, if it is asked
    for, depth (height, width) [m] of the nearest thing.

    background: (height, width, 3); ground: its depth [m], infinite for what is far away.
    """
    if not len(liquid.x):
        layers = Layers(splats, camera, lowpass, antialias, alpha_min)
        return *layers.picture(background), *([layers.depth()] if asked else [])
    typical = float(np.median(liquid.spacing))
    kept, spray = drops(liquid, typical)
    layers = Layers(joined(splats, spray), camera, lowpass, antialias, alpha_min)
    radius = front.BALL * kept.spacing
    depth = front.surface(kept.x, radius, typical, camera)
    far = np.minimum(layers.depth(depth), ground)
    image, left = layers.picture(background, depth)
    ball = front.RADIUS * kept.spacing
    through = front.through(kept.x, ball, kept.color, kept.opacity, camera, far)
    lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy, camera.near])
    turn = np.ascontiguousarray(camera.world_to_camera[:3, :3])
    above = front.ABOVE * typical
    behind = image.copy()
    near = 1 / depth
    optics.shade(
        near, through, behind, far, lens, turn, sky.picture, medium, typical, above, image, left
    )
    dark = np.broadcast_to(np.float32(0), image.shape)
    before, passes = layers.picture(dark, depth, behind=False)
    nearest = (np.minimum(depth, layers.depth()),) if asked else ()
    return before + passes[..., None] * image, passes * left, *nearest
