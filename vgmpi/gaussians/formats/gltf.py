"""Reader and writer of glTF files of Gaussians (KHR_gaussian_splatting, Khronos 2026).

A file is .glb, or .gltf with files beside it. All Gaussians of the scene are read, with the
transformations of their nodes. The axes are those of glTF (left, up, forward), half a turn about z
from those of a .ply (right, down, forward). A written file has one node with one primitive of
points; the kernel is "ellipse". Programs without the extension show points with COLOR_0.

References:
    github.com/KhronosGroup/glTF, extensions/2.0/Khronos/KHR_gaussian_splatting
"""

import contextlib
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vgmpi.gaussians.capture_conventions import to_ply_frame
from vgmpi.gaussians.cloud import (
    CaptureRecord,
    GaussianCloud,
    pack_symmetric,
    principal_axes,
    quaternion,
    quaternion_product,
    rotation_matrices,
)
from vgmpi.gaussians.spherical_harmonics import dc_from_rgb, degree_omissions, rgb_from_dc, rotate
from vgmpi.runtime.user_files import replace_file

from .gltf_container import BYTE, FLOAT, TYPES, Accessor, Container, NodeTransform, scene_meshes
from .json_header import JsonObject, printable_text
from .validation import Columns, GaussianFileError, naming_file, read_validated

NAME = "KHR_gaussian_splatting"
SRGB, LINEAR = "srgb_rec709_display", "lin_rec709_display"
FRAME = "LUF"  # of every glTF file: left, up, forward
_MAX_PRIMITIVES = 1024  # placed sets of points
_DEGREES = 4  # degrees that are read: 0 to 3
# component types that the extension allows: float32, and whole numbers, normalized or not
_KINDS = {
    "POSITION": ({"f4", "i1", "u1", "i2", "u2"}, {"i1", "u1", "i2", "u2"}),
    "ROTATION": ({"f4"}, {"i1", "i2"}),
    "SCALE": ({"f4", "u1", "u2"}, {"u1", "u2"}),
    "OPACITY": ({"f4"}, {"u1", "u2"}),
    "SH": ({"f4"}, set()),
}


@dataclass(frozen=True)
class _Primitive:
    """Gaussians of one primitive at one node."""

    position: Accessor
    rotation: Accessor
    scale: Accessor
    opacity: Accessor
    colors: tuple[Accessor, ...]  # 1, 4, 9 or 16 coefficients
    is_linear: bool
    transform: NodeTransform | None

    def columns(self, start: int, stop: int) -> Columns:
        """Return rows in the axes of the scene."""
        x = self.position.rows(start, stop)
        quat = np.roll(self.rotation.rows(start, stop), 1, axis=1)
        scale = self.scale.rows(start, stop)
        sh = np.stack([color.rows(start, stop) for color in self.colors], axis=1)
        if self.is_linear:
            sh = _encoded_colors(sh)
        if self.transform is not None:
            x, quat, scale, sh = _transformed(self.transform, x, quat, scale, sh)
        return x, quat, scale, self.opacity.rows(start, stop)[:, 0], sh


def read(path: str | Path) -> GaussianCloud:
    """Return the Gaussians of a .glb or .gltf file, node by node, each in the file's order.

    Raises:
        GaussianFileError: If the file is not readable.
    """
    path = Path(path)
    with naming_file(path), contextlib.ExitStack() as files:
        file = files.enter_context(open(path, "rb"))
        container = Container(path, file, files)
        primitives, notes = _primitives(container)
        counts = [primitive.position.count for primitive in primitives]
        terms = max(len(primitive.colors) for primitive in primitives)

        def decoded(start: int, stop: int) -> Columns:
            """Decode a range of rows of all primitives."""
            parts, first = [], 0
            for primitive, count in zip(primitives, counts):
                low, high = max(start - first, 0), min(stop - first, count)
                if low < high:
                    x, quat, scale, opacity, sh = primitive.columns(low, high)
                    sh = np.pad(sh, ((0, 0), (0, terms - sh.shape[1]), (0, 0)))
                    parts.append((x, quat, scale, opacity, sh))
                first += count
            return tuple(np.concatenate(column) for column in zip(*parts))

        record = _record(container.header, path.suffix.lower(), notes)
        return read_validated(sum(counts), decoded, record)


def _record(header: JsonObject, suffix: str, notes: "_Notes") -> CaptureRecord:
    """Return what the header tells of the file."""
    generator = printable_text(header.child("asset").text("generator", ""))
    return CaptureRecord(
        encoding=f"{suffix}, {NAME}",
        frame=FRAME,
        frame_source="the axes of glTF",
        comments=(f"generator: {generator}",) if generator else (),
        doubts=tuple(notes.doubts),
        omissions=tuple(notes.omissions),
    )


