"""Checksums of a checkpoint: what its manifest says, and whether the file still agrees with it.

A flushed but unfinished HDF5 file opens and looks complete, so completeness is said explicitly: the
manifest is written last and holds a CRC32 per dataset and run of layout.CRC_ROWS rows.
"""

import json
import zlib
from collections.abc import Iterable
from pathlib import Path

import h5py
import numpy as np

from vgmpi.output import layout

POLYNOMIAL = 0xEDB88320  # of CRC-32, bits reversed


class Broken(Exception):
    """Why a checkpoint is not valid; one line without the file's name."""


def path_of(checkpoint: Path) -> Path:
    return checkpoint.with_suffix(".json")


def crc(rows: np.ndarray, value: int = 0) -> int:
    """CRC32 of the bytes of a contiguous array."""
    return zlib.crc32(rows.reshape(-1).view(np.uint8).data, value) if rows.size else value


def pieces(start: int, rows: np.ndarray) -> list[tuple[int, int, int]]:
    """(chunk number, CRC32, bytes) of each part of `rows`, which is in the file from row `start`
    on."""
    found = []
    first, end = start, start + len(rows)
    while first < end:
        chunk = first // layout.CRC_ROWS
        last = min(end, (chunk + 1) * layout.CRC_ROWS)
        part = rows[first - start : last - start]
        found.append((chunk, crc(part), part.nbytes))
        first = last
    return found


def join(parts: Iterable[tuple[int, int, int]], chunks: int) -> list[int]:
    """CRC32 of each chunk from its pieces, given in the order of their rows."""
    whole = [0] * chunks
    for chunk, value, size in parts:
        whole[chunk] = combine(whole[chunk], value, size)
    return whole


def chunks_of(shape: tuple[int, ...]) -> int:
    return -(-shape[0] // layout.CRC_ROWS) if shape else 1


def combine(first: int, second: int, size: int) -> int:
    """CRC32 of two texts in a row from their CRCs; `size` is the length of the second in bytes.

    Appending a byte multiplies the first's polynomial by x^8; see crc32_combine in zlib's crc32.c.
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
    """Product of two polynomials modulo that of the CRC."""
    product, bit = 0, 1 << 31
    while bit:
        if a & bit:
            product ^= b
        b = (b >> 1) ^ POLYNOMIAL if b & 1 else b >> 1
        bit >>= 1
    return product


def load(checkpoint: Path) -> dict:
    """The manifest of a checkpoint. Raises Broken."""
    try:
        manifest = json.loads(path_of(checkpoint).read_text(encoding="utf-8"))
        manifest["datasets"], manifest["bytes"]
    except FileNotFoundError:
        raise Broken("it has no manifest: writing it was not finished") from None
    except (OSError, ValueError, KeyError, TypeError):
        raise Broken("its manifest is not readable") from None
    if manifest.get("schema") != layout.SCHEMA:
        raise Broken(f"its schema is {manifest.get('schema')}, this program's {layout.SCHEMA}")
    return manifest


def check(checkpoint: Path, share: int = 0, shares: int = 1) -> None:
    """Compare every `shares`-th chunk, from number `share` on, with the manifest. Raises Broken."""
    manifest = load(checkpoint)
    try:
        size = checkpoint.stat().st_size
    except OSError:
        raise Broken("the file is missing") from None
    if size != manifest["bytes"]:
        raise Broken(f"it has {size} bytes instead of {manifest['bytes']}")
    turn = 0
    try:
        with h5py.File(checkpoint, "r") as f:
            for name, entry in manifest["datasets"].items():
                dataset = f[name]
                _check_form(name, dataset, entry)
                for chunk, want in enumerate(entry["crc"]):
                    if turn % shares == share and crc(_chunk(dataset, chunk)) != want:
                        raise Broken(f"the checksum of {name}, chunk {chunk}, is wrong")
                    turn += 1
    except (OSError, KeyError, RuntimeError) as error:
        raise Broken(f"it is not readable ({str(error).splitlines()[0]})") from None


def _check_form(name, dataset, entry):
    if list(dataset.shape) != entry["shape"] or len(entry["crc"]) != chunks_of(dataset.shape):
        raise Broken(f"{name} has shape {dataset.shape} instead of {tuple(entry['shape'])}")
    if entry["dtype"] != "text" and dataset.dtype.str != entry["dtype"]:
        raise Broken(f"{name} has type {dataset.dtype.str} instead of {entry['dtype']}")


def _chunk(dataset, chunk):
    if dataset.shape:
        return dataset[chunk * layout.CRC_ROWS : (chunk + 1) * layout.CRC_ROWS]
    value = dataset[()]
    if isinstance(value, bytes):
        return np.frombuffer(value, np.uint8)
    return np.asarray(value)
