"""Rendering of frames in a studio, for `[look] preset = "studio"`.

Camera-independent quantities are computed once per frame: lattice stretches, the density field of
liquids, the occlusion pyramid and the light on the ground. For each camera, opaque bodies are drawn
(albedo, normal, kind, depth) and lit, and rays are traced through the liquid.
"""

import functools
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from vgmpi.gaussians.camera import Camera

from ..frames.appearance import Appearance
from ..frames.frame_gaussians import GaussianBatch
from ..frames.render_config import Settings
from ..raster.rasterize import ProjectableGaussians, join_gaussians, supersampled_camera
from ..raster.surface_canvas import draw_surfaces
from . import (
    body_normals,
    compositing,
    cone_occlusion,
    deferred_shading,
    density_field,
    grain_splats,
    lattice_deformation,
    liquid_radiance,
    spray_drops,
    studio_ground,
    tone_mapping,
)
from .compositing import defocus
from .ray_scene import CHANNELS, Medium, Stage, no_view, view_of
from .studio_bodies import Bodies, domain_of, tearing
from .studio_settings import ground_of, optical_values, rig_of
from .value_grid import Grid

CLEAR_DISTANCE = 0.8  # [m] absorption length of liquids at an extent of 1.2 m
REFERENCE_EXTENT = 1.2  # [m]
WALL_CLEAR_SHARE = 0.12  # [-] least visible depth behind a wall, in absorption lengths
FOAM_HISTORY = 12  # [frames] memory of foam
PREVIEW_STRIDE = 2  # [frames] stride of the foam of a preview
PREVIEW_RESOLUTION = 0.75  # [-] relative resolution of grids in a preview
EDGE_OVERSAMPLING = 2  # [-] oversampling of opaque bodies if edges are refined
STRETCH = 0.4, 3.0  # [-] limits for the kernels of liquids
STREAM_STRETCH = 0.3, 8.0  # [-] of those from inlets, whose streams are drawn out as they fall
SPEED_MAX = 1e4  # [m/s]
GRAIN_STRETCH = 0.8, 3.2


@dataclass
class Moment:
    """A frame prepared for all cameras: parts to draw and the scene that light meets.

    parts: opaque Gaussians, with `normals` and `kinds` (n, 3) of each. grain: arguments of
    grain_splats.grains except the eye, or None. drops: spheroids.
    """

    parts: list[GaussianBatch]
    normals: list[np.ndarray]
    kinds: list[np.ndarray]
    shades: list[np.ndarray | None]
    grain: tuple | None
    medium: Medium
    pyramid: Any
    plane: Any
    drops: tuple
    liquid: bool


