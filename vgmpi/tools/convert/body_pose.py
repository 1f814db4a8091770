"""Poses of the bodies of a configuration in their box, and the Gaussians they consist of.

Their way: Gaussians fainter than a threshold are dropped, the others rotated about the axes one
after the other, then moved and scaled so that the longest edge of the box around them is `scale`
and its center (1, 1, 1), or `center_point`.
"""

import math
import re
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from vgmpi.gaussians.capture_conventions import log_capture_notes
from vgmpi.gaussians.formats import registry
from vgmpi.gaussians.formats.validation import GaussianFileError
from vgmpi.runtime.config.schema import format_input
from vgmpi.scene.objects import MAX_NAME_BYTES

from . import source_schema
from .config_reader import Body, Config, ConvertError, Report, key_error

DEFAULT_CENTER = (1.0, 1.0, 1.0)
CORNERS = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)], dtype=float)


class BodyPose(NamedTuple):
    """Body in their box.

    low, high: corners (3,); x: Gaussians (n, 3), None if no file is known; scale, origin: map
    rotated coordinates of the file to the box; turned: rotation; box: part of the file (2, 3) that
    makes the body, in the file's axes; area: part beyond which its Gaussians are only drawn; own:
    all Gaussians of the file (m, 3) that are not too faint.
    """

    name: str
    file: Path | None
    low: np.ndarray
    high: np.ndarray
    x: np.ndarray | None = None
    scale: float = 1.0
    origin: np.ndarray = np.zeros(3)
    turned: np.ndarray = np.eye(3)
    box: np.ndarray | None = None
    area: np.ndarray | None = None
    own: np.ndarray = np.zeros((0, 3))

    @property
    def straight(self) -> bool:
        """Return whether boxes in their box are aligned with the axes of the file."""
        return along_axes(self.turned)

    def in_file(self, box: np.ndarray) -> np.ndarray:
        """Return a box (2, 3) of theirs in the file's axes."""
        ends = (box - self.origin) / self.scale @ self.turned
        return np.array([ends.min(axis=0), ends.max(axis=0)])

    def inside(self, within: Any) -> float:
        """Return the fraction of the body for which within((n, 3)) holds.

        For a body without Gaussians it is 1, 0 or 0.5, by its corners and interior: a region is
        convex.
        """
        if self.x is not None:
            return float(np.mean(within(self.x)))
        points = self.low + CORNERS * (self.high - self.low)
        fraction = np.mean(within(points))
        if fraction == 1.0:
            return 1.0
        lattice = np.stack(np.meshgrid(*[np.linspace(0, 1, 21)] * 3), axis=-1).reshape(-1, 3)
        return 0.5 if np.any(within(self.low + lattice * (self.high - self.low))) else 0.0


def in_box(point: source_schema.Vector, size: source_schema.Extent):
    """Return a function that tells which points (n, 3) are in a box.

    The box extends by `size` from `point` along each axis in both directions, as in their program.
    """
    return lambda x: (np.abs(x - np.asarray(point)) < np.asarray(size)).all(axis=1)


def body_pose(
    config: Config, k: int, file: Path | None, report: Report, used_names: set[str]
) -> BodyPose:
    """Return the pose of body k in their box.

    Args:
        config: Configuration of the other program.
        k: Number of the body.
        file: Gaussian file of the body, if there is one.
        report: Keys that are not converted (in/out).
        used_names: Names so far (in/out).

    Raises:
        ConvertError: The file is unusable.
    """
    body = config.bodies[k]
    name = _name(body, file, used_names)
    center = np.asarray(getattr(body.stand, "center_point", DEFAULT_CENTER))
    if file is None:
        half = np.full(3, body.stand.scale / 2)
        if getattr(body.law, "type", None) == "floor":
            half[2] = config.cell  # a plate of minimum thickness
        for key in ("rotation_degree", "rotation_axis", "opacity_threshold"):
            if body.stand.has_key(key):
                reason = "there is no Gaussian file to apply it to (--gaussians)"
                report.dropped((*body.stand_path, key), getattr(body.stand, key), reason)
        for key in _areas(body):
            reason = "it is cut out of a Gaussian file, which is not here (--gaussians)"
            report.dropped((*body.stand_path, key), getattr(body.stand, key), reason)
        return BodyPose(name, None, center - half, center + half)
    return _pose_from_file(config, body, file, report, BodyPose(name, file, center, center))


