"""Reader and writer of SOG files, spatially ordered Gaussians (PlayCanvas), as one ZIP archive.

A .sog holds meta.json and lossless WebP pictures with a pixel per Gaussian, row by row. Version 2
and the older layout without a version are read; version 2 is written. Members,
pictures and counts are bounded by the size of the archive before they are unpacked. SuperSplat,
PlayCanvas and Spark read these files, also as streams.

The specification names the axes right, up, back; the programs of its authors write the axes of a
.ply unchanged. Here, as there, a cloud is what its .ply would hold.

References:
    https://developer.playcanvas.com/user-manual/gaussian-splatting/formats/sog
"""

import io
import json
import os
import struct
import warnings
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from vgmpi.gaussians.cloud import OTHER_AXES, CaptureRecord, GaussianCloud, complete_quaternions
from vgmpi.gaussians.spherical_harmonics import degree_omissions
from vgmpi.runtime.user_files import replace_file

from .json_header import JsonObject, parse_header, printable_text
from .residual_coding import morton_order
from .validation import Columns, GaussianFileError, naming_file, read_validated, validate_count

_META = "meta.json"
_CODEBOOK = 256  # values that a byte selects
PALETTE = 1 << 16  # view-dependent colors that a written file can hold
_PALETTE_WIDTH, _PALETTE_HEIGHT = 64, 1024  # entries in a row of their picture, and most rows
_TERMS = (0, 3, 8, 15, 24)  # higher coefficients per channel by degree
_READ_TERMS = 15  # higher coefficients that are kept; degree 4 is dropped
_DIRECTORY_LIMIT = 1 << 17  # [bytes] of an archive's list of members; real ones take 600
_ROW_BYTES = 24  # [bytes] of a Gaussian in unpacked pictures
_FREE, _RATIO = 1 << 22, 200  # [bytes] that any file may expand to; factor for a large file
_MARGIN = 1 << 20  # [bytes] by which a member may be larger than the archive
_SPARE_PIXELS = 1 << 16  # [pixels] of a picture that hold no Gaussian, beside three in four
_LEADING = 252  # byte of a quaternion whose first component is left out
_ZIP_ERRORS = (
    zipfile.BadZipFile, NotImplementedError, RuntimeError, ValueError, EOFError, KeyError,
    OverflowError, struct.error, zlib.error,
)  # fmt: skip
_MIN_SCALE = 1e-9  # [m] sizes below have no logarithm worth keeping
_ROUNDS = 12  # iterations of Lloyd's method for a codebook
_COMPONENTS = 6  # principal components by which a palette is searched
_DATE = (1980, 1, 1, 0, 0, 0)  # of the archive's members: the same Gaussians give the same bytes


def read(path: str | Path) -> GaussianCloud:
    """Return the Gaussians of a .sog file in the file's order.

    Raises:
        GaussianFileError: If the file is not readable.
    """
    with naming_file(path), open(path, "rb") as file:
        archive = _Archive(file)
        meta = parse_header(archive.member(_META))
        version = meta.integer("version", 1, low=1, high=1 << 30)
        if version not in (1, 2):
            raise GaussianFileError(f"is of version {version}: allowed are 1 and 2")
        count = meta.integer("count") if version == 2 else _count_of_version_1(meta)
        if _ROW_BYTES * validate_count(count) > max(_FREE, _RATIO * archive.size):
            raise GaussianFileError(
                f"claims {count:,} Gaussians out of {archive.size:,} bytes: made to fill the memory"
            )
        record, is_antialiased = _record(meta, version)
        cloud = read_validated(count, _decoder(meta, archive, count, version), record)
        return replace(cloud, is_antialiased=is_antialiased)


def _count_of_version_1(meta: JsonObject) -> int:
    """Return the number of Gaussians of a file without a version."""
    if "means" not in meta:
        raise GaussianFileError(f"has no 'means' in its {_META}: no cloud of Gaussians?")
    shape = meta.child("means").items("shape")
    count = shape[0] if shape else None
    if not isinstance(count, int) or isinstance(count, bool) or count < 0:
        raise GaussianFileError("has no number of Gaussians in means.shape")
    return count


