"""Container of glTF 2.0, binary (.glb) or as text (.gltf): header, buffers, accessors and nodes.

Every range of bytes is checked against its view, its buffer and its file before it is read, and
rows are read block by block. The nodes tell which meshes stand in the scene, and where.
"""

import contextlib
import os
import urllib.parse
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np

from vgmpi.gaussians.cloud import rotation_matrices

from .json_header import MAX_BYTES, JsonObject, parse_header, printable_text
from .validation import GaussianFileError

FLOAT, BYTE = 5126, 5121  # component types
TYPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}
COMPONENTS = {5120: "<i1", BYTE: "<u1", 5122: "<i2", 5123: "<u2", FLOAT: "<f4"}
_MAX_STRIDE = 252  # [bytes] by the specification
_MAGIC, _JSON, _BINARY = b"glTF", b"JSON", b"BIN\0"
_MAX_NODES = 100_000
_TOLERANCE = 1e-6  # [-] by which sizes along the axes of a node differ that count as equal
_SKEW = 1e-2  # [-] by which axes of a node may miss a right angle
_KEYS = ("matrix", "translation", "rotation", "scale")


class _Buffer(NamedTuple):
    """Bytes of a buffer inside of a file."""

    file: BinaryIO
    start: int
    size: int


@dataclass(frozen=True)
class Accessor:
    """Column of an attribute: `count` rows of `width` numbers."""

    name: str
    file: BinaryIO
    start: int  # [bytes] of the first row
    stride: int  # [bytes] from row to row
    count: int
    width: int
    kind: np.dtype
    is_normalized: bool

    def rows(self, start: int, stop: int) -> np.ndarray:
        """Return rows as float64 (n, width); whole numbers that are normalized lie in -1..1."""
        size = (stop - start - 1) * self.stride + self.width * self.kind.itemsize
        self.file.seek(self.start + start * self.stride)
        data = self.file.read(size)
        if len(data) < size:
            raise GaussianFileError(f"ends within the values of {self.name}: truncated?")
        strides = (self.stride, self.kind.itemsize)
        shape = (stop - start, self.width)
        values = np.ndarray(shape, self.kind, data, strides=strides).astype(np.float64)
        if self.is_normalized:
            values = np.maximum(values / np.iinfo(self.kind).max, -1.0)
        return values


