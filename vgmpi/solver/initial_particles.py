"""Initial particles of a run: prepared once on rank 0 and cached in gaussians.h5."""

import hashlib
import json
import logging
import os
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from vgmpi import gaussians, preprocess
from vgmpi.io import checkpoint, file_layout, hdf5_writer, initial_state
from vgmpi.io.run_reader import RunError, opened, read_gaussians
from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.planning.plan import ObjectMeasures, Plan, make_plan
from vgmpi.planning.region_groups import region_plans
from vgmpi.planning.step_costs import Proximity
from vgmpi.preprocess.initial_conditions import closed_box_tensions, liquid_weights
from vgmpi.preprocess.meshes import triangle_mesh
from vgmpi.preprocess.motion_checks import motion_steps
from vgmpi.preprocess.setting_checks import holding_walls
from vgmpi.scene.scene import Scene
from vgmpi.scene.scene_feature import InitialParticles, feature_folders, prepare_features
from vgmpi.solver.estimates.measure_proximity import surroundings

log = logging.getLogger("vgmpi")


@dataclass
class ParticleSummary:
    """Summary of the particles that every rank holds before it has any particle."""

    objects: list[dict]
    volume: list[float]
    center: list[list[float]]  # [m] center of mass
    colliders: list
    thickness: tuple[float, ...] = ()  # [m] see ObjectMeasures
    surroundings: tuple[Proximity, ...] = ()
    weights: tuple[float, ...] = ()  # [Pa] see ObjectMeasures
    tensions: tuple[float, ...] = ()  # [Pa] see ObjectMeasures
    features: dict[str, Any] = field(default_factory=dict)  # prepared data of features, by name
    holding_walls: tuple[str, ...] = ()  # see WallPlan
    # on rank 0: datasets to be written to gaussians.h5, None if the file holds them
    rows: dict | None = None
    scenery: dict | None = None
    passive: dict | None = None

    @property
    def count(self) -> list[int]:
        """Return the number of particles of each object and particle source."""
        return [entry["row_count"] for entry in self.objects]


def prepare(
    scene: Scene, ranks: SerialCommunicator, folder: Path | None, resumed: bool = False
) -> ParticleSummary:
    """Prepare the particles on rank 0 and write nothing. Collective.

    Particles that gaussians.h5 in `folder` holds for the same objects are reused; those of a
    resumed run are reused in any case.

    Args:
        scene: The scene.
        ranks: Communicator.
        folder: Folder that may hold gaussians.h5, or None.
        resumed: Whether a run goes on from a checkpoint.

    Returns:
        The summary, on every rank; rank 0 also holds the rows that are not on disk yet.

    Raises:
        SceneError: On all ranks, if the scene is at fault.
    """
    failure, summary = None, None
    local_fields: dict[str, dict | None] = {}
    if ranks.rank == 0:
        try:
            summary, local_fields = _build_or_read(scene, folder, resumed)
        except Exception as error:  # all ranks must raise it, or the others wait forever
            failure = error
    failure = ranks.bcast(failure)
    if failure is not None:
        raise failure
    summary = ranks.bcast(summary)
    for name, rows in local_fields.items():
        setattr(summary, name, rows)
    return summary


def write_initial_particles(
    scene: Scene, summary: ParticleSummary, ranks: SerialCommunicator, folder: Path
) -> None:
    """Write gaussians.h5 unless it already holds these particles. Collective.

    Args:
        scene: The scene.
        summary: Summary of the particles; its rows are dropped once they are written (in/out).
        ranks: Communicator.
        folder: Output folder.

    Raises:
        StoreError: On all ranks, if the file cannot be written.
    """
    if not ranks.bcast(summary.rows is not None):
        return
    initial_state.write(
        folder / file_layout.GAUSSIANS, ranks, summary.rows, summary.objects, summary.scenery,
        scene.to_json(), preparation_hash(scene), summary.passive,
    )  # fmt: skip
    summary.rows = summary.scenery = summary.passive = None