def _record(meta: JsonObject, version: int) -> tuple[CaptureRecord, bool]:
    """Return what the header tells of the file, and whether its training was antialiased."""
    model = meta.text("model", "default")
    is_antialiased = model == "antialiased" or meta.values.get("antialias") is True
    source, doubts = "", []
    omissions: list[str] = []
    if is_antialiased:
        key = f'"model": "{model}"' if model == "antialiased" else '"antialias": true'
        source = f"{_META} says {key}"
    elif model == "2dgs":
        doubts.append("the Gaussians are flat discs of 2DGS, drawn here as thin ellipsoids")
    elif model != "default":
        doubts.append(f"{_META} names the unknown model {printable_text(model, 30)!r}")
    if "shN" in meta and meta.child("shN").values.get("bands") == 4:
        omissions += degree_omissions(4)
    asset = meta.child("asset") if "asset" in meta else JsonObject({}, "asset")
    generator = printable_text(asset.text("generator", ""))
    record = CaptureRecord(
        encoding=f".sog, version {version}",
        render_model_source=source,
        comments=(f"generator: {generator}",) if generator else (),
        doubts=tuple(doubts),
        omissions=tuple(omissions),
    )
    return record, is_antialiased


class _BoundedReads:
    """File whose reads are bounded while the list of an archive's members is read."""

    def __init__(self, file: BinaryIO):
        self.file, self.is_bounded = file, True
        self.seek, self.tell, self.seekable = file.seek, file.tell, file.seekable

    def read(self, size: int = -1) -> bytes:
        """Return the next bytes."""
        if not self.is_bounded:
            return self.file.read(size)
        limit = _DIRECTORY_LIMIT + 1
        data = self.file.read(min(size, limit) if size >= 0 else limit)
        if len(data) > _DIRECTORY_LIMIT:
            raise GaussianFileError("has a list of members that is too long for a .sog")
        return data


class _Archive:
    """ZIP archive whose members are bounded by its own size."""

    def __init__(self, file: BinaryIO):
        self.size = os.fstat(file.fileno()).st_size
        if file.read(2) != b"PK":
            raise GaussianFileError("is not a .sog file (no ZIP archive)")
        bounded = _BoundedReads(file)
        try:
            self.archive = zipfile.ZipFile(bounded)  # type: ignore[arg-type]
        except GaussianFileError:
            raise
        except _ZIP_ERRORS as error:
            reason = printable_text(str(error))
            raise GaussianFileError(f"is no readable ZIP archive ({reason}): truncated?") from None
        bounded.is_bounded = False

    def member(self, name: str) -> bytes:
        """Return the bytes of a member."""
        try:
            member = self.archive.getinfo(name)
        except KeyError:
            raise GaussianFileError(f"has no {printable_text(name)!r} in its archive") from None
        limit = self.size + _MARGIN
        if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise GaussianFileError(f"has {name!r} packed by another method than deflate")
        if member.file_size > limit:
            size = f"{member.file_size:,} bytes out of {self.size:,}"
            raise GaussianFileError(
                f"has {printable_text(name)!r} of {size}: made to fill the memory"
            )
        try:
            with self.archive.open(member) as stream:
                return stream.read(limit)
        except (*_ZIP_ERRORS, OSError) as error:
            damaged, reason = printable_text(name), printable_text(str(error))
            message = f"has a damaged {damaged!r} in its archive ({reason})"
            raise GaussianFileError(message) from None

    def pixels(self, table: JsonObject, index: int, count: int) -> np.ndarray:
        """Return the pixels of a picture that a table names, (count, 4) bytes.

        Args:
            table: Table with the names of its pictures.
            index: Number of the picture.
            count: Number of the first pixels, one per Gaussian.
        """
        picture, name = self.picture(table, index, 4 * count + _SPARE_PIXELS)
        pixels = picture.reshape(-1, 4)
        if len(pixels) < count:
            raise GaussianFileError(
                f"has {len(pixels):,} pixels in {name!r} for {count:,} Gaussians"
            )
        return pixels[:count]

    def picture(self, table: JsonObject, index: int, max_count: int) -> tuple[np.ndarray, str]:
        """Return a picture (height, width, 4) in bytes, and its printable name.

        Args:
            table: Table with the names of its pictures.
            index: Number of the picture.
            max_count: Most pixels that it may have.
        """
        files = table.items("files")
        name = files[index] if index < len(files) else None
        if not isinstance(name, str):
            raise GaussianFileError(f"has no picture {index} in {table.name}.files")
        label = printable_text(name)
        return _decoded_picture(self.member(name), label, max_count), label


