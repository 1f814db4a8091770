"""Broken and hostile Gaussian files: their bytes, or what makes them; and what the reader says."""

import gzip
import struct
import zlib

import numpy as np
import zstandard

from tests.support import gaussian_files

GOOD = gaussian_files.plain([gaussian_files.row(), gaussian_files.row(x=(4, 5, 6))])
_RNG = np.random.default_rng(0)
PACKED = gaussian_files.compressed(
    _RNG.normal(size=(5, 3)),
    _RNG.normal(size=(5, 4)),
    _RNG.normal(size=(5, 3)),
    _RNG.random((5, 3)),
    _RNG.random(5),
)
VERTEX = [("float", name) for name in gaussian_files.names()]
CHUNK = [("float", name) for name in gaussian_files.BOUNDS]
WORDS = [("uint", name) for name in gaussian_files.PACKED]


def one_bad(**changes):
    return gaussian_files.plain([gaussian_files.row(), gaussian_files.row(**changes)])


def with_header(*elements, data=b"\0" * 4096, form="binary_little_endian"):
    return gaussian_files.header(elements, form) + data


PLY = {
    "empty": (b"", "does not begin with 'ply'"),
    "a picture": (b"\x89PNG\r\n\x1a\n" + bytes(100), "does not begin with 'ply'"),
    "no end of the header": (b"ply\nformat binary_little_endian 1.0\n", "no end"),
    "an endless header": (b"ply\n" + b"comment x\n" * 20000, "no end"),
    "a line of 100 MB": (
        lambda path: path.write_bytes(b"ply\ncomment " + b"x" * 100_000_000 + GOOD[4:]),
        "no end",
    ),
    "a name of 60 KB": (GOOD.replace(b" nx", b" " + b"n" * 60_000), "header line"),
    "rows of 40 KB": (
        with_header(("vertex", 1, VERTEX + [("double", f"p{i}") for i in range(3000)])),
        "bytes in 'vertex'",
    ),
    "numbers that are no text": (GOOD.replace(b"binary_little_endian", b"ascii"), "row|truncated"),
    "an unknown encoding": (GOOD.replace(b"binary_little_endian", b"base64"), "format base64"),
    "no format": (b"ply\nelement vertex 1\nproperty float x\nend_header\n    ", "format"),
    "a half of it": (GOOD[:-1], "truncated"),
    "the header only": (GOOD[: GOOD.index(b"end_header") + 11], "truncated"),
    "a huge count": (GOOD.replace(b"vertex 2", b"vertex 900000000000"), "truncated"),
    "an absurd count": (GOOD.replace(b"vertex 2", b"vertex " + b"9" * 30), "number of rows"),
    "a sparse file of 2 GB": (
        lambda path: sparse(path, GOOD.replace(b"vertex 2", b"vertex 9000000"), 2 * 10**9),
        "no rotation",
    ),
    "10^9 rows and room for them": (
        lambda path: sparse(
            path, GOOD.replace(b"vertex 2", b"vertex 1000000000"), 68 * 10**9 + 999
        ),
        "allowed are at most",
    ),
    "the other order of bytes": (
        GOOD.replace(b"little_endian", b"big_endian"),
        "no rotation",
    ),
    "a negative count": (GOOD.replace(b"vertex 2", b"vertex -2"), "number of rows"),
    "a worded count": (GOOD.replace(b"vertex 2", b"vertex two"), "number of rows"),
    "nothing in it": (gaussian_files.plain([]), "no Gaussians"),
    "no vertices": (with_header(("face", 1, [("float", "x")])), "vertex"),
    "a mesh": (
        with_header(("vertex", 1, [("float", n) for n in "xyz"])).replace(
            b"end_header", b"element face 1\nproperty list uchar int vertex_index\nend_header"
        ),
        "is a mesh",
    ),
    "a list in the vertices": (
        GOOD.replace(b"property float nx", b"property list uchar float nx"),
        "lists",
    ),
    "points": (with_header(("vertex", 1, [("float", n) for n in "xyz"])), "rot_0"),
    "an unknown type": (
        GOOD.replace(b"float nx", b"quad nx"),
        "unknown type 'quad' of the property",
    ),
    "a property before any element": (
        GOOD.replace(b"element vertex 2\n", b""),
        "header line",
    ),
    "a name twice": (GOOD.replace(b"float ny", b"float nx"), "repeated"),
    "an element twice": (with_header(("vertex", 1, VERTEX), ("vertex", 1, VERTEX)), "twice"),
    "an element without properties": (with_header(("vertex", 10**12, [])), "claims 1,0"),
    "an odd number of colors": (
        with_header(("vertex", 1, VERTEX + [("float", f"f_rest_{i}") for i in range(10)])),
        "10 f_rest",
    ),
    "misnumbered colors": (
        with_header(("vertex", 1, VERTEX + [("float", f"f_rest_{i + 1}") for i in range(9)])),
        "f_rest_0",
    ),
    "not a number": (one_bad(x=(0, np.nan, 0)), "row 1"),
    "infinite": (one_bad(x=(0, 0, np.inf)), "not finite"),
    "a scale beyond all bounds": (one_bad(scale=(0, 0, 1e4)), "not finite"),
    "no rotation": (one_bad(rot=(0, 0, 0, 0)), "no rotation"),
    "an infinite rotation": (one_bad(rot=(np.inf, 0, 0, 0)), "row 1"),
    "a color that is no number": (one_bad(color=(0, np.nan, 0)), "row 1"),
    "an opacity that is no number": (one_bad(opacity=np.nan), "row 1"),
    "packed and short": (PACKED[:-1], "truncated"),
    "packed without chunks": (with_header(("vertex", 5, WORDS)), "0 chunks"),
    "packed with too few chunks": (
        with_header(("chunk", 1, CHUNK), ("vertex", 257, WORDS), data=bytes(8192)),
        "1 chunks for 257",
    ),
    "chunks without bounds": (
        with_header(("chunk", 1, CHUNK[1:]), ("vertex", 5, WORDS)),
        "min_x",
    ),
    "packed as floats": (
        with_header(
            ("chunk", 1, CHUNK), ("vertex", 5, [("float", n) for n in gaussian_files.PACKED])
        ),
        "packed_position",
    ),
    "packed colors for others": (
        with_header(
            ("chunk", 1, CHUNK),
            ("vertex", 5, WORDS),
            ("sh", 4, [("uchar", f"f_rest_{i}") for i in range(9)]),
        ),
        "4 rows of 'sh'",
    ),
    "bounds that are no numbers": (
        gaussian_files.header([("chunk", 1, CHUNK), ("vertex", 5, WORDS)])
        + np.full(12, np.nan, "<f4").tobytes()
        + bytes(80),
        "not finite",
    ),
}