def _pose_from_file(
    config: Config, body: Body, file: Path, report: Report, pose: BodyPose
) -> BodyPose:
    """Return the pose of a body with a Gaussian file."""
    try:
        cloud = registry.read(file)
    except GaussianFileError as error:
        raise ConvertError([str(error)]) from None
    except OSError as error:
        raise ConvertError([f"{file}: {error.strerror or error}"]) from None
    log_capture_notes(file, cloud)
    points = cloud.x[cloud.opacity >= body.stand.opacity_threshold]
    rotation = rotation_matrix(body.stand)
    x = points @ rotation.T
    boxes = {key: np.reshape(getattr(body.stand, key), (3, 2)).T for key in _areas(body)}
    if not config.is_versagauss and "sim_area" in boxes:  # their program does this before scaling
        x = x[_within(x, boxes["sim_area"])]
    if len(x) == 0:
        raise _empty_error(config, body, file)
    low, high = x.min(axis=0), x.max(axis=0)
    if not (high - low).max() > 0:
        raise ConvertError([f"{file}: all its Gaussians are at one point: no scale is known"])
    scale = body.stand.scale / (high - low).max()
    origin = pose.low - scale * (low + high) / 2
    x = scale * x + origin
    if config.is_versagauss:
        for box in boxes.values():
            x = x[_within(x, box)]
        boxes = {key: (box - origin) / scale for key, box in boxes.items()}
    if len(x) == 0:
        raise _empty_error(config, body, file)
    crop, area = _crop_boxes(body, boxes, rotation, report)
    if boxes and crop is None:  # the scene contains all of the file
        x = scale * points @ rotation.T + origin
    return pose._replace(
        low=x.min(axis=0), high=x.max(axis=0), x=x, scale=float(scale), origin=origin,
        turned=rotation, box=crop, area=area, own=points,
    )  # fmt: skip


def _empty_error(config: Config, body: Body, file: Path) -> ConvertError:
    """Return the error for a body without Gaussians."""
    key = next(iter(_areas(body)), "opacity_threshold")
    message = f"leaves no Gaussian of {file}; {format_input(getattr(body.stand, key))}"
    return key_error(config.path, (*body.stand_path, key), message)


def _areas(body: Body) -> list[str]:
    """Return the keys of a body that cut its file."""
    names = ("sim_area", "sim_selected_area", "object_area")
    return [key for key in names if getattr(body.stand, key, None) is not None]


def _within(x: np.ndarray, box: np.ndarray) -> np.ndarray:
    """Return which points (n, 3) are inside a box (2, 3)."""
    return ((x > box[0]) & (x < box[1])).all(axis=1)


def _crop_boxes(
    body: Body, boxes: dict[str, np.ndarray], rotation: np.ndarray, report: Report
) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Return the boxes in rotated coordinates as one box (2, 3) in the file's axes; sim_area."""
    crop = area = None
    straight = along_axes(rotation)
    for key, box in boxes.items():
        key_path, value = (*body.stand_path, key), getattr(body.stand, key)
        if not straight:
            reason = "a part of a file is a box along its own axes, which the rotation turns away"
            report.dropped(key_path, value, reason)
            continue
        ends = box @ rotation
        low, high = ends.min(axis=0), ends.max(axis=0)
        crop = np.array([low, high]) if crop is None else np.array(
            [np.maximum(crop[0], low), np.minimum(crop[1], high)]
        )  # fmt: skip
        if key == "sim_area":
            area = np.array([low, high])
        elif key == "object_area" and body.stand.particle_filling is not None:
            report.approximated(key_path, value, "it is cut before it is filled, theirs after")
    return crop, area


