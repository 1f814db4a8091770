"""Bodies of a run for the studio: materials, spacings and surface normals."""

from dataclasses import dataclass

import numpy as np

from vgmpi.gaussians.baked_shading import facing_of_shade

from ..frames import shape_surfaces
from ..frames.appearance import Appearance
from ..frames.export_model import is_capture
from ..frames.frame_gaussians import GaussianBatch, Passive, Scenery
from ..frames.scenery_filling import SceneryFilling, fill_scenery
from . import body_normals, lattice_deformation, surface_edges

GRANULAR = ("sand", "snow")
TEAR_LIMITS = 4.0, 6.5  # [spacings] lattice links of a liquid tear between these lengths
SIDES = ("west", "south", "bottom", "east", "north", "top")
HIDDEN_SCALE = 0.1  # [-] of the variances of round Gaussians that would show through flat ones
OPAQUE_LAYER = 2.0  # [cells] thickness of a surface without filling that lets no light through
SCENERY_SPACING = 1.6  # [standard deviations] assumed spacing of Gaussians of scenery


@dataclass(frozen=True)
class Domain:
    """Domain of a run. low, high: corners [m]. walls: (6,) bool, -x -y -z +x +y +z."""

    low: np.ndarray
    high: np.ndarray
    walls: np.ndarray

    @property
    def size(self) -> np.ndarray:
        """Edge lengths [m], (3,)."""
        return self.high - self.low

    @property
    def box(self) -> np.ndarray:
        """Both corners (6,) [m]."""
        return np.concatenate([self.low, self.high])


def domain_of(run, walled: bool) -> Domain:
    """Return the domain of a run.

    It is the extent of the particles, without walls, if the scene does not hold the domain.
    """
    try:
        domain = run.scene["domain"]
        size = np.array(domain["size"], dtype=np.float64)
        kinds = domain["boundary"]
        walls = [(kinds.get(side) or kinds["default"])["kind"] != "open" for side in SIDES]
        if size.shape == (3,) and (size > 0).all() and np.isfinite(size).all():
            return Domain(np.zeros(3), size, np.array(walls) & walled)
    except (KeyError, TypeError, ValueError, AttributeError):
        pass
    x = np.asarray(run.gaussians.x0)
    low, high = x.min(axis=0), x.max(axis=0)
    return Domain(low, np.maximum(high, low + 1e-6), np.zeros(6, bool))


def tearing(
    look: Appearance, tear: tuple[float, float]
) -> tuple[np.ndarray, lattice_deformation.Links]:
    """Return tearing distances (n,) [m] and rest neighbors of fluids, sand and snow."""
    gaussians = look.run.gaussians
    x0, count = np.asarray(gaussians.x0, dtype=np.float64), len(gaussians.object)
    spacing = np.cbrt(look.vol0)
    tearing_distance = np.full(count, 1.0)
    axes, row = np.full((count, 6), -1, np.int32), np.full(count, -1, np.int32)
    nearest, offsets = [np.zeros((0, lattice_deformation.NEIGHBORS), np.int32)], []
    offsets.append(np.zeros((0, lattice_deformation.NEIGHBORS, 3), np.float32))
    linked_count = 0
    for k, entry in enumerate(look.objects):
        members = np.flatnonzero(look.object == k)
        family = entry.get("family")
        if not len(members) or (family != "fluid" and family not in GRANULAR):
            continue
        s = float(np.median(spacing[members]))
        limits = TEAR_LIMITS if family == "fluid" else tear
        reference = x0[members]
        if entry.get("role") == "source" and gaussians.v0 is not None:
            reference = upstream_positions(reference, np.asarray(gaussians.v0)[members], s)
        tearing_distance[members] = lattice_deformation.tearing_distance(reference, s, *limits, k)
        links = lattice_deformation.link(reference, s)
        axes[members] = np.where(links.axes >= 0, members[links.axes], -1)
        row[members] = np.where(links.row >= 0, links.row + linked_count, -1)
        nearest.append(members[links.nearest].astype(np.int32))
        offsets.append(links.offsets)
        linked_count += len(links.nearest)
    return tearing_distance, lattice_deformation.Links(
        axes, np.concatenate(nearest), np.concatenate(offsets), row
    )


