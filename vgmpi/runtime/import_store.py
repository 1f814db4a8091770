"""Store of the imports of source files, so that a process need not parse what another has parsed.

It is one file in the user's cache folder: a line of JSON per source, by the digest of its text,
with a checksum. A damaged line counts as absent; several processes may append at once.
"""

import functools
import json
import os
import zlib
from pathlib import Path

from .cache_paths import user_folder

Entry = tuple[list[tuple[str, str]], list[str]]  # imports (local, full), names in annotations

MAX_BYTES = 16 << 20  # [bytes] a larger file is begun anew


def store_path() -> Path:
    """Return the path of the store."""
    return user_folder() / "imports.jsonl"


def read_entry(key: str) -> Entry | None:
    """Return the entry of a key, or None."""
    return _entries().get(key)


def write_entry(key: str, entry: Entry) -> None:
    """Append an entry; a folder that cannot be written keeps none."""
    _entries()[key] = entry
    text = json.dumps([key, entry[0], entry[1]])
    line = f"{zlib.crc32(text.encode()):08x} {text}\n".encode()
    path = store_path()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.exists() and path.stat().st_size > MAX_BYTES:
            path.unlink()
        handle = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
    except OSError:
        return
    try:
        os.write(handle, line)  # one call: lines of several processes do not mix
    except OSError:
        pass
    finally:
        os.close(handle)


@functools.cache
def _entries() -> dict[str, Entry]:
    """Return the entries on disk, by key."""
    try:
        lines = store_path().read_bytes().splitlines()
    except OSError:
        return {}
    entries: dict[str, Entry] = {}
    for line in lines:
        checksum, _, text = line.partition(b" ")
        if checksum == b"%08x" % zlib.crc32(text):
            key, imports, annotated = json.loads(text)
            entries[key] = [(local, full) for local, full in imports], annotated
    return entries