def behind_lists(count, data, kind="list uchar int", order="binary_little_endian"):
    """Bytes of GOOD with an element of lists before the Gaussians."""
    head = f"format {order} 1.0\nelement face {count}\nproperty {kind} vertex_indices\n".encode()
    good = GOOD.replace(b"format binary_little_endian 1.0\n", head)
    return good.replace(b"end_header\n", b"end_header\n" + data)


def text(data, count=2):
    """Bytes of a file of text with the properties of GOOD."""
    return with_header(("vertex", count, VERTEX), data=data, form="ascii")


TEXT_ROW = b"1 2 3 0 0 0 .1 .2 .3 .5 -3 -4 -5 1 0 0 0\n"
PLY |= {
    "lists without end": (behind_lists(10**9, b""), "1,000,000,000 lists in element 'face'"),
    "a list beyond the end": (
        behind_lists(1, b"\xff\xff\xff\xff", "list uint double"),
        "1 rows of 'face'",
    ),
    "a list of -1 items": (behind_lists(1, b"\xff", "list char int"), "1 rows of 'face'"),
    "lists of nothing beyond the end": (behind_lists(50_000, b""), "50,000 rows of 'face'"),
    "a list counted in fractions": (behind_lists(1, b"", "list float int"), "header line"),
    "a list of nothing known": (behind_lists(1, b"", "list uchar quad"), "unknown type 'quad'"),
    "a list without an item's type": (behind_lists(1, b"", "list uchar"), "header line"),
    "text: a line of 100 MB": (
        lambda path: path.write_bytes(text(b"1 " * 50_000_000)),
        "line of more than",
    ),
    "text: a number of 100 MB": (
        lambda path: path.write_bytes(text(b"1" * 100_000_000)),
        "line of more than",
    ),
    "text: 100 MB of blank lines": (
        lambda path: path.write_bytes(text(b"\n" * 100_000_000)),
        "blank lines",
    ),
    "text: a sparse file of 2 GB": (
        lambda path: sparse(path, text(TEXT_ROW, 9_000_000), 2 * 10**9),
        "line of more than",
    ),
    "text: a huge count": (text(TEXT_ROW * 2, 900_000_000_000), "truncated"),
    "text: a row too few": (text(TEXT_ROW * 4 + b" " * 99, 5), "ends after 4 of 5 rows"),
    "text: a number too few": (text(TEXT_ROW + TEXT_ROW[2:]), "row 1 of 'vertex' has 16 numbers"),
    "text: a number too many": (text(b"1 " + TEXT_ROW * 2), "row 0 of 'vertex' has 18 numbers"),
    "text: a word": (
        text(TEXT_ROW + TEXT_ROW.replace(b".5", b"5,0")),
        "row 1 of 'vertex' has text",
    ),
    "text: not a number": (text(TEXT_ROW + TEXT_ROW.replace(b"1 2", b"nan 2")), "row 1"),
    "text: a label of 1.5": (
        with_header(
            ("vertex", 1, [*VERTEX, ("uchar", "label")]),
            data=TEXT_ROW.replace(b"\n", b" 1.5\n"),
            form="ascii",
        ),
        "row 0 of 'vertex' has no integer of 0 to 255 as label",
    ),
    "text: a label of 256": (
        with_header(
            ("vertex", 1, [*VERTEX, ("uchar", "label")]),
            data=TEXT_ROW.replace(b"\n", b" 256\n"),
            form="ascii",
        ),
        "no integer of 0 to 255",
    ),
    "text: 10^9 lines before": (
        lambda path: sparse(path, behind_lists(10**9, b"", order="ascii"), 4 * 10**9),
        "1,000,000,000 lines before",
    ),
}

