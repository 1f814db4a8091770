"""Files .sog, .glb and .ksplat written value by value from their specifications: the readers are
not tested with this program's writers."""

import io
import json
import struct
import zipfile

import numpy as np
from PIL import Image

KHR = "KHR_gaussian_splatting"
TYPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}
CODES = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "f4": 5126}


def webp(pixels, lossless=True):
    """The bytes of a WebP picture of (height, width, 3 or 4) bytes."""
    data = io.BytesIO()
    image = Image.fromarray(np.asarray(pixels, np.uint8))
    image.save(data, "webp", lossless=lossless, exact=True)
    return data.getvalue()


def archive(members, method=zipfile.ZIP_STORED):
    """The bytes of a ZIP archive; members: bytes by name."""
    data = io.BytesIO()
    with zipfile.ZipFile(data, "w", method) as file:
        for name, content in members.items():
            file.writestr(name, content)
    return data.getvalue()


def sog_members(version=2, n=5):
    """Members of a .sog of five Gaussians in two rows of three pixels, degree 1; meta as object."""
    files = {"means": ["l.webp", "u.webp"], "scales": ["s.webp"], "quats": ["q.webp"],
             "sh0": ["c.webp"], "shN": ["centroids.webp", "labels.webp"]}  # fmt: skip
    k = np.arange(6)
    pixels = {
        "l.webp": np.stack([k, 10 * k, 255 - k, 0 * k + 255], 1),
        "u.webp": np.stack([0 * k, 40 * k, 255 - 50 * k, 0 * k + 255], 1),
        "s.webp": np.stack([k, k + 1, k + 2, 0 * k + 255], 1),
        "q.webp": np.stack([100 + k, 128 + 0 * k, 150 - k, [252, 253, 254, 255, 252, 0]], 1),
        "c.webp": np.stack([2 * k, 3 * k, 4 * k, 51 * k], 1),
        "labels.webp": np.stack([[0, 1, 66, 2, 1, 9], 0 * k, 0 * k, 0 * k + 255], 1),
    }
    members = {name: webp(rows.reshape(2, 3, 4)) for name, rows in pixels.items()}
    centroids = np.zeros((2, 64 * 3, 4), np.uint8)
    centroids[..., 3] = 255
    centroids[:, :, :3] = (np.arange(2 * 192 * 3).reshape(2, 192, 3) * 7) % 256
    members["centroids.webp"] = webp(centroids)
    pixels["centroids.webp"] = centroids
    meta = {key: {"files": names} for key, names in files.items()}
    meta["means"] |= {"mins": [-1.0, 0.0, -3.0], "maxs": [1.0, 2.0, 0.5]}
    if version == 2:
        meta = {"version": 2, "count": n} | meta
        meta["scales"]["codebook"] = np.linspace(-6, 0, 256).tolist()
        meta["sh0"]["codebook"] = np.linspace(-2, 2, 256).tolist()
        meta["shN"] |= {"codebook": np.linspace(-1, 1, 256).tolist(), "count": 70, "bands": 1}
    else:
        meta["means"]["shape"] = [n, 3]
        meta["scales"] |= {"mins": [-6, -5, -4], "maxs": [0, -1, -2]}
        meta["sh0"] |= {"mins": [-2, -1, -1.5, -5], "maxs": [2, 1, 1.5, 5]}
        meta["shN"] |= {"mins": -1, "maxs": 1, "quantization": 8}
    return meta, members, pixels


def sog(meta, members, method=zipfile.ZIP_STORED):
    """The bytes of a .sog file."""
    text = meta if isinstance(meta, bytes) else json.dumps(meta).encode()
    return archive({"meta.json": text} | members, method)


def glb(header, binary=b"", version=2):
    """The bytes of a .glb file."""
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    text += b" " * (-len(text) % 4)
    binary += bytes(-len(binary) % 4)
    body = struct.pack("<I4s", len(text), b"JSON") + text
    if binary:
        body += struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sII", b"glTF", version, 12 + len(body)) + body