class Container:
    """Open glTF file.

    Attributes:
        header: The JSON object of the file.
    """

    def __init__(self, path: Path, file: BinaryIO, files: contextlib.ExitStack):
        self._folder, self._files = path.parent, files
        self._size = os.fstat(file.fileno()).st_size
        self._binary: _Buffer | None = None
        self._buffers: dict[int, _Buffer] = {}
        start = file.read(12)
        if start[:4] == _MAGIC:
            self.header = self._read_chunks(file, start)
        elif path.suffix.lower() == ".gltf" and start.lstrip()[:1] in (b"{", b"\xef"):
            file.seek(0)
            self.header = parse_header(file.read(MAX_BYTES + 1))
        else:
            raise GaussianFileError("is not a glTF file (it does not begin with 'glTF')")
        version = self.header.child("asset").text("version")
        if not version.startswith("2."):
            raise GaussianFileError(f"is glTF {printable_text(version, 20)}: allowed is 2.0")

    def _read_chunks(self, file: BinaryIO, start: bytes) -> JsonObject:
        """Return the header of a binary file, and note where its buffer stands."""
        if len(start) < 12:
            raise GaussianFileError("ends within its header: truncated?")
        version, total = (int(word) for word in np.frombuffer(start[4:], "<u4"))
        if version != 2:
            raise GaussianFileError(f"is a .glb of version {version}: allowed is 2")
        if total > self._size:
            raise GaussianFileError(f"has {self._size:,} of {total:,} bytes: truncated?")
        header, offset = None, 12
        while offset + 8 <= total and (header is None or self._binary is None):
            file.seek(offset)
            head = file.read(8)
            size, kind = int.from_bytes(head[:4], "little"), head[4:]
            if offset + 8 + size > total:
                raise GaussianFileError(f"has a chunk of {size:,} bytes that ends behind the file")
            if header is None:
                if kind != _JSON:
                    raise GaussianFileError("does not begin with its JSON header")
                header = parse_header(file.read(min(size, MAX_BYTES + 1)))
            elif kind == _BINARY:
                self._binary = _Buffer(file, offset + 8, size)
            offset += 8 + size
        if header is None:
            raise GaussianFileError("has no JSON header")
        return header

    def _buffer(self, index: int) -> _Buffer:
        """Return a buffer by its number."""
        if index in self._buffers:
            return self._buffers[index]
        table = self.header.entry("buffers", index)
        size = table.integer("byteLength")
        if "uri" in table:
            buffer = self._external_buffer(table.text("uri"))
        elif index == 0 and self._binary is not None:
            buffer = self._binary
        else:
            raise GaussianFileError(f"has no bytes for {table.name}")
        if size > buffer.size:
            raise GaussianFileError(
                f"has {buffer.size:,} of {size:,} bytes of {table.name}: truncated?"
            )
        self._buffers[index] = _Buffer(buffer.file, buffer.start, size)
        return self._buffers[index]

    def _external_buffer(self, uri: str) -> _Buffer:
        """Open a file that stands beside this one or below."""
        if uri.startswith("data:"):
            raise GaussianFileError("holds its numbers as text (data:): convert it to a .glb")
        name = urllib.parse.unquote(uri)
        file = self._folder / name.replace("\0", "?")
        if not file.resolve().is_relative_to(self._folder.resolve()):
            raise GaussianFileError(
                f"names the buffer {printable_text(name)!r} outside of its own folder"
            )
        if not file.is_file():
            raise GaussianFileError(f"names the buffer {printable_text(name)!r}: there is none")
        opened = self._files.enter_context(open(file, "rb"))
        return _Buffer(opened, 0, os.fstat(opened.fileno()).st_size)

    def accessor(self, index: object, name: str, width: int) -> Accessor:
        """Return the column of an attribute, checked against the file.

        Args:
            index: Number of the accessor, as the file gives it.
            name: Name of the attribute.
            width: Numbers in a row.
        """
        table = self.header.entry("accessors", index)
        code = table.integer("componentType")
        if code not in COMPONENTS or table.text("type") != TYPES[width]:
            raise GaussianFileError(
                f"has {name} of type {printable_text(table.text('type'), 20)} and component type"
                f" {code}: expected {TYPES[width]} of a type that the extension allows"
            )
        if "sparse" in table or "bufferView" not in table:
            raise GaussianFileError(f"has {name} as a sparse or compressed accessor: not supported")
        kind, count = np.dtype(COMPONENTS[code]), table.integer("count")
        view = self.header.entry("bufferViews", table.integer("bufferView"))
        if "extensions" in view:
            extensions = ", ".join(view.child("extensions").values)
            raise GaussianFileError(f"has {name} compressed by {printable_text(extensions)}")
        buffer = self._buffer(view.integer("buffer"))
        start, size = view.integer("byteOffset", 0), view.integer("byteLength")
        offset, item = table.integer("byteOffset", 0), width * kind.itemsize
        stride = view.integer("byteStride", item, low=item, high=max(_MAX_STRIDE, item))
        if start + size > buffer.size or (count and offset + (count - 1) * stride + item > size):
            raise GaussianFileError(
                f"has {count:,} rows of {name} that end behind their buffer: truncated?"
            )
        is_normalized = table.values.get("normalized") is True and code != FLOAT
        return Accessor(
            name, buffer.file, buffer.start + start + offset, stride, count, width, kind,
            is_normalized,
        )  # fmt: skip


