"""Gaussian files written byte by byte: the readers are not tested with their own writers."""

import gzip
import struct

import numpy as np

PLAIN = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"]
SHAPE = ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
BOUNDS = [
    f"{end}_{part}{axis}" for part in ("", "scale_") for end in ("min", "max") for axis in "xyz"
]
COLOR_BOUNDS = [f"{end}_{axis}" for end in ("min", "max") for axis in "rgb"]
PACKED = ["packed_position", "packed_rotation", "packed_scale", "packed_color"]


def names(rest=0):
    return PLAIN + [f"f_rest_{i}" for i in range(rest)] + SHAPE


def header(elements, form="binary_little_endian", end="\n"):
    """elements: (name, count, [(type, property), ...])."""
    lines = ["ply", f"format {form} 1.0", "comment made by a test"]
    for name, count, properties in elements:
        lines.append(f"element {name} {count}")
        lines += [f"property {kind} {p}" for kind, p in properties]
    return (end.join([*lines, "end_header"]) + end).encode()


def plain(rows, rest=0, order="<", end="\n"):
    """The bytes of a plain file; rows: numbers in the order of names(rest)."""
    properties = [("float", name) for name in names(rest)]
    form = "binary_little_endian" if order == "<" else "binary_big_endian"
    data = b"".join(struct.pack(f"{order}{len(row)}f", *row) for row in rows)
    return header([("vertex", len(rows), properties)], form, end) + data


def row(
    x=(1, 2, 3), color=(0.1, 0.2, 0.3), rest=(), opacity=0.5, scale=(-3, -4, -5), rot=(1, 0, 0, 0)
):
    return [*x, 0, 0, 0, *color, *rest, opacity, *scale, *rot]


CODES = {"char": "b", "uchar": "B", "short": "h", "ushort": "H", "int": "i", "uint": "I"}
CODES |= {"half": "e", "float": "f", "double": "d"}


def columns(n=3, scales=3, rest=0, **others):
    """Columns of n Gaussians as name -> (type, values); others replace (None: remove) or follow."""
    table = {name: ("float", [k + 0.25 * i for i in range(n)]) for k, name in enumerate("xyz")}
    table |= {f"f_dc_{k}": ("float", [0.1 * k] * n) for k in range(3)}
    table |= {f"f_rest_{k}": ("float", [k] * n) for k in range(rest)}
    table |= {"opacity": ("float", [1.5] * n)}
    table |= {f"scale_{k}": ("float", [-3.0 - k] * n) for k in range(scales)}
    table |= {f"rot_{k}": ("float", [float(k == 0)] * n) for k in range(4)}
    return {name: column for name, column in (table | others).items() if column is not None}


def table(columns, form="<", comments=(), before=((), b""), behind=((), b"")):
    """The bytes of a file with these columns in its element 'vertex'.

    form: "<", ">" or "ascii"; before, behind: lines of the header and bytes of other elements."""
    rows = list(zip(*(values for _, values in columns.values()), strict=True))
    name = {"<": "binary_little_endian", ">": "binary_big_endian"}.get(form, form)
    lines = ["ply", f"format {name} 1.0", *(f"comment {text}" for text in comments), *before[0]]
    lines += [f"element vertex {len(rows)}"]
    lines += [f"property {kind} {name}" for name, (kind, _) in columns.items()]
    lines += [*behind[0], "end_header", ""]
    if form == "ascii":
        data = "".join(" ".join(map(repr, row)) + "\n" for row in rows).encode()
    else:
        codes = form + "".join(CODES[kind] for kind, _ in columns.values())
        data = b"".join(struct.pack(codes, *row) for row in rows)
    return "\n".join(lines).encode("utf-8") + before[1] + data + behind[1]


def _word(values, widths):
    """Numbers in 0..1 packed from the top bit down."""
    word = 0
    for value, width in zip(values, widths):
        word = (word << width) | int(round(float(value) * ((1 << width) - 1)))
    return word


def compressed(x, quat, log_scale, rgb, opacity, rest=None, color_bounds=True):
    """The bytes of a SuperSplat file of these Gaussians."""
    n = len(x)
    groups = [slice(i, min(i + 256, n)) for i in range(0, n, 256)]
    bounds, packed = b"", b""
    for group in groups:
        ends = []
        for values in (x, log_scale, rgb):
            low, high = values[group].min(axis=0), values[group].max(axis=0)
            ends.append((low, np.where(high > low, high, low + 1)))
        kept = ends if color_bounds else ends[:2]
        for low, high in kept:
            bounds += struct.pack("<6f", *low, *high)
        for i in range(group.start, group.stop):
            (p, s, c) = (
                (values[i] - low) / (high - low)
                for values, (low, high) in zip((x, log_scale, rgb), ends)
            )
            q = quat[i] / np.linalg.norm(quat[i])
            largest = int(np.argmax(np.abs(q)))
            q = q * np.sign(q[largest])
            others = np.delete(q, largest) / np.sqrt(2) + 0.5
            color = c if color_bounds else rgb[i]
            packed += struct.pack(
                "<4I",
                _word(p, (11, 10, 11)),
                (largest << 30) | _word(others, (10, 10, 10)),
                _word(s, (11, 10, 11)),
                _word([*color, opacity[i]], (8, 8, 8, 8)),
            )
    names_ = BOUNDS + (COLOR_BOUNDS if color_bounds else [])
    elements = [
        ("chunk", len(groups), [("float", name) for name in names_]),
        ("vertex", n, [("uint", name) for name in PACKED]),
    ]
    data = bounds + packed
    if rest is not None:
        elements.append(("sh", n, [("uchar", f"f_rest_{i}") for i in range(rest.shape[1])]))
        data += rest.astype(np.uint8).tobytes()
    return header(elements) + data


def splat(rows):
    """The bytes of a .splat file; rows: x, scale, (r, g, b, a) and (w, x, y, z) as bytes."""
    return b"".join(struct.pack("<6f8B", *x, *s, *rgba, *quat) for x, s, rgba, quat in rows)


def spz_header(count, version=3, degree=0, bits=12, flags=0, streams=0, magic=b"NGSP"):
    return struct.pack("<4sIIBBBB", magic, version, count, degree, bits, flags, streams)


def spz_sections(rows, version=3):
    """Attributes as bytes; rows: x (fixed-point integers, or floats in version 1), alpha, rgb,
    scale, quat, and the rest of the colors, all bytes."""
    x = [v for row in rows for v in row[0]]
    if version == 1:
        first = struct.pack(f"<{len(x)}e", *x)
    else:
        first = b"".join((v & 0xFFFFFF).to_bytes(3, "little") for v in x)
    return [first] + [bytes(v for row in rows for v in row[k]) for k in range(1, 6)]


def spz(rows, version=3, records=b"", **header):
    """The bytes of a .spz file of version 1 to 3; records: extension records."""
    head = spz_header(len(rows), version, **header)
    return gzip.compress(head + b"".join(spz_sections(rows, version)) + records, 6, mtime=0)


def spz4(rows, pack, records=b"", **header):
    """The bytes of a .spz file of version 4; pack: zstd's compression."""
    sections = [section for section in spz_sections(rows) if section]
    packed = [pack(section) for section in sections]
    head = spz_header(len(rows), 4, streams=len(sections), **header)
    table = b"".join(struct.pack("<QQ", len(p), len(s)) for p, s in zip(packed, sections))
    return head + struct.pack("<I12x", 32 + len(records)) + records + table + b"".join(packed)
