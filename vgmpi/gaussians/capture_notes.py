"""Text on what a reader decided, doubted or left out of a capture's file."""

import logging
from pathlib import Path

from .capture_record import CaptureRecord
from .cloud import GaussianCloud

log = logging.getLogger("vgmpi")


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
