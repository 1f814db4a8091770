"""Pictures of Gaussians some of which are a liquid with a surface.

A pixel has three layers, all from the same Gaussians and without a mesh: what lies before the
liquid's front, the liquid, and what lies behind it. The first and the last are splatted as usual;
each Gaussian belongs to the side of the front on which its center lies (DepthSide). liquid_depth.py
finds the front, and liquid_shading.py shades the liquid.
"""

from dataclasses import dataclass

import numpy as np

from vgmpi.gaussians.camera import Camera

from . import liquid_depth, liquid_shading
from .projection import depth_order, project
from .rasterize import ProjectableGaussians, join_gaussians, resolve_lowpass
from .surface_canvas import surface_canvas, surfaces_of
from .tile_blend import (
    TILE,
    DepthSide,
    blend_tiles,
    depths_of,
    new_canvas,
    picture,
    to_tiles,
)

BYTES = 150  # [bytes] memory of a drawn pixel, at least
SPRAY = 0.04, 0.14  # [-] neighbor fractions of a full drop and of no drop
MIN_DROP_OPACITY, MAX_DROP_OPACITY = 0.3, 0.8  # [-] range of a drop's opacity


@dataclass(frozen=True)
class Liquid:
    """Particles of a liquid with a surface.

    Attributes:
        x: Positions, shape (n, 3) [m].
        spacing: Distance of neighbors, shape (n,) [m].
        color: Colors, shape (n, 3).
        opacity: Opacity of each particle as a Gaussian, shape (n,), 0..1.
    """

    x: np.ndarray
    spacing: np.ndarray
    color: np.ndarray
    opacity: np.ndarray