def _decoded_picture(data: bytes, name: str, max_count: int) -> np.ndarray:
    """Decode a picture of at most `max_count` pixels, as (height, width, 4) bytes."""
    from PIL import Image  # only this format needs it

    def require_bound(width: int, height: int) -> None:
        """Check the number of pixels."""
        if width * height > max_count:
            raise GaussianFileError(
                f"has {width:,} x {height:,} pixels in {name!r}: expected at most {max_count:,}"
            )

    require_bound(*_webp_size(data))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of large pictures: they are bounded here
            with Image.open(io.BytesIO(data), formats=("WEBP", "PNG")) as image:
                require_bound(*image.size)
                return np.asarray(image.convert("RGBA"))
    except (GaussianFileError, MemoryError):
        raise
    except Exception as error:  # Pillow's readers raise anything
        reason = printable_text(str(error)) if "BytesIO" not in str(error) else "no WebP or PNG"
        raise GaussianFileError(f"has a broken picture {name!r} ({reason})") from None


def _webp_size(data: bytes) -> tuple[int, int]:
    """Return width and height of a WebP picture by its header; (0, 0) for other files."""
    if len(data) < 30 or data[:4] != b"RIFF" or data[8:12] != b"WEBP":
        return 0, 0
    if data[12:16] == b"VP8L":
        word = int.from_bytes(data[21:25], "little")
        return (word & 0x3FFF) + 1, (word >> 14 & 0x3FFF) + 1
    if data[12:16] == b"VP8X":
        return int.from_bytes(data[24:27], "little") + 1, int.from_bytes(data[27:30], "little") + 1
    width, height = struct.unpack_from("<HH", data, 26)
    return width & 0x3FFF, height & 0x3FFF


@dataclass(frozen=True)
class _Palette:
    """Higher colors: entries of bytes, the entry of each Gaussian, and the value of each byte."""

    entries: np.ndarray  # (k, terms, 3) bytes
    labels: np.ndarray  # (n,) numbers of entries
    codebook: np.ndarray  # (256,)

    def colors(self, start: int, stop: int) -> np.ndarray:
        """Return coefficients (n, terms, 3); NaN where an entry does not exist."""
        labels = self.labels[start:stop].astype(np.int64)
        exists = labels < len(self.entries)
        colors = self.codebook[self.entries[np.where(exists, labels, 0)]]
        colors[~exists] = np.nan
        return colors[:, :_READ_TERMS]


