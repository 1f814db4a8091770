"""Export of a run as one moving file: vgmpi export OUT --format web -o page.html.

Format usd makes an OpenUSD file: vgmpi export OUT --format usd -o scene.usdc.

Gaussians are grouped by object and ordered along a Morton curve, so that neighbors in space are
neighbors in the file. Scenery comes first, then the particles, then carried Gaussians.
"""

import argparse
import dataclasses
import functools
import logging
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

from vgmpi.gaussians import shape_evolution, spherical_harmonics
from vgmpi.gaussians.cloud import pack_symmetric, quaternion, unpack_symmetric
from vgmpi.gaussians.formats import motion_stream
from vgmpi.gaussians.formats.motion_stream import (
    GroupState,
    MotionGroup,
    MotionWriter,
    RestGaussians,
)
from vgmpi.gaussians.formats.residual_coding import morton_order
from vgmpi.io.run_reader import RunError, RunReader

from ..frames import image_io, render_config
from ..frames.appearance import Appearance
from ..frames.camera_paths import CameraPath
from ..frames.collider_meshes import collider_meshes
from ..frames.frame_gaussians import (
    DEFORMED,
    FIXED,
    RADIUS_SPHERE,
    VOLUME_SPHERE,
    GaussianBatch,
    moving,
    select_rows,
)
from ..frames.frame_renderer import visible_extent
from ..raster.shadow_lighting import Light
from ..web import web_page
from . import usd_stage

log = logging.getLogger("vgmpi")
WEB, USD = "web", "usd"
KINDS = (WEB, USD)
SUFFIXES = {WEB: (".html", ".htm"), USD: usd_stage.SUFFIXES}
ACCURACY = 0.02  # [cells] default of --accuracy
FPS = 25.0  # default of --fps
ACCURACIES = (1e-5, 1.0)  # [cells] allowed


class _FrameRows(NamedTuple):
    """Rows of a part in one frame: their Gaussians, centers, F or J, and colors."""

    ids: np.ndarray  # [Gaussian] of each row
    x: np.ndarray
    F: np.ndarray | None
    J: np.ndarray | None
    batch: GaussianBatch


class _PartGroup(NamedTuple):
    """Gaussians of one group by their indices in a part of the run."""

    part: str  # "scenery", "particles" or "carried"
    ids: np.ndarray


