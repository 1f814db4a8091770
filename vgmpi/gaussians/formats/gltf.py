"""Reader and writer of glTF files of Gaussians (KHR_gaussian_splatting, Khronos 2026).

The kernel is "ellipse". A written file has one node with one primitive of points. Programs without
the extension show points with COLOR_0. Its axes are those of glTF (left, up, forward), half a turn
about z from those of a .ply (right, down, forward).
"""

import json
from pathlib import Path

import numpy as np

from vgmpi.gaussians.cloud import GaussianCloud
from vgmpi.gaussians.coordinate_frames import to_ply_frame
from vgmpi.runtime.user_files import replace_file

from .gltf_container import BYTE, FLOAT, TYPES
from .gltf_reader import FRAME, NAME, SRGB, read

__all__ = ["FRAME", "NAME", "read", "write"]


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
