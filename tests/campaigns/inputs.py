"""Spoiled Gaussian files, meshes and pictures: read, or refused by a line that names it."""

import base64
import contextlib
import functools
import io
import random
import re
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np

from tests.campaigns import worker
from tests.campaigns.result import Result
from tests.support import drawn_runs, hostile_gaussians
from tests.support import gaussian_files as written
from tests.support.small_scenes import ROOM

NAME = "inputs"
COUNT = 300
SMALL = 24

SCENE = f"""{ROOM}
[[object]]
name = "thing"
material = "clay"
{{source}} = "{{file}}"
height = 0.1
position = [0.2, 0.2, 0.2]
"""
RENDER = '[picture]\nwidth = 48\nheight = 32\nbackground = "{}"\n'
OBJ = """mtllib thing.mtl
v 0 0 0
v 1 0 0
v 1 1 0.5
v 0 1 1
vt 0 0
vt 1 0
vt 1 1
vt 0 1
usemtl paint
f 1/1 2/2 3/3
f 1/1 3/3 4/4
f 1/1 4/4 2/2
"""
MTL = "newmtl paint\nmap_Kd {}\n"
GAUSSIANS, MESHES = (".ply", ".splat", ".spz"), (".obj", ".stl", ".ply", ".vtk", ".vtu")
PICTURES = (".png", ".jpg")
Good = dict[tuple[str, str], list[bytes]]  # by what they are for and how their names end


@functools.cache
def good(folder: Path) -> Good:
    """Small files that are read; folder: for those that are written by programs."""
    random = np.random.default_rng(0)
    x, turn = random.normal(size=(60, 3)), random.normal(size=(60, 4))
    rows = [written.row(x=p, rot=q, rest=[0.1] * 9) for p, q in zip(x, turn, strict=True)]
    found: Good = {
        ("gaussians", ".ply"): [
            hostile_gaussians.PACKED,
            written.plain(rows, 9),
            written.compressed(x, turn, x - 4, abs(x) % 1, abs(x[:, 0]) % 1),
        ],
        ("gaussians", ".splat"): [written.splat([hostile_gaussians.HONEST] * 3 + [
            (p, (0.1, 0.2, 0.3), *hostile_gaussians.HONEST[2:]) for p in x])],
        ("gaussians", ".spz"): _spz(random),
    }  # fmt: skip
    for suffix in MESHES:
        found["mesh", suffix] = _meshes(folder, suffix)
    for suffix in PICTURES:
        found["map_Kd", suffix] = found["background", suffix] = _pictures(suffix)
    return found


def _spz(random: np.random.Generator) -> list[bytes]:
    rows = [
        (*(random.integers(0, 256, k).tolist() for k in (3, 1, 3, 3, 4)), ()) for _ in range(60)
    ]
    rows = [(tuple(100 * v for v in row[0]), *row[1:]) for row in rows]
    found = [written.spz(rows)]
    with contextlib.suppress(ImportError):
        import zstandard

        found.append(written.spz4(rows, zstandard.ZstdCompressor().compress))
    return found


def _meshes(folder: Path, suffix: str) -> list[bytes]:
    """A bent sheet with a lid, in all ways in which meshio (.vtp: VTK) writes such a file."""
    import meshio
    import pyvista

    u = np.stack(np.meshgrid(*(np.linspace(0, 1, 5),) * 2), -1).reshape(-1, 2)
    points = np.column_stack([u, 0.3 * np.sin(3 * u[:, 0]) + u[:, 1] ** 2])
    at = [[k, k + 1, k + 6, k + 5] for k in range(20) if k % 5 < 4]
    cells = [("triangle", [t for a, b, c, d in at for t in ((a, b, c), (a, c, d))])]
    mesh = meshio.Mesh(
        points, cells, point_data={"red": u[:, 0], "green": u[:, 1], "blue": u[:, 1]}
    )
    ways = {
        ".obj": [{}],
        ".stl": [{"binary": True}, {"binary": False}],
        ".ply": [{"binary": True}, {"binary": False}],
        ".vtk": [{"binary": True}, {"binary": False}],
        ".vtp": [{"binary": True}, {"binary": False}],
        ".vtu": [{"binary": False}, {"compression": None}, {"compression": "zlib"},
                 {"compression": "lzma"}],
    }  # fmt: skip
    found = []
    for options in ways[suffix]:
        path = folder / f"good{suffix}"
        with contextlib.redirect_stderr(io.StringIO()):  # it has much to say
            if suffix == ".vtp":  # meshio has none
                pyvista.PolyData.from_regular_faces(points, cells[0][1]).save(path, **options)
            else:
                mesh.write(path, **options)
        found.append(path.read_bytes())
    return found + ([OBJ.encode()] if suffix == ".obj" else [])