class RunMotion:
    """Groups of a run's Gaussians and their states. Raises RunError.

    Attributes:
        groups: Groups in the order of the file.
        rest_gaussians: Gaussians at rest in that order.
    """

    def __init__(self, look: Appearance, middle: int, scenery: bool = True):
        """Group and order the Gaussians.

        Args:
            look: Appearance of the run.
            middle: Frame whose positions determine the order.
            scenery: Whether scenery belongs to the file.
        """
        self.look = look
        self.has_scenery = scenery and look.scenery is not None
        frame = look.frame(middle)
        self.has_colors = "sh" in frame
        self.groups: list[MotionGroup] = []
        self.members: list[_PartGroup] = []
        if self.has_scenery:
            self._add_scenery()
        self._add_particles(frame)
        if look.passive is not None:
            self._add_carried()
        self.rest_gaussians = self._rest()

    def _add_group(self, group: MotionGroup, part: str, ids: np.ndarray, x: np.ndarray) -> None:
        """Append a group with its Gaussians `ids` in the order of their centers `x`.

        Gaussians of several render models become several groups.
        """
        look: Any = self.look
        source = {"particles": look, "scenery": look.scenery, "carried": look.passive}[part]
        own = select_rows(source.compensated_lowpass, ids)
        own = np.zeros(len(ids)) if own is None else own
        for variance in np.unique(own):
            rows = own == variance
            order = morton_order(x[rows], look.spacing)
            count, lowpass = len(order), float(variance)
            self.groups.append(dataclasses.replace(group, count=count, compensated_lowpass=lowpass))
            self.members.append(_PartGroup(part, ids[rows][order]))

    def _add_scenery(self) -> None:
        """Append the scenery: one group of what rests, and one for each object that moves."""
        scenery = self.look.scenery
        assert scenery is not None
        is_still = np.ones(len(scenery.x0), bool)
        for members in scenery.moving:
            is_still[members] = False
        ids = np.flatnonzero(is_still)
        self._add_group(
            MotionGroup("scenery", 0, motion_stream.STATIC), "scenery", ids, scenery.x0[ids]
        )
        for pose, (number, members) in enumerate(zip(moving(self.look.objects), scenery.moving)):
            name = str(self.look.objects[number].get("name", number))
            group = MotionGroup(name, 0, motion_stream.POSED, pose=pose)
            self._add_group(group, "scenery", members, scenery.x0[members])

    def _add_particles(self, frame: dict[str, np.ndarray]) -> None:
        """Append a group of particles for each object."""
        look = self.look
        x = np.array(look.run.gaussians.x0, dtype=np.float64)
        x[frame["id"]] = frame["positions"]
        for number in np.unique(look.object):
            ids = np.flatnonzero(look.object == number)
            name = str(look.objects[number].get("name", number)) if look.objects else "particles"
            shape = _shape(int(look.rule[ids[0]]), bool(look.turns[ids[0]]))
            changes = look.colors.mode == "step" or bool((look.colors.set[ids] >= 0).any())
            group = MotionGroup(name, 0, motion_stream.FREE, shape, self.has_colors and changes)
            self._add_group(group, "particles", ids, x[ids])

    def _add_carried(self) -> None:
        """Append a group of carried Gaussians for each object."""
        passive = self.look.passive
        assert passive is not None
        riders = self.look.run.gaussians.passive
        objects, x0 = np.asarray(riders.object), np.asarray(riders.x0)
        for number in np.unique(objects):
            ids = np.flatnonzero(objects == number)
            name = str(self.look.objects[number].get("name", number)) + " (carried)"
            shape = _shape(int(passive.rule[ids[0]]), bool(passive.turns[ids[0]]))
            group = MotionGroup(name, 0, motion_stream.FREE, shape, self.has_colors)
            self._add_group(group, "carried", ids, x0[ids])

    def _rest(self) -> RestGaussians:
        """Return the Gaussians at rest, in the order of the groups."""
        look, run = self.look, self.look.run
        fields: list[tuple[np.ndarray, ...]] = []
        for part, ids in self.members:
            source: Any = look
            x0, sh = run.gaussians.x0, look.color.sh
            if part == "scenery":
                source = look.scenery
                x0, sh = source.x0, source.color.sh
            elif part == "carried":
                source = look.passive
                x0, sh = run.gaussians.passive.x0, source.color.sh
            cov = source.cov0[ids]
            if part != "scenery":
                cov = self._unit_covariances(source.rule[ids[0]], part, ids, cov)
            fields.append((np.asarray(x0)[ids], _root(cov), source.opacity[ids], sh[ids]))
        terms = max([sh.shape[1] for *_, sh in fields] or [1])
        padded = [np.pad(sh, ((0, 0), (0, terms - sh.shape[1]), (0, 0))) for *_, sh in fields]
        x, root, opacity = (np.concatenate([f[k] for f in fields]) for k in range(3))
        return RestGaussians(x.astype(np.float64), root, opacity, np.concatenate(padded))

    def _unit_covariances(
        self, rule: int, part: str, ids: np.ndarray, cov: np.ndarray
    ) -> np.ndarray:
        """Return the covariances drawn for J = 1 [m2], (n, 6)."""
        ones = np.ones(len(ids))
        if rule == VOLUME_SPHERE and part == "particles":
            return shape_evolution.volume_sphere_covariance(self.look.vol0[ids], ones)
        if rule in (VOLUME_SPHERE, RADIUS_SPHERE):
            return shape_evolution.equivalent_sphere_covariance(cov, ones)
        return cov

    def poses(self, frame: dict[str, np.ndarray]) -> list[np.ndarray]:
        """Return the poses (4, 4) of the POSED groups in a frame."""
        return list(frame["poses"]) if self.has_scenery and "poses" in frame else []

    def states(self, frame: dict[str, np.ndarray]) -> list[GroupState]:
        """Return the states of the FREE groups in a frame, the result of look.frame."""
        batches = self.look.parts(frame)
        if self.look.scenery is not None:
            batches = batches[1:]
        ids = np.asarray(frame["id"])
        parts = {"particles": _FrameRows(
            ids, batches[0].x, frame.get("F"), frame.get("J"), batches[0]
        )}  # fmt: skip
        if self.look.passive is not None:
            batch = batches[1]
            assert batch.rider_rows is not None and batch.deformation is not None
            J = np.linalg.det(batch.deformation.reshape(-1, 3, 3))
            rows = _FrameRows(batch.rider_rows, batch.x, batch.deformation, J, batch)
            parts["carried"] = rows
        counts = {"particles": len(self.look.object)}
        if self.look.passive is not None:
            counts["carried"] = len(self.look.passive.opacity)
        row_of = {}
        for name, part in parts.items():
            row_of[name] = np.full(counts[name], -1)
            row_of[name][part.ids] = np.arange(len(part.ids))
        return [
            _state(group, row_of[part][ids], parts[part])
            for group, (part, ids) in zip(self.groups, self.members)
            if group.motion == motion_stream.FREE
        ]


