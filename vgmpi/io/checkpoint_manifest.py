"""Manifest of a checkpoint: its checksums, and their comparison with the file.

A flushed but unfinished HDF5 file opens and looks complete, so completeness is recorded explicitly:
the manifest is written last and holds a CRC32 per dataset and chunk of file_layout.CRC_ROWS rows.
"""

import json
import re
import zlib
from collections.abc import Iterable
from pathlib import Path

import h5py
import numpy as np

from vgmpi.runtime import user_files

from . import file_layout, hdf5_validation

MAX_BYTES = 1 << 30  # [bytes] largest size of a manifest (about ten bytes per chunk)
POLYNOMIAL = 0xEDB88320  # generator of CRC-32, bits reversed


class InvalidCheckpoint(Exception):
    """A checkpoint is not valid; its text is one line without the file's name."""


def path_of(checkpoint: Path) -> Path:
    """Return the path of a checkpoint's manifest."""
    return checkpoint.with_suffix(".json")


def crc(rows: np.ndarray, value: int = 0) -> int:
    """Return the CRC32 of the bytes of a contiguous array."""
    return zlib.crc32(rows.reshape(-1).view(np.uint8).data, value) if rows.size else value


def chunk_checksums(start: int, rows: np.ndarray) -> list[tuple[int, int, int]]:
    """Return (chunk number, CRC32, bytes) of each part of `rows` that lies in one chunk.

    `start` is the row of the file at which `rows` begins.
    """
    result = []
    first, end = start, start + len(rows)
    while first < end:
        chunk = first // file_layout.CRC_ROWS
        last = min(end, (chunk + 1) * file_layout.CRC_ROWS)
        part = rows[first - start : last - start]
        result.append((chunk, crc(part), part.nbytes))
        first = last
    return result


def combine_checksums(parts: Iterable[tuple[int, int, int]], chunks: int) -> list[int]:
    """Return the CRC32 of each chunk from its pieces, in the order of their rows."""
    crcs = [0] * chunks
    for chunk, value, size in parts:
        crcs[chunk] = combine(crcs[chunk], value, size)
    return crcs