def _pictures(suffix: str) -> list[bytes]:
    """In color, with opacity, grey, deep, of few colors."""
    from PIL import Image

    bow = np.arange(40 * 30 * 3, dtype=np.uint8).reshape(30, 40, 3)
    all_ = [Image.fromarray(bow), Image.fromarray(bow[:, :, 0])]
    if suffix == ".png":
        deep = Image.fromarray(bow[:, :, 0].astype(np.uint16) * 257)
        all_ += [all_[0].convert("RGBA"), all_[0].convert("P"), deep, all_[0].convert("LA")]
    found = []
    for picture in all_:
        data = io.BytesIO()
        picture.save(data, "PNG" if suffix == ".png" else "JPEG")
        found.append(data.getvalue())
    return found


def campaign(count: int, seed: int, folder: Path) -> Result:
    """count: of files. Those that fail stay in the folder, with the scene that names them."""
    folder.mkdir(parents=True, exist_ok=True)
    run = drawn_runs.write(folder / "run", frames=2)
    all_ = good(folder)
    cases, spoiled, kinds = [], [], sorted(all_)
    for k, kind in enumerate([None, *(kinds[k % len(kinds)] for k in range(count))]):
        draw = random.Random(f"{seed} {k}")
        of = kind or ("mesh", ".vtu")
        path = folder / f"{k:04}" / f"thing{of[1]}"
        path.parent.mkdir(exist_ok=True)
        data = draw.choice(all_[of])
        path.write_bytes(spoil(data, of, all_, draw) if kind else data)
        spoiled.append(path)
        cases.append(_commands(of[0], path, run))
    warm = [*cases.pop(0), *_commands("background", _picture(folder, all_), run)]
    return worker.judged(spoiled[1:], cases, warm, _where, _named)


def _named(path: Path, command: list[str], code: int) -> str:
    return f"{path.suffix} {'refused' if code else 'read'}"


def _picture(folder: Path, all_: Good) -> Path:
    path = folder / "0000" / "thing.png"
    path.write_bytes(all_["background", ".png"][0])
    return path


def _commands(use: str, path: Path, run: Path) -> worker.Case:
    """What reads the file; the files that name it are written."""
    if use == "background":
        settings = path.with_name("render.toml")
        settings.write_text(RENDER.format(path.name))
        result = str(path.with_name("picture.png"))
        return [["render", str(run), str(settings), "-q", "-o", result]]
    thing, scene = path, path.with_name("scene.toml")
    if use == "map_Kd":
        path.with_name("thing.mtl").write_text(MTL.format(path.name))
        thing = path.with_name("thing.obj")
        thing.write_text(OBJ)
    source = "gaussians" if use == "gaussians" else "mesh"
    scene.write_text(SCENE.format(source=source, file=thing.name))
    return [["vgmpi", "--inspect", str(thing)], ["vgmpi", str(scene), "--check"]]


def _where(path: Path, command: list[str]) -> re.Pattern:
    """How lines begin: with the file; of a scene whose file could be read, with a key's place."""
    name = re.escape(str(path))
    if "--check" in command:
        return re.compile(rf"{re.escape(command[1])}:\d+: object.thing.\w+: ")
    key = r"(?:\S+/render\.toml:\d+: picture\.background: )?"
    return re.compile(rf"(?:vgmpi: )?{key}'?{name}'?:? .+")


def spoil(data: bytes, kind: tuple[str, str], all_: Good, draw: random.Random) -> bytes:
    """A good file after one to three blows; or a bomb, or another file under its name."""
    bombs = BOMBS.get(kind[1], [])
    if bombs and draw.random() < 0.12:
        return draw.choice(bombs)(data)
    if draw.random() < 0.06:
        return draw.choice(all_[draw.choice(sorted(all_))])
    for _ in range(draw.choice((1, 1, 2, 3))):
        data = draw.choice(_BLOWS)(data, draw)
    return data