@dataclass
class _Notes:
    """Doubts and omissions that reading a file collected, each once."""

    doubts: list[str]
    omissions: list[str]

    def add_doubt(self, text: str) -> None:
        """Note a doubt."""
        if text not in self.doubts:
            self.doubts.append(text)

    def add_omission(self, text: str) -> None:
        """Note what is left out."""
        if text not in self.omissions:
            self.omissions.append(text)


def _primitives(container: Container) -> tuple[list[_Primitive], _Notes]:
    """Return all primitives of Gaussians of the scene, and what is doubtful or left out."""
    header, notes = container.header, _Notes([], [])
    primitives: list[_Primitive] = []
    has_others = False
    for index, transform in scene_meshes(header):
        mesh = header.entry("meshes", index)
        for k in range(len(mesh.items("primitives"))):
            table = mesh.entry("primitives", k)
            extensions = table.child("extensions") if "extensions" in table else table
            if extensions is table or NAME not in extensions:
                has_others = True
                continue
            primitive = _primitive(container, table, extensions.child(NAME), transform, notes)
            if primitive.position.count:
                primitives.append(primitive)
            if len(primitives) > _MAX_PRIMITIVES:
                raise GaussianFileError(f"has more than {_MAX_PRIMITIVES:,} sets of Gaussians")
    if has_others:
        notes.add_omission("meshes without Gaussians are left out")
    if not primitives:
        hint = ": a mesh? Convert it to .obj" if has_others else ""
        raise GaussianFileError(f"holds no Gaussians of {NAME} in its scene{hint}")
    return primitives, notes


def _primitive(
    container: Container,
    table: JsonObject,
    extension: JsonObject,
    transform: NodeTransform | None,
    notes: _Notes,
) -> _Primitive:
    """Return a primitive whose attributes are checked against the file."""
    if "extensions" in extension:
        names = ", ".join(extension.child("extensions").values)
        if "compression" in names:
            raise GaussianFileError(
                f"holds Gaussians compressed by {printable_text(names)}: not supported, convert it"
                " to .ply or .spz"
            )
        notes.add_doubt(f"the extensions {printable_text(names)} are ignored")
    if table.integer("mode", 4) != 0 or "indices" in table:
        raise GaussianFileError("has Gaussians whose primitive is no plain list of points (mode 0)")
    kernel = extension.text("kernel", "ellipse")
    if kernel != "ellipse":
        notes.add_doubt(f"the kernel {printable_text(kernel, 30)!r} is taken as 'ellipse'")
    space = extension.text("colorSpace", "")
    if space not in (SRGB, LINEAR):
        notes.add_doubt(f"the color space {printable_text(space, 30)!r} is taken as {SRGB!r}")
    if space == LINEAR:
        notes.add_doubt("colors of linear light are turned to sRGB: mixtures of Gaussians differ")
    attributes = table.child("attributes").values
    columns = _Attributes(container, attributes)
    if f"{NAME}:SH_DEGREE_{_DEGREES}_COEF_0" in attributes:
        for text in degree_omissions(_DEGREES):
            notes.add_omission(text)
    primitive = _Primitive(
        position=columns.accessor("POSITION", "POSITION", 3),
        rotation=columns.accessor(f"{NAME}:ROTATION", "ROTATION", 4),
        scale=columns.accessor(f"{NAME}:SCALE", "SCALE", 3),
        opacity=columns.accessor(f"{NAME}:OPACITY", "OPACITY", 1),
        colors=columns.colors(),
        is_linear=space == LINEAR,
        transform=transform,
    )
    return primitive


class _Attributes:
    """Attributes of a primitive; all have the same number of rows."""

    def __init__(self, container: Container, names: dict):
        self.container, self.names = container, names
        self.count: int | None = None

    def accessor(self, name: str, kind: str, width: int) -> Accessor:
        """Return the column of an attribute.

        Args:
            name: Name of the attribute.
            kind: Key of the component types that it may have.
            width: Numbers in a row.
        """
        if name not in self.names:
            raise GaussianFileError(f"has no {name}: of a draft of the extension, or broken?")
        column = self.container.accessor(self.names[name], name, width)
        component = column.kind.str[1:]
        if component not in _KINDS[kind][1 if column.is_normalized else 0]:
            normalized = "normalized " if column.is_normalized else ""
            raise GaussianFileError(
                f"has {name} as {normalized}{column.kind.name}: the extension does not allow it"
            )
        if self.count is not None and column.count != self.count:
            raise GaussianFileError(
                f"has {column.count:,} rows of {name}, {self.count:,} of others"
            )
        self.count = column.count
        return column

    def colors(self) -> tuple[Accessor, ...]:
        """Return the coefficients of all whole degrees up to 3."""
        columns: list[Accessor] = []
        for degree in range(_DEGREES):
            prefix = f"{NAME}:SH_DEGREE_{degree}_COEF_"
            if degree and f"{prefix}0" not in self.names:
                break
            columns += [self.accessor(f"{prefix}{k}", "SH", 3) for k in range(2 * degree + 1)]
        return tuple(columns)