def _build_or_read(
    scene: Scene, folder: Path | None, resumed: bool
) -> tuple[ParticleSummary, dict]:
    """Prepare or read the particles on rank 0.

    Returns:
        The summary for all ranks, and the fields of `ParticleSummary` that stay on rank 0
        because they are not on disk.
    """
    path = folder / file_layout.GAUSSIANS if folder is not None else None
    moving = not any(obj.collider for obj in scene.object)
    checksum = "" if path is None else initial_state.preparation_hash(path)
    exists = bool(checksum)
    if path is not None and not exists:
        _report_unreadable(path, resumed)
    if path is not None and exists and moving and (resumed or checksum == preparation_hash(scene)):
        try:
            gaussians = read_gaussians(path)
            log.info("particles as prepared before: %s", path)
            particles, objects = (gaussians.x0, gaussians.vol0, gaussians.object), gaussians.objects
            prepared, _ = prepare_features(
                scene, InitialParticles(*particles, objects, gaussians.sh), []
            )
            summary = _summary_of(scene, objects, gaussians, gaussians.x0, [])
            return replace(summary, features=prepared), {}
        except RunError as error:
            if resumed:
                raise
            log.warning("%s; the particles are made anew", error)
    from vgmpi.preprocess.scene_builder import (
        build_scene,  # it imports scipy: only this rank waits for that
    )

    built = build_scene(scene)
    rows = {
        "x0": built.x,
        "vol0": built.vol0,
        "object": built.object,
        "cov0": built.cov0,
        "opacity": built.opacity,
        "sh": built.sh,
    }
    if built.v0.any():
        rows["v0"] = built.v0
    if built.theta0.any():
        rows["theta0"] = built.theta0
    if built.surface0 is not None:
        rows["surface0"] = built.surface0
    if built.shade is not None:
        rows["shade"] = built.shade
    scenery = _massless(built.scenery)
    passive = _massless(built.passive, "carriers", "weights")
    if exists and resumed:  # the colliders are new, the particles are not
        summary = known_of(scene, built)
        if scene.particle_sources and path is not None:  # as many particles as were reserved
            summary = replace(summary, objects=read_gaussians(path).objects)
        return summary, {}
    return known_of(scene, built), {"rows": rows, "scenery": scenery, "passive": passive}


def _massless(gaussians, *extra_names: str) -> dict[str, np.ndarray] | None:
    """Return the datasets of massless Gaussians by their names in the file, or None without any.

    Args:
        gaussians: Scenery or passive Gaussians.
        extra_names: Names of datasets that only one of the two kinds has.
    """
    if gaussians is None:
        return None
    names = ("object", "cov0", "opacity", "sh", "shade", *extra_names)
    datasets = {"x0": gaussians.x} | {name: getattr(gaussians, name) for name in names}
    return {name: rows for name, rows in datasets.items() if rows is not None}


def _report_unreadable(path: Path, resumed: bool) -> None:
    """Warn of a file that exists and cannot be read; it is an error if a resumed run needs it."""
    if not os.path.lexists(path):
        return
    try:
        with opened(path):
            pass
    except RunError as error:
        if resumed:
            raise
        log.warning("%s; the particles are made anew", error)


def known_of(scene: Scene, built) -> ParticleSummary:
    """Return the summary of the particles that `build_scene` made."""
    summary = _summary_of(scene, built.objects, built, built.x, built.colliders)
    return replace(summary, features=built.features)


def _summary_of(scene, objects, particles, x, colliders) -> ParticleSummary:
    """Summarize the particles for all ranks.

    Args:
        scene: The scene.
        objects: Entries of the objects and particle sources.
        particles: Particles with object (n,) and vol0 (n,) [m3].
        x: Positions, shape (n, 3) [m].
        colliders: Colliders of the scene.
    """
    object_of, volume, x = (np.asarray(rows) for rows in (particles.object, particles.vol0, x))
    total = np.bincount(object_of, volume, minlength=len(objects))
    moment = [np.bincount(object_of, volume * x[:, a], minlength=len(objects)) for a in range(3)]
    center = (np.array(moment) / np.maximum(total, 1e-300)).T
    thickness = _thicknesses(objects, x, total)
    proximity = surroundings(scene, objects, x, colliders)
    return ParticleSummary(
        objects,
        total.tolist(),
        center.tolist(),
        colliders,
        thickness,
        proximity,
        liquid_weights(scene, objects, x),
        closed_box_tensions(scene, objects, x, volume),
        holding_walls=holding_walls(scene, objects, x),
    )


