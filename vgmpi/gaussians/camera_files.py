"""Cameras from files of other tools: transforms.json of nerfstudio and models of COLMAP.

Both become `Camera` (OpenCV convention, world to camera). Every mistake is one line that names
the file and the place in it.
"""

import json
import logging
import math
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from vgmpi.runtime.config.schema import TomlError
from vgmpi.runtime.user_files import read_regular_file

from .camera import Camera

log = logging.getLogger("vgmpi")

MAX_JSON_BYTES = 1 << 25  # [bytes] 40,000 frames; parsed, it takes up to thirty times as much
MAX_BYTES = 1 << 28  # [bytes] a model of 100,000 photos without its points has a tenth of it
SIDES = (16, 8192)  # [pixels] range of width and height, as in render.toml
BINARY_MODELS = {0: "SIMPLE_PINHOLE", 1: "PINHOLE"}
PARAMETERS = {"SIMPLE_PINHOLE": 3, "PINHOLE": 4}
DISTORTION = ("k1", "k2", "k3", "k4", "p1", "p2")
NamedCameras = list[tuple[str, Camera]]


class CameraFileError(TomlError):
    """Error of a file without usable cameras; one line."""


def transforms(path: Path) -> NamedCameras:
    """Return name and camera of every frame of a nerfstudio transforms.json, in its order.

    Its transform_matrix is camera to world with y up and z backward (OpenGL).

    Raises:
        CameraFileError: If the file is not readable or a frame is not valid.
    """
    raw = _read(path, MAX_JSON_BYTES)
    try:
        data = json.loads(raw)
    except (ValueError, RecursionError) as error:
        reason = "nested too deep" if isinstance(error, RecursionError) else error
        raise CameraFileError([f"{path}: not readable as JSON: {reason}"]) from None
    frames = data.get("frames") if isinstance(data, dict) else None
    if not isinstance(frames, list) or not frames:
        raise CameraFileError([f"{path}: no list of frames in it"])
    cameras, is_distorted = [], False
    for number, frame in enumerate(frames):
        try:
            if not isinstance(frame, dict):
                raise ValueError("not a table")
            fields = {**data, **frame}
            cameras.append((str(fields.get("file_path", number)), _camera_of_frame(fields)))
            is_distorted = is_distorted or any(fields.get(name) for name in DISTORTION)
        except ValueError as error:
            raise CameraFileError([f"{path}: frame {number}: {error}"]) from None
    if is_distorted:
        log.warning("%s: lens distortion is not drawn: straight lines stay straight", path)
    return cameras


def _camera_of_frame(fields: dict[str, Any]) -> Camera:
    """Return the camera of a frame."""
    model = fields.get("camera_model", "OPENCV")
    if model not in ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE"):
        raise ValueError(f"camera_model {model!r}: allowed: OPENCV, PINHOLE, SIMPLE_PINHOLE")
    width, height = (_number(fields, name, *SIDES) for name in ("w", "h"))
    if "fl_x" not in fields and "camera_angle_x" in fields:
        angle = _number(fields, "camera_angle_x", 1e-3, 3.1)
        fields = {**fields, "fl_x": 0.5 * width / math.tan(0.5 * angle)}
    fx = _number(fields, "fl_x", 1e-2, 1e6)
    fy = _number({"fl_y": fx, **fields}, "fl_y", 1e-2, 1e6)
    cx = _number({"cx": width / 2, **fields}, "cx", -10 * width, 10 * width)
    cy = _number({"cy": height / 2, **fields}, "cy", -10 * height, 10 * height)
    if width % 1 or height % 1:
        raise ValueError(f"w, h = {width:g}, {height:g}: allowed: whole numbers of pixels")
    try:
        matrix = np.array(fields.get("transform_matrix"), dtype=np.float64)
    except (ValueError, TypeError, OverflowError):
        matrix = np.zeros(0)
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        raise ValueError("transform_matrix: allowed: four rows of four numbers")
    rotation = matrix[:3, :3] * [1.0, -1.0, -1.0]  # to y down, z forward
    return _camera(rotation.T, -rotation.T @ matrix[:3, 3], (fx, fy, cx, cy), width, height)


def colmap(folder: Path) -> NamedCameras:
    """Return name and camera of every image of a COLMAP model (text or binary), by name.

    The model has cameras.txt and images.txt, or cameras.bin and images.bin, with PINHOLE or
    SIMPLE_PINHOLE cameras. Its poses are world to camera, y down and z forward.

    Raises:
        CameraFileError: If a file is not readable or a record is not valid.
    """
    suffix = next((s for s in (".bin", ".txt") if (folder / f"cameras{s}").exists()), ".txt")
    readers = {".txt": (_text_lenses, _text_poses), ".bin": (_binary_lenses, _binary_poses)}
    named = []
    paths = folder / f"cameras{suffix}", folder / f"images{suffix}"
    lenses = _records(paths[0], readers[suffix][0])
    lens_of = {}
    for number, model, width, height, values in lenses:
        lens = _lens(model, values)
        lens_of[number] = (lens, width, height)
    for name, number, q, t in _records(paths[1], readers[suffix][1]):
        try:
            if number not in lens_of:
                raise ValueError(f"there is no camera {number} in {paths[0].name}")
            lens, width, height = lens_of[number]
            named.append((name, _camera(_rotation(q), np.array(t), lens, width, height)))
        except ValueError as error:
            raise CameraFileError([f"{paths[1]}: {name}: {error}"]) from None
    if not named:
        raise CameraFileError([f"{paths[1]}: no images in it"])
    return sorted(named, key=lambda item: item[0])


