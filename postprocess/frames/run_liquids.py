"""Liquids of a run that are drawn with a surface."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from vgmpi.gaussians.camera import Camera

from ..raster import ground_plane, liquid_shading, liquid_surface
from ..raster.shadow_lighting import Light
from . import image_io
from .appearance import Appearance, view_dependent_splats
from .frame_gaussians import GaussianBatch
from .render_config import LiquidSettings

CLEAR_FRACTION = 1 / 3  # [-] absorption length over the diagonal of the visible extent


class Liquids:
    """Fluids of a run with their optical medium and environment."""

    def __init__(
        self, look: Appearance, chosen: LiquidSettings, light: Light, box: Callable, folder: Path
    ):
        """Set up the medium and the environment.

        Args:
            look: Appearance of the run.
            chosen: Table [liquid] of render.toml.
            light: Light that the liquids reflect.
            box: Function that returns the lower and upper corner of the visible extent [m].
            folder: Folder of render.toml.
        """
        self.look, self.sky = look, _sky(chosen, folder)
        clear = chosen.absorption_length
        if clear is None:
            low, high = box()
            clear = CLEAR_FRACTION * max(float(np.linalg.norm(high - low)), 1e-12)
        towards = -np.asarray(light.direction, dtype=np.float64)
        towards /= np.linalg.norm(towards)
        rough = float(np.radians(chosen.roughness))
        self.medium = liquid_shading.LiquidMedium(
            chosen.refractive_index, clear, towards, chosen.highlight, rough, light.shade
        )

    def select_liquids(
        self, parts: list[GaussianBatch], frame: dict[str, np.ndarray]
    ) -> np.ndarray:
        """Return which Gaussians of all parts belong to liquids, bool."""
        masks = [np.zeros(len(part.x), bool) for part in parts]
        masks[self._particle_part] = self.look.fluid[np.asarray(frame["id"])]
        return np.concatenate(masks)

    @property
    def _particle_part(self) -> int:
        """Index of the part with the particles; scenery comes first."""
        return int(self.look.scenery is not None)

    def render(
        self,
        frame: dict[str, np.ndarray],
        parts: list[GaussianBatch],
        camera: Camera,
        background: np.ndarray,
        floor_below: ground_plane.GroundPlane | None,
        **options,
    ) -> tuple[np.ndarray, ...]:
        """Render a frame with its liquids by vgmpi.postprocess.raster.liquid_surface.render.

        Args:
            frame: Arrays of the frame.
            parts: Gaussians of the frame, of Appearance.parts.
            camera: Camera.
            background: Background image.
            floor_below: Floor, or None.
            **options: Options of vgmpi.postprocess.raster.liquid_surface.render.
        """
        particle_part = self._particle_part
        particles, fluid = parts[particle_part], self.look.fluid[np.asarray(frame["id"])]
        others = [*parts[:particle_part], particles.subset(~fluid), *parts[particle_part + 1 :]]
        liquid = particles.subset(fluid).view_from(camera.eye)
        J = np.asarray(frame["J"], dtype=np.float64)[fluid] if "J" in frame else 1.0
        volume = self.look.vol0[np.asarray(frame["id"])[fluid]] * J
        drawn = liquid_surface.Liquid(liquid.x, np.cbrt(volume), liquid.color, liquid.opacity)
        ground = np.full((camera.height, camera.width), np.inf, dtype=np.float32)
        if floor_below is not None:
            ground = ground_plane.ground_depth(floor_below, camera)
        return liquid_surface.render(
            view_dependent_splats(others, camera.eye), drawn, camera, background, ground,
            self.sky, self.medium, **options,
        )  # fmt: skip


def _sky(chosen: LiquidSettings, folder: Path) -> liquid_shading.EnvironmentMap:
    """Return the environment that liquids reflect."""
    environment = chosen.environment
    if environment.picture is None:
        return liquid_shading.gradient(environment.zenith, environment.horizon, environment.ground)
    image = image_io.photograph("liquid.environment.picture", folder / environment.picture)
    return liquid_shading.EnvironmentMap(np.ascontiguousarray(image, dtype=np.float32))
