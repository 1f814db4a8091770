"""Bodies of a run for the studio: what they are made of, how dense they stand, where they face."""

from dataclasses import dataclass

import numpy as np

from postprocess.look import Look
from postprocess.parts import Part
from vgmpi.studio import lattice, normals

GRANULAR = ("sand", "snow")
TEAR = 4.0, 6.5  # spacings between which a liquid's lattice is torn
SIDES = ("west", "south", "floor", "east", "north", "roof")
THICK = 1.6  # standard deviations of a Gaussian of scenery, as a spacing


@dataclass(frozen=True)
class Domain:
    """low, high: corners [m]. walls: (6,) whether it ends there: -x -y -z +x +y +z."""

    low: np.ndarray
    high: np.ndarray
    walls: np.ndarray

    @property
    def size(self) -> np.ndarray:
        """[m], (3,)."""
        return self.high - self.low

    @property
    def box(self) -> np.ndarray:
        """Both corners (6,) [m]."""
        return np.concatenate([self.low, self.high])


def domain_of(run, walled: bool) -> Domain:
    """The domain of a run; of its particles, without walls, where the scene does not tell."""
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


def tearing(look: Look, tear: tuple[float, float]) -> tuple[np.ndarray, lattice.Links]:
    """Tearing distances (n,) [m] and rest neighbors of all particles of fluids, sand and snow."""
    rest = look.run.gaussians
    x0, count = np.asarray(rest.x0, dtype=np.float64), len(rest.object)
    spacing = np.cbrt(look.vol0)
    torn = np.full(count, 1.0)
    axes, row = np.full((count, 6), -1, np.int32), np.full(count, -1, np.int32)
    nearest, offsets = [np.zeros((0, lattice.NEIGHBORS), np.int32)], []
    offsets.append(np.zeros((0, lattice.NEIGHBORS, 3), np.float32))
    found = 0
    for k, entry in enumerate(look.objects):
        at = np.flatnonzero(look.object == k)
        family = entry.get("family")
        if not len(at) or (family != "fluid" and family not in GRANULAR):
            continue
        s = float(np.median(spacing[at]))
        limits = TEAR if family == "fluid" else tear
        torn[at] = lattice.tearing_distance(x0[at], s, *limits, k)
        own = lattice.link(x0[at], s)
        axes[at] = np.where(own.axes >= 0, at[own.axes], -1)
        row[at] = np.where(own.row >= 0, own.row + found, -1)
        nearest.append(at[own.nearest].astype(np.int32))
        offsets.append(own.offsets)
        found += len(own.nearest)
    return torn, lattice.Links(axes, np.concatenate(nearest), np.concatenate(offsets), row)