def _records(path: Path, reader) -> list:
    """Return all records of a file; an error of one becomes one line."""
    records: list = []
    try:
        for record in reader(_read(path)):
            if reader in (_text_lenses, _binary_lenses):
                _check_lens(*record[1:])
            records.append(record)
    except (ValueError, IndexError, struct.error, OverflowError) as error:
        reason = "ends too early" if isinstance(error, IndexError | struct.error) else error
        raise CameraFileError([f"{path}: record {len(records) + 1}: {reason}"]) from None
    return records


def _check_lens(model: str, width: int, height: int, values: list[float]) -> None:
    """Raise ValueError for an impossible size or focal length."""
    if not all(SIDES[0] <= side <= SIDES[1] for side in (width, height)):
        raise ValueError(f"{width} x {height} pixels: allowed: {SIDES[0]} to {SIDES[1]}")
    focal = values[: len(values) - 2]
    if not all(math.isfinite(v) and abs(v) < 1e6 for v in values) or min(focal) < 1e-2:
        raise ValueError(f"{model} {values}: no focal lengths and centre in pixels")


def _text_lenses(data: bytes) -> Iterator[tuple]:
    """Yield (number, model, width, height, parameters) of every camera in cameras.txt."""
    for line in _lines(data):
        words = line.split()
        if words:
            values = [float(word) for word in words[4:]]
            _check_model(words[1], len(values))
            yield int(words[0]), words[1], int(words[2]), int(words[3]), values


def _text_poses(data: bytes) -> Iterator[tuple]:
    """Yield name, camera number, quaternion and translation of every image in images.txt.

    An image has two lines: its pose, and its points, which may be missing or empty.
    """
    points = False
    for line in _lines(data):
        words = line.split(maxsplit=9)
        if points and (len(words) < 10 or _is_points(line)):
            points = False
            continue
        points = False
        if words:
            values = [float(word) for word in words[1:8]]
            yield words[9].strip(), int(words[8]), values[:4], values[4:]
            points = True


def _is_points(line: str) -> bool:
    """Return whether a line holds x, y, id of points: numbers only, three by three."""
    words = line.split()
    try:
        return len([float(word) for word in words]) % 3 == 0
    except ValueError:
        return False


def _lines(data: bytes) -> Iterator[str]:
    """Yield the lines without comments."""
    for line in data.decode("utf-8").splitlines():
        if not line.startswith("#"):
            yield line


def _binary_lenses(data: bytes) -> Iterator[tuple]:
    """Yield (number, model, width, height, parameters) of every camera in cameras.bin."""
    (count,), offset = struct.unpack_from("<Q", data), 8
    for _ in range(min(count, len(data))):  # a wrong count runs into the end of the file
        number, model, width, height = struct.unpack_from("<iiQQ", data, offset)
        name = BINARY_MODELS.get(model, f"number {model}")
        _check_model(name, PARAMETERS.get(name, 0))
        values = list(struct.unpack_from(f"<{PARAMETERS[name]}d", data, offset + 24))
        offset += 24 + 8 * len(values)
        yield number, name, width, height, values


def _binary_poses(data: bytes) -> Iterator[tuple]:
    """Yield name, camera number, quaternion and translation of every image in images.bin."""
    (count,), offset = struct.unpack_from("<Q", data), 8
    for _ in range(min(count, len(data))):
        values = struct.unpack_from("<i7di", data, offset)
        end = data.index(b"\0", offset + 64)
        name = data[offset + 64 : end].decode("utf-8")
        (points,) = struct.unpack_from("<Q", data, end + 1)
        offset = end + 9 + 24 * points
        if offset > len(data):
            raise IndexError
        yield name, values[8], values[1:5], values[5:8]


def _check_model(model: str, count: int) -> None:
    """Raise ValueError for an unknown camera model or a wrong number of parameters."""
    if model not in PARAMETERS:
        raise ValueError(f"camera model {model}: allowed: {', '.join(PARAMETERS)}")
    if count != PARAMETERS[model]:
        raise ValueError(f"{model} has {PARAMETERS[model]} parameters, not {count}")


def _lens(model: str, values: list[float]) -> tuple:
    """Return (fx, fy, cx, cy) [pixels]."""
    f, *others = values
    return (f, f, *others) if model == "SIMPLE_PINHOLE" else tuple(values)


def _rotation(q) -> np.ndarray:
    """Return the rotation matrix of a quaternion w, x, y, z."""
    length = math.sqrt(sum(v * v for v in q))
    if not abs(length - 1) < 1e-2:
        raise ValueError(f"the quaternion has length {length:g} instead of 1")
    w, x, y, z = (v / length for v in q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _camera(
    rotation: np.ndarray, shift: np.ndarray, lens: tuple, width: float, height: float
) -> Camera:
    """Return a camera; raise ValueError if the pose is no rotation or no finite position."""
    skew = np.abs(rotation @ rotation.T - np.eye(3)).max()
    if not (skew < 1e-3 and np.linalg.det(rotation) > 0):
        raise ValueError("the pose is no rotation and position")
    if not (np.isfinite(shift).all() and np.abs(shift).max() < 1e9):
        raise ValueError("the position is not finite")
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, shift
    fx, fy, cx, cy = (float(v) for v in lens)
    return Camera(pose, fx, fy, cx, cy, int(width), int(height))


def _number(fields: dict[str, Any], name: str, low: float, high: float) -> float:
    """Return a number of a table; raise ValueError if it is missing or out of its range."""
    value: float | None = fields.get(name)
    if value is None or type(value) not in (int, float) or not low <= value <= high:
        raise ValueError(f"{name} = {value!r:.40}: allowed: a number from {low:g} to {high:g}")
    return value


def _read(path: Path, max_bytes: int = MAX_BYTES) -> bytes:
    """Return the content of a file."""
    try:
        return read_regular_file(path, max_bytes)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise CameraFileError([f"{path}: {reason}"]) from None