def _flipped(data: bytes, draw: random.Random) -> bytes:
    out = bytearray(data)
    for _ in range(draw.choice((1, 2, 8, 40)) if out else 0):
        out[draw.randrange(len(out))] ^= 1 << draw.randrange(8)
    return bytes(out)


def _flipped_head(data: bytes, draw: random.Random) -> bytes:
    out = bytearray(data)
    for _ in range(draw.choice((1, 2)) if out else 0):
        out[draw.randrange(min(len(out), 200))] = draw.randrange(256)
    return bytes(out)


def _cut(data: bytes, draw: random.Random) -> bytes:
    return data[: draw.randrange(len(data) + 1)]


def _overwritten(data: bytes, draw: random.Random) -> bytes:
    """A piece of zeros, ones, text or noise."""
    at, long = draw.randrange(len(data) + 1), draw.choice((4, 60, 5000))
    long = min(long, len(data) - at)
    new = draw.choice((bytes(long), b"\xff" * long, b"a text \n" * long, draw.randbytes(long)))
    return data[:at] + new[:long] + data[at + long :]


def _moved(data: bytes, draw: random.Random) -> bytes:
    """A piece left out, or doubled somewhere else."""
    at, long = draw.randrange(len(data) + 1), draw.choice((1, 2, 4, 100))
    if draw.random() < 0.5:
        return data[:at] + data[at + long :]
    to = draw.randrange(len(data) + 1)
    return data[:to] + data[at : at + long] + data[to:]


def _number(data: bytes, draw: random.Random) -> bytes:
    """A number written in the file, most often of its header, becomes another."""
    found = [*re.finditer(rb"-?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?", data[:6000])]
    if not found:
        return data
    match = draw.choice(found[:12] if draw.random() < 0.6 else found)
    return data[: match.start()] + draw.choice(NUMBERS) + data[match.end() :]


def _binary(data: bytes, draw: random.Random) -> bytes:
    """A number of four or eight bytes becomes an extreme one, in either order of bytes."""
    form, value = draw.choice((*(("f", v) for v in FLOATS), *(("d", v) for v in FLOATS),
                               *(("I", v) for v in WORDS), *(("Q", v) for v in WORDS)))  # fmt: skip
    new = struct.pack(draw.choice("<>") + form, value)
    at = draw.randrange(max(len(data) - 8, 1))
    at -= at % draw.choice((1, 4))
    return data[:at] + new + data[at + len(new) :]


def _order(data: bytes, draw: random.Random) -> bytes:
    """The other order of bytes, or text for binary, is claimed."""
    old, new = draw.choice((
        (b"little_endian", b"big_endian"), (b"binary_little_endian", b"ascii"),
        (b"ascii", b"binary_little_endian"), (b"LittleEndian", b"BigEndian"),
        (b"BINARY", b"ASCII"), (b"ASCII", b"BINARY"), (b'format="binary"', b'format="ascii"'),
        (b'format="ascii"', b'format="binary"'), (b"Float64", b"Int8"), (b"double", b"int"),
        (b"float", b"double"), (b"vtkZLib", b"vtkLZMA"), (b"UInt32", b"UInt64"), (b"\n", b"\r\n"),
        (b"triangle", b"line"), (b"UNSTRUCTURED_GRID", b"STRUCTURED_GRID"), (b" ", b"\t"),
    ))  # fmt: skip
    return data.replace(old, new)