HONEST = ((0, 0, 0), (1, 1, 1), (9, 9, 9, 9), (255, 128, 128, 128))
SPLAT = {
    "empty": (b"", "no Gaussians"),
    "a byte too many": (gaussian_files.splat([HONEST]) + b"x", "truncated"),
    "cut": (gaussian_files.splat([HONEST] * 3)[:-5], "truncated"),
    "a .ply": (GOOD + bytes(-len(GOOD) % 32), "begins like a .ply"),
    "a picture": (b"\x89PNG\r\n\x1a\n" + bytes(88), "begins like a picture"),
    "gzip": (b"\x1f\x8b\x08" + bytes(93), "begins like a gzip"),
    "text": (b"these are not Gaussians at all, " * 4, "is text"),
    "not a number": (gaussian_files.splat([HONEST, ((0, np.nan, 0), *HONEST[1:])]), "row 1"),
    "infinite": (gaussian_files.splat([((np.inf, 0, 0), *HONEST[1:])]), "row 0"),
    "a negative scale": (gaussian_files.splat([(HONEST[0], (1, -1, 1), *HONEST[2:])]), "no size"),
    "no rotation": (gaussian_files.splat([(*HONEST[:3], (128,) * 4)]), "no rotation"),
    "no size": (bytes(3200), "no size"),
    "a sparse file of 2 GB": (lambda path: sparse(path, b"", 2_000_000_000), "at least 16,384 of"),
    "a sparse file of 64 GB": (lambda path: sparse(path, b"", 64 << 30), "allowed are at most"),
}