def _decoder(
    meta: JsonObject, archive: _Archive, count: int, version: int
) -> Callable[[int, int], Columns]:
    """Return the function that decodes a range of Gaussians."""
    means, scales, sh0 = meta.child("means"), meta.child("scales"), meta.child("sh0")
    low = means.numbers("mins", 3)
    extent = means.numbers("maxs", 3) - low
    lower, upper = archive.pixels(means, 0, count), archive.pixels(means, 1, count)
    quats = archive.pixels(meta.child("quats"), 0, count)
    sizes, colors = archive.pixels(scales, 0, count), archive.pixels(sh0, 0, count)
    log_size = _lookup(scales, version, 3)
    dc, opacity = _lookup(sh0, version, 3), _opacities(sh0, version)
    palette = _read_palette(meta.child("shN"), archive, count, version) if "shN" in meta else None

    def decoded(start: int, stop: int) -> Columns:
        """Decode a range of pixels to columns."""
        steps = lower[start:stop, :3] + 256.0 * upper[start:stop, :3]
        values = low + extent * (steps / 65535)
        sh = dc(colors[start:stop, :3])[:, None, :]
        if palette is not None:
            sh = np.concatenate([sh, palette.colors(start, stop)], axis=1)
        return (
            np.sign(values) * np.expm1(np.abs(values)),
            _read_rotation(quats[start:stop]),
            np.exp(log_size(sizes[start:stop, :3])),
            opacity[colors[start:stop, 3]],
            sh,
        )

    return decoded


def _read_codebook(table: JsonObject) -> np.ndarray:
    """Return the values of the bytes 0 to 255; NaN where there is none."""
    codebook = table.numbers("codebook", 1, _CODEBOOK)
    return np.pad(codebook, (0, _CODEBOOK - len(codebook)), constant_values=np.nan)


def _lookup(table: JsonObject, version: int, axes: int) -> Callable[[np.ndarray], np.ndarray]:
    """Return the function of bytes (n, axes) to values: a codebook, or bounds in version 1."""
    if version == 2:
        codebook = _read_codebook(table)
        return lambda steps: codebook[steps]
    low = table.numbers("mins", axes, 4)[:axes]
    extent = table.numbers("maxs", axes, 4)[:axes] - low
    return lambda steps: low + extent * (steps / 255)


def _opacities(table: JsonObject, version: int) -> np.ndarray:
    """Return the opacities of the bytes 0 to 255; version 1 bounds their logits."""
    steps = np.arange(256) / 255
    if version == 2:
        return steps
    low, high = table.numbers("mins", 4)[3], table.numbers("maxs", 4)[3]
    with np.errstate(over="ignore"):
        return 1 / (1 + np.exp(-(low + (high - low) * steps)))


def _read_palette(
    table: JsonObject, archive: _Archive, count: int, version: int
) -> _Palette | None:
    """Return the view-dependent colors; None of degree 0."""
    allowed = _TERMS[1:] if version == 1 else (_TERMS[table.integer("bands", high=4)],)
    if allowed == (0,):
        return None
    picture, name = archive.picture(table, 0, _PALETTE_WIDTH * _TERMS[-1] * _PALETTE_HEIGHT)
    width = picture.shape[1]
    terms, odd_pixels = divmod(width, _PALETTE_WIDTH)
    if odd_pixels or terms not in allowed:
        message = f"has {name!r} with a width of {width} pixels: not that of its degree"
        raise GaussianFileError(message)
    entries = picture[..., :3].reshape(-1, terms, 3)
    if version == 2:
        size = table.integer("count", low=1)
        if size > len(entries):
            raise GaussianFileError(f"has {len(entries):,} of {size:,} colors in {name!r}")
        entries, codebook = entries[:size], _read_codebook(table)
    else:
        low, high = table.number("mins"), table.number("maxs")
        codebook = low + (high - low) * np.arange(_CODEBOOK) / 255
    pixels = archive.pixels(table, 1, count)
    labels = pixels[:, 0] + (pixels[:, 1].astype(np.uint16) << 8)
    return _Palette(entries, labels, codebook)


def _read_rotation(pixels: np.ndarray) -> np.ndarray:
    """Decode quaternions w, x, y, z (n, 4) of three bytes and the number of the leading one."""
    leading = pixels[:, 3].astype(np.int64) - _LEADING
    valid = leading >= 0
    leading = np.where(valid, leading, 0)
    small = (pixels[:, :3] / 255.0 - 0.5) * np.sqrt(2)
    quat = complete_quaternions(leading, small)
    quat[~valid] = 0.0
    return quat


