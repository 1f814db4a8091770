"""Liquids of a run that are drawn with a surface."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from postprocess import video
from postprocess.look import Look, seen
from postprocess.parts import Part
from postprocess.settings import LiquidSettings
from vgmpi.splatting import floor, liquid, optics
from vgmpi.splatting.camera import Camera
from vgmpi.splatting.light import Light

SHARE = 1 / 3  # of the diagonal of what is in view: how far one sees through a liquid


class Liquids:
    """The fluids of a run, and what they show.

    chosen: [liquid] of render.toml. light: that they mirror. box: () -> lower and upper corner of
    what is to be seen [m]. folder: of render.toml.
    """

    def __init__(
        self, look: Look, chosen: LiquidSettings, light: Light, box: Callable, folder: Path
    ):
        self.look, self.sky = look, _sky(chosen, folder)
        clear = chosen.clear
        if clear is None:
            low, high = box()
            clear = SHARE * max(float(np.linalg.norm(high - low)), 1e-12)
        towards = -np.asarray(light.direction, dtype=np.float64)
        towards /= np.linalg.norm(towards)
        rough = float(np.radians(chosen.roughness))
        self.medium = optics.Medium(
            chosen.index, clear, towards, chosen.highlight, rough, light.shade
        )

    def among(self, parts: list[Part], frame: dict[str, np.ndarray]) -> np.ndarray:
        """Which Gaussians of all parts are of these liquids."""
        found = [np.zeros(len(part.x), bool) for part in parts]
        found[self._particles] = self.look.fluid[np.asarray(frame["id"])]
        return np.concatenate(found)

    @property
    def _particles(self) -> int:
        """Which of the parts they are among: scenery comes first."""
        return int(self.look.scenery is not None)

    def render(
        self,
        frame: dict[str, np.ndarray],
        parts: list[Part],
        camera: Camera,
        background: np.ndarray,
        under: floor.Floor | None,
        **options,
    ) -> tuple[np.ndarray, ...]:
        """A frame's parts (Look.parts) as vgmpi.splatting.liquid.render draws them, over a
        background with a floor or without one (None)."""
        at = self._particles
        particles, fluid = parts[at], self.look.fluid[np.asarray(frame["id"])]
        rest = [*parts[:at], particles.only(~fluid), *parts[at + 1 :]]
        _, _, opacity, color = particles.only(fluid).seen_from(camera.eye)
        J = np.asarray(frame["J"], dtype=np.float64)[fluid] if "J" in frame else 1.0
        volume = self.look.vol0[np.asarray(frame["id"])[fluid]] * J
        drawn = liquid.Liquid(particles.x[fluid], np.cbrt(volume), color, opacity)
        ground = np.full((camera.height, camera.width), np.inf, dtype=np.float32)
        if under is not None:
            ground = floor.depths(under, camera)
        return liquid.render(
            seen(rest, camera.eye), drawn, camera, background, ground, self.sky, self.medium,
            **options,
        )  # fmt: skip


def _sky(chosen: LiquidSettings, folder: Path) -> optics.Sky:
    around = chosen.surroundings
    if around.picture is None:
        return optics.gradient(around.zenith, around.horizon, around.ground)
    found = video.photograph("liquid.surroundings.picture", folder / around.picture)
    return optics.Sky(np.ascontiguousarray(found, dtype=np.float32))
