"""A model's folder in the layout of diffusers, looked at before anything of it is loaded: its
parts, their settings and the sizes of their weights. Reads heads of files alone."""

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ... import inputs
from ...misspelt import nearest_file

INDEX = "model_index.json"
MOST_HEAD = 100 << 20  # bytes of the head of a file of weights, as its own format has it
HALVES = ".fp16."  # in names of files of weights that are there in half precision as well


class ModelError(ValueError):
    """What is wrong with a model's folder; one line."""


@dataclass(frozen=True)
class Part:
    """A part of a model. kind: its class. config: its settings. files: of its weights, numbers in
    all, and as which variant they are asked for."""

    name: str
    kind: str
    folder: Path
    config: dict[str, Any]
    files: tuple[Path, ...] = ()
    numbers: int = 0
    variant: str | None = None


class Folder:
    """parts: the classes of a model's parts by their names. Raises ModelError."""

    def __init__(self, path: Path):
        self.path = path
        if not path.is_dir():
            raise ModelError(f"no such folder{nearest_file(path)}")
        self.index = _table(path / INDEX)
        self.parts = {
            name: str(given[1])
            for name, given in self.index.items()
            if isinstance(given, list) and len(given) == 2 and given[1]
        }

    def part(self, name: str, kinds: tuple[str, ...], config: str = "config.json") -> Part:
        """A part of one of these classes, with its weights. Raises ModelError."""
        plain = self.plain(name, kinds, config)
        there = sorted(plain.folder.glob("*.safetensors"))
        half = [file for file in there if HALVES in file.name]
        files = [file for file in there if file not in half] or half
        if not files:
            raise ModelError(f"{name} has no .safetensors")
        _all_shards(plain, files)
        numbers = sum(_numbers(file) for file in files)
        variant = HALVES.strip(".") if files == half else None
        return Part(
            name, plain.kind, plain.folder, plain.config, tuple(files), numbers, variant
        )  # fmt: skip

    def plain(self, name: str, kinds: tuple[str, ...], config: str | None) -> Part:
        """A part without weights, such as a scheduler. config: the name of its settings' file."""
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
        """What tells this model from another, without reading its weights: names, sizes and times
        of its files."""
        files = [file for file in sorted(self.path.rglob("*")) if file.is_file()]
        found = [(file, file.stat()) for file in files]
        return [[str(f.relative_to(self.path)), s.st_size, s.st_mtime_ns] for f, s in found]


def _table(path: Path) -> dict[str, Any]:
    where = f"{path.parent.name}/{path.name}"
    try:
        found = json.loads(inputs.content(path, inputs.MOST_TEXT))
    except OSError as error:
        raise ModelError(f"{where}: {error.strerror}") from None
    except ValueError:
        raise ModelError(f"{where} is not JSON") from None
    if not isinstance(found, dict):
        raise ModelError(f"{where} is no table")
    return found


def _all_shards(part: Part, files: list[Path]) -> None:
    """Weights in several files name them all in an index. Raises ModelError."""
    for index in part.folder.glob("*.safetensors.index*.json"):
        wanted = set(_table(index).get("weight_map", {}).values())
        gone = sorted(wanted - {file.name for file in files})
        if gone and (HALVES in index.name) == (HALVES in files[0].name):
            raise ModelError(f"{part.name}/{gone[0]} is missing")


def _numbers(path: Path) -> int:
    """How many numbers a file of weights holds, by its head. Raises ModelError, also where the file
    is cut off."""
    where, size = f"{path.parent.name}/{path.name}", path.stat().st_size
    try:
        with open(path, "rb") as f:
            length = int.from_bytes(f.read(8), "little")
            if not 2 <= length <= min(MOST_HEAD, size - 8):
                raise ValueError
            head = json.loads(f.read(length))
        tensors = [value for name, value in head.items() if name != "__metadata__"]
        numbers = sum(math.prod(one["shape"]) for one in tensors)
        end = max((int(one["data_offsets"][1]) for one in tensors), default=0)
    except OSError as error:
        raise ModelError(f"{where}: {error.strerror}") from None
    except (ValueError, KeyError, TypeError, AttributeError, IndexError):
        raise ModelError(f"{where} holds no weights that can be read") from None
    if size < 8 + length + end:
        raise ModelError(f"{where} is cut off: {size:,} bytes of {8 + length + end:,}")
    return numbers
