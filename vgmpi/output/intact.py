"""Whether what is read of frames and of gaussians.h5 is what was written: checksums first, then
types, shapes and ranges, so that nothing else ever reaches a kernel."""

import json
from types import SimpleNamespace

import h5py
import numpy as np

from vgmpi.output import layout, manifest, plain
from vgmpi.output.plain import Damaged

FRAME_FORMS = layout.named(layout.FRAME)
GAUSSIAN_FORMS = {
    prefix + d.name: d
    for prefix, rows in (
        ("", layout.GAUSSIAN), ("scenery/", layout.SCENERY), ("passive/", layout.PASSIVE),
    )
    for d in rows
}  # fmt: skip


def sums(f: h5py.File) -> dict[str, int] | None:
    """CRC32 by the name of the dataset; None in files of earlier versions. Raises Damaged."""
    if layout.CRC not in f:
        return None
    try:
        found = json.loads(f[layout.CRC][()])
    except (ValueError, RecursionError):
        found = None
    if not isinstance(found, dict):
        raise Damaged("its checksums cannot be read")
    return found


def check_sums(f: h5py.File, held: dict) -> None:
    """held: datasets as they were read, by name. Raises Damaged where one is not what was written,
    and where one that was written is no longer there. Files of earlier versions pass."""
    want = sums(f)
    if want is None:
        return
    gone = [name for name in want if name not in f]
    if gone:
        raise Damaged(f"there is no {gone[0]}")
    for name, rows in held.items():
        if name not in want:
            raise Damaged(f"{name} has no checksum")
        if isinstance(rows, bytes):
            rows = np.frombuffer(rows, np.uint8)
        if manifest.crc(np.ascontiguousarray(rows)) != want[name]:
            raise Damaged(f"{name} is not what was written")


def _check_head(f, known):
    """Its schema, and that nothing lies in it that is not of such a file."""
    schema = int(f.attrs["schema"])
    if schema != layout.SCHEMA:
        raise plain.OtherSchema(f"its schema is {schema}, this program's {layout.SCHEMA}")
    foreign = sorted(set(f) - known)
    if foreign:
        raise Damaged(f"it holds {foreign[0]!a:.60}, which is not of such a file")


def check_frame(f: h5py.File, number: int | None, held: dict, of: int | None = None) -> None:
    """number: that its name says; of: identity of the gaussians.h5 beside it. Raises Damaged, also
    where it is another frame's file or one of other particles."""
    _check_head(f, {"VTKHDF", *(d.name for d in layout.FRAME_OWN)})
    if layout.CRC in f:
        said = f["frame"][()]
        named = {name: f[name][()] for name in ("gaussians", "poses") if name in f}
        check_sums(f, {**held, "frame": said, **named})
        if number is not None and int(said) != number:
            raise Damaged(f"it is frame {int(said)}, not {number}")
        if of is not None and named and int(named["gaussians"]) != of:
            raise Damaged(f"it is of other particles than {layout.GAUSSIANS} beside it")


def listed(f: h5py.File) -> list[int]:
    """Numbers of the frames that series.vtkhdf is put together of. Raises Damaged."""
    _check_head(f, {"VTKHDF", *(d.name for d in layout.SERIES_OWN)})
    if layout.CRC not in f:
        found = plain.sources(f["VTKHDF/FieldData/time"])
        return [number for number in found if number is not None]
    numbers = f["frames"][()]
    check_sums(f, {"frames": numbers})
    return numbers.tolist()