def write(path: str | Path, cloud: GaussianCloud) -> None:
    """Write `cloud` in its axes, in the order of a Morton curve.

    Raises:
        GaussianFileError: If the cloud is empty.
        OSError: If the file cannot be written.
    """
    if not len(cloud):
        raise GaussianFileError(f"{path}: a .sog holds at least one Gaussian")
    spacing = float(np.ptp(cloud.x, axis=0).max()) / 1024 or 1.0
    cloud = cloud.select(morton_order(cloud.x, spacing))
    width = 4 * -(-int(np.ceil(np.sqrt(len(cloud)))) // 4)
    meta: dict[str, Any] = {"version": 2, "asset": {"generator": "vgmpi"}, "count": len(cloud)}
    if cloud.is_antialiased:  # as splat-transform has it, and as the format was proposed
        meta |= {"model": "antialiased", "antialias": True}
    pictures: dict[str, np.ndarray] = {}
    _add_positions(meta, pictures, cloud)
    _add_shapes(meta, pictures, cloud)
    _add_colors(meta, pictures, cloud)
    data = io.BytesIO()
    with zipfile.ZipFile(data, "w") as archive:
        archive.writestr(zipfile.ZipInfo(_META, _DATE), json.dumps(meta))
        for name, rows in pictures.items():
            picture = rows if rows.ndim == 3 else _picture(rows, width)
            archive.writestr(zipfile.ZipInfo(name, _DATE), _webp(picture))
    replace_file(path, data.getvalue())


def _add_positions(meta: dict, pictures: dict, cloud: GaussianCloud) -> None:
    """Add the positions, 16 bits of sign(x) log(1 + |x|) per axis."""
    values = np.sign(cloud.x) * np.log1p(np.abs(cloud.x))
    low, high = values.min(axis=0), values.max(axis=0)
    steps = np.rint((values - low) / np.maximum(high - low, 1e-30) * 65535).astype(np.uint16)
    files = ["means_l.webp", "means_u.webp"]
    meta["means"] = {"mins": low.tolist(), "maxs": high.tolist(), "files": files}
    pictures["means_l.webp"] = (steps & 255).astype(np.uint8)
    pictures["means_u.webp"] = (steps >> 8).astype(np.uint8)


def _add_shapes(meta: dict, pictures: dict, cloud: GaussianCloud) -> None:
    """Add the logarithms of the sizes by a codebook, and the rotations by three components."""
    codebook, labels = _fit_codebook(np.log(np.maximum(cloud.scale, _MIN_SCALE)))
    meta["scales"] = {"codebook": codebook.tolist(), "files": ["scales.webp"]}
    pictures["scales.webp"] = labels
    leading_index = np.abs(cloud.quat).argmax(axis=1)
    leading = np.take_along_axis(cloud.quat, leading_index[:, None], axis=1)
    quat = cloud.quat * np.where(leading < 0, -1.0, 1.0)
    small = np.take_along_axis(quat, OTHER_AXES[leading_index], axis=1)
    rows = np.empty((len(cloud), 4), np.uint8)
    rows[:, :3] = np.rint(np.clip(small * np.sqrt(0.5) + 0.5, 0, 1) * 255)
    rows[:, 3] = _LEADING + leading_index
    meta["quats"] = {"files": ["quats.webp"]}
    pictures["quats.webp"] = rows


def _add_colors(meta: dict, pictures: dict, cloud: GaussianCloud) -> None:
    """Add colors and opacities, and the view dependence by a palette."""
    codebook, labels = _fit_codebook(cloud.sh[:, 0].astype(np.float64))
    opacity = np.rint(np.clip(cloud.opacity, 0, 1) * 255).astype(np.uint8)
    meta["sh0"] = {"codebook": codebook.tolist(), "files": ["sh0.webp"]}
    pictures["sh0.webp"] = np.column_stack([labels, opacity])
    higher = cloud.sh[:, 1:].astype(np.float64)
    if not higher.any():
        return
    palette, entries = _fit_palette(higher)
    codebook, codes = _fit_codebook(palette)
    count, terms = palette.shape[:2]
    rows = -(-count // _PALETTE_WIDTH)
    centroids = np.zeros((rows * _PALETTE_WIDTH, terms, 3), np.uint8)
    centroids[:count] = codes
    files = ["shN_centroids.webp", "shN_labels.webp"]
    meta["shN"] = {
        "count": count, "bands": round((terms + 1) ** 0.5) - 1, "codebook": codebook.tolist(),
        "files": files,
    }  # fmt: skip
    pictures["shN_centroids.webp"] = centroids.reshape(rows, _PALETTE_WIDTH * terms, 3)
    labels = np.zeros((len(cloud), 3), np.uint8)
    labels[:, 0], labels[:, 1] = entries & 255, entries >> 8
    pictures["shN_labels.webp"] = labels


def _fit_codebook(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return 256 numbers and the index (uint8) of the nearest one for each value."""
    flat = np.sort(values, axis=None)
    unique = np.unique(flat)
    if len(unique) <= _CODEBOOK:
        book = np.concatenate([unique, np.full(_CODEBOOK - len(unique), unique[-1])])
    else:  # half of the first guess follows the density, half the range
        density = flat[np.linspace(0, len(flat) - 1, _CODEBOOK // 2).astype(int)]
        book = np.sort(np.concatenate([density, np.linspace(flat[0], flat[-1], _CODEBOOK // 2)]))
        totals = np.concatenate([[0.0], np.cumsum(flat)])
        for _ in range(_ROUNDS):
            edges = np.searchsorted(flat, 0.5 * (book[1:] + book[:-1]))
            edges = np.concatenate([[0], edges, [len(flat)]])
            count = np.diff(edges)
            mean = np.diff(totals[edges]) / np.maximum(count, 1)
            book = np.sort(np.where(count > 0, mean, book))
    labels = np.searchsorted(0.5 * (book[1:] + book[:-1]), values).astype(np.uint8)
    return book, labels


def _fit_palette(higher: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return palette entries (k, terms, 3) and the entry of each Gaussian (n,).

    Entry 0 has no view dependence. Up to PALETTE - 1 others have an entry of their own; beyond,
    a sample of them stands for all.
    """
    rows = higher.reshape(len(higher), -1)
    shiny = np.flatnonzero(rows.any(axis=1))
    entries = np.zeros(len(rows), np.int64)
    chosen = shiny
    if len(shiny) >= PALETTE:
        from scipy.spatial import cKDTree  # only large clouds need it

        chosen = np.random.default_rng(0).choice(shiny, PALETTE - 1, replace=False)
        axes = np.linalg.svd(rows[chosen[:4096]], full_matrices=False)[2][:_COMPONENTS].T
        entries[shiny] = 1 + cKDTree(rows[chosen] @ axes).query(rows[shiny] @ axes)[1]
    else:
        entries[shiny] = 1 + np.arange(len(shiny))
    palette = np.concatenate([np.zeros((1, *higher.shape[1:])), higher[chosen]])
    return palette, entries


def _picture(rows: np.ndarray, width: int) -> np.ndarray:
    """Return rows (n, channels) as a picture (height, width, channels) filled with zeros."""
    height = -(-len(rows) // width)
    out = np.zeros((height * width, rows.shape[1]), np.uint8)
    out[: len(rows)] = rows
    return out.reshape(height, width, rows.shape[1])


def _webp(picture: np.ndarray) -> bytes:
    """Return a lossless WebP file; `exact` keeps colors where the fourth channel is 0."""
    from PIL import Image  # only this format needs it

    data = io.BytesIO()
    Image.fromarray(picture).save(data, "webp", lossless=True, exact=True, quality=60, method=4)
    return data.getvalue()