def _shape(rule: int, turns: bool) -> str:
    """Return how the shapes of a group change."""
    if rule == DEFORMED or turns:
        return motion_stream.DEFORMATION
    return motion_stream.FIXED if rule == FIXED else motion_stream.SIZE


def _state(group: MotionGroup, rows: np.ndarray, part: _FrameRows) -> GroupState:
    """Return the state of a group whose Gaussians have the `rows` (-1: absent) of a part."""
    present = rows >= 0
    rows = rows[present]
    size = quat = stretch = color = None
    if group.shape == motion_stream.SIZE:
        J = np.ones(len(rows)) if part.J is None else np.asarray(part.J)[rows]
        size = np.cbrt(np.clip(J, *shape_evolution.J_RANGE))
    if group.shape == motion_stream.DEFORMATION:
        assert part.F is not None  # Appearance refuses a frame without
        quat, stretch = _rotation_and_stretch(np.asarray(part.F)[rows])
    if group.color:
        batch = part.batch
        color = spherical_harmonics.rgb_from_dc(
            batch.color.sh[batch.rows[rows], 0].astype(np.float64)
        )
    return GroupState(present, part.x[rows], size, quat, stretch, color)


def _rotation_and_stretch(F: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return rotations (n, 4) and right stretches (n, 6) of deformations F (n, 9).

    Principal stretches are limited to shape_evolution.STRETCH_RANGE.
    """
    rotation = shape_evolution.rotation(F)
    U = rotation.transpose(0, 2, 1) @ np.asarray(F, dtype=np.float64).reshape(-1, 3, 3)
    U = 0.5 * (U + U.transpose(0, 2, 1))
    low, high = shape_evolution.STRETCH_RANGE
    extreme = np.abs(U - np.eye(3)).sum(axis=2).max(axis=1) > 1 - low
    if extreme.any():
        U[extreme] = _map_eigenvalues(U[extreme], lambda values: np.clip(values, low, high))
    return quaternion(rotation), pack_symmetric(U)


def _root(cov: np.ndarray) -> np.ndarray:
    """Return the square roots (n, 6) [m] of covariances (n, 6) [m2]."""
    matrices = unpack_symmetric(np.asarray(cov, dtype=np.float64))
    return pack_symmetric(_map_eigenvalues(matrices, lambda v: np.sqrt(np.maximum(v, 0.0))))


def _map_eigenvalues(
    matrices: np.ndarray, function: Callable[[np.ndarray], np.ndarray]
) -> np.ndarray:
    """Return symmetric matrices (n, 3, 3) with a function applied to their eigenvalues (n, 3)."""
    values, vectors = np.linalg.eigh(matrices)
    return (vectors * function(values)[:, None, :]) @ vectors.transpose(0, 2, 1)


def output_path(args: argparse.Namespace) -> Path:
    """Return the file that an export of one moving file writes. Raises RunError."""
    suffixes = SUFFIXES[args.format]
    path = Path(args.output or Path(args.out) / f"run{suffixes[0]}")
    if path.suffix.lower() not in suffixes:
        raise RunError(f"-o: {path}: allowed: a name that ends in {', '.join(suffixes)}")
    return path


def check_flags(args: argparse.Namespace) -> None:
    """Raise RunError if a flag has no meaning with the format, or a value is not allowed."""
    for flag in ("accuracy", "fps"):
        if getattr(args, flag) is not None and args.format != WEB:
            raise RunError(f"--{flag}: allowed with --format {WEB}")
    if args.format in KINDS and args.up not in (None, "z"):
        raise RunError(f"--up: {args.up}: a moving file has z up")
    low, high = ACCURACIES
    if args.accuracy is not None and not low <= args.accuracy <= high:
        raise RunError(f"--accuracy: {args.accuracy}: allowed: {low} to {high} cells")
    if args.fps is not None and not 0.1 <= args.fps <= 240:
        raise RunError(f"--fps: {args.fps}: allowed: 0.1 to 240")


def export_moving(args: argparse.Namespace, numbers: list[int], run: RunReader, path: Path) -> None:
    """Write a run as one file.

    Args:
        args: Arguments of the command line.
        numbers: Frames.
        run: Files of the run.
        path: Result of `output_path`.

    Raises:
        RunError: If a frame is wrong, or a package is missing.
        SettingsError: If the settings are wrong.
    """
    export = export_page if args.format == WEB else export_usd
    export(args, numbers, run, path)


def export_page(args: argparse.Namespace, numbers: list[int], run: RunReader, path: Path) -> None:
    """Write the page of a run's frames.

    Args:
        args, numbers, run, path: See `export_moving`.
    """
    chosen = render_config.load(args.settings)
    look = Appearance(run, chosen.look)
    motion = RunMotion(look, numbers[len(numbers) // 2], not args.no_scenery)
    accuracy = args.accuracy or ACCURACY
    groups = web_page.groups_as_drawn(motion.groups, chosen)
    writer = MotionWriter(groups, motion.rest_gaussians, cell=look.cell_size(), accuracy=accuracy)
    for index in tqdm(numbers, unit="frame", disable=True if args.quiet else None):
        frame = look.frame(index)
        writer.add_frame(float(run.times[index]), motion.states(frame), motion.poses(frame))
    folder = render_config.base_folder(args.settings)
    box = functools.cache(lambda: visible_extent(run))
    view = web_page.view_settings(look, chosen, folder, box, args.fps or FPS)
    title = str(run.scene.get("title") or run.folder.name)
    image_io.write(path, web_page.assemble_page(writer.to_bytes(view), title))
    size = path.stat().st_size / 1e6
    message = "%d frames of %d Gaussians, %.1f MB"
    log.info(message, len(numbers), len(motion.rest_gaussians.x), size)


def export_usd(args: argparse.Namespace, numbers: list[int], run: RunReader, path: Path) -> None:
    """Write the OpenUSD file of a run's frames.

    Args:
        args, numbers, run, path: See `export_moving`.
    """
    usd = usd_stage.load_usd()
    chosen = render_config.load(args.settings)
    folder = render_config.base_folder(args.settings)
    box = functools.cache(lambda: visible_extent(run))
    views = [CameraPath(entry, chosen.picture, box, folder) for entry in chosen.views()]
    look = Appearance(run, chosen.look)
    motion = RunMotion(look, numbers[len(numbers) // 2], not args.no_scenery)
    if antialiased := [group.name for group in motion.groups if group.compensated_lowpass]:
        log.warning(
            "OpenUSD holds no render model: a viewer draws what was trained antialiased as classic,"
            " and small Gaussians too opaque: %s", ", ".join(antialiased),
        )  # fmt: skip
    times = run.times[numbers]
    rate = 1 / float(np.median(np.diff(times))) if len(times) > 1 else 24.0
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=path.parent, prefix=".usd") as temporary:
        layer = Path(temporary) / f"{path.stem}{'.usdc' if path.suffix == '.usdz' else path.suffix}"
        stage = usd_stage.UsdStage(
            layer, motion.groups, motion.rest_gaussians, frames=len(numbers), rate=rate
        )
        stage.add_light((chosen.light.light() if chosen.light else Light()).direction)
        colliders, without = collider_meshes(run.objects, run.scene)
        if without:
            log.warning(
                "colliders without a mesh, shown by Gaussians alone: %s", ", ".join(without)
            )
        meshes = [stage.add_mesh(m.name, m.points, m.faces, m.color) for m in colliders]
        for k, index in enumerate(tqdm(numbers, unit="frame", disable=args.quiet or None)):
            frame = look.frame(index)
            part = k / max(len(numbers) - 1, 1)
            cameras = {view.name: view.camera_at(part, float(times[k])) for view in views}
            stage.add_frame(motion.states(frame), motion.poses(frame), cameras)
            for mesh, collider in zip(meshes, colliders):
                if collider.pose >= 0:
                    stage.set_mesh_pose(mesh, frame["poses"][collider.pose])
        stage.save()
        del stage
        if path.suffix.lower() == ".usdz":
            package = layer.with_suffix(".usdz")
            usd.UsdUtils.CreateNewUsdzPackage(str(layer), str(package))
            layer = package
        layer.replace(path)
    message = "%d frames of %d Gaussians, %.1f MB"
    log.info(message, len(numbers), len(motion.rest_gaussians.x), path.stat().st_size / 1e6)