def box_difference(box: np.ndarray, outer: np.ndarray) -> list[np.ndarray]:
    """Return the rest of a box (2, 3) without another, as boxes side by side."""
    boxes, rest_box = [], outer.copy()
    for axis in range(3):
        for side, sign in ((0, 1), (1, -1)):
            if sign * (box[side][axis] - rest_box[side][axis]) > 0:
                piece = rest_box.copy()
                piece[1 - side][axis] = box[side][axis]
                boxes.append(piece)
                rest_box[side][axis] = box[side][axis]
    return boxes


def rotation_matrix(stand: source_schema.Stand) -> np.ndarray:
    """Return their rotations one after the other (3, 3)."""
    rotation = np.eye(3)
    for angle, axis in zip(stand.rotation_degree, stand.rotation_axis, strict=True):
        c, s = math.cos(math.radians(angle)), math.sin(math.radians(angle))
        turn, i, j = np.eye(3), (axis + 1) % 3, (axis + 2) % 3
        turn[i, i] = turn[j, j] = c
        turn[j, i], turn[i, j] = s, -s
        rotation = turn @ rotation
    return rotation


def along_axes(rotation: np.ndarray) -> bool:
    """Return whether a rotation maps axes to axes."""
    return bool(np.allclose(np.abs(rotation).max(axis=1), 1.0, atol=1e-9))


def find_file(config: Config, k: int, files_given: list[Path]) -> tuple[Path | None, str]:
    """Return the Gaussian file of body k, and why there is none.

    files_given: those of --gaussians, in order of the bodies. In a folder of Gaussian splatting the
    last iteration counts. Raises ConvertError if a given file does not exist.
    """
    if k < len(files_given):
        file = _model_file(files_given[k])
        if file is None:
            raise ConvertError([f"{files_given[k]}: there is no such Gaussian file"])
        return file, ""
    if not config.is_versagauss:
        return None, "--gaussians FILE names it"
    model_path = config.bodies[k].stand.model_path  # type: ignore[attr-defined]
    if "\0" in model_path:
        return None, "no file has such a name"
    # Relative to the current folder, as in their program; or to the folder that contains config/.
    for folder in (Path(), config.path.parent, config.path.parent.parent):
        try:
            file = _model_file(folder / model_path)
        except OSError as error:  # a name too long for a file, a folder that may not be read
            return None, f"{error.strerror}; --gaussians names the files of all bodies in order"
        if file is not None:
            return file, ""
    return None, f"{model_path} is not here; --gaussians names the files of all bodies in order"


def _model_file(path: Path) -> Path | None:
    """Return the Gaussian file at a path, which may be a folder of Gaussian splatting."""
    if path.is_file():
        return path
    iterations = [
        (int(match[1]), folder)
        for folder in (path / "point_cloud").glob("iteration_*")
        if (match := re.fullmatch(r"iteration_(\d{1,9})", folder.name))
    ]
    latest = max(iterations, default=(0, path))[1] / "point_cloud.ply"
    return latest if latest.is_file() else None


def _name(body: Body, file: Path | None, used_names: set[str]) -> str:
    """Return a unique name, made from the body's file."""
    stem = Path(getattr(body.stand, "model_path", file or "body")).stem
    if stem == "point_cloud":
        stem = "body"
    name = re.sub(r"[^\w -]", "_", stem).strip() or "body"
    name = name if name[0].isalpha() else f"body {name}"
    # room for a number behind it
    name = name.encode()[: MAX_NAME_BYTES - 4].decode(errors="ignore").strip()
    base, count = name, 1
    while name in used_names:
        count += 1
        name = f"{base} {count}"
    used_names.add(name)
    return name
