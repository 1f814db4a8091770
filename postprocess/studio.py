"""Frames of a run in a studio's light: what `[look] preset = "studio"` draws.

What does not depend on the camera is worked out once for a frame: stretches of the lattices, the
liquid's density field, the pyramid of what hides light, and the ground's light. A camera then
paints what is opaque (albedo, normal, kind, depth), lights it, and sends rays through the liquid.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from postprocess.lights import ground_of, rig_of
from postprocess.look import Look
from postprocess.parts import Part
from postprocess.settings import Settings
from postprocess.shapes import Bodies, domain_of, tearing
from vgmpi.splatting.camera import Camera
from vgmpi.splatting.liquid import Layers
from vgmpi.splatting.splat import Splats, finer
from vgmpi.studio import compose, deferred, drops, field, grains, ground, lattice, liquid
from vgmpi.studio import occlusion as hiding
from vgmpi.studio import tone as display
from vgmpi.studio.defocus import defocus
from vgmpi.studio.grid import Grid
from vgmpi.studio.stage import Medium, Stage, no_view, view_of

CLEAR = 0.8  # m that one sees through a liquid, where 1.2 m are in view
IN_VIEW = 1.2  # m
SCATTER = 1.5  # 1/m: own light of a liquid whose Gaussians have the usual opacity
USUAL_OPACITY = 0.05  # scale of the Gaussians of a clear liquid
BEHIND_WALL = 0.12  # of the clear way, that is seen of a liquid behind a wall at least
HISTORY = 12  # frames that foam remembers
PREVIEW = 2  # frames from which one is taken for the foam of a preview
COARSER = 0.75  # cells of grids in a preview, of a picture's
COATED = 2  # times as fine as the picture is what is painted, where edges are refined
STRETCH = 0.4, 3.0  # least and largest of a liquid's kernels
FASTEST = 1e4  # m/s
THICKEST = 1e6  # 1/m that a liquid absorbs or scatters
GRAIN_STRETCH = 0.8, 3.2


@dataclass
class Moment:
    """A frame, worked out for all cameras: parts to paint, and what light meets.

    parts: opaque Gaussians, with `normals` and `kinds` (n, 3) of each. grain: the arguments of
    grains.grains but for the eye, or None. stage: what rays meet, without a view. drops: spheroids.
    """

    parts: list[Part]
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
    """Draws frames of one run.

    Args:
        look: what the run's Gaussians look like.
        chosen: render.toml.
        box: gives lower and upper corner of what is to be seen [m].
        folder: of render.toml, for the files it names.
        quick: whether it is for a preview: edges are not refined, and grids are coarser.
    """

    def __init__(
        self, look: Look, chosen: Settings, box: Callable, folder: Path, quick: bool = False
    ):
        self.look, self.chosen, self.box = look, chosen, box
        self.domain = domain_of(look.run, chosen.liquid.walls)
        self.bodies = Bodies(look)
        self.quick, self.edges = quick, 1 if quick else chosen.picture.edges
        self.times = COATED if self.edges > 1 else 1
        self.tone = int(chosen.toned)
        self.rig = rig_of(chosen, folder)
        self.torn, self.links = tearing(look, chosen.look.tear)
        self.made: dict[int, tuple] = {}  # foam by frame
        self.first: ground.Ground | None = None  # at the first frame

    # ---- a frame ---------------------------------------------------------------------------

    def moment(self, frame: dict[str, np.ndarray], index: int) -> Moment:
        """All that does not depend on the camera."""
        made, asked = self._moment(frame, index), self.chosen.picture.floor
        if asked is not None and asked.kind == "photograph":
            if self.first is None:
                number = min(self.look.run.frames)
                self.first = self._moment(self.look.frame(number), number).plane
            made.plane = ground.since(made.plane, self.first)
        return made

    def _moment(self, frame: dict[str, np.ndarray], index: int) -> Moment:
        look, bodies = self.look, self.bodies
        parts = look.parts(frame)
        ids = np.asarray(frame["id"])
        x = np.asarray(frame["x"], dtype=np.float64)
        at = int(look.scenery is not None)
        solid = np.flatnonzero(~(bodies.fluid[ids] | bodies.granular[ids]))
        opaque, normals, kinds, shades = bodies.opaque(parts, at, frame, solid)
        near = self._near(x)
        granular = np.flatnonzero(bodies.granular[ids] & near)
        grain = self._grain(x, ids, granular, parts[at]) if len(granular) else None
        pyramid = self._pyramid(opaque, x, ids, granular, parts[at], solid, at)
        rows = np.flatnonzero(bodies.fluid[ids] & near)
        medium, spray = self._medium(frame, index, ids, x, rows, parts[at])
        plane = ground_of(self.chosen, self.domain, pyramid, self.rig)
        stage = Stage(medium, pyramid, self.rig, plane, no_view())
        if len(rows) and plane.kind != ground.NONE:
            deferred.tint_ground(stage)
        plane = ground.closed(plane)
        return Moment(
            opaque, normals, kinds, shades, grain, medium, pyramid, plane, spray, len(rows) > 0
        )

    def _stretches(self, x, ids, rows, limits) -> np.ndarray:
        """(n, 6) of the lattice around the particles `rows` of a frame."""
        row_of = np.full(len(self.torn), -1, np.int64)
        row_of[ids[rows]] = np.arange(len(rows))
        return lattice.stretches(
            x[rows], ids[rows].astype(np.int64), row_of, self.links, self.bodies.spacing,
            self.torn, *limits,
        )  # fmt: skip

    def _grain(self, x, ids, rows, part) -> tuple:
        bodies, color = self.bodies, _unshaded(part.only_rows(rows), self.look.shade, ids[rows])
        stretch = self._stretches(x, ids, rows, GRAIN_STRETCH)
        spacing = bodies.spacing[ids[rows]]
        floor = self.domain.low[2] if self.domain.walls[2] else -np.inf
        seen = grains.heap(x[rows], spacing, float(floor))
        return (
            x[rows],
            ids[rows],
            spacing,
            stretch,
            color,
            bodies.sandy[ids[rows]],
            seen,
            float(floor),
        )

    def _pyramid(self, opaque, x, ids, granular, part, solid, at):
        """What hides light: bodies, scenery, sand and snow."""
        xs, volumes, colors = [], [], []
        for k, one in enumerate(opaque):
            if k > at:  # riders: their bodies are there already
                continue
            xs.append(one.x)
            volumes.append(
                self.look.vol0[ids[solid]] if k == at else self.bodies.scenery_volume[: len(one.x)]
            )
            colors.append(display.to_linear(np.clip(_plain(one), 0, 1)))
        if len(granular):
            xs.append(x[granular])
            volumes.append(self.look.vol0[ids[granular]])
            colors.append(display.to_linear(np.clip(_plain(part.only_rows(granular)), 0, 1)))
        points = np.concatenate(xs) if xs else np.zeros((0, 3))
        volume = np.concatenate(volumes) if xs else np.zeros(0)
        color = np.concatenate(colors) if xs else np.zeros((0, 3))
        cells = self.chosen.light.cells if self.chosen.light else 150
        if self.quick:
            cells = max(int(COARSER * cells), 1)
        return hiding.occlusion(points, volume, color, self.domain.low, self.domain.high, cells)

    def _medium(self, frame, index, ids, x, rows, part) -> tuple[Medium, tuple]:
        """The liquid and its drops."""
        chosen, bodies = self.chosen.liquid, self.bodies
        if not len(rows):
            tint = Grid(np.zeros((2, 2, 2, 8), np.float32), np.zeros(3), 1.0)
            none = Medium(field.empty_field(), tint, 1.333, 0.0, True, 0.0, np.zeros(8))
            return none, drops.spray(x[:0], x[:0], ids[:0], none.field, 1.0)
        velocity = np.zeros((len(rows), 3))
        if "velocity" in frame:
            velocity = _speeds(frame["velocity"], rows)
        spacing = bodies.spacing[ids[rows]]
        s = float(np.median(spacing))
        color = display.to_linear(np.clip(_plain(part.only_rows(rows)), 0, 1))
        clear = chosen.clear
        if clear is None:
            low, high = self.box()
            clear = CLEAR * max(float(np.linalg.norm(high - low)), 1e-9) / IN_VIEW
        absorbs = -np.log(np.clip(color, 0.03, 0.97)) / clear
        scatter = self._scattering(ids[rows])
        color = color * self._unlit()[bodies.captured[ids[rows]].astype(int)]
        white = np.zeros(len(rows))
        if self.chosen.look.foam > 0 and "velocity" in frame:
            white = self._foam(index)[ids[rows]]
        values = np.minimum(np.column_stack([absorbs, color, white, scatter]), THICKEST)
        walls, box = self.domain.walls, self.domain.box
        inside = field.interior(x[rows], spacing, values, box, walls)
        stretch = self._stretches(x, ids, rows, STRETCH)
        fine = chosen.fine * (COARSER if self.quick else 1.0)
        found = field.liquid_field(x[rows], spacing, stretch, inside, box, walls, fine)
        uniform = bool((np.ptp(values[:, :3], axis=0) < 1e-3 * values[:, :3].max()).all())
        foam = self.chosen.look.foam if white.any() else 0.0
        mean = np.ascontiguousarray(values.mean(axis=0))
        medium = Medium(
            found,
            inside.means,
            float(chosen.index),
            BEHIND_WALL * clear,
            uniform,
            float(foam),
            mean,
        )
        return medium, drops.spray(x[rows], velocity, ids[rows], found, s)

    def _unlit(self) -> np.ndarray:
        """Factors (2, 3) on the linear colors of liquids, and of those of captures, whose colors
        hold a light: divided by a liquid's usual light as far as they take none of the studio's."""
        takes = self.chosen.captures
        usual = liquid.DIRECT * self.rig.key + liquid.AMBIENT * self.rig.horizon
        return np.stack([np.ones(3), takes + (1.0 - takes) / np.maximum(usual, 0.1)])

    def _scattering(self, ids) -> np.ndarray:
        """Own light of the liquid's particles [1/m]: the more opaque their Gaussians, the more."""
        if self.chosen.liquid.scatter is not None:
            return np.full(len(ids), float(self.chosen.liquid.scatter))
        return SCATTER * (np.maximum(self.bodies.opaqueness[ids], 0.02) / USUAL_OPACITY) ** 2

    def _foam(self, index: int) -> np.ndarray:
        """Foam of every particle at a frame, from the frames before it: as many for every picture,
        so that it is the same whoever draws which."""
        run, value = self.look.run, np.zeros(len(self.bodies.fluid))
        step = PREVIEW if self.quick else 1
        for k in range(max(index - HISTORY, index % step), index + 1, step):
            if k not in run.frames:
                continue
            if k not in self.made:
                self.made = {
                    n: made for n, made in self.made.items() if index - HISTORY <= n <= index
                }
                self.made[k] = self._foam_of(k)
            before = run.times[k - step] if k >= step else np.nan
            dt = float(run.times[k] - before) if np.isfinite(before) else 0.0
            drops.foam_later(value, *self.made[k], max(dt, 0.0))
        return value

    def _foam_of(self, k: int) -> tuple[np.ndarray, np.ndarray]:
        """Numbers of the liquid's particles at a frame, and how much foam they make."""
        frame = self.look.run.frame(k)
        ids = np.asarray(frame["id"])
        x = np.asarray(frame["x"], dtype=np.float64)
        rows = np.flatnonzero(self.bodies.fluid[ids] & self._near(x))
        if "velocity" not in frame or not len(rows):
            return ids[:0], np.zeros(0)
        spacing = float(np.median(self.bodies.spacing[ids[rows]]))
        return ids[rows], drops.foam_made(x[rows], _speeds(frame["velocity"], rows), spacing)

    def _near(self, x: np.ndarray) -> np.ndarray:
        """Whether points (n, 3) are where grids reach: not farther off than two domains."""
        away = 2.0 * float(self.domain.size.max())
        return ((x > self.domain.low - away) & (x < self.domain.high + away)).all(axis=1)

    # ---- a picture -------------------------------------------------------------------------

    def render(
        self, moment: Moment, camera: Camera, picture: np.ndarray, options: dict, lens: tuple
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Display values (height, width, 3), what comes through (height, width) and depth [m].

        Args:
            moment: the frame.
            camera: as large as the picture.
            picture: background in display values, (height, width, 3), or one color (3,).
            options: alpha_min, lowpass and antialias of the splats.
            lens: radius of the lens and depth of what is sharp [m]; 0 and 0 for a pinhole.
        """
        fine = finer(camera, self.times)
        shape, view = (camera.height, camera.width), view_of(fine)
        taken = self._background(picture, fine)
        view = view._replace(picture=taken.shape[0] > 1)
        splats, normal, kind = self._splats(moment, camera.eye)
        painted = self._paint(splats, normal, kind, fine, view, options)
        albedo, normals, kinds, left = painted
        stage = Stage(moment.medium, moment.pyramid, self.rig, moment.plane, view)
        deferred.shade_background(stage, taken, self.times)
        deferred.shade_opaque(
            stage, albedo, normals, kinds, left, self.times, moment.liquid, self.chosen.captures
        )
        far = np.full(view.depth.shape, np.inf, np.float32)
        turned = np.zeros((*far.shape, 3), np.float32)
        drops.paint_drops(*moment.drops, view, far, turned)
        image, alpha, depth = self._composed(stage, shape, camera, left, far, turned)
        if lens[0] > 0:
            image, alpha = defocus(image, alpha, depth, camera.fx, *lens)
        return image, alpha, depth

    def _composed(self, stage, shape, camera, left, drop_depth, drop_normal):
        """The picture of what is painted and of the liquid."""
        hits, normals = np.empty(shape, np.float32), np.zeros((*shape, 3), np.float32)
        times = self.times
        near = stage.buffers.depth
        if times > 1:
            near = near.reshape(shape[0], times, shape[1], times).max(axis=(1, 3))
        pixel = 1.0 / camera.fx
        liquid.find_surface(stage, np.ascontiguousarray(near), hits, normals, pixel)
        image, alpha, depth = np.empty((*shape, 3)), np.empty(shape), np.empty(shape, np.float32)
        given = (drop_depth, drop_normal, hits, normals)
        keys = np.empty(shape, np.float32)
        flags = self.tone + (2 if self.chosen.background == "none" else 0)
        compose.compose(stage, left, *given, pixel, flags, image, alpha, depth, keys)
        if self.edges > 1:
            marked = np.zeros(shape, np.bool_)
            if compose.rough_pixels(stage, hits, normals, drop_depth, image, marked):
                drawn = image, alpha, keys
                compose.refine(stage, left, *given, marked, self.edges, pixel, flags, drawn)
        return image.astype(np.float32), alpha.astype(np.float32), depth

    def _background(self, picture: np.ndarray, fine: Camera) -> np.ndarray:
        """Linear, as fine as it is painted; (1, 1, 3) where the studio has its own."""
        given = self.chosen.picture.background
        if given == "none":
            return np.zeros((fine.height, fine.width, 3), np.float32)
        if not self.chosen.picture.on_photograph:
            return np.zeros((1, 1, 3), np.float32)
        linear = display.scene_linear(np.asarray(picture, dtype=np.float64), self.chosen.toned)
        wide = linear.astype(np.float32).repeat(self.times, axis=0).repeat(self.times, axis=1)
        return np.ascontiguousarray(wide)

    def _splats(self, moment: Moment, eye: np.ndarray) -> tuple[Splats, np.ndarray, np.ndarray]:
        """What is opaque as Gaussians of linear colors, with normals and kinds."""
        arrays, normals, kinds = [], list(moment.normals), list(moment.kinds)
        for part, shade in zip(moment.parts, moment.shades):
            x, cov, opacity, color = part.seen_from(eye)
            if shade is not None:
                color = color / shade[:, None]
            color = np.clip(color, 0, 1)
            arrays.append((x, cov, opacity, display.to_linear(color)))
        if moment.grain is not None:
            look, (*first, floor) = self.chosen.look, moment.grain
            own = grains.grains(*first, eye, floor, look.children, look.dust)
            arrays.append((own.x, own.cov, own.opacity, display.to_linear(own.color)))
            normals.append(own.normal)
            kinds.append(
                np.column_stack([own.sandy, ~own.sandy, np.zeros(len(own.x))]).astype(float)
            )
        if not arrays:
            none = np.zeros((0, 3))
            return Splats(none, np.zeros((0, 6)), np.zeros(0), none), none, none
        joined = Splats(*(np.concatenate(one) for one in zip(*arrays)))
        return joined, np.concatenate(normals), np.concatenate(kinds)

    def _paint(self, splats, normal, kind, fine, view, options):
        """Albedo, normals, kinds and what comes through; the depth goes into the view."""
        shape = (fine.height, fine.width)
        if not len(splats.x):
            empty = np.zeros((*shape, 3), np.float32)
            return empty, empty, empty, np.ones(shape, np.float32)
        size = np.linalg.norm(normal, axis=1, keepdims=True)
        normal = 0.5 + 0.5 * normal / np.maximum(size, 1.0)
        black = np.broadcast_to(np.float32(0), (*shape, 3))
        layers = Layers(
            splats, fine, options["lowpass"], options["antialias"], options["alpha_min"]
        )
        albedo, left = layers.picture(black)
        view.depth[:] = layers.depth()
        normals = layers.with_colors(normal).picture(black)[0]
        one = kind[0]
        if (kind == one).all():
            return albedo, normals, (1 - left)[..., None] * one.astype(np.float32), left
        return albedo, normals, layers.with_colors(kind).picture(black)[0], left


def _speeds(velocity: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Velocities (n, 3) [m/s] of rows, as numbers whose squares are some."""
    return np.clip(np.nan_to_num(np.asarray(velocity)[rows].astype(np.float64)), -FASTEST, FASTEST)


def _plain(part: Part) -> np.ndarray:
    """Colors as seen from everywhere (n, 3)."""
    color = part.color.plain[part.rows]
    return color if part.bright is None else color * part.bright[:, None]


def _unshaded(part: Part, shade: np.ndarray | None, ids: np.ndarray) -> np.ndarray:
    """Display values (n, 3) without the light that was painted on them."""
    color = _plain(part)
    return np.clip(color if shade is None else color / shade[ids][:, None], 0, 1)
