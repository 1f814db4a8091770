"""Coordinate frames of captures, and the turn from a file's frame to that of a .ply.

A frame is three letters, the directions of x, y and z: one each of R/L (right, left), U/D (up,
down) and F/B (forward, back), as in "RDF". A frame of the other handedness than RDF, such as LUB,
holds the mirror image of its object; the turn mirrors it back.
"""

from dataclasses import replace

import numpy as np

from . import spherical_harmonics as harmonics
from .capture_record import CaptureRecord
from .cloud import GaussianCloud, quaternion, quaternion_product

PLY_FRAME = "RDF"  # frame of captures in a .ply: right, down, forward
_AXES = ("RL", "DU", "FB")  # a letter of each pair; the first points along that axis of a .ply


def validate_frame(frame: str) -> str:
    """Return `frame` if it names one.

    Raises:
        ValueError: If it does not.
    """
    letters = frame if isinstance(frame, str) else ""
    if len(letters) != 3 or any(sum(c in pair for c in letters) != 1 for pair in _AXES):
        raise ValueError(
            "must be three letters, the directions of x, y and z: one each of R or L, U or D and"
            ' F or B, such as "RDF" or "RUB"'
        )
    return letters


def axis_matrix(frame: str) -> np.ndarray:
    """Return the matrix (3, 3) that turns vectors of a frame to RDF.

    Raises:
        ValueError: If the name is not that of a frame.
    """
    matrix = np.zeros((3, 3))
    for column, letter in enumerate(validate_frame(frame)):
        row = next(k for k, pair in enumerate(_AXES) if letter in pair)
        matrix[row, column] = 1.0 if letter == _AXES[row][0] else -1.0
    return matrix


def to_ply_frame(cloud: GaussianCloud, frame: str) -> GaussianCloud:
    """Return the cloud that a .ply would hold: centers, shapes and colors turned from `frame`.

    A Gaussian is the same if its principal axes change their signs, so that a mirrored one has a
    proper rotation, too: with the matrix M = P S of an order P of axes and signs S, the rotation R
    becomes det(P) P (S R S).

    Raises:
        ValueError: If the name is not that of a frame.
    """
    matrix = axis_matrix(frame)
    order, signs = np.abs(matrix), matrix.sum(axis=0)
    quat = cloud.quat * np.append(1.0, signs[[1, 0, 0]] * signs[[2, 2, 1]])
    if np.array_equal(order, np.eye(3)):  # only signs change: exact
        sh = cloud.sh * _coefficient_signs(matrix, cloud.sh.shape[1])[:, None]
    else:
        quat = quaternion_product(quaternion(np.round(np.linalg.det(order)) * order), quat)
        sh = harmonics.rotate(cloud.sh, matrix)
    return replace(cloud, x=cloud.x @ matrix.T, quat=quat, sh=sh)


def _coefficient_signs(matrix: np.ndarray, count: int) -> np.ndarray:
    """Return the signs (count,) of SH coefficients under a diagonal matrix of signs (3, 3)."""
    units = np.repeat(np.eye(count)[:, :, None], 3, axis=2)
    return np.rint(np.diagonal(harmonics.rotate(units, matrix)[..., 0])).astype(np.float32)


def in_ply_frame(cloud: GaussianCloud, frame: str | None, encoding: str) -> GaussianCloud:
    """Return a cloud as read, turned to the frame of a .ply if it has another.

    Args:
        cloud: Numbers as they are in the file, with the frame that the file names, if any.
        frame: Frame that a user names, which wins over the file's.
        encoding: Name of the format, for clouds without a record.

    Raises:
        ValueError: If the name is not that of a frame.
    """
    record = cloud.record or CaptureRecord(encoding)
    chosen, source = record.frame, record.frame_source
    if frame:
        chosen, source = validate_frame(frame), "named by the key frame"
        if record.frame and record.frame != frame:
            source += f", although the file says {record.frame}"
    if not chosen:
        return cloud
    if chosen != PLY_FRAME:
        cloud = to_ply_frame(cloud, chosen)
        source += f", turned to {PLY_FRAME}"
    return replace(cloud, record=replace(record, frame=chosen, frame_source=source))
