"""Integrity of frames and gaussians.h5: checksums first, then types, shapes and ranges.

Data that differ from what was written never reach a kernel.
"""

import json
from types import SimpleNamespace

import h5py
import numpy as np

from vgmpi.gaussians.capture_conventions import COMPENSATED_LOWPASS

from . import checkpoint_manifest, file_layout, hdf5_validation
from .hdf5_validation import CorruptFileError

FRAME_FORMS = file_layout.named(file_layout.FRAME)
GAUSSIAN_FORMS = {
    prefix + d.name: d
    for prefix, rows in (
        ("", file_layout.GAUSSIAN), ("scenery/", file_layout.SCENERY), ("passive/",
        file_layout.PASSIVE),
    )
    for d in rows
}  # fmt: skip


def read_checksums(f: h5py.File) -> dict[str, int]:
    """Return the CRC32 of each dataset by its name. Raises CorruptFileError."""
    if file_layout.CRC not in f:
        raise CorruptFileError("it has no checksums")
    try:
        result = json.loads(f[file_layout.CRC][()])
    except (ValueError, RecursionError):
        result = None
    if not isinstance(result, dict):
        raise CorruptFileError("its checksums cannot be read")
    return result


def verify_checksums(f: h5py.File, read_data: dict) -> None:
    """Compare datasets with their checksums.

    Args:
        f: The file.
        read_data: Datasets as they were read, by name.

    Raises:
        CorruptFileError: A dataset is not what was written, or one that was written is missing.
    """
    want = read_checksums(f)
    missing = [name for name in want if name not in f]
    if missing:
        raise CorruptFileError(f"there is no {missing[0]}")
    for name, rows in read_data.items():
        if name not in want:
            raise CorruptFileError(f"{name} has no checksum")
        if isinstance(rows, bytes):
            rows = np.frombuffer(rows, np.uint8)
        if checkpoint_manifest.crc(np.ascontiguousarray(rows)) != want[name]:
            raise CorruptFileError(f"{name} is not what was written")


def _check_head(f, expected):
    """Check that the file names its schema and holds nothing that such a file does not have."""
    if "schema" not in f.attrs:
        raise CorruptFileError("it names no schema")
    foreign = sorted(set(f) - expected)
    if foreign:
        raise CorruptFileError(f"it holds {foreign[0]!a:.60}, which is not of such a file")


def check_frame(
    f: h5py.File, number: int | None, read_data: dict, particles: int | None = None
) -> None:
    """Check datasets of a frame.

    Args:
        f: The file.
        number: Number according to the file's name, None if unknown.
        read_data: Datasets as they were read, by name.
        particles: Identity of the gaussians.h5 beside it, None if unknown.

    Raises:
        CorruptFileError: The data are damaged, or the file is of another frame or of other
            particles.
    """
    _check_head(f, {"VTKHDF", *(d.name for d in file_layout.FRAME_OWN)})
    own = {d.name: f[d.name][()] for d in file_layout.FRAME_OWN if d.name in f}
    own.pop(file_layout.CRC, None)
    verify_checksums(f, {**read_data, **own})
    if number is not None and int(own["frame"]) != number:
        raise CorruptFileError(f"it is frame {int(own['frame'])}, not {number}")
    if particles is not None and own.get("gaussians_crc", particles) != particles:
        raise CorruptFileError(f"it is of other particles than {file_layout.GAUSSIANS} beside it")


def series_frames(f: h5py.File) -> list[int]:
    """Return the numbers of the frames that series.vtkhdf refers to. Raises CorruptFileError."""
    _check_head(f, {"VTKHDF", *(d.name for d in file_layout.SERIES_OWN)})
    numbers = f["frames"][()]
    verify_checksums(f, {"frames": numbers})
    return numbers.tolist()


def check_series(f: h5py.File) -> None:
    """Check that series.vtkhdf refers to the right rows of each frame. Raises CorruptFileError."""
    series_frames(f)
    names = hdf5_validation.datasets(f)
    virtual = [name for name in names if f[name].is_virtual]
    read_data = {
        name: f[name][()] for name in names if name not in virtual and name != file_layout.CRC
    }
    verify_checksums(f, read_data)
    numbers, counts = read_data["frames"].tolist(), read_data["VTKHDF/NumberOfPoints"].tolist()
    for name in virtual:
        rows, offset, want = counts, 0, []
        if "FieldData" in name:
            rows = [1] * len(counts)
        elif name.endswith("Offsets"):
            rows = [count + 1 for count in counts]
        for number, count in zip(numbers, rows, strict=True):
            if count:
                want.append((number, f"/{name}", offset, offset + count - 1))
            offset += count
        if f[name].shape[0] != offset or hdf5_validation.virtual_sources(f[name]) != want:
            raise CorruptFileError(f"{name} is not put together of its frames")


