"""The particles of a run: made once on rank 0, kept in gaussians.h5, known to all ranks."""

import hashlib
import json
import logging
import os
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from .. import prepare as preparation
from ..domain.ranks import Alone
from ..output import checkpoint, layout, rest, store
from ..output.read import RunError, opened, read_gaussians
from ..planning.colour_sets import shades
from ..planning.driven import Extents
from ..planning.plan import Plan, make_plan
from ..planning.surroundings import Surroundings
from ..prepare import texture
from ..prepare.courses import extent
from ..prepare.loaded import find
from ..scene.scene import Scene
from .surroundings import surroundings

log = logging.getLogger("vgmpi")


@dataclass
class Known:
    """What all ranks know of the particles before they hold any."""

    objects: list[dict]
    volume: list[float]
    center: list[list[float]]  # of mass [m]
    colliders: list
    loads: list
    shades: np.ndarray | None = None  # of colours that travel (colour_sets.shades)
    thickness: tuple[float, ...] = ()  # as plan.Plan has it
    surroundings: tuple[Surroundings, ...] = ()
    extents: Extents = field(default_factory=dict)  # of what is driven
    # on rank 0, of particles that are in no gaussians.h5 yet: what belongs into it, see rest.write
    rows: dict | None = None
    scenery: dict | None = None
    passive: dict | None = None

    @property
    def count(self) -> list[int]:
        return [thing["count"] for thing in self.objects]


def prepare(scene: Scene, ranks: Alone, folder: Path | None, resumed: bool = False) -> Known:
    """Make the particles on rank 0, and write nothing. Collective.

    Particles that gaussians.h5 in `folder` has from the same objects are used again; those of a run
    that is `resumed` in any case. Raises SceneError on all ranks.
    """
    said, known = None, None
    made: dict[str, dict | None] = {}
    if ranks.rank == 0:
        try:
            known, made = _particles(scene, folder, resumed)
        except Exception as error:  # every rank must hear of it, or they wait for ever
            said = error
    said = ranks.bcast(said)
    if said is not None:
        raise said
    known = ranks.bcast(known)
    for name, rows in made.items():
        setattr(known, name, rows)
    return known


def keep(scene: Scene, known: Known, ranks: Alone, folder: Path) -> None:
    """Write gaussians.h5 where it does not hold these particles yet. Collective; StoreError on all
    ranks."""
    if not ranks.bcast(known.rows is not None):
        return
    rest.write(
        folder / layout.GAUSSIANS, ranks, known.rows, known.objects, known.scenery,
        scene.resolved(), digest(scene), known.passive,
    )  # fmt: skip
    known.rows = known.scenery = known.passive = None


def _particles(scene: Scene, folder: Path | None, resumed: bool) -> tuple[Known, dict]:
    """On rank 0: what all shall know, and the rest of Known where it is not on the disk."""
    path = folder / layout.GAUSSIANS if folder is not None else None
    moving = not any(thing.collider for thing in scene.object)
    seal = "" if path is None else rest.digest(path)
    there = bool(seal)
    if path is not None and not there:
        _complain(path, resumed)
    if path is not None and there and moving and (resumed or seal == digest(scene)):
        try:
            found = read_gaussians(path)
            log.info("particles as prepared before: %s", path)
            loads = find(scene, found.x0, found.vol0, found.object)
            return _known(scene, found.objects, found, found.x0, [], loads), {}
        except RunError as error:
            if resumed:
                raise
            log.warning("%s; the particles are made anew", error)
    from ..prepare.build import build  # scipy comes with it: only the rank that prepares waits

    made = build(scene)
    rows = {
        "x0": made.x,
        "vol0": made.vol0,
        "object": made.object,
        "cov0": made.cov0,
        "opacity": made.opacity,
        "sh": made.sh,
    }
    if made.v0.any():
        rows["v0"] = made.v0
    if made.theta0.any():
        rows["theta0"] = made.theta0
    if made.surface0 is not None:
        rows["surface0"] = made.surface0
    if made.shade is not None:
        rows["shade"] = made.shade
    scenery = _massless(made.scenery)
    passive = _massless(made.passive, "carriers", "weights")
    if there and resumed:  # its colliders were made anew, its particles are as they were
        known = known_of(scene, made)
        if scene.inflow and path is not None:  # of what comes there are as many as were kept ready
            known = replace(known, objects=read_gaussians(path).objects)
        return known, {}
    return known_of(scene, made), {"rows": rows, "scenery": scenery, "passive": passive}


def _massless(part, *more: str) -> dict[str, np.ndarray] | None:
    """Datasets of Gaussians without mass (scenery, passive ones), by their names in the file; None
    where there are none. more: names of those that not all of them have."""
    if part is None:
        return None
    names = ("object", "cov0", "opacity", "sh", "shade", *more)
    found = {"x0": part.x} | {name: getattr(part, name) for name in names}
    return {name: rows for name, rows in found.items() if rows is not None}


