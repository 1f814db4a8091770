"""Broken and hostile .sog, .glb, .gltf and .ksplat files, and what the readers say of them."""

import json
import struct
import zipfile

import numpy as np

from tests.support import splat_containers
from tests.support.hostile_gaussians import GOOD as PLY_GOOD
from tests.support.hostile_gaussians import sparse

META, MEMBERS, _ = splat_containers.sog_members()
SOG_GOOD = splat_containers.sog(META, MEMBERS)
HEADER, BINARY = splat_containers.gltf_parts(splat_containers.gltf_columns(degree=1))
GLB_GOOD = splat_containers.glb(HEADER, BINARY)
GLTF_GOOD = json.dumps(HEADER).encode()
QUAT = (0.5, -0.5, 0.5, 0.5)
DEEP = b"[" * 100_000 + b"]" * 100_000


def ksplat_rows(count, level=1, degree=1):
    sh = [0.5] * 9 if level < 2 else [100] * 9
    x = [(k, 2 * k, 300) for k in range(count)]
    return b"".join(
        splat_containers.ksplat_row(level, p, (0.5, 1, 2), QUAT, (9, 8, 7, 200), sh[: 9 * degree])
        for p in x
    )


def ksplat(count=5, claimed=None, section=None, level=1, lengths=(1, 2), center=0.0, **header):
    """A file of five rows at level 1, in a full bucket of two and others of one and two."""
    section = section or splat_containers.ksplat_section(
        count, 1, buckets=(2, 1, 2), block=5.0, steps=32767
    )
    head = splat_containers.ksplat_header(
        count if claimed is None else claimed, level=level, **header
    )
    start = struct.pack("<2I9f", *lengths, center, *range(8))
    return head + section + start + ksplat_rows(5, level)


KSPLAT_GOOD = ksplat()


def sog(meta=None, members=None, **more):
    return splat_containers.sog(META | (meta or {}), MEMBERS | (members or {}), **more)


def table(key, **change):
    return {key: META[key] | change}


def solid(width, height):
    """A picture of one color: small as a file."""
    return splat_containers.webp(np.full((height, width, 4), 253, np.uint8))