def _many_numbers(data: bytes, draw: random.Random) -> bytes:
    """Every so many bytes of the second half a number that is none."""
    out, value = bytearray(data), struct.pack("<f", draw.choice(FLOATS))
    for at in range(len(out) // 2 & ~3, len(out) - 4, draw.choice((4, 12, 68))):
        out[at : at + 4] = value
    return bytes(out)


NUMBERS = [b"0", b"-1", b"1", b"255", b"65536", b"2147483647", b"2147483648", b"4294967296",
           b"9223372036854775807", b"99999999999999999999", b"1e308", b"1e400", b"-1e39", b"nan",
           b"inf", b"-inf", b"5e-324", b"1e-40", b"9" * 5000, b"x", b"", b"3.5"]  # fmt: skip
FLOATS = [float("nan"), float("inf"), float("-inf"), 3e38, -3e38, 1e-44, 1e-30, 0.0, 1e10, -1e10]
WORDS = [0, 1, 2, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 0xFFFF, 0x1000000, 30000]
_BLOWS = (_flipped, _flipped_head, _cut, _overwritten, _moved, _number, _number, _binary, _binary,
          _order, _many_numbers)  # fmt: skip


def _spz_bomb(data: bytes) -> bytes:
    return _packed(written.spz_header((1200 << 20) // 20), 1200, 31)


def _vtu_bomb(data: bytes) -> bytes:
    """Points that become 1.2 GB."""
    packed = _packed(b"", 1200, 15)
    head = struct.pack("<IIII", 1, 1200 << 20, 1200 << 20, len(packed))
    points = base64.b64encode(head) + base64.b64encode(packed)
    return (
        b"""<?xml version="1.0"?>
<VTKFile type="UnstructuredGrid" version="0.1" byte_order="LittleEndian" header_type="UInt32"
 compressor="vtkZLibDataCompressor"><UnstructuredGrid>
<Piece NumberOfPoints="52428800" NumberOfCells="0"><Points>
<DataArray type="Float64" Name="Points" NumberOfComponents="3" format="binary">
%s</DataArray></Points></Piece></UnstructuredGrid></VTKFile>"""
        % points
    )


def _vtu_laughs(data: bytes) -> bytes:
    """Entities of XML in each other."""
    names = [f'<!ENTITY a{k} "{f"&a{k - 1};" * 10}">' for k in range(1, 12)]
    head = f'<!DOCTYPE x [<!ENTITY a0 "{"1 " * 10}">{"".join(names)}]>'
    body = data[data.index(b"<VTKFile") :].replace(b"</Points>", b"&a11;</Points>")
    return b'<?xml version="1.0"?>\n' + head.encode() + body


def _png_bomb(data: bytes) -> bytes:
    """30,000 x 30,000 pixels that are there."""
    return _png(30_000, 30_000, _packed(b"", 859, 15))


def _png_large(data: bytes) -> bytes:
    """8,192 x 8,192 pixels: few enough to be read where there is memory for them."""
    return _png(8192, 8192, _packed(b"", 65, 15))


def _png_text_bomb(data: bytes) -> bytes:
    """A comment of 1.2 GB before the picture."""
    body = b"zTXt" + b"a\0\0" + _packed(b"", 1200, 15)
    return data[:33] + _chunk(body) + data[33:]


def _png_profile_bomb(data: bytes) -> bytes:
    body = b"iCCP" + b"a\0\0" + _packed(b"", 1200, 15)
    return data[:33] + _chunk(body) + data[33:]


def _png_claim(data: bytes) -> bytes:
    """As many pixels as are read, of which hardly one is there."""
    return _png(8192, 8192, zlib.compress(bytes(9)))


def _png(width: int, height: int, packed: bytes) -> bytes:
    head = _chunk(b"IHDR" + struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + head + _chunk(b"IDAT" + packed) + _chunk(b"IEND")


def _chunk(body: bytes) -> bytes:
    return struct.pack(">I", len(body) - 4) + body + struct.pack(">I", zlib.crc32(body))


@functools.cache
def _packed(first: bytes, megabytes: int, form: int) -> bytes:
    """`first` and as many zeros, packed; form: 15 of zlib, 31 of gzip."""
    packer = zlib.compressobj(9, zlib.DEFLATED, form)
    parts = [packer.compress(first)]
    parts += [packer.compress(bytes(1 << 20)) for _ in range(megabytes)]
    return b"".join([*parts, packer.flush()])


def _ply_claim(data: bytes) -> bytes:
    """Faces of a hundred million corners."""
    return re.sub(rb"element (vertex|face) \d+", rb"element \1 100000000", data)


def _grid(data: bytes) -> bytes:
    return (b"# vtk DataFile Version 3.0\nx\nASCII\nDATASET STRUCTURED_POINTS\n"
            b"DIMENSIONS 2000 2000 2000\nORIGIN 0 0 0\nSPACING 1 1 1\n")  # fmt: skip


BOMBS: dict[str, list[Callable[[bytes], bytes]]] = {
    ".ply": [_ply_claim],
    ".spz": [_spz_bomb],
    ".vtk": [_grid],
    ".vtu": [_vtu_bomb, _vtu_bomb, _vtu_laughs],
    ".png": [_png_bomb, _png_large, _png_text_bomb, _png_profile_bomb, _png_claim],
}