def _encoded_colors(sh: np.ndarray) -> np.ndarray:
    """Return coefficients of sRGB of coefficients of linear light; only degree 0 has them.

    Raises:
        GaussianFileError: If colors depend on the view.
    """
    if sh[:, 1:].any():
        raise GaussianFileError(
            f"has view-dependent colors in {LINEAR}: only colors of degree 0 can be turned to sRGB"
        )
    linear = np.maximum(rgb_from_dc(sh[:, 0]), 0.0)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.concatenate([dc_from_rgb(encoded)[:, None], sh[:, 1:]], axis=1)


def _transformed(
    transform: NodeTransform, x: np.ndarray, quat: np.ndarray, scale: np.ndarray, sh: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return centers, rotations, sizes and colors after the transformation of a node."""
    x = x @ transform.matrix.T + transform.shift
    sh = rotate(sh, transform.rotation)
    if transform.factor is not None:
        quat = quaternion_product(quaternion(transform.rotation), quat)
        return x, quat, transform.factor * scale, sh
    length = np.linalg.norm(quat, axis=1, keepdims=True)
    root = transform.matrix @ (rotation_matrices(quat / length) * scale[:, None, :])
    cov = pack_symmetric(root @ root.transpose(0, 2, 1))
    valid = np.isfinite(cov).all(axis=1) & (scale >= 0).all(axis=1)
    quat, scale = principal_axes(np.where(valid[:, None], cov, 0.0))
    return x, quat, np.where(valid[:, None], scale, np.nan), sh


def write(path: str | Path, cloud: GaussianCloud) -> None:
    """Write `cloud`, in the axes of a .ply, in its order with float32 precision.

    Raises:
        OSError: If the file cannot be written.
    """
    header, data = _encode_buffers(_attributes(to_ply_frame(cloud, FRAME)))  # its own inverse
    text = json.dumps(header, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    data += b"\0" * (-len(data) % 4)
    total = 12 + 8 + len(text) + 8 + len(data)
    replace_file(
        path,
        b"glTF" + np.array([2, total], "<u4").tobytes(),
        np.array([len(text)], "<u4").tobytes() + b"JSON" + text,
        np.array([len(data)], "<u4").tobytes() + b"BIN\0" + data,
    )


def _attributes(cloud: GaussianCloud) -> dict[str, np.ndarray]:
    """Return the attributes by name: float32 (n, c), or bytes that represent 0..1."""
    color = np.column_stack([cloud.rgb, np.clip(cloud.opacity, 0, 1)])
    out = {
        "POSITION": cloud.x,
        "COLOR_0": np.rint(255 * color).astype(np.uint8),
        f"{NAME}:ROTATION": cloud.quat[:, (1, 2, 3, 0)],  # x, y, z, w
        f"{NAME}:SCALE": cloud.scale,
        f"{NAME}:OPACITY": np.clip(cloud.opacity, 0, 1)[:, None],
    }
    coefficient = 0
    for degree in range(round(cloud.sh.shape[1] ** 0.5)):
        for k in range(2 * degree + 1):
            out[f"{NAME}:SH_DEGREE_{degree}_COEF_{k}"] = cloud.sh[:, coefficient]
            coefficient += 1
    converted = {name: a if a.dtype == np.uint8 else a.astype("<f4") for name, a in out.items()}
    return {name: np.ascontiguousarray(a) for name, a in converted.items()}


def _encode_buffers(attributes: dict[str, np.ndarray]) -> tuple[dict, bytes]:
    """Return the header and the binary buffer that it describes."""
    views: list[dict] = []
    accessors: list[dict] = []
    parts, offset = [], 0
    for name, values in attributes.items():
        encoded = values.tobytes()
        views.append(
            {"buffer": 0, "byteOffset": offset, "byteLength": len(encoded), "target": 34962}
        )
        byte = values.dtype == np.uint8
        accessor = {
            "bufferView": len(views) - 1,
            "componentType": BYTE if byte else FLOAT,
            "count": len(values),
            "type": TYPES[values.shape[1]],
        }
        if byte:
            accessor["normalized"] = True
        if name == "POSITION":
            accessor |= {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()}
        accessors.append(accessor)
        parts.append(encoded + b"\0" * (-len(encoded) % 4))
        offset += len(parts[-1])
    primitive = {
        "mode": 0,
        "attributes": {name: k for k, name in enumerate(attributes)},
        "extensions": {NAME: {"kernel": "ellipse", "colorSpace": SRGB}},
    }
    header = {
        "asset": {"version": "2.0", "generator": "vgmpi"},
        "extensionsUsed": [NAME],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": offset}],
    }
    return header, b"".join(parts)