def sog_bomb(path):
    """A member of 300 MB of zeros."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as file:
        file.writestr("meta.json", json.dumps(META))
        for name, data in MEMBERS.items():
            if name != "q.webp":
                file.writestr(name, data)
        with file.open("q.webp", "w") as member:
            for _ in range(300):
                member.write(bytes(1 << 20))


def many_members(path):
    """An archive of 20,000 empty members."""
    with zipfile.ZipFile(path, "w") as file:
        for k in range(20_000):
            file.writestr(str(k), b"")


def sog_of_zeros(path):
    """A small file that claims four million Gaussians, and has the pictures for them."""
    picture = solid(2048, 2048)
    path.write_bytes(sog({"count": 1 << 22}, {name: picture for name in MEMBERS}))


SOG = {
    "empty": (b"", "no ZIP"),
    "a .ply": (PLY_GOOD, "no ZIP"),
    "cut": (SOG_GOOD[:-30], "no readable ZIP"),
    "half of it": (SOG_GOOD[: len(SOG_GOOD) // 2], "no readable ZIP"),
    "an archive of something else": (
        splat_containers.archive({"a.txt": b"hello"}), "no 'meta.json'",
    ),
    "many members": (many_members, "list of members"),
    "a bomb": (sog_bomb, "made to fill the memory"),
    "a header that is a bomb": (
        splat_containers.archive({"meta.json": b" " * (50 << 20)}, zipfile.ZIP_DEFLATED),
        "fill the memory",
    ),
    "pictures of one color": (sog_of_zeros, "fill the memory"),
    "a picture of 268 million pixels": (
        sog(members={"q.webp": solid(16383, 4)[:21]
            + struct.pack("<I", 16382 | 16382 << 14) + solid(16383, 4)[25:]}),
        "expected at most",
    ),
    "a picture of a million pixels for 5": (sog(members={"s.webp": solid(1000, 1000)}), "at most"),
    "a picture too small": (sog({"count": 7}), "6 pixels in 'l.webp' for 7"),
    "no picture": (sog(members={"q.webp": b"hello"}), "broken picture 'q.webp'"),
    "half a picture": (
        sog(members={"l.webp": MEMBERS["l.webp"][:-9]}),
        "broken picture 'l.webp'",
    ),
    "a member that is not there": (sog(table("quats", files=["x.webp"])), "no 'x.webp'"),
    "a name with a line end": (sog(table("quats", files=["x\n\ny"])), "no 'xy'"),
    "no name": (sog(table("quats", files=[])), "no picture 0"),
    "no text as name": (sog(table("quats", files=[7])), "no picture 0"),
    "another method": (sog(method=zipfile.ZIP_LZMA), "than deflate"),
    "no JSON": (splat_containers.sog(b"{nothing", MEMBERS), "cannot be read"),
    "a list": (splat_containers.sog(b"[]", MEMBERS), "no object"),
    "deep": (splat_containers.sog(DEEP, MEMBERS), "nested 100,000 deep"),
    "deep behind a text": (
        splat_containers.sog(b'{"a": "\\"[", "b": ' + DEEP, MEMBERS), "nested 100,001",
    ),
    "quotes": (splat_containers.sog(b'"\\' * (1 << 21), MEMBERS), "cannot be read"),
    "a long number": (
        splat_containers.sog(b'{"version": ' + b"9" * 100_000 + b"}", MEMBERS), "JSON",
    ),
    "no UTF-8": (splat_containers.sog(b'{"version": "\xff"}', MEMBERS), "cannot be read"),
    "version 3": (sog({"version": 3}), "version 3"),
    "version text": (sog({"version": "2"}), "a whole number"),
    "no Gaussians": (sog({"count": 0}), "no Gaussians"),
    "a negative count": (sog({"count": -1}), "whole number"),
    "a count of 10^12": (sog({"count": 10**12}), "allowed are at most"),
    "a count of 10^8": (sog({"count": 10**8}), "fill the memory"),
    "a broken count": (sog({"count": 1.5}), "whole number"),
    "no means": (splat_containers.sog({"version": 2, "count": 5}, MEMBERS), "no 'means'"),
    "nothing": (splat_containers.sog({}, MEMBERS), "no 'means'"),
    "bounds that are no numbers": (sog(table("means", mins=[0, 0, "a"])), "3 numbers"),
    "NaN": (
        splat_containers.sog(
            json.dumps(META | table("means", mins=[float("nan")] * 3)).encode(), MEMBERS
        ),
        "3 numbers",
    ),
    "bounds beyond meters": (sog(table("means", maxs=[1, 1e4, 1])), "above 1e18"),
    "a short codebook": (sog(table("scales", codebook=[0.0])), "not finite"),
    "no codebook": (sog(table("sh0", codebook=[])), "1 to 256 numbers"),
    "a palette of another degree": (sog(table("shN", bands=2)), "not that of its degree"),
    "degree 9": (sog(table("shN", bands=9)), "from 0 to 4"),
    "a palette too long": (sog(table("shN", count=129)), "128 of 129"),
    "a palette too short": (sog(table("shN", count=2)), "not finite"),
    "no rotations": (sog(members={}
        | {"q.webp": splat_containers.webp(np.zeros((2, 3, 4)))}), "no rotation"),
    "a wrong sum": (SOG_GOOD.replace(META["means"]["files"][0].encode(), b"L.webp", 1),
                    "ZIP|no 'l.webp'|damaged"),
}  # fmt: skip


def gltf(change=None, binary=BINARY, **more):
    """The good .glb after a change of its header."""
    header = json.loads(json.dumps(HEADER))
    if change:
        change(header)
    return splat_containers.glb(header | more, binary)


def accessor(index, **change):
    return gltf(lambda header: header["accessors"][index].update(change))


def view(index, **change):
    return gltf(lambda header: header["bufferViews"][index].update(change))


def node(**change):
    return gltf(lambda header: header["nodes"][0].update(change))


def primitive(**change):
    return gltf(lambda header: header["meshes"][0]["primitives"][0].update(change))


def instances(header):
    """A thousand million Gaussians out of four."""
    header["nodes"] = [{"mesh": 0}] * 90_000
    header["scenes"] = [{"nodes": list(range(90_000))}]


def without(name):
    def change(header):
        del header["meshes"][0]["primitives"][0]["attributes"][name]

    return gltf(change)


KHR = splat_containers.KHR
GLTF_CASES = {
    "no scene": ({"scene": 5}, "scenes\\['5'\\] of 1"),
    "a scene of text": ({"scene": "0"}, "scenes"),
    "scenes of text": ({"scenes": "x"}, "a list"),
    "a node that is not there": ({"scenes": [{"nodes": [7]}]}, "nodes\\['7'\\] of 1"),
    "a node of text": ({"nodes": ["x"]}, "an object"),
    "a node in a circle": ({"nodes": [{"mesh": 0, "children": [0]}]}, "no tree"),
    "a node twice": ({"scenes": [{"nodes": [0, 0]}]}, "no tree"),
    "a mesh that is not there": ({"meshes": []}, "meshes\\['0'\\] of 0"),
    "glTF 1": ({"asset": {"version": "1.0"}}, "glTF 1.0"),
    "no asset": ({"asset": []}, "an object"),
    "too many nodes": ({"nodes": [{}] * 100_001}, "100,001 nodes"),
    "no buffers": ({"buffers": []}, "buffers\\['0'\\] of 0"),
}
GLB = {
    "empty": (b"", "not a glTF"),
    "a .ply": (PLY_GOOD, "not a glTF"),
    "text": (GLTF_GOOD, "not a glTF"),
    "half a header": (GLB_GOOD[:9], "truncated"),
    "the header only": (GLB_GOOD[:12], "truncated"),
    "version 1": (splat_containers.glb(HEADER, BINARY, version=1), "version 1"),
    "cut": (GLB_GOOD[:-4], "truncated"),
    "no JSON": (splat_containers.glb(b"{nothing", BINARY), "cannot be read"),
    "deep": (splat_containers.glb(DEEP, BINARY), "nested 100,000 deep"),
    "10 MB of JSON": (splat_containers.glb(b" " * 10_000_000), "the most is"),
    "a chunk too long": (GLB_GOOD[:12] + b"\xff" * 4 + GLB_GOOD[16:], "ends behind"),
    "another chunk": (GLB_GOOD[:16] + b"BIN\0" + GLB_GOOD[20:], "begin with its JSON"),
    "no binary": (gltf(binary=b""), "no bytes for buffers"),
    "half the binary": (gltf(binary=BINARY[:40]), "truncated"),
    "a sparse file of 2 GB": (
        lambda path: sparse(path, gltf_of_zeros(10_000_000), 2_000_000_000),
        "no size or no rotation",
    ),
    "a count of 10^12": (accessor(0, count=10**12), "end behind"),
    "a count of text": (accessor(0, count="4"), "whole number"),
    "a count below zero": (accessor(0, count=-4), "whole number"),
    "other counts": (accessor(0, count=3), "of others"),
    "an offset beyond": (accessor(0, byteOffset=10**6), "end behind"),
    "a view beyond": (view(0, byteOffset=10**6), "end behind"),
    "a view too long": (view(0, byteLength=10**9), "end behind"),
    "a buffer too long": (gltf(buffers=[{"byteLength": 10**9}]), "truncated"),
    "a stride of 0": (view(0, byteStride=0), "whole number"),
    "a stride of 1000": (view(0, byteStride=1000), "whole number"),
    "an unknown number": (accessor(0, componentType=5130), "component type 5130"),
    "a vector of 2": (accessor(0, type="VEC2"), "expected VEC3"),
    "sparse": (accessor(0, sparse={}), "sparse"),
    "compressed": (view(0, extensions={"EXT_meshopt_compression": {}}), "EXT_meshopt"),
    "whole numbers": (accessor(0, componentType=5125), "component type 5125"),
    "an accessor beyond": (primitive(attributes={"POSITION": 99}), "accessors\\['99'\\]"),
    "an accessor of text": (primitive(attributes={"POSITION": "x"}), "accessors"),
    "no rotation": (without(f"{KHR}:ROTATION"), "no KHR.*ROTATION"),
    "no color": (without(f"{KHR}:SH_DEGREE_0_COEF_0"), "no KHR.*SH_DEGREE_0"),
    "half a degree": (without(f"{KHR}:SH_DEGREE_1_COEF_2"), "no KHR.*COEF_2"),
    "triangles": (primitive(mode=4), "mode 0"),
    "indices": (primitive(indices=0), "mode 0"),
    "an extension of text": (primitive(extensions={KHR: "x"}), "an object"),
    "no extension": (primitive(extensions={}), "no Gaussians of KHR"),
    "too many instances": (gltf(instances), "more than 1,024 sets"),
    "mirrored": (node(scale=[1, 1, -1]), "mirrored"),
    "flat": (node(scale=[1, 1, 0]), "mirrored, sheared or without a size"),
    "sheared": (node(matrix=[1, 0, 0, 0, 0.5, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]), "sheared"),
    "a matrix of 15": (node(matrix=[1.0] * 15), "16 numbers"),
    "a shift of text": (node(translation=["a", 0, 0]), "3 numbers"),
    "a shift beyond all bounds": (node(translation=[1e30, 0, 0]), "above 1e18"),
    "a scale beyond all bounds": (node(scale=[1e300] * 3), "above 1e18|mirrored"),
    "scales beyond all bounds": (node(scale=[1e300, 1e299, 1e298]), "above 1e18|mirrored"),
    "a rotation of nothing": (node(rotation=[0, 0, 0, 0]), "unit quaternion"),
    "a file elsewhere": (
        gltf(buffers=[{"byteLength": 4, "uri": "/etc/passwd"}]),
        "outside of its own folder",
    ),
    "positions that are no numbers": (
        gltf(binary=np.full(3, np.nan, "<f4").tobytes() + BINARY[12:]),
        "not finite",
    ),
} | {name: (gltf(**more), says) for name, (more, says) in GLTF_CASES.items()}  # fmt: skip
GLTF = {
    "empty": (b"", "not a glTF"),
    "a .ply": (PLY_GOOD, "not a glTF"),
    "a file that is not there": (
        json.dumps(HEADER | {"buffers": [{"byteLength": 9, "uri": "a.bin"}]}).encode(),
        "there is none",
    ),
    "numbers as text": (
        json.dumps(HEADER | {"buffers": [{"byteLength": 9, "uri": "data:x"}]}).encode(),
        "as text",
    ),
    "no file": (GLTF_GOOD, "no bytes"),
    "cut": (GLTF_GOOD[:-5], "cannot be read"),
    "10 MB": (b"{" + b" " * 10_000_000, "the most is"),
    "deep": (b'{"a":' + DEEP + b"}", "nested"),
} | {
    name: (json.dumps(HEADER | more).encode(), f"{says}|no bytes")
    for name, (more, says) in GLTF_CASES.items()
}


def gltf_of_zeros(count):
    """The beginning of a .glb of `count` Gaussians whose numbers all are zero."""
    header = json.loads(json.dumps(HEADER))
    header["accessors"] = [a | {"count": count, "bufferView": 0} for a in header["accessors"]]
    size = 16 * count
    header["bufferViews"] = [{"buffer": 0, "byteLength": size}]
    header["buffers"] = [{"byteLength": size}]
    start = splat_containers.glb(header, bytes(4))[:-12]
    total = len(start) + 8 + size
    return start[:8] + struct.pack("<I", total) + start[12:] + struct.pack("<I4s", size, b"BIN\0")


def section(count=5, degree=1, buckets=(2, 1, 2), block=5.0, **more):
    """The good file with another header of its section."""
    head = splat_containers.ksplat_section(
        count, degree, buckets=buckets, block=block, steps=32767, **more
    )
    return ksplat(section=head)


KSPLAT = {
    "empty": (b"", "truncated"),
    "a .ply": (PLY_GOOD, "no .ksplat"),
    "a long .ply": (PLY_GOOD + bytes(5000), "no .ksplat"),
    "half a header": (KSPLAT_GOOD[:4000], "truncated"),
    "the header only": (KSPLAT_GOOD[:4096], "sections"),
    "cut": (KSPLAT_GOOD[:-1], "truncated"),
    "version 1.0": (ksplat(version=(1, 0)), "version 1.0"),
    "level 3": (splat_containers.ksplat_header(5, level=3) + KSPLAT_GOOD[4096:], "level 3"),
    "none": (ksplat(claimed=0), "no Gaussians"),
    "another count": (ksplat(claimed=6), "5 Gaussians in its sections"),
    "a negative count": (ksplat(claimed=2**32 - 1), "4,294,967,295"),
    "no sections": (ksplat(sections=0), "0 sections"),
    "sections beyond the end": (ksplat(sections=4000), "4,000 sections"),
    "2^32 sections": (ksplat(sections=2**32 - 1), "sections"),
    "degree 3": (section(degree=3), "degree 3"),
    "degree 65535": (section(degree=65535), "degree 65535"),
    "a huge section": (section(capacity=2**32 - 1), "truncated"),
    "more than there is room for": (section(capacity=4), "truncated"),
    "no block": (section(block=0.0), "block of size 0"),
    "a block that is no number": (section(block=float("nan")), "block of size nan"),
    "full buckets of none": (section(buckets=(0, 1, 2)), "buckets of 0"),
    "full buckets too large": (section(buckets=(9, 1, 2)), "1 buckets of 9"),
    "more buckets than Gaussians": (section(1, buckets=(1, 1, 2)), "of 3 buckets for 1 "),
    "too few in buckets": (section(buckets=(1, 1, 2)), "do not hold"),
    "a bucket of none": (ksplat(lengths=(0, 3)), "do not hold"),
    "a bucket of 2^32": (ksplat(lengths=(1, 2**32 - 1)), "do not hold"),
    "a center that is no number": (ksplat(center=float("nan")), "not finite"),
    "a sparse file of 8 GB": (
        lambda path: sparse(
            path,
            splat_containers.ksplat_header(90_000_000, level=1)
            + splat_containers.ksplat_section(
                90_000_000, 2, buckets=(256, 0, 89_000_000), block=1.0
            ),
            8_000_000_000,
        ),
        "do not hold",
    ),
    "a sparse file of 4 GB at level 0": (
        lambda path: sparse(
            path,
            splat_containers.ksplat_header(90_000_000)
            + splat_containers.ksplat_section(90_000_000),
            4 * 10**9,
        ),
        "no size or no rotation",
    ),
}

CASES = {".sog": SOG, ".glb": GLB, ".gltf": GLTF, ".ksplat": KSPLAT}
GOOD = {".sog": SOG_GOOD, ".glb": GLB_GOOD, ".ksplat": KSPLAT_GOOD}