def _thicknesses(objects: list[dict], x: np.ndarray, volume: np.ndarray) -> tuple[float, ...]:
    """Return the thickness of every solid body [m], NaN for others; () without a fluid."""
    if not any(entry.get("family") == "fluid" for entry in objects):
        return ()
    return tuple(
        _thickness(x[entry["first_row"] : entry["first_row"] + entry["row_count"]], volume[k])
        if entry.get("family") == "solid" and entry["role"] == "body"
        else np.nan
        for k, entry in enumerate(objects)
    )


def _thickness(x: np.ndarray, volume: float) -> float:
    """Return the least extent [m] of a body along the axes and along its principal axes of inertia.

    Half the particle spacing is added on either side.

    Args:
        x: Particle positions, shape (n, 3) [m].
        volume: Volume of the body [m3].
    """
    x = x - x.mean(axis=0)
    across = np.concatenate([np.eye(3), np.linalg.eigh(x.T @ x)[1].T])
    extent = np.ptp(x @ across.T, axis=0)
    return float(extent.min() + np.cbrt(volume / len(x)))


def plan_for(scene: Scene, summary: ParticleSummary) -> Plan:
    """Return the plan of the scene with these particles. Raises SceneError."""
    colliders = bool(summary.colliders)
    surface = [bool(entry.get("surface")) for entry in summary.objects]
    plan = make_plan(
        scene, summary.count, summary.volume, colliders, summary.center, surface,
        summary.features,
    )  # fmt: skip
    courses = [course for feature in plan.features for course in feature.courses()]
    steps = motion_steps(scene, summary.colliders, courses)
    return replace(
        plan,
        measures=ObjectMeasures(
            summary.thickness, summary.surroundings, tuple(summary.volume), summary.weights,
            summary.tensions,
        ),
        time_step=plan.time_step._replace(motion_steps=tuple(steps.tolist())),
        walls=plan.walls._replace(holding=summary.holding_walls),
        regions=region_plans(plan, summary.objects),
    )  # fmt: skip


def preparation_hash(scene: Scene) -> str:
    """Return the hash of everything that the particles depend on.

    It covers the resolved text of the scene, the files that the scene reads and the source code
    of the preparation and of the readers of captures.
    """
    hasher = hashlib.sha256(json.dumps(scene.to_json(), sort_keys=True).encode())
    for name in sorted(scene.files):
        for path in (
            Path(scene.files[name]),
            *triangle_mesh.texture_files(Path(scene.files[name])),
        ):
            with open(path, "rb") as file:  # it may be of any size
                while chunk := file.read(1 << 20):
                    hasher.update(chunk)
    for folder in (*preprocess.__path__, *gaussians.__path__, *feature_folders()):
        for path in sorted(Path(folder).rglob("*.py")):
            hasher.update(path.read_bytes())
    return hasher.hexdigest()


def rows_of_this_rank(
    plan: Plan, summary: ParticleSummary, ranks: SerialCommunicator, folder: Path | None
):
    """Return ids and rows of the particles that this rank contributes.

    Every rank reads an equal slice of the file; without a file rank 0 contributes all particles.

    Args:
        plan: Plan of the run.
        summary: Summary of the particles.
        ranks: Communicator.
        folder: Output folder, or None if nothing is written.
    """
    if folder is None:
        rows = summary.rows
        if rows is None:
            empty = np.zeros(0)
            rows = {"x0": np.zeros((0, 3)), "vol0": empty, "object": empty.astype(np.int32)}
            rows["surface0"] = np.zeros((0, 10))
        return np.arange(len(rows["x0"])), rows
    total = plan.particles
    first, last = total * ranks.rank // ranks.size, total * (ranks.rank + 1) // ranks.size
    path = folder / file_layout.GAUSSIANS
    rows = on_all(ranks, path, lambda: initial_state.read_slice(path, first, last))
    return np.arange(first, last), rows


def on_all(ranks: SerialCommunicator, path: Path, action):
    """Run `action` on every rank, and raise the failure of one on all of them. Collective.

    Args:
        ranks: Communicator.
        path: File that the error message names.
        action: Function without arguments.

    Returns:
        The result of `action` on this rank.

    Raises:
        StoreError: On all ranks, if a file could not be read on one of them.
    """
    result, error = None, None
    try:
        result = action()
    except (OSError, checkpoint.CheckpointError, RunError) as caught:
        error = caught
    hdf5_writer.raise_on_all_ranks(ranks, error, path, "read")
    return result