class LayeredImage:
    """Gaussians projected once and drawn completely or on one side of a surface."""

    def __init__(self, splats: ProjectableGaussians, camera: Camera, lowpass, antialias, alpha_min):
        self.shape = (camera.height, camera.width)
        lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy, camera.near])
        visible_ids = np.empty(len(splats.x), np.int64)
        x, cov, opacity, color = (
            np.ascontiguousarray(getattr(splats, field))
            for field in ("x", "cov", "opacity", "color")
        )
        *self.rows, z = project(
            x,
            cov,
            opacity,
            color,
            np.ascontiguousarray(camera.world_to_camera, dtype=np.float64),
            lens.astype(np.float64),
            *self.shape,
            *resolve_lowpass(splats, lowpass, antialias),
            float(alpha_min),
            visible_ids,
        )
        self.visible_ids = visible_ids[: len(z)]
        self.order, self.z = depth_order(z), z.astype(np.float32)

    def _painted(self, looks, side: DepthSide | None, depths: bool) -> np.ndarray:
        """Blend the Gaussians on one side into a new canvas."""
        canvas = new_canvas(*self.shape)
        ellipses, _, bounds = self.rows
        blend_tiles(
            self.order,
            ellipses,
            looks,
            bounds,
            canvas,
            -(-self.shape[1] // TILE),
            depths,
            side,
            None,
            None,
        )
        return canvas

    def picture(self, background: np.ndarray, limit=None, is_behind=True) -> tuple:
        """Draw the Gaussians on one side of a depth limit.

        Args:
            background: Picture behind them, shape (height, width, 3).
            limit: Depth of the surface per pixel, shape (height, width) [m], or None for no limit.
            is_behind: Whether to draw the side behind the limit, or else before it.

        Returns:
            Picture, shape (height, width, 3), and transmittance, shape (height, width).
        """
        side = None if limit is None else DepthSide(self.z, to_tiles(limit), is_behind)
        image, through = (
            np.empty((*self.shape, 3), np.float32),
            np.empty(self.shape, np.float32),
        )
        picture(self._painted(self.rows[1], side, False), background, image, through)
        return image, through

    def surfaces(
        self, normal: np.ndarray, material: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Draw colors, normals, materials and depths in one pass.

        Args:
            normal, material: Of every Gaussian, shape (n, 3).

        Returns:
            Colors, normals and materials weighted by opacity, shape (height, width, 3),
            transmittance and median depth [m], shape (height, width), float32.
        """
        ellipses, looks, bounds = self.rows
        material = material[self.visible_ids].astype(np.float32)
        is_mixed = len(material) > 0 and bool((material != material[0]).any())
        only = material[0] if len(material) else np.zeros(3, np.float32)
        canvas, drawn = surface_canvas(normal[self.visible_ids], self.z, is_mixed, *self.shape)
        nx = -(-self.shape[1] // TILE)
        blend_tiles(
            self.order, ellipses, looks, bounds, canvas, nx, False, None, drawn,
            material if is_mixed else None,
        )  # fmt: skip
        pictures = np.zeros((3, *self.shape, 3), np.float32)
        through, median = (np.full(self.shape, n, np.float32) for n in (1, np.inf))
        surfaces_of(canvas, drawn.is_drawn, only, pictures, through, median)
        return *pictures, through, median

    def depth(self, limit=None) -> np.ndarray:
        """Return the median depth of the Gaussians, or of those behind a limit.

        It is float32 (height, width) [m]: the depth at which the transmittance falls to a half,
        infinite where it stays above.
        """
        side = None if limit is None else DepthSide(self.z, to_tiles(limit), True)
        looks = self.rows[1].copy()
        looks[:, 2] = self.z
        mean, median = (np.empty(self.shape, np.float32) for _ in range(2))
        depths_of(self._painted(looks, side, True), mean, median)
        return median


def split_spray(liquid: Liquid, spacing: float) -> tuple[Liquid, ProjectableGaussians]:
    """Split a liquid into its body and its spray.

    Particles with few neighbors are drawn as Gaussians; those in between become smaller balls and
    fainter Gaussians.

    Args:
        liquid: All particles.
        spacing: Usual distance of neighbors [m].

    Returns:
        The liquid without its spray, and the spray as Gaussians.
    """
    sparse, dense = SPRAY
    spray_fraction = np.clip(
        (dense - liquid_depth.neighbor_fraction(liquid.x, spacing)) / (dense - sparse), 0.0, 1.0
    )
    spray = np.flatnonzero(spray_fraction > 0)
    radius = liquid_depth.RADIUS * liquid.spacing[spray]
    cov = np.zeros((len(spray), 6))
    cov[:, (0, 3, 5)] = (0.5 * radius**2)[:, None]
    opacity = spray_fraction[spray] * np.clip(
        liquid.opacity[spray], MIN_DROP_OPACITY, MAX_DROP_OPACITY
    )
    rows = np.flatnonzero(spray_fraction < 1)
    size = liquid.spacing[rows] * (1 - spray_fraction[rows])
    opacity_left = liquid.opacity[rows] * (1 - spray_fraction[rows])
    body = Liquid(liquid.x[rows], size, liquid.color[rows], opacity_left)
    return body, ProjectableGaussians(liquid.x[spray], cov, opacity, liquid.color[spray])


def render(
    splats: ProjectableGaussians, liquid: Liquid, camera: Camera, background: np.ndarray,
    ground: np.ndarray, sky: liquid_shading.EnvironmentMap, medium: liquid_shading.LiquidMedium, *,
    lowpass: float | None, antialias: bool | None, alpha_min: float, with_depth: bool = False,
) -> tuple[np.ndarray, ...]:  # fmt: skip
    """Draw Gaussians and a liquid with a surface.

    Args:
        splats: Gaussians that are not of the liquid.
        liquid: Particles of the liquid.
        camera: Camera of the picture.
        background: Picture behind everything, shape (height, width, 3).
        ground: Depth of that background, shape (height, width) [m]; infinite for a far one.
        sky: Environment that the liquid reflects.
        medium: Optical properties of the liquid.
        lowpass, antialias, alpha_min: Options of rasterize.render.
        with_depth: Whether to return depths.

    Returns:
        Picture, float32 (height, width, 3), transmittance, shape (height, width), and, if
        requested, depth of the nearest surface, shape (height, width) [m].
    """
    if not len(liquid.x):
        layers = LayeredImage(splats, camera, lowpass, antialias, alpha_min)
        return *layers.picture(background), *([layers.depth()] if with_depth else [])
    typical = float(np.median(liquid.spacing))
    body, spray = split_spray(liquid, typical)
    layers = LayeredImage(join_gaussians([splats, spray]), camera, lowpass, antialias, alpha_min)
    radius = liquid_depth.BALL * body.spacing
    depth = liquid_depth.liquid_depth(body.x, radius, typical, camera)
    background_depth = np.minimum(layers.depth(depth), ground)
    image, left = layers.picture(background, depth)
    ball = liquid_depth.RADIUS * body.spacing
    through = liquid_depth.liquid_thickness(
        body.x, ball, body.color, body.opacity, camera, background_depth
    )
    lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy, camera.near])
    rotation = np.ascontiguousarray(camera.world_to_camera[:3, :3])
    above = liquid_depth.ABOVE * typical
    background_image = image.copy()
    inv_depth = 1 / depth
    liquid_shading.shade(
        inv_depth, through, background_image, background_depth, lens, rotation, sky.picture, medium,
        typical, above, image, left,
    )  # fmt: skip
    dark = np.broadcast_to(np.float32(0), image.shape)
    front_image, front_through = layers.picture(dark, depth, is_behind=False)
    depth_image = (np.minimum(depth, layers.depth()),) if with_depth else ()
    return (
        front_image + front_through[..., None] * image,
        front_through * left,
        *depth_image,
    )
