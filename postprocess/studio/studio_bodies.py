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
                surface = self._rest_surface(gaussians, members, s, captured[k])
                self.normal[members], self.shift[members], cov0[members] = surface
        look.cov0 = cov0
        self.shifted = np.asarray(self.shift.any(axis=1))
        self.scenery_normal: np.ndarray | None = None
        self.scenery_kind: np.ndarray | None = None
        self.scenery_volume = self.scenery_area = np.zeros(0)
        self.skins: list[np.ndarray] = []
        self.filling: SceneryFilling | None = None
        if look.scenery is not None:
            self._scenery(look.scenery, gaussians.scenery, captured)
        self.surface = shape_surfaces.surface_of_bodies(look)
        self.is_covered = np.zeros(len(x0), bool)
        if self.surface is not None:
            self.is_covered[self.surface.covered] = True
        self.moving = [] if look.scenery is None else look.scenery.moving
        self.scenery_surface = shape_surfaces.surface_of_scenery(look)
        if look.passive is not None:
            self._riders(look.passive, gaussians.passive, captured)

    def _rest_surface(
        self, rows, members: np.ndarray, spacing: float, captured: bool
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return normals (n, 3) of one body at rest, and its Gaussians cut at edges.

        The cut is a displacement (n, 3) [m] and a covariance (n, 6) [m2] of each.

        Args:
            rows: Arrays of gaussians.h5, of its scenery or of its carried Gaussians.
            members: Rows of the body.
            spacing: Spacing of its Gaussians [m].
            captured: Whether it is a capture, whose Gaussians stay as they are.
        """
        shade, facing = getattr(rows, "shade", None), None
        if shade is not None and self.painted > 0:
            facing = facing_of_shade(np.asarray(shade)[members], self.painted)
        x0 = np.asarray(rows.x0, dtype=np.float64)[members]
        cov = np.asarray(rows.cov0, dtype=np.float64)[members]
        normal, flat, covered = body_normals.rest_normals(x0, cov, spacing, facing)
        shift = np.zeros_like(x0)
        if len(flat) and not captured:
            cut = surface_edges.cut_at_edges(x0[flat], normal[flat], cov[flat])
            shift[flat], cov[flat] = cut
            cov[covered] *= HIDDEN_SCALE
        return normal, shift, cov

    def _riders(self, passive: Passive, rows, captured: np.ndarray) -> None:
        """Determine normals and kinds of carried Gaussians."""
        object_ids = np.asarray(rows.object)
        self.rider_kind = _kind_shares(captured[object_ids])
        self.rider_normal = np.zeros((len(object_ids), 3))
        shift, cov0 = self.rider_normal.copy(), passive.cov0.copy()
        for k in np.unique(object_ids):
            members = np.flatnonzero(object_ids == k)
            s = float(np.cbrt(np.median(self.look.vol0[self.look.object == k])))
            surface = self._rest_surface(rows, members, s, captured[k])
            self.rider_normal[members], shift[members], cov0[members] = surface
        passive.offset = passive.offset + shift[:, None]
        passive.cov0 = cov0

    def _scenery(self, scenery: Scenery, rows, captured: np.ndarray) -> None:
        """Determine normals, volumes and kinds of the scenery."""
        x0, object_ids = np.asarray(rows.x0, dtype=np.float64), np.asarray(rows.object)
        sd = np.sqrt(
            np.maximum(np.asarray(rows.cov0, dtype=np.float64)[:, (0, 3, 5)].max(axis=1), 0)
        )
        normal, volume = np.zeros_like(x0), np.zeros(len(x0))
        shift, cov0 = np.zeros_like(x0), scenery.cov0.copy()
        is_flat = body_normals.thin_axes(np.asarray(rows.cov0))[1]
        for k in np.unique(object_ids):
            members = np.flatnonzero(object_ids == k)
            s = max(SCENERY_SPACING * float(np.median(sd[members])), 1e-9)
            surface = self._rest_surface(rows, members, s, captured[k])
            normal[members], shift[members], cov0[members] = surface
            volume[members] = s**3
        scenery.x0, scenery.cov0 = x0 + shift, cov0
        self.scenery_normal, self.scenery_volume = normal, volume
        self.scenery_area = np.where(is_flat & ~captured[object_ids], np.cbrt(volume) ** 2, 0.0)
        self.scenery_kind = _kind_shares(captured[object_ids])
        bodies = [np.flatnonzero(object_ids == k) for k in np.unique(object_ids)]
        self.skins = [rows for rows in bodies if np.median(self.scenery_area[rows]) > 0]

    def scenery_filling(self, cell: float, frame: dict) -> tuple[np.ndarray, SceneryFilling]:
        """Return what hides light inside of closed scenery: positions (n, 3) [m] and the rest.

        Args:
            cell: Cell size of the occlusion [m].
            frame: Arrays of the frame.
        """
        if self.filling is None:
            assert self.look.scenery is not None and self.scenery_normal is not None
            x, particles = self.look.scenery.x0, np.asarray(self.look.run.gaussians.x0)
            spacing = np.cbrt(self.scenery_volume)
            self.filling = fill_scenery(
                x, self.scenery_normal, self.skins, spacing, self.moving, cell, particles
            )
        return self.filling.positions(frame.get("poses", ())), self.filling

    def scenery_volumes(self, cell: float) -> np.ndarray:
        """Return the volumes (n,) [m3] with which scenery hides light.

        The skin of a mesh is empty inside; it counts as thick enough to hide all light.

        Args:
            cell: Cell size of the occlusion [m].
        """
        return np.maximum(self.scenery_volume, OPAQUE_LAYER * cell * self.scenery_area)

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
            scenery = self.look.scenery
            assert scenery is not None and self.scenery_normal is not None
            assert self.scenery_kind is not None
            rotated = self.scenery_normal.copy()
            for rows, pose in zip(scenery.moving, frame.get("poses", ())):
                rotated[rows] = rotated[rows] @ np.asarray(pose)[:3, :3].T
            shade = getattr(self.look.run.gaussians.scenery, "shade", None)
            static = parts[0]
            if self.scenery_surface is not None:
                covered = np.zeros(len(static.x), bool)
                covered[self.scenery_surface.covered] = True
                static = shape_surfaces.without(static, covered)
            out.insert(0, (static, rotated, self.scenery_kind, shade))
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
        out += self._surfaces_of_shapes(parts, particle_part, frame)
        return tuple(map(list, zip(*out)))

    def _surfaces_of_shapes(self, parts, particle_part: int, frame: dict) -> list[tuple]:
        """Return the flat Gaussians of shapes as `opaque` does."""
        out = []
        for surface, number in ((self.surface, particle_part), (self.scenery_surface, 0)):
            if surface is None:
                continue
            carriers = parts[number]
            if surface is self.surface:
                row_of = np.full(len(self.captured), -1)
                row_of[np.asarray(frame["id"])] = np.arange(len(carriers.x))
                rows, shade = row_of[surface.parent], self.look.shade
                F = np.asarray(frame["F"])[rows]
            else:
                rows = surface.parent
                shade = getattr(self.look.run.gaussians.scenery, "shade", None)
                F_all = np.tile(np.eye(3).ravel(), (len(carriers.x), 1))
                for members, pose in zip(self.moving, frame.get("poses", ())):
                    F_all[members] = np.asarray(pose)[:3, :3].ravel()
                F = F_all[rows]
            batch, normal, present = shape_surfaces.carry(surface, carriers, rows, F)
            kind = np.zeros((len(present), 3))
            out.append((batch, normal, kind, _shade_of_rows(shade, surface.parent[present])))
        return out

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