def upstream_positions(mouth: np.ndarray, velocity: np.ndarray, spacing: float) -> np.ndarray:
    """Return positions (n, 3) [m] of an inlet's particles in a stream that nothing has deformed.

    It is the stream behind the mouth when the first particle passes. Particles pass one by one, at
    equal intervals, and those that pass at the same place are a spacing apart.

    Args:
        mouth: Positions in the mouth in the order of passing, shape (n, 3) [m].
        velocity: Velocities there, shape (n, 3) [m/s].
        spacing: Spacing of the particles [m].
    """
    repeats = np.flatnonzero((mouth == mouth[0]).all(axis=1))
    per_layer = repeats[1] if len(repeats) > 1 else len(mouth)
    direction = velocity[0] / max(float(np.linalg.norm(velocity[0])), 1e-300)
    return mouth - np.outer(spacing / per_layer * np.arange(len(mouth)), direction)


class SceneryBodies:
    """Rest normals, kinds and volumes of the scenery.

    Attributes:
        normal: Normals at rest, shape (n, 3).
        kind: Shares of sand, snow and captures, shape (n, 3).
        volume: Volumes, shape (n,) [m3].
        area: Areas of flat Gaussians that are no capture, else 0, shape (n,) [m2].
        skins: Rows of each body that is a flat skin.
        filling: What hides light inside of closed scenery; None before a frame asks for it.
        surface: Flat Gaussians of shapes, or None.
    """

    def __init__(self, look: Appearance, scenery: Scenery, captured: np.ndarray, painted: float):
        """Determine them, and cut the scenery at its edges (in/out).

        Args:
            look: Appearance of the run.
            scenery: Gaussians of the scenery (in/out).
            captured: Whether each object is a capture.
            painted: Strength of the light painted on the colors.
        """
        self.look, self.scenery = look, scenery
        rows = look.run.gaussians.scenery
        x0, object_ids = np.asarray(rows.x0, dtype=np.float64), np.asarray(rows.object)
        sd = np.sqrt(
            np.maximum(np.asarray(rows.cov0, dtype=np.float64)[:, (0, 3, 5)].max(axis=1), 0)
        )
        self.normal, self.volume = np.zeros_like(x0), np.zeros(len(x0))
        shift, cov0 = np.zeros_like(x0), scenery.cov0.copy()
        is_flat = body_normals.thin_axes(np.asarray(rows.cov0))[1]
        for k in np.unique(object_ids):
            members = np.flatnonzero(object_ids == k)
            s = max(SCENERY_SPACING * float(np.median(sd[members])), 1e-9)
            surface = _rest_surface(rows, members, s, captured[k], painted)
            self.normal[members], shift[members], cov0[members] = surface
            self.volume[members] = s**3
        scenery.x0, scenery.cov0 = x0 + shift, cov0
        is_skin = is_flat & ~captured[object_ids]
        self.area = np.where(is_skin, np.cbrt(self.volume) ** 2, 0.0)
        self.kind = _kind_shares(captured[object_ids])
        bodies = [np.flatnonzero(object_ids == k) for k in np.unique(object_ids)]
        self.skins = [rows for rows in bodies if np.median(self.area[rows]) > 0]
        self.filling: SceneryFilling | None = None
        self.surface = shape_surfaces.surface_of_scenery(look)

    def fill(self, cell: float, frame: dict) -> tuple[np.ndarray, SceneryFilling]:
        """Return what hides light inside of closed scenery: positions (n, 3) [m] and the rest.

        Args:
            cell: Cell size of the occlusion [m].
            frame: Arrays of the frame.
        """
        if self.filling is None:
            x, particles = self.scenery.x0, np.asarray(self.look.run.gaussians.x0)
            self.filling = fill_scenery(
                x, self.normal, self.skins, np.cbrt(self.volume), self.scenery.moving, cell,
                particles,
            )  # fmt: skip
        return self.filling.positions(frame.get("poses", ())), self.filling

    def hiding_volumes(self, cell: float) -> np.ndarray:
        """Return the volumes (n,) [m3] with which scenery hides light.

        The skin of a mesh is empty inside; it counts as thick enough to hide all light.

        Args:
            cell: Cell size of the occlusion [m].
        """
        return np.maximum(self.volume, OPAQUE_LAYER * cell * self.area)

    def opaque(self, part: GaussianBatch, frame: dict) -> tuple:
        """Return the part with its normals, kinds and the shading in its colors.

        Args:
            part: Gaussians of the scenery in the frame.
            frame: Arrays of the frame.
        """
        rotated = self.normal.copy()
        for rows, pose in zip(self.scenery.moving, frame.get("poses", ())):
            rotated[rows] = rotated[rows] @ np.asarray(pose)[:3, :3].T
        if self.surface is not None:
            covered = np.zeros(len(part.x), bool)
            covered[self.surface.covered] = True
            part = shape_surfaces.without(part, covered)
        return part, rotated, self.kind, self._shade()

    def surface_of_shapes(self, carriers: GaussianBatch, frame: dict) -> list[tuple]:
        """Return the flat Gaussians of shapes as `opaque` does, if there are any.

        Args:
            carriers: Gaussians of the scenery in the frame.
            frame: Arrays of the frame.
        """
        if self.surface is None:
            return []
        F = np.tile(np.eye(3).ravel(), (len(carriers.x), 1))
        for members, pose in zip(self.scenery.moving, frame.get("poses", ())):
            F[members] = np.asarray(pose)[:3, :3].ravel()
        rows = self.surface.parent
        return [_carried_surface(self.surface, carriers, rows, F[rows], self._shade())]

    def _shade(self) -> np.ndarray | None:
        """Return the shading in the colors, if there is any."""
        return getattr(self.look.run.gaussians.scenery, "shade", None)


