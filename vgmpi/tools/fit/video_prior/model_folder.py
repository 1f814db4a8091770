"""Inspection of a model folder in the layout of diffusers, before anything is loaded.

It reads the list of components, their configurations and the headers of weight files.
"""

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from vgmpi.runtime import user_files
from vgmpi.runtime.message_text import did_you_mean_file

INDEX = "model_index.json"
MAX_HEADER_BYTES = 100 << 20  # [bytes] largest header of a .safetensors file in its specification
HALF_PRECISION_MARK = ".fp16."  # part of the names of weight files in half precision


class ModelError(ValueError):
    """Error in a model folder; its message has one line."""


@dataclass(frozen=True)
class Part:
    """A component of a model.

    kind: class name. config: its configuration. files: weight files. numbers: count of all weights.
    variant: name under which diffusers loads the files.
    """

    name: str
    kind: str
    folder: Path
    config: dict[str, Any]
    files: tuple[Path, ...] = ()
    numbers: int = 0
    variant: str | None = None


class Folder:
    """A model folder; parts: class names of the components by their names."""

    def __init__(self, path: Path):
        """Read the index. Raises ModelError."""
        self.path = path
        if not path.is_dir():
            raise ModelError(f"no such folder{did_you_mean_file(path)}")
        self.index = _table(path / INDEX)
        self.parts = {
            name: str(value[1])
            for name, value in self.index.items()
            if isinstance(value, list) and len(value) == 2 and value[1]
        }

    def part(self, name: str, kinds: tuple[str, ...], config: str = "config.json") -> Part:
        """Return a component with its weights.

        Args:
            name: Name of the component.
            kinds: Accepted class names.
            config: Name of its configuration file.

        Raises:
            ModelError: If it is missing, incomplete or of another class.
        """
        plain = self.plain(name, kinds, config)
        all_files = sorted(plain.folder.glob("*.safetensors"))
        half = [file for file in all_files if HALF_PRECISION_MARK in file.name]
        files = [file for file in all_files if file not in half] or half
        if not files:
            raise ModelError(f"{name} has no .safetensors")
        _all_shards(plain, files)
        numbers = sum(_numbers(file) for file in files)
        variant = HALF_PRECISION_MARK.strip(".") if files == half else None
        return Part(
            name, plain.kind, plain.folder, plain.config, tuple(files), numbers, variant
        )  # fmt: skip

    def plain(self, name: str, kinds: tuple[str, ...], config: str | None) -> Part:
        """Return a component without weights, such as a scheduler.

        Args:
            name: Name of the component.
            kinds: Accepted class names.
            config: Name of its configuration file, or None.

        Raises:
            ModelError: If it is missing or of another class.
        """
        kind = self.parts.get(name)
        if kind is None:
            raise ModelError(f"{INDEX} has no {name}")
        if kind not in kinds:
            raise ModelError(f"its {name} is a {kind}, where {' or '.join(kinds)} is known")
        folder = self.path / name
        if not folder.is_dir():
            raise ModelError(f"the folder {name} is missing")
        return Part(name, kind, folder, _table(folder / config) if config else {})

    def stamp(self) -> list:
        """Return names, sizes and times of all files.

        They identify a model without reading its weights.
        """
        files = [file for file in sorted(self.path.rglob("*")) if file.is_file()]
        stats = [(file, file.stat()) for file in files]
        return [[str(f.relative_to(self.path)), s.st_size, s.st_mtime_ns] for f, s in stats]


def _table(path: Path) -> dict[str, Any]:
    """Read a JSON object. Raises ModelError."""
    where = f"{path.parent.name}/{path.name}"
    try:
        table = json.loads(user_files.read_regular_file(path, user_files.MAX_TEXT_BYTES))
    except OSError as error:
        raise ModelError(f"{where}: {error.strerror}") from None
    except ValueError:
        raise ModelError(f"{where} is not JSON") from None
    if not isinstance(table, dict):
        raise ModelError(f"{where} is no table")
    return table


def _all_shards(part: Part, files: list[Path]) -> None:
    """Verify that all weight files of an index are present. Raises ModelError."""
    for index in part.folder.glob("*.safetensors.index*.json"):
        wanted = set(_table(index).get("weight_map", {}).values())
        missing = sorted(wanted - {file.name for file in files})
        if missing and (HALF_PRECISION_MARK in index.name) == (
            HALF_PRECISION_MARK in files[0].name
        ):
            raise ModelError(f"{part.name}/{missing[0]} is missing")


def _numbers(path: Path) -> int:
    """Return the count of weights in a file, from its header. Raises ModelError."""
    where, size = f"{path.parent.name}/{path.name}", path.stat().st_size
    try:
        with open(path, "rb") as f:
            length = int.from_bytes(f.read(8), "little")
            if not 2 <= length <= min(MAX_HEADER_BYTES, size - 8):
                raise ValueError
            header = json.loads(f.read(length))
        tensors = [value for name, value in header.items() if name != "__metadata__"]
        numbers = sum(math.prod(tensor["shape"]) for tensor in tensors)
        end = max((int(tensor["data_offsets"][1]) for tensor in tensors), default=0)
    except OSError as error:
        raise ModelError(f"{where}: {error.strerror}") from None
    except (ValueError, KeyError, TypeError, AttributeError, IndexError):
        raise ModelError(f"{where} holds no weights that can be read") from None
    if size < 8 + length + end:
        raise ModelError(f"{where} is cut off: {size:,} bytes of {8 + length + end:,}")
    return numbers