class Bodies:
    """What each particle is of, and the normals of what is opaque at rest."""

    def __init__(self, look: Look):
        self.look = look
        rest, objects = look.run.gaussians, look.objects
        family = [entry.get("family") for entry in objects]
        captured = _captures(look.run, objects)
        of = look.object
        self.fluid = np.array([f == "fluid" for f in family] or [False])[of]
        self.granular = np.array([f in GRANULAR for f in family] or [False])[of]
        self.sandy = np.array([f == "sand" for f in family] or [False])[of]
        self.captured = captured[of]
        scale = [entry.get("opacity_scale") for entry in objects] or [None]
        scale = np.array([1.0 if s is None else float(s) for s in scale])
        asked = look.opacity_scales
        self.opaqueness = np.where(np.isfinite(asked), asked, scale)[of]
        self.spacing = np.cbrt(look.vol0)
        x0 = np.asarray(rest.x0, dtype=np.float64)
        self.normal = np.zeros_like(x0)
        for k in range(len(objects)):
            at = np.flatnonzero(of == k)
            if len(at) and not self.fluid[at[0]] and not self.granular[at[0]]:
                s = float(np.cbrt(np.median(look.vol0[at])))
                self.normal[at] = normals.density_normals(x0[at], s)
        self.scenery_normal = self.scenery_kind = self.scenery_volume = None
        if look.scenery is not None:
            self._scenery(rest.scenery, captured)
        if look.passive is not None:
            of = np.asarray(rest.passive.object)
            self.rider_kind = _kinds(captured[of])
            w = np.asarray(rest.passive.weights, dtype=np.float64)
            carried = self.normal[np.asarray(rest.passive.carriers)]
            self.rider_normal = np.einsum("pk,pki->pi", w, carried)

    def _scenery(self, rows, captured) -> None:
        x0, of = np.asarray(rows.x0, dtype=np.float64), np.asarray(rows.object)
        sd = np.sqrt(
            np.maximum(np.asarray(rows.cov0, dtype=np.float64)[:, (0, 3, 5)].max(axis=1), 0)
        )
        self.scenery_normal, self.scenery_volume = np.zeros_like(x0), np.zeros(len(x0))
        for k in np.unique(of):
            at = np.flatnonzero(of == k)
            s = max(THICK * float(np.median(sd[at])), 1e-9)
            self.scenery_normal[at] = normals.density_normals(x0[at], s)
            self.scenery_volume[at] = s**3
        self.scenery_kind = _kinds(captured[of])

    def opaque(self, parts: list[Part], at: int, frame: dict, solid: np.ndarray) -> tuple:
        """Parts that are opaque, with their normals, kinds, and the light painted on them.

        Args:
            parts: of Look.parts.
            at: which of them the particles are.
            frame: arrays of the frame.
            solid: rows of the particles that are neither fluid nor sand nor snow.
        """
        ids = np.asarray(frame["id"])[solid]
        normal = self._turned(ids, frame, solid)
        out = [
            (
                parts[at].only_rows(solid),
                normal,
                _kinds(self.captured[ids]),
                _taken(self.look.shade, ids),
            )
        ]
        if at:
            turned = self.scenery_normal.copy()
            scenery = self.look.scenery
            for rows, pose in zip(scenery.moving, frame.get("poses", ())):
                turned[rows] = turned[rows] @ np.asarray(pose)[:3, :3].T
            shade = getattr(self.look.run.gaussians.scenery, "shade", None)
            out.insert(0, (parts[0], turned, self.scenery_kind, shade))
        if len(parts) > at + 1:
            there = parts[at + 1].there
            riders, F = self.rider_normal[there], parts[at + 1].deformation
            turned = riders
            if F is not None:
                turned = np.empty_like(riders)
                normals.turned(riders, np.ascontiguousarray(F, dtype=np.float64), turned)
            shade = getattr(self.look.run.gaussians.passive, "shade", None)
            out.append((parts[at + 1], turned, self.rider_kind[there], _taken(shade, there)))
        return tuple(map(list, zip(*out)))

    def _turned(self, ids, frame, rows) -> np.ndarray:
        """Normals of solids in a frame."""
        rest = self.normal[ids]
        deforms = np.array(
            [bool(e.get("deforms", e.get("family") == "solid")) for e in self.look.objects]
        )
        follows = (
            np.flatnonzero(deforms[self.look.object[ids]]) if len(deforms) else np.zeros(0, int)
        )
        out = rest.copy()
        if len(follows) and "F" in frame:
            F = np.ascontiguousarray(np.asarray(frame["F"])[rows[follows]], dtype=np.float64)
            turned = np.empty((len(follows), 3))
            normals.turned(rest[follows], F, turned)
            out[follows] = turned
        loose = np.setdiff1d(np.arange(len(ids)), follows)
        x = np.asarray(frame["x"], dtype=np.float64)[rows]
        for k in np.unique(self.look.object[ids[loose]]) if len(loose) else ():
            at = loose[self.look.object[ids[loose]] == k]
            s = float(np.cbrt(np.median(self.look.vol0[ids[at]])))
            out[at] = normals.density_normals(x[at], s)
        return out


def _taken(shade: np.ndarray | None, rows: np.ndarray) -> np.ndarray | None:
    return None if shade is None else np.asarray(shade)[rows]


def _kinds(captured: np.ndarray) -> np.ndarray:
    """Shares (n, 3) of sand, snow and captures."""
    out = np.zeros((len(captured), 3))
    out[:, 2] = captured
    return out


def _captures(run, objects: list[dict]) -> np.ndarray:
    """Of each object, whether its Gaussians come from a file and hold the light of a photograph."""
    try:
        asked = {o.get("name"): o.get("gaussians") for o in run.scene.get("object", ())}
    except (AttributeError, TypeError):
        asked = {}
    return np.array([bool(asked.get(entry.get("name"))) for entry in objects] or [False])