def chunks_of(shape: tuple[int, ...]) -> int:
    """Return the number of chunks of a dataset."""
    return -(-shape[0] // file_layout.CRC_ROWS) if shape else 1


def combine(first: int, second: int, size: int) -> int:
    """Return the CRC32 of two consecutive texts from their CRCs.

    Appending a byte multiplies the first one's polynomial by x^8; see crc32_combine in zlib's
    crc32.c.

    Args:
        first: CRC32 of the first text.
        second: CRC32 of the second text.
        size: Length of the second text [bytes].
    """
    if first == 0:
        return second
    power, square, bits = 1 << 31, 1 << 30, 8 * size  # x^0 and x^1, highest power in the lowest bit
    while bits:
        if bits & 1:
            power = _multiply(square, power)
        square = _multiply(square, square)
        bits >>= 1
    return _multiply(power, first) ^ second


def _multiply(a, b):
    """Return the product of two polynomials modulo the CRC's generator."""
    product, bit = 0, 1 << 31
    while bit:
        if a & bit:
            product ^= b
        b = (b >> 1) ^ POLYNOMIAL if b & 1 else b >> 1
        bit >>= 1
    return product


def load(checkpoint: Path) -> dict:
    """Return the manifest of a checkpoint after a check of all types. Raises Broken."""
    try:
        text = user_files.read_regular_file(path_of(checkpoint), MAX_BYTES, follow=False)
        manifest = json.loads(text)
    except FileNotFoundError:
        raise InvalidCheckpoint("it has no manifest: writing it was not finished") from None
    except (OSError, ValueError, RecursionError):
        raise InvalidCheckpoint("its manifest is not readable") from None
    schema = manifest.get("schema") if isinstance(manifest, dict) else None
    if schema != file_layout.SCHEMA:
        raise InvalidCheckpoint(
            f"its schema is {schema!r:.20}, this program's {file_layout.SCHEMA}"
        )
    if not _is_count(manifest.get("bytes")) or not isinstance(manifest.get("datasets"), dict):
        raise InvalidCheckpoint("its manifest is not readable")
    for name, entry in manifest["datasets"].items():
        if not isinstance(entry, dict) or set(entry) != {"shape", "dtype", "crc"}:
            raise InvalidCheckpoint(f"its manifest does not tell of {name!r:.60}")
        lists = (entry["shape"], entry["crc"])
        if not all(isinstance(numbers, list) and all(map(_is_count, numbers)) for numbers in lists):
            raise InvalidCheckpoint(f"its manifest does not tell of {name!r:.60}")
    return manifest


def _is_count(value: object) -> bool:
    """Return True for a non-negative integer."""
    return isinstance(value, int) and not isinstance(value, bool) and value >= 0


def check(checkpoint: Path, share: int = 0, shares: int = 1) -> None:
    """Compare a checkpoint with its manifest.

    Args:
        checkpoint: File of the checkpoint.
        share: First chunk that is compared.
        shares: Distance between chunks that are compared; everything else is compared always.

    Raises:
        Broken: They differ.
    """
    manifest = load(checkpoint)
    if checkpoint.is_symlink():
        raise InvalidCheckpoint("it is a link to elsewhere")
    try:
        size = checkpoint.stat().st_size
    except OSError:
        raise InvalidCheckpoint("the file is missing") from None
    if size != manifest["bytes"]:
        raise InvalidCheckpoint(f"it has {size} bytes instead of {manifest['bytes']}")
    try:
        with h5py.File(checkpoint, "r") as f:
            hdf5_validation.check_structure(f)
            _compare(f, manifest, share, shares)
            _check_step(checkpoint, manifest, json.loads(f["attrs"][()]))
    except InvalidCheckpoint:
        raise
    except hdf5_validation.CorruptFileError as damaged:
        raise InvalidCheckpoint(str(damaged)) from None
    except Exception as error:  # a damaged file makes HDF5, h5py and json raise many types
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise InvalidCheckpoint(f"it is not readable ({reason})") from None


def _compare(f, manifest, share, shares):
    """Compare the datasets with their entries and every `shares`-th checksum."""
    datasets, turn = file_layout.named(file_layout.CHECKPOINT), 0
    odd = sorted(set(hdf5_validation.datasets(f)) ^ set(manifest["datasets"]))
    if odd:
        raise InvalidCheckpoint(f"{odd[0]} is in one of the file and its manifest alone")
    rows: dict[str, int] = {}
    for name, entry in manifest["datasets"].items():
        dataset = f[name]
        _check_form(name, dataset, entry)
        group, _, member = name.partition("/")
        if member:
            form = datasets.get(f"*/{member}")
            if form is None or not file_layout.fits(form, dataset):
                raise InvalidCheckpoint(
                    f"{name} is not as the layout has it: {dataset.dtype} {dataset.shape}"
                )
            kind = f"{group}{form.shape[:2]}"  # the first two characters are (n or (b
            if rows.setdefault(kind, len(dataset)) != len(dataset):
                raise InvalidCheckpoint(f"{name} has {len(dataset)} rows instead of {rows[kind]}")
        for chunk, expected in enumerate(entry["crc"]):
            if turn % shares == share and crc(_chunk(dataset, chunk)) != expected:
                raise InvalidCheckpoint(f"the checksum of {name}, chunk {chunk}, is wrong")
            turn += 1


def _check_form(name, dataset, entry):
    """Compare shape and type of a dataset with its entry."""
    if list(dataset.shape) != entry["shape"] or len(entry["crc"]) != chunks_of(dataset.shape):
        raise InvalidCheckpoint(
            f"{name} has shape {dataset.shape} instead of {tuple(entry['shape'])}"
        )
    if (dataset.dtype.str if dataset.dtype.kind != "S" else "text") != entry["dtype"]:
        raise InvalidCheckpoint(
            f"{name} has type {dataset.dtype.str} instead of {entry['dtype']!r:.20}"
        )


def _check_step(checkpoint, manifest, attrs):
    """Check that the file's name, its manifest and the file agree on step and time."""
    match = re.fullmatch(r"checkpoint_([0-9]+)\.h5", checkpoint.name)
    for step in ([int(match[1])] if match else []) + [manifest.get("step")]:
        if step != attrs["step"]:
            raise InvalidCheckpoint(f"it is of step {attrs['step']!r:.20}, not {step!r:.20}")
    if manifest.get("time") != attrs.get("time"):
        raise InvalidCheckpoint(
            f"it is of {attrs.get('time')!r:.30} s, not {manifest.get('time')!r:.30}"
        )


def _chunk(dataset, chunk):
    """Return the rows of a chunk, or the value of a scalar dataset."""
    if dataset.shape:
        return dataset[chunk * file_layout.CRC_ROWS : (chunk + 1) * file_layout.CRC_ROWS]
    value = dataset[()]
    if isinstance(value, bytes):
        return np.frombuffer(value, np.uint8)
    return np.asarray(value)