class Bodies:
    """Material of each particle, and rest normals of opaque bodies."""

    def __init__(self, look: Appearance):
        self.look = look
        gaussians, objects = look.run.gaussians, look.objects
        family = [entry.get("family") for entry in objects]
        from_inlet = [entry.get("role") == "source" for entry in objects]
        captured = is_capture(look.run, objects)
        object_ids = look.object
        self.fluid = np.array([f == "fluid" for f in family] or [False])[object_ids]
        self.from_inlet = np.array(from_inlet or [False])[object_ids]
        self.granular = np.array([f in GRANULAR for f in family] or [False])[object_ids]
        self.sandy = np.array([f == "sand" for f in family] or [False])[object_ids]
        self.captured = captured[object_ids]
        scale = [entry.get("opacity_scale") for entry in objects] or [None]
        factor = np.array([1.0 if s is None else float(s) for s in scale])
        requested = look.opacity_scales
        self.opaqueness = np.where(np.isfinite(requested), requested, factor)[object_ids]
        self.spacing = np.cbrt(look.vol0)
        self.painted = _baked_shading(look.run)
        x0 = np.asarray(gaussians.x0, dtype=np.float64)
        self.normal, self.shift = np.zeros_like(x0), np.zeros_like(x0)
        cov0 = look.cov0.copy()
        for k in range(len(objects)):
            members = np.flatnonzero(object_ids == k)
            if len(members) and not self.fluid[members[0]] and not self.granular[members[0]]:
                s = float(np.cbrt(np.median(look.vol0[members])))
                surface = _rest_surface(gaussians, members, s, captured[k], self.painted)
                self.normal[members], self.shift[members], cov0[members] = surface
        look.cov0 = cov0
        self.shifted = np.asarray(self.shift.any(axis=1))
        self.scenery: SceneryBodies | None = None
        if look.scenery is not None:
            self.scenery = SceneryBodies(look, look.scenery, captured, self.painted)
        self.surface = shape_surfaces.surface_of_bodies(look)
        self.is_covered = np.zeros(len(x0), bool)
        if self.surface is not None:
            self.is_covered[self.surface.covered] = True
        if look.passive is not None:
            self._riders(look.passive, gaussians.passive, captured)

    def _riders(self, passive: Passive, rows, captured: np.ndarray) -> None:
        """Determine normals and kinds of carried Gaussians."""
        object_ids = np.asarray(rows.object)
        self.rider_kind = _kind_shares(captured[object_ids])
        self.rider_normal = np.zeros((len(object_ids), 3))
        shift, cov0 = self.rider_normal.copy(), passive.cov0.copy()
        for k in np.unique(object_ids):
            members = np.flatnonzero(object_ids == k)
            s = float(np.cbrt(np.median(self.look.vol0[self.look.object == k])))
            surface = _rest_surface(rows, members, s, captured[k], self.painted)
            self.rider_normal[members], shift[members], cov0[members] = surface
        passive.offset = passive.offset + shift[:, None]
        passive.cov0 = cov0

    def opaque(
        self, parts: list[GaussianBatch], particle_part: int, frame: dict, solid: np.ndarray
    ) -> tuple:
        """Return opaque parts with their normals, kinds, and the shading in their colors.

        Args:
            parts: Gaussians of the frame, of Appearance.parts.
            particle_part: Index of the part with the particles.
            frame: Arrays of the frame.
            solid: Rows of the particles that are neither fluid nor sand nor snow.
        """
        ids = np.asarray(frame["id"])[solid]
        normal = self._current_normals(ids, frame, solid)
        particles = self._cut_at_edges(parts[particle_part].subset_rows(solid), ids, frame, solid)
        if self.surface is not None:
            particles = shape_surfaces.without(particles, self.is_covered[ids])
        out = [
            (
                particles,
                normal,
                _kind_shares(self.captured[ids]),
                _shade_of_rows(self.look.shade, ids),
            )
        ]
        if particle_part:
            assert self.scenery is not None
            out.insert(0, self.scenery.opaque(parts[0], frame))
        if len(parts) > particle_part + 1:
            rider_rows = parts[particle_part + 1].rider_rows
            assert rider_rows is not None
            riders, F = self.rider_normal[rider_rows], parts[particle_part + 1].deformation
            rotated = riders
            if F is not None:
                rotated = np.empty_like(riders)
                body_normals.turn_normals(
                    riders, np.ascontiguousarray(F, dtype=np.float64), rotated
                )
            shade = getattr(self.look.run.gaussians.passive, "shade", None)
            out.append(
                (
                    parts[particle_part + 1],
                    rotated,
                    self.rider_kind[rider_rows],
                    _shade_of_rows(shade, rider_rows),
                )
            )
        out += self._surface_of_shapes(parts[particle_part], frame)
        if self.scenery is not None:
            out += self.scenery.surface_of_shapes(parts[0], frame)
        return tuple(map(list, zip(*out)))

    def _surface_of_shapes(self, carriers: GaussianBatch, frame: dict) -> list[tuple]:
        """Return the flat Gaussians of shapes as `opaque` does, if there are any."""
        if self.surface is None:
            return []
        row_of = np.full(len(self.captured), -1)
        row_of[np.asarray(frame["id"])] = np.arange(len(carriers.x))
        rows = row_of[self.surface.parent]
        F = np.asarray(frame["F"])[rows]
        return [_carried_surface(self.surface, carriers, rows, F, self.look.shade)]

    def _cut_at_edges(
        self, part: GaussianBatch, ids: np.ndarray, frame: dict, rows: np.ndarray
    ) -> GaussianBatch:
        """Return particles, those of them moved that were cut at edges."""
        cut = np.flatnonzero(self.shifted[ids])
        if not len(cut):
            return part
        x, shift = part.x.copy(), self.shift[ids[cut]]
        if "F" in frame:
            F = np.asarray(frame["F"], dtype=np.float64)[rows[cut]].reshape(-1, 3, 3)
            shift = np.einsum("nij,nj->ni", F, shift)
        x[cut] += shift
        return part._replace(x=x)

    def _current_normals(self, ids, frame, rows) -> np.ndarray:
        """Return the normals of solids in a frame."""
        object_ids = self.look.object[ids]
        deforms = [
            bool(e.get("tracks_deformation", e.get("family") == "solid")) for e in self.look.objects
        ]
        deformed = np.array(deforms or [False])[object_ids]
        out = self.normal[ids]
        if deformed.any() and "F" in frame:
            F = np.ascontiguousarray(np.asarray(frame["F"])[rows[deformed]], dtype=np.float64)
            rotated = np.empty((len(F), 3))
            body_normals.turn_normals(out[deformed], F, rotated)
            out[deformed] = rotated
        x = np.asarray(frame["positions"], dtype=np.float64)[rows]
        for k in np.flatnonzero(np.bincount(object_ids[~deformed])):
            members = np.flatnonzero(~deformed & (object_ids == k))
            s = float(np.cbrt(np.median(self.look.vol0[ids[members]])))
            out[members] = body_normals.density_normals(x[members], s)
        return out