def check_arrays(arrays: dict[str, np.ndarray], count: int) -> None:
    """Check the arrays of a frame of `count` particles. Raises CorruptFileError."""
    for name, rows in arrays.items():
        form = FRAME_FORMS.get(name)
        if form is None:
            raise CorruptFileError(f"{name!a:.60} is no field of a frame")
        if rows.ndim == 0 or len(rows) != count:
            raise CorruptFileError(f"{name} should have {count} rows")
        if not file_layout.fits(form, rows):
            raise CorruptFileError(
                f"{name} is {rows.dtype} {rows.shape}, not {form.dtype} {form.shape}"
            )
    ids = arrays["id"]
    if len(ids) and (ids[0] < 0 or (np.diff(ids) <= 0).any()):
        raise CorruptFileError("id does not ascend")


def checked_poses(rows: np.ndarray) -> np.ndarray:
    """Return the poses of a frame after a check. Raises CorruptFileError."""
    form = file_layout.named(file_layout.FRAME_OWN)["poses"]
    if not file_layout.fits(form, rows) or not np.isfinite(rows).all():
        raise CorruptFileError(
            f"poses are {rows.dtype} {rows.shape}, not {form.dtype} {form.shape}"
        )
    return rows


def check_gaussians(f: h5py.File, read_data: dict) -> None:
    """Check the datasets of gaussians.h5.

    Args:
        f: The file.
        read_data: Arrays and texts by their names in the file.

    Raises:
        CorruptFileError: They are not what was written, or have impossible values.
    """
    texts = {d.name for d in file_layout.GAUSSIAN_TEXTS}
    _check_head(f, {name.partition("/")[0] for name in GAUSSIAN_FORMS} | texts)
    verify_checksums(f, read_data)
    for name, rows in read_data.items():
        if name in texts:
            continue
        form = GAUSSIAN_FORMS[name]
        first = read_data[name.rpartition("/")[0] + "/x0" if "/" in name else "x0"]
        if rows.ndim == 0 or not file_layout.fits(form, rows) or len(rows) != len(first):
            raise CorruptFileError(
                f"{name} is {rows.dtype} {rows.shape}, not {form.dtype} {form.shape}"
            )
        if rows.dtype.kind == "f" and not np.isfinite(rows).all():
            raise CorruptFileError(f"{name} holds what is no number")
        if form.name == "sh" and rows.shape[1] not in (1, 4, 9, 16):
            raise CorruptFileError(f"{name} has {rows.shape[1]} coefficients, not 1, 4, 9 or 16")
        if form.name == "shade" and not ((rows > 0) & (rows <= 1)).all():
            raise CorruptFileError(f"{name} holds what is not above 0 and at most 1")


def check_objects(gaussians: SimpleNamespace) -> None:
    """Check the objects of gaussians.h5 and all references to them. Raises CorruptFileError."""
    objects = gaussians.objects
    if not isinstance(objects, list) or not all(isinstance(entry, dict) for entry in objects):
        raise CorruptFileError("objects is no list of objects")
    for entry in objects:
        if str(entry.get("render_model", "classic")) not in COMPENSATED_LOWPASS:
            raise CorruptFileError("objects names a render model that is not known")
    if not isinstance(gaussians.scene, dict):
        raise CorruptFileError("scene is no scene")
    for prefix in ("", "scenery/", "passive/"):
        part = gaussians if not prefix else getattr(gaussians, prefix[:-1])
        rows = None if part is None else part.object
        if rows is not None and len(rows) and not 0 <= rows.min() <= rows.max() < len(objects):
            raise CorruptFileError(f"{prefix}object names objects that are not there")
    if gaussians.passive is not None and len(gaussians.passive.x0):
        carriers = gaussians.passive.carriers
        if not 0 <= carriers.min() <= carriers.max() < len(gaussians.x0):
            raise CorruptFileError("passive/carriers names particles that are not there")