SPZ_ROW = ((1, 2, 3), (9,), (1, 2, 3), (150, 150, 150), (0, 0, 0, 192), ())
SPZ_GOOD = gaussian_files.spz([SPZ_ROW] * 50)
# a camera's limits and the frame RUB
SPZ_RECORDS = struct.pack("<IIfff", 0xADBE0002, 12, 0, 1, 1) + struct.pack("<III", 0xADBE0003, 4, 4)
ZSTD = zstandard.ZstdCompressor().compress
SPZ_EXTENDED = gaussian_files.spz([SPZ_ROW] * 50, records=SPZ_RECORDS, flags=2)
SPZ4_GOOD = gaussian_files.spz4([SPZ_ROW] * 50, ZSTD)
SPZ4_EXTENDED = gaussian_files.spz4([SPZ_ROW] * 50, ZSTD, records=SPZ_RECORDS, flags=3)


def spz_header(count=1, data=bytes(20), **header):
    return gzip.compress(gaussian_files.spz_header(count, **header) + data, 1, mtime=0)


def spz_bomb(path, count, size, flags=0):
    """A header and `size` zeros: a thousandth of them as a file."""
    packer = zlib.compressobj(1, zlib.DEFLATED, 31)
    with open(path, "wb") as file:
        file.write(packer.compress(gaussian_files.spz_header(count, flags=flags)))
        for _ in range(size >> 20):
            file.write(packer.compress(bytes(1 << 20)))
        file.write(packer.flush())