def _complain(path: Path, resumed: bool) -> None:
    """Of a file that is there and cannot be read; one that a resumed run needs is an error."""
    if not os.path.lexists(path):
        return
    try:
        with opened(path):
            pass
    except RunError as error:
        if resumed:
            raise
        log.warning("%s; the particles are made anew", error)


def known_of(scene: Scene, made) -> Known:
    """What all ranks shall know of what prepare.build made."""
    return _known(scene, made.objects, made, made.x, made.colliders, made.loads)


def _known(scene, objects, rest, x, colliders, loads) -> Known:
    """rest: object (n,) of each particle, vol0 (n,) [m3] and sh (n, K, 3). x: (n, 3) [m]."""
    thing, volume, x = (np.asarray(rows) for rows in (rest.object, rest.vol0, x))
    total = np.bincount(thing, volume, minlength=len(objects))
    moment = [np.bincount(thing, volume * x[:, a], minlength=len(objects)) for a in range(3)]
    center = (np.array(moment) / np.maximum(total, 1e-300)).T
    travel = scene.appearance.colour_transfer == "step"
    hues = shades(len(objects), rest.object, rest.sh) if travel else None
    thick = _thicknesses(objects, x, total)
    extents = {
        k: extent(x[objects[k]["first"] :][: objects[k]["count"]])
        for k, body in enumerate(scene.object)
        if body.driven
    }
    near = surroundings(scene, objects, x, colliders)
    return Known(
        objects, total.tolist(), center.tolist(), colliders, loads, hues, thick, near, extents
    )


def _thicknesses(objects: list[dict], x: np.ndarray, volume: np.ndarray) -> tuple[float, ...]:
    """Of every solid body, nan for other objects [m]; none where no fluid can touch them."""
    if not any(told.get("family") == "fluid" for told in objects):
        return ()
    return tuple(
        _thickness(x[told["first"] : told["first"] + told["count"]], volume[k])
        if told.get("family") == "solid" and told["role"] == "body"
        else np.nan
        for k, told in enumerate(objects)
    )


def _thickness(x: np.ndarray, volume: float) -> float:
    """Least extent [m] of a body of `volume` [m3] with particles at x (n, 3), along the axes and
    those of its inertia, with half their spacing on either side."""
    x = x - x.mean(axis=0)
    across = np.concatenate([np.eye(3), np.linalg.eigh(x.T @ x)[1].T])
    extent = np.ptp(x @ across.T, axis=0)
    return float(extent.min() + np.cbrt(volume / len(x)))


def plan_for(scene: Scene, known: Known) -> Plan:
    """What the scene needs with these particles. Raises SceneError."""
    colliders = bool(known.colliders)
    surface = [bool(thing.get("surface")) for thing in known.objects]
    plan = make_plan(
        scene, known.count, known.volume, colliders, known.center, known.shades, surface,
        known.extents,
    )  # fmt: skip
    return replace(plan, thickness=known.thickness, surroundings=known.surroundings)


def digest(scene: Scene) -> str:
    """What the particles depend on: the scene's text as resolved, the files it reads, this
    program's version.
    """
    seal = hashlib.sha256(json.dumps(scene.resolved(), sort_keys=True).encode())
    for name in sorted(scene.files):
        for path in (Path(scene.files[name]), *texture.files(Path(scene.files[name]))):
            with open(path, "rb") as file:  # of any size
                while part := file.read(1 << 20):
                    seal.update(part)
    (folder,) = preparation.__path__
    for path in sorted(Path(folder).rglob("*.py")):
        seal.update(path.read_bytes())
    return seal.hexdigest()


def share(plan: Plan, known: Known, ranks: Alone, folder: Path | None):
    """Ids and rows of the particles this rank brings: of a file an equal share, without a file all
    on rank 0.
    """
    if folder is None:
        rows = known.rows
        if rows is None:
            none = np.zeros(0)
            rows = {"x0": np.zeros((0, 3)), "vol0": none, "object": none.astype(np.int32)}
        return np.arange(len(rows["x0"])), rows
    total = plan.particles
    first, last = total * ranks.rank // ranks.size, total * (ranks.rank + 1) // ranks.size
    path = folder / layout.GAUSSIANS
    rows = on_all(ranks, path, lambda: rest.read_slice(path, first, last))
    return np.arange(first, last), rows


def on_all(ranks: Alone, path: Path, action):
    """action() on every rank; what fails on one is the same StoreError on all. Collective."""
    found, error = None, None
    try:
        found = action()
    except (OSError, checkpoint.CheckpointError, RunError) as caught:
        error = caught
    store.agree(ranks, error, path, "read")
    return found