def _rest_surface(
    rows, members: np.ndarray, spacing: float, captured: bool, painted: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return normals (n, 3) of one body at rest, and its Gaussians cut at edges.

    The cut is a displacement (n, 3) [m] and a covariance (n, 6) [m2] of each.

    Args:
        rows: Arrays of gaussians.h5, of its scenery or of its carried Gaussians.
        members: Rows of the body.
        spacing: Spacing of its Gaussians [m].
        captured: Whether it is a capture, whose Gaussians stay as they are.
        painted: Strength of the light painted on the colors.
    """
    shade, facing = getattr(rows, "shade", None), None
    if shade is not None and painted > 0:
        facing = facing_of_shade(np.asarray(shade)[members], painted)
    x0 = np.asarray(rows.x0, dtype=np.float64)[members]
    cov = np.asarray(rows.cov0, dtype=np.float64)[members]
    normal, flat, covered = body_normals.rest_normals(x0, cov, spacing, facing)
    shift = np.zeros_like(x0)
    if len(flat) and not captured:
        cut = surface_edges.cut_at_edges(x0[flat], normal[flat], cov[flat])
        shift[flat], cov[flat] = cut
        cov[covered] *= HIDDEN_SCALE
    return normal, shift, cov


def _carried_surface(
    surface, carriers: GaussianBatch, rows: np.ndarray, F: np.ndarray, shade: np.ndarray | None
) -> tuple:
    """Return flat Gaussians of shapes with their normals, kinds and the shading in their colors.

    Args:
        surface: The flat Gaussians.
        carriers: Gaussians that carry them in the frame.
        rows: Row of the carrier of each.
        F: Deformation gradients of these rows, shape (n, 9).
        shade: Shading of all carriers, or None.
    """
    batch, normal, present = shape_surfaces.carry(surface, carriers, rows, F)
    kind = np.zeros((len(present), 3))
    return batch, normal, kind, _shade_of_rows(shade, surface.parent[present])


def _baked_shading(run) -> float:
    """Return the strength of the light painted on the colors, 0 if the scene does not say."""
    try:
        return float(run.scene["appearance"]["baked_shading"])
    except (KeyError, TypeError, ValueError, AttributeError):
        return 0.0


def _shade_of_rows(shade: np.ndarray | None, rows: np.ndarray) -> np.ndarray | None:
    """Return the shading of some rows, if there is any."""
    return None if shade is None else np.asarray(shade)[rows]


def _kind_shares(captured: np.ndarray) -> np.ndarray:
    """Return the shares (n, 3) of sand, snow and captures."""
    out = np.zeros((len(captured), 3))
    out[:, 2] = captured
    return out