class Studio:
    """Renderer of frames of one run in the studio.

    Args:
        look: appearance of the run's Gaussians.
        chosen: contents of render.toml.
        box: function that returns the lower and upper corner of the visible extent [m].
        folder: folder of render.toml, for the files it names.
        quick: whether to render a preview, with coarser grids and without refined edges.
    """

    def __init__(
        self, look: Appearance, chosen: Settings, box: Callable, folder: Path, quick: bool = False
    ):
        self.look, self.chosen, self.box = look, chosen, box
        self.domain = domain_of(look.run, chosen.liquid.clip_at_walls)
        self.quick, self.edges = quick, 1 if quick else chosen.picture.edge_samples
        self.times = EDGE_OVERSAMPLING if self.edges > 1 else 1
        self.tone = int(chosen.toned)
        self.rig = rig_of(chosen, folder)
        self.foam_sources: dict[int, tuple[np.ndarray, np.ndarray]] = {}  # foam sources by frame
        self.first: studio_ground.Ground | None = None  # ground at the first frame

    @functools.cached_property
    def bodies(self) -> Bodies:
        """Materials and rest normals of the bodies, computed by processes that draw."""
        return Bodies(self.look)

    @functools.cached_property
    def tears(self) -> tuple[np.ndarray, lattice_deformation.Links]:
        """Tearing distances (n,) [m] and rest neighbors of fluids, sand and snow."""
        return tearing(self.look, self.chosen.look.tear)

    # ---- a frame ---------------------------------------------------------------------------

    def moment(self, frame: dict[str, np.ndarray], index: int) -> Moment:
        """Prepare a frame: compute all that does not depend on the camera."""
        moment, floor = self._moment(frame, index), self.chosen.picture.floor
        if floor is not None and floor.kind == "photograph":
            if self.first is None:
                number = min(self.look.run.frames)
                self.first = self._moment(self.look.frame(number), number).plane
            moment.plane = studio_ground.new_shadows(moment.plane, self.first)
        return moment

    def _moment(self, frame: dict[str, np.ndarray], index: int) -> Moment:
        look, bodies = self.look, self.bodies
        ids, x = np.asarray(frame["id"]), np.asarray(frame["positions"], dtype=np.float64)
        parts, main = look.parts(frame), int(look.scenery is not None)
        solid = np.flatnonzero(~(bodies.fluid[ids] | bodies.granular[ids]))
        opaque, normals, kinds, shades = bodies.opaque(parts, main, frame, solid)
        is_near = self._is_within_grids(x)
        granular = np.flatnonzero(bodies.granular[ids] & is_near)
        grain = self._grain(x, ids, granular, parts[main]) if len(granular) else None
        pyramid = self._pyramid(frame, opaque, x, ids, granular, parts[main], solid, main)
        rows = np.flatnonzero(bodies.fluid[ids] & is_near)
        medium, spray = self._medium(frame, index, ids, x, rows, parts[main])
        plane = ground_of(self.chosen, self.domain, pyramid, self.rig)
        stage = Stage(medium, pyramid, self.rig, plane, no_view())
        if len(rows) and plane.kind != studio_ground.NONE:
            deferred_shading.tint_ground(stage)
        plane = studio_ground.close_rim(plane)
        return Moment(
            opaque, normals, kinds, shades, grain, medium, pyramid, plane, spray, len(rows) > 0
        )

    def empty_moment(self) -> Moment:
        """Return a frame of nothing but the ground."""
        none, nowhere = np.zeros((0, 3)), np.zeros(0, np.int64)
        medium, drops = self._medium({}, 0, nowhere, none, nowhere, None)
        pyramid = cone_occlusion.occlusion(
            none, np.zeros(0), none, self.domain.low, self.domain.high, 1
        )
        plane = studio_ground.close_rim(ground_of(self.chosen, self.domain, pyramid, self.rig))
        return Moment([], [], [], [], None, medium, pyramid, plane, drops, False)

    def _stretches(self, x, ids, rows, limits) -> np.ndarray:
        """Return stretches (n, 6) of the lattice around the particles `rows` of a frame."""
        torn, links = self.tears
        row_of = np.full(len(torn), -1, np.int64)
        row_of[ids[rows]] = np.arange(len(rows))
        return lattice_deformation.stretches(
            x[rows], ids[rows].astype(np.int64), row_of, links, self.bodies.spacing, torn, *limits,
        )  # fmt: skip

    def _grain(self, x, ids, rows, part) -> tuple:
        bodies, color = self.bodies, _unshaded(part.subset_rows(rows), self.look.shade, ids[rows])
        stretch = self._stretches(x, ids, rows, GRAIN_STRETCH)
        spacing = bodies.spacing[ids[rows]]
        floor = self.domain.low[2] if self.domain.walls[2] else -np.inf
        heap = grain_splats.find_visible_particles(x[rows], spacing, float(floor))
        return (
            x[rows], ids[rows], spacing, stretch, color, bodies.sandy[ids[rows]], heap,
            float(floor),
        )  # fmt: skip

    def _pyramid(self, frame, opaque, x, ids, granular, part, solid, main):
        """Return the occlusion pyramid of bodies, scenery, sand and snow."""
        cells = self.chosen.light.cells if self.chosen.light else 150
        if self.quick:
            cells = max(int(PREVIEW_RESOLUTION * cells), 1)
        low, high = self.domain.low, self.domain.high
        cell = cone_occlusion.cell_size(low, high, cells)
        xs, volumes, colors = [np.zeros((0, 3))], [np.zeros(0)], [np.zeros((0, 3))]
        scenery = self.bodies.scenery
        for k, g in enumerate(opaque[: main + 1]):  # the bodies of carried Gaussians included
            xs.append(g.x)
            if scenery is not None and k < main:
                volumes.append(scenery.hiding_volumes(cell))
            else:
                volumes.append(self.look.vol0[ids[solid]])
            colors.append(tone_mapping.to_linear(np.clip(_base_color(g), 0, 1)))
        if scenery is not None and scenery.skins:
            inside, filling = scenery.fill(cell, frame)
            xs.append(inside)
            volumes.append(filling.volume)
            colors.append(colors[1][filling.parent])
        if len(granular):
            xs.append(x[granular])
            volumes.append(self.look.vol0[ids[granular]])
            colors.append(
                tone_mapping.to_linear(np.clip(_base_color(part.subset_rows(granular)), 0, 1))
            )
        points, volume, color = map(np.concatenate, (xs, volumes, colors))
        return cone_occlusion.occlusion(points, volume, color, low, high, cells)

    def _medium(self, frame, index, ids, x, rows, part) -> tuple[Medium, tuple]:
        """Return the liquid and its drops."""
        chosen, bodies = self.chosen.liquid, self.bodies
        if not len(rows):
            tint = Grid(np.zeros((2, 2, 2, CHANNELS), np.float32), np.zeros(3), 1.0)
            mean = np.zeros(CHANNELS)
            none = Medium(density_field.empty_field(), tint, 1.333, 0.0, True, 0.0, mean)
            return none, spray_drops.spray_drops(x[:0], x[:0], ids[:0], none.field, 1.0)
        velocity = np.zeros((len(rows), 3))
        if "velocity" in frame:
            velocity = _velocities(frame["velocity"], rows)
        spacing = bodies.spacing[ids[rows]]
        s = float(np.median(spacing))
        color = tone_mapping.to_linear(np.clip(_base_color(part.subset_rows(rows)), 0, 1))
        clear = chosen.absorption_length
        if clear is None:
            low, high = self.box()
            clear = CLEAR_DISTANCE * max(float(np.linalg.norm(high - low)), 1e-9) / REFERENCE_EXTENT
        white = np.zeros(len(rows))
        if self.chosen.look.foam > 0 and "velocity" in frame:
            white = self._foam(index)[ids[rows]]
        captured, opaqueness = bodies.captured[ids[rows]], bodies.opaqueness[ids[rows]]
        values = optical_values(color, captured, opaqueness, white, clear, self.chosen, self.rig)
        walls, box = self.domain.walls, self.domain.box
        inside = density_field.interior(x[rows], spacing, values, box, walls)
        from_inlet = bodies.from_inlet[ids[rows]]
        limits = [np.where(from_inlet, *pair) for pair in zip(STREAM_STRETCH, STRETCH, strict=True)]
        stretch = self._stretches(x, ids, rows, limits)
        fine = chosen.cells_per_spacing * (PREVIEW_RESOLUTION if self.quick else 1.0)
        density = density_field.liquid_field(x[rows], spacing, stretch, inside, box, walls, fine)
        uniform = bool((np.ptp(values[:, :3], axis=0) < 1e-3 * values[:, :3].max()).all())
        foam = self.chosen.look.foam if white.any() else 0.0
        mean = np.ascontiguousarray(values.mean(axis=0))
        medium = Medium(
            density, inside.means, chosen.refractive_index, WALL_CLEAR_SHARE * clear, uniform,
            float(foam), mean,
        )  # fmt: skip
        return medium, spray_drops.spray_drops(x[rows], velocity, ids[rows], density, s)

    def _foam(self, index: int) -> np.ndarray:
        """Return the foam of particles, from a fixed number of frames whatever image is drawn."""
        run, value = self.look.run, np.zeros(len(self.bodies.fluid))
        step = PREVIEW_STRIDE if self.quick else 1
        for k in range(max(index - FOAM_HISTORY, index % step), index + 1, step):
            if k not in run.frames:
                continue
            if k not in self.foam_sources:
                self.foam_sources = {
                    n: s for n, s in self.foam_sources.items() if index - FOAM_HISTORY <= n <= index
                }
                self.foam_sources[k] = self._foam_sources(k)
            previous = run.times[k - step] if k >= step else np.nan
            dt = float(run.times[k] - previous) if np.isfinite(previous) else 0.0
            ids, source = self.foam_sources[k]
            spray_drops.advance_foam(value, ids, source, max(dt, 0.0))
        return value

    def _foam_sources(self, k: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the liquid's particles at a frame, and how much foam they produce."""
        frame = self.look.run.frame(k)
        ids = np.asarray(frame["id"])
        x = np.asarray(frame["positions"], dtype=np.float64)
        rows = np.flatnonzero(self.bodies.fluid[ids] & self._is_within_grids(x))
        if "velocity" not in frame or not len(rows):
            return ids[:0], np.zeros(0)
        spacing = float(np.median(self.bodies.spacing[ids[rows]]))
        return ids[rows], spray_drops.foam_source(
            x[rows], _velocities(frame["velocity"], rows), spacing
        )

    def _is_within_grids(self, x: np.ndarray) -> np.ndarray:
        """Return whether points (n, 3) are within two domain sizes, the reach of the grids."""
        margin = 2.0 * float(self.domain.size.max())
        inside = (x > self.domain.low - margin) & (x < self.domain.high + margin)
        return np.all(inside, axis=1)

    def render(
        self, moment: Moment, camera: Camera, picture: np.ndarray, options: dict, lens: tuple
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return display values (height, width, 3), transmittance (height, width) and depth [m].

        Args:
            moment: Frame.
            camera: Camera with the size of the image.
            picture: Background in display values, (height, width, 3), or one color (3,).
            options: alpha_min, lowpass and antialias of the splats.
            lens: Radius of the lens and focus distance [m]; 0 and 0 for a pinhole.
        """
        fine = supersampled_camera(camera, self.times)
        shape, view = (camera.height, camera.width), view_of(fine)
        backdrop = self._background(picture, fine)
        view = view._replace(picture=backdrop.shape[0] > 1)
        splats, normal, kind = self._splats(moment, camera.eye)
        albedo, normals, kinds, transmit = self._paint(splats, normal, kind, fine, view, options)
        stage = Stage(moment.medium, moment.pyramid, self.rig, moment.plane, view)
        deferred_shading.shade_background(stage, backdrop, self.times)
        deferred_shading.shade_opaque(
            stage, albedo, normals, kinds, transmit, self.times, moment.liquid, self.chosen.captures
        )
        drop_depth = np.full(view.depth.shape, np.inf, np.float32)
        drop_normal = np.zeros((*drop_depth.shape, 3), np.float32)
        spray_drops.paint_drops(*moment.drops, view, drop_depth, drop_normal)
        image, alpha, depth = self._compose(stage, shape, camera, transmit, drop_depth, drop_normal)
        if lens[0] > 0:
            image, alpha = defocus(image, alpha, depth, camera.fx, *lens)
        return image, alpha, depth

    def _compose(self, stage, shape, camera, transmit, drop_depth, drop_normal):
        """Compose the image of opaque bodies, drops and the liquid."""
        hits, normals = np.empty(shape, np.float32), np.zeros((*shape, 3), np.float32)
        times = self.times
        limit = stage.buffers.depth
        if times > 1:
            parts = [limit[j::times, k::times] for j in range(times) for k in range(times)]
            limit = functools.reduce(np.maximum, parts)
        pixel = 1.0 / camera.fx
        liquid_radiance.find_surface(stage, limit, hits, normals, pixel)
        image, alpha, depth = np.empty((*shape, 3)), np.empty(shape), np.empty(shape, np.float32)
        hit_data = (drop_depth, drop_normal, hits, normals)
        keys = np.empty(shape, np.float32)
        flags = self.tone + (2 if self.chosen.background == "none" else 0)
        compositing.compose(stage, transmit, *hit_data, pixel, flags, image, alpha, depth, keys)
        drawn = image, alpha, keys
        if self.edges > 1:
            marked = np.zeros(shape, np.bool_)
            if compositing.rough_pixels(hits, normals, drop_depth, image, marked):
                compositing.refine(
                    stage, transmit, *hit_data, marked, self.edges, pixel, flags, drawn
                )
        return image.astype(np.float32), alpha.astype(np.float32), depth

    def _background(self, picture: np.ndarray, fine: Camera) -> np.ndarray:
        """Return the linear background, oversampled; (1, 1, 3) if the studio's own is used."""
        background = self.chosen.picture.background
        if background == "none":
            return np.zeros((fine.height, fine.width, 3), np.float32)
        if not self.chosen.picture.on_photograph:
            return np.zeros((1, 1, 3), np.float32)
        linear = tone_mapping.scene_linear(np.asarray(picture, dtype=np.float64), self.chosen.toned)
        enlarged = linear.astype(np.float32).repeat(self.times, axis=0).repeat(self.times, axis=1)
        return np.ascontiguousarray(enlarged)

    def _splats(
        self, moment: Moment, eye: np.ndarray
    ) -> tuple[ProjectableGaussians, np.ndarray, np.ndarray]:
        """Return opaque bodies as Gaussians of linear colors, with normals and kinds."""
        bodies, normals, kinds = [], [], list(moment.kinds)
        for part, shade, normal in zip(moment.parts, moment.shades, moment.normals):
            body = part.view_from(eye)
            normals.append(np.empty_like(normal))
            body_normals.face_eye(body.x, normal, np.asarray(eye, np.float64), normals[-1])
            color = body.color if shade is None else body.color / shade[:, None]
            bodies.append(replace(body, color=tone_mapping.to_linear(np.clip(color, 0, 1))))
        if moment.grain is not None:
            x, ids, gap, stretch, color, sandy, heap, floor = moment.grain
            look, count = self.chosen.look, self.chosen.look.grains_per_particle
            sand = grain_splats.grains(
                x, ids, gap, stretch, color, sandy, heap, eye, floor, count, look.dust
            )
            color = tone_mapping.to_linear(sand.color)
            bodies.append(ProjectableGaussians(sand.x, sand.cov, sand.opacity, color))
            normals.append(sand.normal)
            kinds.append(
                np.column_stack([sand.sandy, ~sand.sandy, np.zeros(len(sand.x))]).astype(float)
            )
        if not bodies:
            none = np.zeros((0, 3))
            return ProjectableGaussians(none, np.zeros((0, 6)), np.zeros(0), none), none, none
        return join_gaussians(bodies), np.concatenate(normals), np.concatenate(kinds)

    def _paint(self, splats, normal, kind, fine, view, options):
        """Return albedo, normals, kinds and transmittance; write the depth to the view."""
        shape = (fine.height, fine.width)
        if not len(splats.x):
            empty = np.zeros((*shape, 3), np.float32)
            return empty, empty, empty, np.ones(shape, np.float32)
        size = np.linalg.norm(normal, axis=1, keepdims=True)
        normal = 0.5 + 0.5 * normal / np.maximum(size, 1.0)
        albedo, normals, kinds, transmit, view.depth[:] = draw_surfaces(
            splats, fine, normal, kind, **options
        )
        return albedo, normals, kinds, transmit


def _velocities(velocity: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Return velocities (n, 3) [m/s] of rows, limited to finite values."""
    return np.clip(
        np.nan_to_num(np.asarray(velocity)[rows].astype(np.float64)), -SPEED_MAX, SPEED_MAX
    )


def _base_color(part: GaussianBatch) -> np.ndarray:
    """Return view-independent colors (n, 3)."""
    color = part.color.plain[part.rows]
    return color if part.bright is None else color * part.bright[:, None]


def _unshaded(part: GaussianBatch, shade: np.ndarray | None, ids: np.ndarray) -> np.ndarray:
    """Return display values (n, 3) without the shading in the colors."""
    color = _base_color(part)
    return np.clip(color if shade is None else color / shade[ids][:, None], 0, 1)