def check_series(f: h5py.File) -> None:
    """Raises Damaged where series.vtkhdf does not say of each number in its frames where it is."""
    listed(f)
    if layout.CRC not in f:
        return
    names = plain.datasets(f)
    virtual = [name for name in names if f[name].is_virtual]
    held = {name: f[name][()] for name in names if name not in virtual and name != layout.CRC}
    check_sums(f, held)
    numbers, counts = held["frames"].tolist(), held["VTKHDF/NumberOfPoints"].tolist()
    for name in virtual:
        rows, at, want = counts, 0, []
        if "FieldData" in name:
            rows = [1] * len(counts)
        elif name.endswith("Offsets"):
            rows = [count + 1 for count in counts]
        for number, count in zip(numbers, rows, strict=True):
            if count:
                want.append((number, f"/{name}", at, at + count - 1))
            at += count
        if f[name].shape[0] != at or plain.parts(f[name]) != want:
            raise Damaged(f"{name} is not put together of its frames")


def check_arrays(arrays: dict[str, np.ndarray], count: int) -> None:
    """Arrays of a frame of `count` particles. Raises Damaged."""
    for name, rows in arrays.items():
        form = FRAME_FORMS.get(name)
        if form is None:
            raise Damaged(f"{name!a:.60} is no field of a frame")
        if rows.ndim == 0 or len(rows) != count:
            raise Damaged(f"{name} should have {count} rows")
        if not layout.fits(form, rows):
            raise Damaged(f"{name} is {rows.dtype} {rows.shape}, not {form.dtype} {form.shape}")
    ids = arrays["id"]
    if len(ids) and (ids[0] < 0 or (np.diff(ids) <= 0).any()):
        raise Damaged("id does not ascend")


def poses(rows: np.ndarray) -> np.ndarray:
    """Those of a frame. Raises Damaged where they cannot be any."""
    form = layout.named(layout.FRAME_OWN)["poses"]
    if not layout.fits(form, rows) or not np.isfinite(rows).all():
        raise Damaged(f"poses are {rows.dtype} {rows.shape}, not {form.dtype} {form.shape}")
    return rows


def check_gaussians(f: h5py.File, held: dict) -> None:
    """held: arrays and texts by their names in gaussians.h5. Raises Damaged where they are not what
    was written, or cannot be."""
    texts = {d.name for d in layout.GAUSSIAN_TEXTS}
    _check_head(f, {name.partition("/")[0] for name in GAUSSIAN_FORMS} | texts)
    check_sums(f, held)
    for name, rows in held.items():
        if name in texts:
            continue
        form = GAUSSIAN_FORMS[name]
        first = held[name.rpartition("/")[0] + "/x0" if "/" in name else "x0"]
        if rows.ndim == 0 or not layout.fits(form, rows) or len(rows) != len(first):
            raise Damaged(f"{name} is {rows.dtype} {rows.shape}, not {form.dtype} {form.shape}")
        if rows.dtype.kind == "f" and not np.isfinite(rows).all():
            raise Damaged(f"{name} holds what is no number")
        if form.name == "sh" and rows.shape[1] not in (1, 4, 9, 16):
            raise Damaged(f"{name} has {rows.shape[1]} coefficients, not 1, 4, 9 or 16")
        if form.name == "shade" and not ((rows > 0) & (rows <= 1)).all():
            raise Damaged(f"{name} holds what is not above 0 and at most 1")


def check_objects(found: SimpleNamespace) -> None:
    """What gaussians.h5 says of objects, and what names them. Raises Damaged."""
    things = found.objects
    if not isinstance(things, list) or not all(isinstance(one, dict) for one in things):
        raise Damaged("objects is no list of objects")
    if not isinstance(found.scene, dict):
        raise Damaged("scene is no scene")
    for prefix in ("", "scenery/", "passive/"):
        part = found if not prefix else getattr(found, prefix[:-1])
        rows = None if part is None else part.object
        if rows is not None and len(rows) and not 0 <= rows.min() <= rows.max() < len(things):
            raise Damaged(f"{prefix}object names objects that are not there")
    if found.passive is not None and len(found.passive.x0):
        carriers = found.passive.carriers
        if not 0 <= carriers.min() <= carriers.max() < len(found.x0):
            raise Damaged("passive/carriers names particles that are not there")
