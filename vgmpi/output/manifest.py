"""Checksums of a checkpoint: what its manifest says, and whether the file still agrees with it.

A flushed but unfinished HDF5 file opens and looks complete, so completeness is said explicitly: the
manifest is written last and holds a CRC32 per dataset and run of layout.CRC_ROWS rows.
"""

import json
import re
import zlib
from collections.abc import Iterable
from pathlib import Path

import h5py
import numpy as np

from vgmpi import inputs
from vgmpi.output import layout, plain

MOST_BYTES = 1 << 30  # of a manifest: ten a chunk of a dataset
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
    """The manifest of a checkpoint, every entry of the type it must have. Raises Broken."""
    try:
        text = inputs.content(path_of(checkpoint), MOST_BYTES, follow=False)
        manifest = json.loads(text)
    except FileNotFoundError:
        raise Broken("it has no manifest: writing it was not finished") from None
    except (OSError, ValueError, RecursionError):
        raise Broken("its manifest is not readable") from None
    schema = manifest.get("schema") if isinstance(manifest, dict) else None
    if schema != layout.SCHEMA:
        raise Broken(f"its schema is {schema!r:.20}, this program's {layout.SCHEMA}")
    if not _whole(manifest.get("bytes")) or not isinstance(manifest.get("datasets"), dict):
        raise Broken("its manifest is not readable")
    for name, entry in manifest["datasets"].items():
        if not isinstance(entry, dict) or set(entry) != {"shape", "dtype", "crc"}:
            raise Broken(f"its manifest does not tell of {name!r:.60}")
        lists = (entry["shape"], entry["crc"])
        if not all(isinstance(one, list) and all(map(_whole, one)) for one in lists):
            raise Broken(f"its manifest does not tell of {name!r:.60}")
    return manifest


def _whole(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= 0


def check(checkpoint: Path, share: int = 0, shares: int = 1) -> None:
    """Compare every `shares`-th chunk, from number `share` on, with the manifest, and what is not
    in chunks too. Raises Broken."""
    manifest = load(checkpoint)
    if checkpoint.is_symlink():
        raise Broken("it is a link to elsewhere")
    try:
        size = checkpoint.stat().st_size
    except OSError:
        raise Broken("the file is missing") from None
    if size != manifest["bytes"]:
        raise Broken(f"it has {size} bytes instead of {manifest['bytes']}")
    try:
        with h5py.File(checkpoint, "r") as f:
            plain.check(f)
            _compare(f, manifest, share, shares)
            _check_step(checkpoint, manifest, json.loads(f["attrs"][()]))
    except Broken:
        raise
    except plain.Damaged as damaged:
        raise Broken(str(damaged)) from None
    except Exception as error:  # HDF5, h5py and json raise all kinds of what is in a file
        said = (str(error).splitlines() or [type(error).__name__])[0]
        raise Broken(f"it is not readable ({said})") from None


def _compare(f, manifest, share, shares):
    known, turn = layout.named(layout.CHECKPOINT), 0
    odd = sorted(set(plain.datasets(f)) ^ set(manifest["datasets"]))
    if odd:
        raise Broken(f"{odd[0]} is in one of the file and its manifest alone")
    rows: dict[str, int] = {}
    for name, entry in manifest["datasets"].items():
        dataset = f[name]
        _check_form(name, dataset, entry)
        group, _, member = name.partition("/")
        if member:
            form = known.get(f"*/{member}")
            if form is None or not layout.fits(form, dataset):
                raise Broken(f"{name} is not as the layout has it: {dataset.dtype} {dataset.shape}")
            kind = f"{group}{form.shape[:2]}"  # (n or (b
            if rows.setdefault(kind, len(dataset)) != len(dataset):
                raise Broken(f"{name} has {len(dataset)} rows instead of {rows[kind]}")
        for chunk, want in enumerate(entry["crc"]):
            if turn % shares == share and crc(_chunk(dataset, chunk)) != want:
                raise Broken(f"the checksum of {name}, chunk {chunk}, is wrong")
            turn += 1


def _check_form(name, dataset, entry):
    if list(dataset.shape) != entry["shape"] or len(entry["crc"]) != chunks_of(dataset.shape):
        raise Broken(f"{name} has shape {dataset.shape} instead of {tuple(entry['shape'])}")
    if (dataset.dtype.str if dataset.dtype.kind != "S" else "text") != entry["dtype"]:
        raise Broken(f"{name} has type {dataset.dtype.str} instead of {entry['dtype']!r:.20}")


def _check_step(checkpoint, manifest, attrs):
    """The file's name, its manifest and the file itself tell of one moment."""
    match = re.fullmatch(r"checkpoint_([0-9]+)\.h5", checkpoint.name)
    for said in ([int(match[1])] if match else []) + [manifest.get("step")]:
        if said != attrs["step"]:
            raise Broken(f"it is of step {attrs['step']!r:.20}, not {said!r:.20}")
    if manifest.get("time") != attrs.get("time"):
        raise Broken(f"it is of {attrs.get('time')!r:.30} s, not {manifest.get('time')!r:.30}")


def _chunk(dataset, chunk):
    if dataset.shape:
        return dataset[chunk * layout.CRC_ROWS : (chunk + 1) * layout.CRC_ROWS]
    value = dataset[()]
    if isinstance(value, bytes):
        return np.frombuffer(value, np.uint8)
    return np.asarray(value)