def gltf_parts(columns, node=None, extension=None, stride=None):
    """Header and buffer of one primitive; columns: (array (n, c), normalized) by attribute.

    stride: all attributes in rows of so many bytes, interleaved, instead of one after the other.
    """
    accessors, views, binary = [], [], b""
    if stride:
        n = len(next(iter(columns.values()))[0])
        rows, offset = np.zeros((n, stride), np.uint8), 0
        views.append({"buffer": 0, "byteLength": n * stride, "byteStride": stride})
    for values, normalized in columns.values():
        values = np.ascontiguousarray(values)
        if stride:
            width = values.shape[1] * values.itemsize
            rows[:, offset : offset + width] = values.view(np.uint8).reshape(n, -1)
            accessors.append({"bufferView": 0, "byteOffset": offset})
            offset += -(-width // 4) * 4
        else:
            views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": values.nbytes})
            accessors.append({"bufferView": len(views) - 1})
            binary += values.tobytes() + bytes(-values.nbytes % 4)
        accessors[-1] |= {
            "componentType": CODES[values.dtype.str[1:]],
            "count": len(values),
            "type": TYPES[values.shape[1]],
            "normalized": normalized,
        }
    if stride:
        binary = rows.tobytes()
    khr = {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"} | (extension or {})
    primitive = {
        "mode": 0,
        "attributes": {name: k for k, name in enumerate(columns)},
        "extensions": {KHR: khr},
    }
    header = {
        "asset": {"version": "2.0"},
        "extensionsUsed": [KHR],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0} | (node or {})],
        "meshes": [{"primitives": [primitive]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(binary)}],
    }
    return header, binary


def gltf_columns(n=4, degree=0, seed=0):
    """Columns of n Gaussians as float32, for gltf_parts."""
    rng = np.random.default_rng(seed)
    quat = rng.normal(size=(n, 4))
    quat /= np.linalg.norm(quat, axis=1)[:, None]
    values = {
        "POSITION": rng.normal(size=(n, 3)),
        f"{KHR}:ROTATION": quat,
        f"{KHR}:SCALE": rng.uniform(0.1, 1, (n, 3)),
        f"{KHR}:OPACITY": rng.random((n, 1)),
    }
    for l in range(degree + 1):
        for k in range(2 * l + 1):
            values[f"{KHR}:SH_DEGREE_{l}_COEF_{k}"] = 0.3 * rng.normal(size=(n, 3))
    return {name: (column.astype("f4"), False) for name, column in values.items()}


def ksplat_header(count, sections=1, level=0, version=(0, 1), bounds=(0.0, 0.0)):
    head = struct.pack(
        "<BBxxIIIIHxx3f2f", *version, sections, sections, count, count, level, 0, 0, 0, *bounds
    )
    return head + bytes(4096 - len(head))


def ksplat_section(count, degree=0, capacity=None, buckets=(0, 0, 0), block=0.0, steps=0):
    """Header of a section; buckets: rows of a full one, number of full ones and of others."""
    size, full, partial = buckets
    head = struct.pack(
        "<IIIIfHxxIIIIH", count, count if capacity is None else capacity, size, full + partial,
        block, 12 if full + partial else 0, steps, 0, full, partial, degree,
    )  # fmt: skip
    return head + bytes(1024 - len(head))


def ksplat_row(level, x, scale, quat, rgba, sh=()):
    """Row of a section; x: floats at level 0, else 16-bit numbers; sh: floats, bytes at level 2."""
    position, shape, color = (("3f", "f", "f"), ("3H", "e", "e"), ("3H", "e", "B"))[level]
    form = f"<{position}3{shape}4{shape}4B{len(sh)}{color}"
    return struct.pack(form, *x, *scale, *quat, *rgba, *sh)