SPZ = {
    "empty": (b"", "not a .spz"),
    "a .ply": (GOOD, "not a .spz"),
    "gzip of nothing": (gzip.compress(b"", mtime=0), "header"),
    "gzip of a .ply": (gzip.compress(GOOD, mtime=0), "NGSP"),
    "half a header": (gzip.compress(b"NGSP\x03\0\0\0", mtime=0), "header"),
    "version 0": (spz_header(version=0), "version 0"),
    "version 9": (spz_header(version=9), "version 9"),
    "version 4 in gzip": (spz_header(version=4), "version 4"),
    "a negative version": (spz_header(version=2**32 - 1), "version 4294967295"),
    "colors of degree 9": (spz_header(degree=9), "degree 9"),
    "60 fraction bits": (spz_header(bits=60), "60 fraction bits"),
    "none": (spz_header(count=0, data=b""), "no Gaussians"),
    "a negative count": (spz_header(count=2**32 - 1), "4,294,967,295"),
    "a huge count": (spz_header(count=90_000_000), "fill the memory"),
    "a count too high": (spz_header(count=2), "truncated"),
    "a count too low": (spz_header(data=bytes(40)), "holds more"),
    "cut": (SPZ_GOOD[:-20], "truncated"),
    "damaged": (SPZ_GOOD[:40] + bytes(9) + SPZ_GOOD[49:], "gzip"),
    "a wrong sum": (SPZ_GOOD[:-8] + bytes(4) + SPZ_GOOD[-4:], "gzip"),
    "a bomb": (lambda path: spz_bomb(path, (500 << 20) // 20, 500 << 20), "fill the memory"),
    "a bomb behind one Gaussian": (lambda path: spz_bomb(path, 1, 500 << 20), "holds more"),
    "positions that are no numbers": (
        gaussian_files.spz([((np.nan, 0, 0), *SPZ_ROW[1:4], (1, 1, 1), ())], version=1),
        "not finite",
    ),
}


def spz4():
    """Files of version 4."""
    good, table = SPZ4_GOOD, 32

    def bomb(path):
        zeros = ZSTD(bytes(300 << 20))
        first = struct.pack("<QQ", len(zeros), 450)
        path.write_bytes(good[:table] + first + good[table + 16 : table + 80] + zeros)

    return {
        "4: no streams": (good[:15] + b"\0" + good[16:], "no table"),
        "4: 255 streams": (good[:15] + b"\xff" + good[16:], "no table"),
        "4: a table beyond the end": (good[:16] + b"\xff" * 4 + good[20:], "no table"),
        "4: a table in the header": (good[:16] + struct.pack("<I", 8) + good[20:], "no table"),
        "4: a table beyond 2 GB of records": (
            SPZ4_EXTENDED[:16] + struct.pack("<I", 2**31) + SPZ4_EXTENDED[20:],
            "no table",
        ),
        "4: a table in the records": (
            SPZ4_EXTENDED[:16] + struct.pack("<I", 40) + SPZ4_EXTENDED[20:],
            "a stream of",
        ),
        "4: a byte too many": (good + b"x", "more than its streams"),
        "4: cut in the header": (good[:25], "header"),
        "4: cut": (good[:-3], "zstd|length"),
        "4: a stream too long": (
            good[: table + 8] + struct.pack("<Q", 2**63) + good[table + 16 :],
            "expected 450",
        ),
        "4: a packed stream too long": (
            good[:table] + struct.pack("<Q", 2**63) + good[table + 8 :],
            "the file has",
        ),
        "4: no zstd": (good[:112] + bytes(len(good) - 112), "zstd"),
        "4: a bomb": (bomb, "zstd"),
        "4: a huge count": (good[:8] + struct.pack("<I", 90_000_000) + good[12:], "fill the mem"),
        "4: degree 9": (good[:12] + b"\x09" + good[13:], "degree 9"),
        "4: version 5": (good[:4] + b"\x05" + good[5:], "version 5"),
    }


def damaged(count=200, seed=8):
    """Files of text and with lists, each damaged at a few places or cut."""
    rng = np.random.default_rng(seed)
    face = ["element face 3", "property list uchar int vertex_indices", "property float area"]
    lists = b"".join(struct.pack("<B3if", 3, 1, 2, 3, 0.5) for _ in range(3))
    line = b"3 1 2 3 0.5\n" * 3
    labeled = gaussian_files.columns(n=40, rest=9, label=("uchar", list(range(40))))
    originals = [
        gaussian_files.table(labeled, "ascii"),
        gaussian_files.table(labeled, "ascii", before=(face, line), behind=(["element a 1"], b"")),
        gaussian_files.table(labeled, "<", before=(face, lists)),
        gaussian_files.table(labeled, "<", behind=(["element last 3", *face[1:]], lists)),
        gaussian_files.table(gaussian_files.columns(n=40, scales=2, filter_3D=("float", [1] * 40))),
    ]
    pieces = [b"9" * 12, b" ", b"\n", b"-", b"e9", b"nan", b"list uchar ", b"\xff" * 4, b"\0" * 8]
    for k in range(count):
        data = originals[k % len(originals)]
        for _ in range(rng.integers(1, 4)):
            # few places lie in the header, before the properties of the Gaussians
            top, end = (data.find(text) for text in (b"property float x", b"end_header"))
            in_header = rng.random() < 0.15
            at = int(rng.integers(*((4, max(top, 5)) if in_header else (end, len(data) + 1))))
            width = int(rng.integers(0, 12))
            data = data[:at] + pieces[rng.integers(len(pieces))] + data[at + width :]
        yield data[: rng.integers(len(data) // 2, len(data))] if rng.random() < 0.2 else data


def cases():
    """(suffix, name) -> (bytes or what makes the file, what is said)."""
    from tests.support import hostile_containers  # it builds on this module

    kinds = {".ply": PLY, ".splat": SPLAT, ".spz": SPZ | spz4()} | hostile_containers.CASES
    return {(suffix, name): case for suffix, bad in kinds.items() for name, case in bad.items()}


def make(path, data):
    """Write a case's file."""
    data(path) if callable(data) else path.write_bytes(data)


def sparse(path, head, size):
    """A file that begins with `head` and takes no room for its zeros."""
    path.write_bytes(head)
    with open(path, "r+b") as file:
        file.truncate(size)