@dataclass(frozen=True)
class NodeTransform:
    """Transformation x -> matrix @ x + shift of a node.

    Attributes:
        matrix: Shape (3, 3).
        shift: Shape (3,).
        rotation: Rotation in `matrix`, shape (3, 3).
        factor: Size in `matrix`, the same along all axes; None if it differs among them.
    """

    matrix: np.ndarray
    shift: np.ndarray
    rotation: np.ndarray
    factor: float | None


def scene_meshes(header: JsonObject) -> list[tuple[int, NodeTransform | None]]:
    """Return number and transformation of each mesh of the scene; None where nothing moves it.

    Without a scene, all nodes count. Children follow their parents, in the order of the file.

    Raises:
        GaussianFileError: If the nodes are no tree, or a transformation mirrors or shears a mesh.
    """
    nodes = header.items("nodes")
    if len(nodes) > _MAX_NODES:
        raise GaussianFileError(f"has {len(nodes):,} nodes: the most is {_MAX_NODES:,}")
    meshes: list[tuple[int, NodeTransform | None]] = []
    pending: list[tuple[object, np.ndarray | None]] = [(k, None) for k in reversed(_roots(header))]
    visited: set[int] = set()
    while pending:
        index, above = pending.pop()
        node = header.entry("nodes", index)
        if index in visited:
            raise GaussianFileError(f"has {node.name} twice in its scene: its nodes are no tree")
        visited.add(index)  # type: ignore[arg-type]  # entry() accepts whole numbers only
        own = _local_matrix(node)
        matrix = own if above is None else above if own is None else above @ own
        if "mesh" in node:
            meshes.append((node.integer("mesh"), _transform(node.name, matrix)))
        pending += [(child, matrix) for child in reversed(node.items("children"))]
    return meshes


def _roots(header: JsonObject) -> list:
    """Return the numbers of the nodes that have no parent."""
    if header.items("scenes"):
        return list(header.entry("scenes", header.values.get("scene", 0)).items("nodes"))
    count = len(header.items("nodes"))
    tables = (header.entry("nodes", k) for k in range(count))
    children = {str(child) for table in tables for child in table.items("children")}
    return [k for k in range(count) if str(k) not in children]


def _local_matrix(node: JsonObject) -> np.ndarray | None:
    """Return the 4 x 4 matrix of a node; None if it has no transformation."""
    if not any(key in node for key in _KEYS):
        return None
    if "matrix" in node:
        return node.numbers("matrix", 16).reshape(4, 4).T
    matrix = np.eye(4)
    if "rotation" in node:
        x, y, z, w = node.numbers("rotation", 4)
        length = np.sqrt(w * w + x * x + y * y + z * z)
        if not 0.9 < length < 1.1:
            raise GaussianFileError(f"has a rotation of {node.name} that is no unit quaternion")
        matrix[:3, :3] = rotation_matrices(np.array([[w, x, y, z]]) / length)[0]
    if "scale" in node:
        matrix[:3, :3] *= node.numbers("scale", 3)
    if "translation" in node:
        matrix[:3, 3] = node.numbers("translation", 3)
    return matrix


def _transform(name: str, matrix: np.ndarray | None) -> NodeTransform | None:
    """Return the transformation of a 4 x 4 matrix in its parts."""
    if matrix is None or np.array_equal(matrix, np.eye(4)):
        return None
    linear, shift = matrix[:3, :3], matrix[:3, 3]
    with np.errstate(all="ignore"):  # numbers of any size
        sizes = np.linalg.norm(linear, axis=0)
        axes = linear / sizes
        gram = axes.T @ axes
        is_proper = np.isfinite(matrix).all() and np.linalg.det(axes) > 0
    if not is_proper or np.abs(gram - np.eye(3)).max() > _SKEW:
        raise GaussianFileError(f"has {name} mirrored, sheared or without a size: not supported")
    u, _, vt = np.linalg.svd(axes)  # the nearest rotation
    mean = float(sizes.mean())
    is_uniform = np.abs(sizes / mean - 1).max() < _TOLERANCE
    if is_uniform:
        linear = mean * (u @ vt)
    return NodeTransform(linear, shift, u @ vt, mean if is_uniform else None)
