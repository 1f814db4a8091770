"""Conventions in which captures are written, and notes on what a reader decided about them.

A coordinate frame is three letters, the directions of x, y and z: one each of R/L (right, left),
U/D (up, down) and F/B (forward, back), as in "RDF". A frame of the other handedness than RDF, such
as LUB, holds the mirror image of its object; the turn to the frame of a .ply mirrors it back.

A render model is the filter on the picture with which the Gaussians were trained. A renderer adds a
variance to each Gaussian on the picture, so that none falls between the pixels. Antialiased
training compensates it: opacities are multiplied by sqrt(det / det'). Files only say whether a
capture was trained so, and the program that writes this mark, Brush, trains as Mip-Splatting.
gsplat adds a larger variance and writes no mark.

References:
    Z. Yu, A. Chen, B. Huang, T. Sattler, A. Geiger. Mip-Splatting: alias-free 3D Gaussian
    splatting. 2024.
"""

import logging
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np

from . import spherical_harmonics
from .cloud import CaptureRecord, GaussianCloud, quaternion, quaternion_product

PLY_FRAME = "RDF"  # frame of captures in a .ply: right, down, forward
_AXES = ("RL", "DU", "FB")  # a letter of each pair; the first points along that axis of a .ply
RenderModel = Literal["classic", "antialiased", "mip"]
# [pixels^2] variance whose effect on the opacity is compensated; 0: nothing is compensated
COMPENSATED_LOWPASS: dict[RenderModel, float] = {"classic": 0.0, "antialiased": 0.3, "mip": 0.1}
log = logging.getLogger("vgmpi")


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
        sh = spherical_harmonics.rotate(cloud.sh, matrix)
    return replace(cloud, x=cloud.x @ matrix.T, quat=quat, sh=sh)


def _coefficient_signs(matrix: np.ndarray, count: int) -> np.ndarray:
    """Return the signs (count,) of SH coefficients under a diagonal matrix of signs (3, 3)."""
    units = np.repeat(np.eye(count)[:, :, None], 3, axis=2)
    return np.rint(np.diagonal(spherical_harmonics.rotate(units, matrix)[..., 0])).astype(
        np.float32
    )


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


def render_model(cloud: GaussianCloud) -> RenderModel:
    """Return the render model of a cloud."""
    if not cloud.is_antialiased:
        return "classic"
    return "mip" if cloud.lowpass < 0.2 else "antialiased"


def with_render_model(cloud: GaussianCloud, model: RenderModel) -> GaussianCloud:
    """Return the same Gaussians as trained by another render model."""
    lowpass = COMPENSATED_LOWPASS[model] or COMPENSATED_LOWPASS["mip"]
    return replace(cloud, is_antialiased=model != "classic", lowpass=lowpass)


def capture_notes(cloud: GaussianCloud) -> list[str]:
    """Return a clause for each decision, doubt and omission of the reader; none for plain files."""
    record = cloud.record
    if record is None:
        return []
    notes = []
    if record.frame_source:
        separator = f" {record.frame}: " if record.frame else " "
        notes.append(f"frame{separator}{record.frame_source}")
    if record.render_model_source:
        model = "antialiased" if cloud.is_antialiased else "not antialiased"
        notes.append(f"{model}: {record.render_model_source}")
    return [*notes, *record.doubts, *capture_extras(record)]


def capture_extras(record: CaptureRecord) -> list[str]:
    """Return a clause on the 3D filter of a file, if it has one, and one for each omission."""
    filtered = ["sizes and opacities contain the 3D filter of the file"]
    return [*(filtered if record.has_filter_3d else []), *record.omissions]


def log_capture_notes(name: str | Path, cloud: GaussianCloud) -> None:
    """Log the notes on a capture in one line, if there are any.

    Args:
        name: Name of the object or path of the file, the beginning of the line.
        cloud: Cloud as read.
    """
    notes, record = capture_notes(cloud), cloud.record
    if notes and record is not None:
        level = logging.WARNING if record.doubts or record.omissions else logging.INFO
        log.log(level, "%s: %s", name, "; ".join(notes))
