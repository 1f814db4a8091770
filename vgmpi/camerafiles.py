"""Cameras from the files of other tools: nerfstudio's transforms.json and COLMAP models.

Both end up as `Camera` (OpenCV convention, world to camera). Every mistake is one line that names
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

from vgmpi.inputs import content
from vgmpi.splatting.camera import Camera
from vgmpi.tables import TomlError

log = logging.getLogger("vgmpi")

LARGEST = 1 << 28  # bytes; a model of 100,000 photos without its points has a tenth of it
SIDES = (16, 8192)  # pixels, as in render.toml
BINARY_MODELS = {0: "SIMPLE_PINHOLE", 1: "PINHOLE"}
PARAMETERS = {"SIMPLE_PINHOLE": 3, "PINHOLE": 4}
DISTORTION = ("k1", "k2", "k3", "k4", "p1", "p2")
Named = list[tuple[str, Camera]]


class CameraFileError(TomlError):
    """A file that tells no cameras; one line."""


def transforms(path: Path) -> Named:
    """Name and camera of every frame of a nerfstudio transforms.json, in its order.

    Its transform_matrix is camera to world with y up and z backward (OpenGL). Raises
    CameraFileError.
    """
    raw = _read(path)
    try:
        data = json.loads(raw)
    except (ValueError, RecursionError) as error:
        said = "nested too deep" if isinstance(error, RecursionError) else error
        raise CameraFileError([f"{path}: not readable as JSON: {said}"]) from None
    frames = data.get("frames") if isinstance(data, dict) else None
    if not isinstance(frames, list) or not frames:
        raise CameraFileError([f"{path}: no list of frames in it"])
    cameras, bent = [], False
    for number, frame in enumerate(frames):
        try:
            if not isinstance(frame, dict):
                raise ValueError("not a table")
            told = {**data, **frame}
            cameras.append((str(told.get("file_path", number)), _of_frame(told)))
            bent = bent or any(told.get(name) for name in DISTORTION)
        except ValueError as error:
            raise CameraFileError([f"{path}: frame {number}: {error}"]) from None
    if bent:
        log.warning("%s: lens distortion is not drawn: straight lines stay straight", path)
    return cameras


def _of_frame(told: dict[str, Any]) -> Camera:
    model = told.get("camera_model", "OPENCV")
    if model not in ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE"):
        raise ValueError(f"camera_model {model!r}: allowed: OPENCV, PINHOLE, SIMPLE_PINHOLE")
    width, height = (_number(told, name, *SIDES) for name in ("w", "h"))
    if "fl_x" not in told and "camera_angle_x" in told:
        angle = _number(told, "camera_angle_x", 1e-3, 3.1)
        told = {**told, "fl_x": 0.5 * width / math.tan(0.5 * angle)}
    fx = _number(told, "fl_x", 1e-2, 1e6)
    fy = _number({"fl_y": fx, **told}, "fl_y", 1e-2, 1e6)
    cx = _number({"cx": width / 2, **told}, "cx", -10 * width, 10 * width)
    cy = _number({"cy": height / 2, **told}, "cy", -10 * height, 10 * height)
    if width % 1 or height % 1:
        raise ValueError(f"w, h = {width:g}, {height:g}: allowed: whole numbers of pixels")
    try:
        matrix = np.array(told.get("transform_matrix"), dtype=np.float64)
    except (ValueError, TypeError, OverflowError):
        matrix = np.zeros(0)
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        raise ValueError("transform_matrix: allowed: four rows of four numbers")
    turn = matrix[:3, :3] * [1.0, -1.0, -1.0]  # to y down, z forward
    return _camera(turn.T, -turn.T @ matrix[:3, 3], (fx, fy, cx, cy), width, height)


def colmap(folder: Path) -> Named:
    """Name and camera of every image of a COLMAP model (text or binary), by name.

    cameras.txt and images.txt, or cameras.bin and images.bin; PINHOLE and SIMPLE_PINHOLE. Its
    poses are world to camera, y down and z forward. Raises CameraFileError.
    """
    suffix = next((s for s in (".bin", ".txt") if (folder / f"cameras{s}").exists()), ".txt")
    readers = {".txt": (_text_lenses, _text_poses), ".bin": (_binary_lenses, _binary_poses)}
    named = []
    paths = folder / f"cameras{suffix}", folder / f"images{suffix}"
    lenses = _all(paths[0], readers[suffix][0])
    known = {}
    for number, model, width, height, values in lenses:
        lens = _lens(model, values)
        known[number] = (lens, width, height)
    for name, number, q, t in _all(paths[1], readers[suffix][1]):
        try:
            if number not in known:
                raise ValueError(f"there is no camera {number} in {paths[0].name}")
            lens, width, height = known[number]
            named.append((name, _camera(_rotation(q), np.array(t), lens, width, height)))
        except ValueError as error:
            raise CameraFileError([f"{paths[1]}: {name}: {error}"]) from None
    if not named:
        raise CameraFileError([f"{paths[1]}: no images in it"])
    return sorted(named, key=lambda one: one[0])


def _all(path: Path, reader) -> list:
    """All records of a file; what is wrong with one becomes one line."""
    records: list = []
    try:
        for record in reader(_read(path)):
            if reader in (_text_lenses, _binary_lenses):
                _check_lens(*record[1:])
            records.append(record)
    except (ValueError, IndexError, struct.error, OverflowError) as error:
        said = "ends too early" if isinstance(error, IndexError | struct.error) else error
        raise CameraFileError([f"{path}: record {len(records) + 1}: {said}"]) from None
    return records


def _check_lens(model: str, width: int, height: int, values: list[float]) -> None:
    if not all(SIDES[0] <= side <= SIDES[1] for side in (width, height)):
        raise ValueError(f"{width} x {height} pixels: allowed: {SIDES[0]} to {SIDES[1]}")
    focal = values[: len(values) - 2]
    if not all(math.isfinite(v) and abs(v) < 1e6 for v in values) or min(focal) < 1e-2:
        raise ValueError(f"{model} {values}: no focal lengths and centre in pixels")


def _text_lenses(data: bytes) -> Iterator[tuple]:
    for line in _lines(data):
        words = line.split()
        if words:
            values = [float(word) for word in words[4:]]
            _check_model(words[1], len(values))
            yield int(words[0]), words[1], int(words[2]), int(words[3]), values


def _text_poses(data: bytes) -> Iterator[tuple]:
    """Two lines an image: the pose, and the points it shows (which may be missing or empty)."""
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
    """Whether a line holds x, y, id of points: numbers only, three by three."""
    words = line.split()
    try:
        return len([float(word) for word in words]) % 3 == 0
    except ValueError:
        return False


def _lines(data: bytes) -> Iterator[str]:
    for line in data.decode("utf-8").splitlines():
        if not line.startswith("#"):
            yield line


def _binary_lenses(data: bytes) -> Iterator[tuple]:
    (count,), at = struct.unpack_from("<Q", data), 8
    for _ in range(min(count, len(data))):  # a false count runs into the end of the file
        number, model, width, height = struct.unpack_from("<iiQQ", data, at)
        name = BINARY_MODELS.get(model, f"number {model}")
        _check_model(name, PARAMETERS.get(name, 0))
        values = list(struct.unpack_from(f"<{PARAMETERS[name]}d", data, at + 24))
        at += 24 + 8 * len(values)
        yield number, name, width, height, values


def _binary_poses(data: bytes) -> Iterator[tuple]:
    (count,), at = struct.unpack_from("<Q", data), 8
    for _ in range(min(count, len(data))):
        values = struct.unpack_from("<i7di", data, at)
        end = data.index(b"\0", at + 64)
        name = data[at + 64 : end].decode("utf-8")
        (points,) = struct.unpack_from("<Q", data, end + 1)
        at = end + 9 + 24 * points
        if at > len(data):
            raise IndexError
        yield name, values[8], values[1:5], values[5:8]


def _check_model(model: str, count: int) -> None:
    if model not in PARAMETERS:
        raise ValueError(f"camera model {model}: allowed: {', '.join(PARAMETERS)}")
    if count != PARAMETERS[model]:
        raise ValueError(f"{model} has {PARAMETERS[model]} parameters, not {count}")


def _lens(model: str, values: list[float]) -> tuple:
    f, *rest = values
    return (f, f, *rest) if model == "SIMPLE_PINHOLE" else tuple(values)


def _rotation(q) -> np.ndarray:
    """Matrix of a quaternion w, x, y, z."""
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


def _camera(rotation: np.ndarray, shift: np.ndarray, lens: tuple, width: int, height: int):
    """Raises ValueError for what is no rotation, or a position that is none."""
    skew = np.abs(rotation @ rotation.T - np.eye(3)).max()
    if not (skew < 1e-3 and np.linalg.det(rotation) > 0):
        raise ValueError("the pose is no rotation and position")
    if not (np.isfinite(shift).all() and np.abs(shift).max() < 1e9):
        raise ValueError("the position is not finite")
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, shift
    return Camera(pose, *(float(v) for v in lens), int(width), int(height))


def _number(told: dict[str, Any], name: str, low: float, high: float) -> float:
    value = told.get(name)
    if type(value) not in (int, float) or not low <= value <= high:
        raise ValueError(f"{name} = {value!r:.40}: allowed: a number from {low:g} to {high:g}")
    return value


def _read(path: Path) -> bytes:
    try:
        return content(path, LARGEST)
    except (OSError, ValueError) as error:
        said = getattr(error, "strerror", None) or error
        raise CameraFileError([f"{path}: {said}"]) from None
